"""The pages of `rdpi` in a real browser: no errors, plots that zoom and tell values, tables that sort and filter."""

from __future__ import annotations

import csv
import json
import sys
import warnings
from collections.abc import Iterator
from dataclasses import replace
from datetime import datetime, timedelta, timezone
from itertools import product
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest
from click.testing import CliRunner
from selenium import webdriver
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.remote.webelement import WebElement

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests/bench"))

import bench  # noqa: E402
from rdpi.cli import main  # noqa: E402
from rdpi.data import sample_times, write_recording  # noqa: E402
from rdpi.gap.batch import Row, write_page  # noqa: E402

pytestmark = pytest.mark.slow

RATE_HZ = 2000.0
PAGES = {"fit": "fit/fit.html", "gap": "gap/index.html", "score": "score/score.html", "batch": "batch/index.html",
         "compensate": "compensate/compensate.html"}


def rdpi(*arguments: object) -> None:
    done = CliRunner().invoke(main, [*map(str, arguments)], catch_exceptions=False)
    assert done.exit_code == 0, done.output


def record(path: Path, seed: int, **settings: float) -> None:
    """Triangles of several rates and sizes; the displacement is also given as a reference that was missed by a bit."""
    t = np.arange(round(6 * RATE_HZ)) / RATE_HZ
    phase = np.cumsum(1 + 4 * (t > 2) + 10 * (t > 4)) / RATE_HZ
    sizes = np.random.default_rng(seed).uniform(0.4, 1, int(phase[-1]) + 1)
    command_V = 100 * sizes[phase.astype(int)] * (1 - np.abs(2 * (phase % 1) - 1))
    plant = bench.make("preisach", seed, **settings)
    plant.demagnetise(RATE_HZ, to_V=0.0)
    displacement_um = plant.run(command_V, RATE_HZ)
    write_recording(path, {"time_s": sample_times(len(t), RATE_HZ), "command_V": command_V,
                           "displacement_um": displacement_um, "reference_um": 1.02 * displacement_um},
                    {"sample_rate_hz": RATE_HZ, "memory": "reset"})


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All pages."""
    folder = tmp_path_factory.mktemp("pages")
    for name, seed, settings in (("first", 1, {}), ("second", 2, {}), ("late", 3, {"delay_s": 0.004})):
        record(folder / f"{name}.csv", seed, **settings)
    model = folder / "model.json"
    rdpi("fit", folder / "first.csv", folder / "second.csv", "-o", model, "--report", folder / "fit")
    rdpi("gap", model, folder / "late.csv", "--report", folder / "gap")
    rdpi("score", folder / "first.csv", "--report", folder / "score")
    rdpi("compensate", model, folder / "first.csv", "-o", folder / "drive.csv", "--report", folder / "compensate")
    with open(folder / "plan.csv", "w", newline="") as file:
        rows = csv.writer(file)
        rows.writerows([["actuator", "model", "gap"], ["A<1>", "model.json", "late.csv"],
                        ["B2", "model.json", "second.csv"], ["C3", "model.json", "late.csv"]])
    rdpi("batch", folder / "plan.csv", "-o", folder / "results.sqlite", "--jobs", "1", "--report", folder / "batch")
    return folder


@pytest.fixture(scope="module")
def browser() -> Iterator[webdriver.Chrome]:
    options = webdriver.ChromeOptions()
    for argument in ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    browser = webdriver.Chrome(options=options, service=webdriver.chrome.service.Service("/usr/bin/chromedriver"))
    yield browser
    browser.quit()


def opened(browser: webdriver.Chrome, page: Path, width: int = 1280, scheme: str = "light") -> list[WebElement]:
    """Its figures."""
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride",
                            {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 600})
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia",
                            {"features": [{"name": "prefers-color-scheme", "value": scheme}]})
    browser.get(page.as_uri())
    return browser.find_elements(By.TAG_NAME, "figure")


def extents(browser: webdriver.Chrome, figure: WebElement) -> list[list[float]]:
    """Of the axes of a plot as they are shown."""
    return browser.execute_script("""
        const plot = echarts.getInstanceByDom(arguments[0].querySelector(".plot")), model = plot.getModel();
        return ["xAxis", "yAxis"].flatMap(name => model.queryComponents({mainType: name}).map(
            one => one.axis.scale.getExtent()));""", figure)


def dragged(browser: webdriver.Chrome, figure: WebElement) -> None:
    """From a point of the first panel to another one."""
    plot = figure.find_element(By.CLASS_NAME, "plot")
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", plot)
    width, height = plot.size["width"], plot.size["height"]
    (ActionChains(browser).move_to_element_with_offset(plot, 0, -round(0.2 * height)).click_and_hold()
     .move_by_offset(round(0.1 * width), round(0.05 * height)).move_by_offset(round(0.1 * width), round(0.05 * height))
     .release().perform())


@pytest.mark.parametrize(("width", "scheme"), [
    (1280, "light"), (400, "dark"), pytest.param(1280, "dark", marks=pytest.mark.long),
    pytest.param(400, "light", marks=pytest.mark.long)])
@pytest.mark.parametrize("name", PAGES)
def test_every_picture_becomes_a_plot(name: str, scheme: str, width: int, folder: Path, browser: webdriver.Chrome
                                      ) -> None:
    figures = opened(browser, folder / PAGES[name], width, scheme)
    assert len(figures) >= 2
    for figure in figures:
        assert figure.find_elements(By.CSS_SELECTOR, ".plot svg path"), figure.text
        assert not figure.find_element(By.TAG_NAME, "img").is_displayed()
        svg, pdf = (one.rect for one in figure.find_elements(By.CSS_SELECTOR, ".saves a"))
        assert svg["y"] == pdf["y"] and svg["x"] + svg["width"] < pdf["x"], figure.text
        assert pdf["y"] + pdf["height"] <= figure.rect["y"] + figure.rect["height"], figure.text
    assert browser.get_log("browser") == []
    loaded = browser.execute_script("return performance.getEntriesByType('resource').map(one => one.name)")
    assert [one for one in loaded if not one.startswith("data:")] == []
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width


def numbers(browser: webdriver.Chrome, plot: WebElement) -> set[str]:
    """All that it shows, tooltip and labels of the axes. It is drawn anew with every movement: one script reads it."""
    return set(browser.execute_script("""return [...arguments[0].querySelectorAll("svg text, :scope > div + div")]
        .filter(one => one.checkVisibility({opacityProperty: true, visibilityProperty: true}))
        .map(one => one.textContent).filter(one => /[0-9]/.test(one))""", plot))


def labels(browser: webdriver.Chrome, figure: WebElement, kind: str) -> list[list[str]]:
    """Of the axes of a plot that are logarithmic ("log"), count ("value" with `whole`) or show time: what can be read."""
    return browser.execute_script("""
        const plot = echarts.getInstanceByDom(arguments[0].querySelector(".plot"));
        const shown = new Set([...arguments[0].querySelectorAll("svg text")].map(one => one.textContent));
        return ["xAxis", "yAxis"].flatMap(name => plot.getModel().queryComponents({mainType: name})).filter(
            one => arguments[1] === "whole" ? one.option.whole : one.option.type === arguments[1]).map(
            one => one.axis.getViewLabels().map(label => label.formattedLabel).filter(label => shown.has(label)));""",
                                  figure, kind)


@pytest.mark.parametrize(("name", "width"), [("fit", 1280), ("gap", 400), ("score", 1280), ("batch", 400)])
def test_a_logarithmic_axis_shows_two_values_or_more(name: str, width: int, folder: Path, browser: webdriver.Chrome
                                                     ) -> None:
    found = [one for one in opened(browser, folder / PAGES[name], width) if labels(browser, one, "log")]
    assert found
    for figure in found:
        assert all(len(one) > 1 for one in labels(browser, figure, "log")), figure.text
        if width > 600:  # a mouse
            dragged(browser, figure)
            assert all(len(one) > 1 for one in labels(browser, figure, "log")), figure.text


@pytest.mark.parametrize("name", PAGES)
def test_plots_zoom_and_tell_values(name: str, folder: Path, browser: webdriver.Chrome) -> None:
    for figure in opened(browser, folder / PAGES[name]):
        whole = extents(browser, figure)
        dragged(browser, figure)
        inside = extents(browser, figure)
        assert inside != whole, figure.text
        assert all(min(low - first, last - high) > -1e-6 * (last - first)
                   for (low, high), (first, last) in zip(inside, whole)), (whole, inside)
        plot = figure.find_element(By.CLASS_NAME, "plot")
        ActionChains(browser).move_to_element_with_offset(plot, 0, -round(0.2 * plot.size["height"])
                                                          ).double_click().perform()
        assert extents(browser, figure) == whole, figure.text
        size = plot.size
        ActionChains(browser).move_to_element_with_offset(plot, 1 - size["width"] // 2, 0).perform()  # beside the axes
        shown = numbers(browser, plot)
        for across, down in product((-0.3, -0.1, 0.1, 0.3), repeat=2):  # a map has empty cells
            ActionChains(browser).move_to_element_with_offset(plot, round(across * size["width"]),
                                                              round(down * size["height"])).perform()
            if numbers(browser, plot) - shown:
                break
        else:
            pytest.fail(f"no value under the pointer: {figure.text}")
    assert browser.get_log("browser") == []


def test_a_plot_is_saved_as_svg_with_text_and_as_pdf(folder: Path, browser: webdriver.Chrome) -> None:
    figure = opened(browser, folder / PAGES["fit"])[0]
    address = browser.execute_script("""
        let saved;
        HTMLAnchorElement.prototype.click = function () { saved = [this.download, this.href]; };
        arguments[0].querySelector("figcaption a").dispatchEvent(new MouseEvent("click", {cancelable: true}));
        return saved;""", figure)
    assert address[0] == "identification-of-actuator-1.svg"
    picture = unquote(address[1])
    assert picture.startswith("data:image/svg+xml") and "displacement [µm]</text>" in picture
    whole = figure.find_element(By.CSS_SELECTOR, "a[download]")
    assert (whole.text, whole.get_attribute("download")) == ("PDF", "identification-of-actuator-1.pdf")
    assert whole.get_attribute("href").startswith("data:application/pdf;base64,JVBERi")


def test_the_table_of_actuators_sorts_and_filters(folder: Path, browser: webdriver.Chrome) -> None:
    opened(browser, folder / PAGES["batch"])

    def shown() -> list[str]:
        return [row.find_element(By.TAG_NAME, "td").text.split(" ")[0]
                for row in browser.find_elements(By.CSS_SELECTOR, "#actuators tbody tr") if row.is_displayed()]

    assert shown() == ["A<1>", "B2", "C3"]
    gap = next(one for one in browser.find_elements(By.CSS_SELECTOR, "#actuators th button") if one.text == "gap")
    gap.click()
    assert shown()[0] == "B2"
    gap.click()
    assert shown()[-1] == "B2"
    text = browser.find_element(By.ID, "text")
    text.send_keys("a<")
    assert shown() == ["A<1>"]
    assert json.loads(browser.execute_script("return JSON.stringify(document.getElementById('count').value)")
                      ).startswith("1 of 3")
    assert browser.get_log("browser") == []


def batch_of(folder: Path, over: timedelta, count: int = 7) -> Path:
    """A page over actuators that were worked on within a time: one failed, one was found to have an effect."""
    start = datetime(2026, 11, 24, 22, 17, 5, tzinfo=timezone.utc)
    rows = [Row(actuator=f"A{k}", status="done", error=None, verdict="none", effect=None, shrink=None,
                gap_percent=0.4 + 0.05 * k, fit_rms_percent=0.3, held_out_rms_percent=None, model_path="m.json", model_sha256="", inputs_sha256="",
                tool="rdpi", started_at=(start + k / (count - 1) * over).isoformat(timespec="seconds"), seconds=1.0)
            for k in range(count)]
    rows[1] = replace(rows[1], status="failed", error="there is no model m.json; fit one", verdict=None, gap_percent=None,
                      fit_rms_percent=None)
    rows[2] = replace(rows[2], verdict="effect", effect="lag", shrink=0.8)
    write_page(folder, rows, "results.sqlite")
    return folder / "index.html"


@pytest.mark.parametrize(("over", "width"), [
    pytest.param(over, width, marks=[] if width == usual else pytest.mark.long) for width in (1280, 400) for over, usual in (
        (timedelta(seconds=20), 1280), (timedelta(minutes=3), 400), (timedelta(minutes=50), 1280),
        (timedelta(hours=3.5), 400), (timedelta(hours=9), 1280), (timedelta(days=2), 400), (timedelta(days=25), 1280),
        (timedelta(days=300), 400))], ids=str)
def test_a_batch_page_counts_in_whole_numbers_over_utc(over: timedelta, width: int, tmp_path: Path, browser: webdriver.Chrome
                                                       ) -> None:
    browser.execute_cdp_cmd("Emulation.setTimezoneOverride", {"timezoneId": "Asia/Kolkata"})  # half an hour off
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        page = batch_of(tmp_path, over)
    errors, times = opened(browser, page, width)
    for figure in (errors, times):
        (counts,) = labels(browser, figure, "whole")
        assert len(counts) > 1 and all(one.isdecimal() for one in counts)
    (shown,) = labels(browser, times, "time")
    assert shown
    if timedelta(hours=2) < over < timedelta(days=1):
        assert all(one.endswith(":00") or "-" in one or one.isdecimal() for one in shown), shown
    places = browser.execute_script("""
        const boxes = [...arguments[0].querySelectorAll("svg text")].filter(one => arguments[1].includes(one.textContent)).map(
            one => one.getBoundingClientRect());
        const lowest = Math.max(...boxes.map(one => one.bottom));
        return boxes.filter(one => lowest - one.bottom < 3).map(one => [one.left, one.right]).sort((a, b) => a[0] - b[0]);""",
                                    times, shown)
    assert len(places) == len(set(shown)) > 1, (shown, places)
    assert all(right + 4 < left for (_, right), (left, _) in zip(places, places[1:])), (shown, places)


def test_a_phone_shows_no_line_without_a_value(folder: Path, browser: webdriver.Chrome) -> None:
    opened(browser, folder / PAGES["gap"], 400)
    cells = browser.find_elements(By.CSS_SELECTOR, ".stacked td")
    assert "–" not in [cell.text for cell in cells if cell.is_displayed()]
    assert "–" in [cell.get_attribute("textContent") for cell in cells]  # they are there, on a wide screen


def test_rows_of_a_batch_are_one_line_each_and_on_a_phone_without_empty_ones(tmp_path: Path, browser: webdriver.Chrome
                                                                            ) -> None:
    page = batch_of(tmp_path, timedelta(hours=3))
    opened(browser, page)
    heights = {row.size["height"] for row in browser.find_elements(By.CSS_SELECTOR, "#actuators tbody tr")[3:]}
    assert len(heights) == 1 and heights.pop() < 40
    opened(browser, page, 400)
    lines = [cell.text for cell in browser.find_elements(By.CSS_SELECTOR, "#actuators tbody td") if cell.is_displayed()]
    assert len(lines) == 7 + 7 + 7 + 6 + 6 + 3 and all(lines) and "–" not in lines
    assert "lag" in lines and "there is no model m.json; fit one" in lines
