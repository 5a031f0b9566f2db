"use strict";
const touched = matchMedia("(pointer: coarse)").matches;
/* Puts a plot in the place of each picture: dragging zooms into a rectangle (a pinch, on a touch screen), a double click
   shows all again. Lengths and letters of the plot are shares of its width. */
for (const figure of document.querySelectorAll("figure:has(> script)")) {
  const given = JSON.parse(figure.querySelector("script").textContent), picture = figure.querySelector("img");
  const place = picture.insertAdjacentElement("afterend", document.createElement("div"));
  place.className = "plot";
  place.style.aspectRatio = given.aspect;
  place.role = "img";
  place.ariaLabel = picture.alt;
  const plot = echarts.init(place, null, {renderer: "svg"});
  const draw = () => {
    plot.setOption(option(given, place.clientWidth), true);
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
  plot.getZr().on("dblclick", () => plot.dispatchAction({type: "dataZoom", batch: plot.getOption().dataZoom.map(
    (_, dataZoomIndex) => ({dataZoomIndex, start: 0, end: 100}))}));
  const caption = figure.querySelector("figcaption");
  const link = values => caption.appendChild(Object.assign(document.createElement("a"), values));
  const save = link({textContent: "SVG", href: "#", title: "Save what is shown"});
  link({textContent: "PDF", href: picture.dataset.pdf, download: "figure.pdf", title: "Save the whole picture"});
  save.addEventListener("click", event => {
    event.preventDefault();
    const file = Object.assign(document.createElement("a"), {href: plot.getDataURL({type: "svg"}), download: "figure.svg"});
    file.click();
  });
}

function option(given, width) {
  const size = Math.max(9, given.letters * width);
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
  });
  const series = given.series.map(one => one.type !== "custom" ? {
    ...one, animation: false, data: one.data.map(item => item.label ?
      {...item, label: {...item.label, fontSize: size * item.label.share}} : item),
  } : {
    ...one, animation: false, encode: {x: [0, 1], y: [2, 3], tooltip: 4}, clip: true, itemStyle: {color: one.color},
    renderItem: (params, api) => {
      const [x, y] = api.coord([api.value(0), api.value(3)]), [right, bottom] = api.coord([api.value(1), api.value(2)]);
      return {type: "rect", style: {fill: one.data[params.dataIndex][5] ?? one.color},
        shape: echarts.graphic.clipRectByRect({x, y, width: right - x, height: bottom - y}, params.coordSys)};
    },
  });
  const alike = one => given.xAxis.flatMap((other, index) => other.min === one.min && other.max === one.max ? [index] : []);
  const zoomed = [...new Set(given.xAxis.map(one => String(alike(one))))].map(
    indices => ({xAxisIndex: indices.split(",").map(Number)})); // panels of one abscissa zoom together
  zoomed.push(...given.yAxis.map((_, index) => ({yAxisIndex: [index]})));
  return {
    animation: false, textStyle: {fontSize: size, color: colour}, grid: given.grid,
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
