"use strict";
const touched = matchMedia("(pointer: coarse)").matches;
/* Puts a plot in the place of each picture: dragging zooms into a rectangle (a pinch, on a touch screen), a double click
   shows all again. Lengths and letters of the plot are shares of its width. */
const title = document.title.toLowerCase().replace(/[^\p{L}\p{N}]+/gu, " ").trim().replaceAll(" ", "-");
document.querySelectorAll("figure:has(> script)").forEach((figure, index) => {
  const given = JSON.parse(figure.querySelector("script").textContent), picture = figure.querySelector("img");
  const place = picture.insertAdjacentElement("afterend", document.createElement("div"));
  place.className = "plot";
  place.style.aspectRatio = given.aspect;
  place.role = "img";
  place.ariaLabel = picture.alt;
  const plot = echarts.init(place, null, {renderer: "svg"});
  const draw = () => {
    plot.setOption(option(given, place.clientWidth), true);
    const whole = ticks(given, place, (name, index) => [given[name][index].min, given[name][index].max]);
    plot.setOption({...whole, yAxis: whole.yAxis.map((one, index) => ({...one, nameGap: beside(one, given, index, place)}))});
    if (!touched) {
      plot.dispatchAction({type: "takeGlobalCursor", key: "dataZoomSelect", dataZoomSelectActive: true});
    }
  };
  draw();
  figure.classList.add("live");
  new ResizeObserver(() => {
    plot.resize();
    draw();
  }).observe(place);
  plot.on("datazoom", () => plot.setOption(ticks(given, place, (name, index) =>
    plot.getModel().getComponent(name, index).axis.scale.getExtent())));
  plot.getZr().on("dblclick", () => plot.dispatchAction({type: "dataZoom", batch: plot.getOption().dataZoom.map(
    (_, dataZoomIndex) => ({dataZoomIndex, start: 0, end: 100}))}));
  const links = figure.querySelector("figcaption").appendChild(document.createElement("span"));
  links.className = "saves";
  const link = values => links.appendChild(Object.assign(document.createElement("a"), values));
  const file = `${title}-${index + 1}`;
  const save = link({textContent: "SVG", href: "#", title: "Save what is shown"});
  link({textContent: "PDF", href: picture.dataset.pdf, download: `${file}.pdf`, title: "Save the whole picture"});
  save.addEventListener("click", event => {
    event.preventDefault();
    Object.assign(document.createElement("a"), {href: plot.getDataURL({type: "svg"}), download: `${file}.svg`}).click();
  });
});

function letters(given, width) {
  return Math.max(9, given.letters * width);
}

/* Of the axes that name no values of their own, from their ends. */
function ticks(given, place, ends) {
  const size = letters(given, place.clientWidth);
  const made = (name, length, share) => given[name].map((one, index) => one.ticks || one.type === "time" ? {} :
    ticked(one, ...ends(name, index), Math.max(2, Math.round(length * parseFloat(given.grid[index][share]) / 100 / size))));
  return {xAxis: made("xAxis", place.clientWidth / 5, "width"), yAxis: made("yAxis", place.clientHeight / 2, "height")};
}

/* Where the title of a y axis stands: beside the longest label. */
function beside(ticked, given, index, place) {
  const longest = Math.max(0, ...(ticked.axisLabel?.customValues ?? []).map(value => String(+value.toPrecision(4)).length));
  return Math.max((given.yAxis[index].nameGap ?? 0) * place.clientWidth,
    longest && (0.6 * longest + 1) * letters(given, place.clientWidth));
}

/* Round values on an axis from low to high that has room for so many labels. On a logarithmic one: powers of ten, and
   what lies between where fewer than two of them are seen. */
function ticked(axis, low, high, room) {
  const steps = [1, 2, 5, 10].map(digit => digit * 10 ** Math.floor(Math.log10((high - low) / room)));
  const step = Math.max(axis.whole ? 1 : 0, steps.find(one => (high - low) / one <= room));
  const finer = steps.filter(one => one < step && (!axis.whole || one >= 1)).reverse();  // where step meets one value
  const even = [step, ...finer].map(by => Array.from(
    {length: Math.ceil((high - low) / by) + 1}, (_, k) => +((Math.ceil(low / by) + k) * by).toPrecision(12)));
  const first = Math.floor(Math.log10(low)), powers = axis.type === "log" ?
    Array.from({length: Math.floor(Math.log10(high)) - first + 1}, (_, k) => first + k) : [];
  const offered = [[1], [1, 2, 5], [1, 2, 3, 4, 5, 6, 7, 8, 9]].map(
    digits => powers.flatMap(power => digits.map(digit => +`${digit}e${power}`)));
  const customValues = [...offered, ...even].map(values => values.filter(value => low <= value && value <= high)).find(
    values => values.length > 1) ?? [];
  return {axisTick: {customValues}, axisLabel: {customValues, showMinLabel: true, showMaxLabel: true}};
}

function option(given, width) {
  const size = letters(given, width);
  const colour = getComputedStyle(document.body).getPropertyValue("--soft");
  const number = value => value === null || !Number.isFinite(+value) ? "" : String(+(+value).toPrecision(4));
  const axis = one => ({
    ...one, nameGap: (one.nameGap ?? 0) * width, nameTextStyle: {fontSize: size, color: colour},
    splitLine: {show: false}, axisLine: {show: true, onZero: false, lineStyle: {color: colour}},
    axisTick: {show: !one.mute, ...one.ticks && {customValues: one.ticks}},
    axisLabel: {
      show: !one.mute, fontSize: size, color: colour, hideOverlap: !one.ticks, showMinLabel: !!one.ticks,
      showMaxLabel: !!one.ticks, rotate: one.rotate ?? 0,
      ...one.ticks && {customValues: one.ticks, formatter: value => one.texts[one.ticks.indexOf(value)] ?? ""},
      ...!one.ticks && one.type !== "time" && {formatter: number},
    },
    axisPointer: {label: {show: !one.ticks, fontSize: size, formatter: ({value}) =>
      one.type === "time" ? new Date(value).toISOString().slice(0, 16) : number(value)}},
    ...one.type === "time" && {splitNumber: 4},
  });
  const series = given.series.map(one => one.type !== "custom" ? {
    ...one, animation: false, data: one.data.map(item => item.label ?
      {...item, label: {...item.label, fontSize: size * item.label.share}} : item),
  } : {
    ...one, animation: false, encode: {x: [0, 1], y: [2, 3], tooltip: 4}, clip: true, itemStyle: {color: one.color},
    renderItem: (params, api) => {
      const [x, y] = api.coord([api.value(0), api.value(3)]), [right, bottom] = api.coord([api.value(1), api.value(2)]);
      const own = one.data[params.dataIndex][5]; // cells side by side, without a gap
      return {type: "rect", style: {fill: own ?? one.color, ...own && {stroke: own, lineWidth: 1}},
        shape: echarts.graphic.clipRectByRect({x, y, width: right - x, height: bottom - y}, params.coordSys)};
    },
  });
  const alike = one => given.xAxis.flatMap((other, index) => other.min === one.min && other.max === one.max ? [index] : []);
  const zoomed = [...new Set(given.xAxis.map(one => String(alike(one))))].map(
    indices => ({xAxisIndex: indices.split(",").map(Number)})); // panels of one abscissa zoom together
  zoomed.push(...given.yAxis.map((_, index) => ({yAxisIndex: [index]})));
  return {
    animation: false, useUTC: true, textStyle: {fontSize: size, color: colour}, grid: given.grid,
    xAxis: given.xAxis.map(axis), yAxis: given.yAxis.map(axis), series,
    legend: {show: given.legend.data.length > 0, data: given.legend.data, top: 0, left: 0, icon: "rect", itemWidth: 1.4 * size,
      itemHeight: size * 0.25, textStyle: {fontSize: size, color: colour}},
    tooltip: {
      trigger: series.some(one => one.type === "custom") ? "item" : "axis", axisPointer: {type: "cross"}, confine: true,
      textStyle: {fontSize: size}, transitionDuration: 0,
      formatter: found => [found].flat().filter(one => one.seriesName || one.value?.[4] !== undefined).map(one =>
        `${one.marker} ${echarts.format.encodeHTML(one.seriesName)} ${number(one.value[4] ?? one.value[1])}`).join("<br>"),
    },
    toolbox: {itemSize: 0, feature: {dataZoom: {filterMode: "none"}}},
    dataZoom: zoomed.map(axes => ({type: "inside", ...axes, filterMode: "none", zoomOnMouseWheel: "ctrl",
      moveOnMouseMove: touched, preventDefaultMouseMove: false})),
  };
}
