"""The pages of `rdpi` in a real browser: no errors, plots that zoom and tell values, tables that sort and filter."""

from __future__ import annotations

import csv
import json
import sys
from collections.abc import Iterator
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


@pytest.mark.parametrize("width", [1280, 400])
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("name", PAGES)
def test_every_picture_becomes_a_plot(name: str, scheme: str, width: int, folder: Path, browser: webdriver.Chrome
                                      ) -> None:
    figures = opened(browser, folder / PAGES[name], width, scheme)
    assert len(figures) >= 2
    for figure in figures:
        assert figure.find_elements(By.CSS_SELECTOR, ".plot svg path"), figure.text
        assert not figure.find_element(By.TAG_NAME, "img").is_displayed()
    assert browser.get_log("browser") == []
    loaded = browser.execute_script("return performance.getEntriesByType('resource').map(one => one.name)")
    assert [one for one in loaded if not one.startswith("data:")] == []
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width


def numbers(browser: webdriver.Chrome, plot: WebElement) -> set[str]:
    """All that it shows, tooltip and labels of the axes. It is drawn anew with every movement: one script reads it."""
    return set(browser.execute_script("""return [...arguments[0].querySelectorAll("svg text, :scope > div + div")]
        .filter(one => one.checkVisibility({opacityProperty: true, visibilityProperty: true}))
        .map(one => one.textContent).filter(one => /[0-9]/.test(one))""", plot))


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
    assert address[0] == "figure.svg"
    picture = unquote(address[1])
    assert picture.startswith("data:image/svg+xml") and "displacement [µm]</text>" in picture
    whole = figure.find_element(By.CSS_SELECTOR, "a[download]")
    assert whole.text == "PDF" and whole.get_attribute("href").startswith("data:application/pdf;base64,JVBERi")


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
