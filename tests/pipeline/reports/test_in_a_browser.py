"""Pages in headless Chromium: they load, draw, sort, and fetch nothing."""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from stillroom.pipeline.reports.comparison import compare_runs

webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not installed; pip install selenium")
from selenium.webdriver.chrome.options import Options  # noqa: E402
from selenium.webdriver.chrome.service import Service  # noqa: E402

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
DRIVER = shutil.which("chromedriver")
if CHROMIUM is None or DRIVER is None:
    pytest.skip(
        "Chromium or its driver is not installed; apt-get install chromium chromium-driver", allow_module_level=True
    )

MOST_BYTES = 15_000_000
ALONE = ("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--disable-gpu", "--window-size=1400,1000")
DRAWN = "return Bokeh.documents.length > 0 && Bokeh.documents.every(each => each.is_idle)"
PICTURES = "return [...document.images].map(image => image.complete && image.naturalWidth > 0)"
CHARTS = """
return [...document.querySelectorAll(".chart")].map(chart => chart.getBoundingClientRect().height)
"""
INSIDE = """
function* inside(root) { for (const each of root.querySelectorAll("*")) {
    yield each; if (each.shadowRoot) yield* inside(each.shadowRoot); } }
"""
SORT = (
    INSIDE
    + """
for (const each of inside(document))
    if (each.matches(".slick-header-column") && each.textContent.trim() === arguments[0]) { each.click(); return true; }
return false
"""
)
ROWS = (
    INSIDE
    + """
return [...inside(document)].filter(each => each.matches(".slick-row"))
    .sort((a, b) => a.getBoundingClientRect().top - b.getBoundingClientRect().top)
    .map(row => [...row.querySelectorAll(".slick-cell")].map(cell => cell.textContent.trim()))
"""
)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    options = Options()
    options.binary_location = CHROMIUM
    for argument in ALONE:
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(DRIVER))
    driver.set_page_load_timeout(120)
    driver.set_script_timeout(120)
    yield driver
    driver.quit()


def load(browser: Any, page: Path) -> None:
    """Open a page; it draws, says no error, fetches nothing, shows all pictures, and is not too large."""
    from selenium.webdriver.support.ui import WebDriverWait

    assert page.stat().st_size <= MOST_BYTES
    browser.get_log("performance")
    browser.get(page.resolve().as_uri())
    WebDriverWait(browser, 120).until(lambda driver: driver.execute_script(DRAWN))
    entries = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    asked = [each["params"]["request"]["url"] for each in entries if each["method"] == "Network.requestWillBeSent"]
    assert asked, "nothing was loaded, so nothing was looked at"
    assert [address for address in asked if not address.startswith(("file:", "data:"))] == []
    assert asked.count(page.resolve().as_uri()) == sum(address.startswith("file:") for address in asked)
    assert [entry for entry in browser.get_log("browser") if entry["level"] in ("SEVERE", "WARNING")] == []
    pictures = browser.execute_script(PICTURES)
    assert all(pictures)
    heights = browser.execute_script(CHARTS)
    assert heights
    assert min(heights) > 60


def test_the_report_of_a_run_and_the_comparison_of_four_methods(
    browser: Any, four: dict[str, Path], tmp_path: Path
) -> None:
    load(browser, four["oc-slam"] / "report.html")
    assert len(browser.execute_script(PICTURES)) >= 4
    assert len(browser.execute_script(CHARTS)) == 4

    compared = compare_runs([folder for name, folder in four.items() if name != "again"], tmp_path / "page.html")
    load(browser, compared.file)
    assert len(browser.execute_script(PICTURES)) == 3, "orb-slam2 makes no dense map"
    assert len(browser.execute_script(CHARTS)) == 1 + 1 + 1 + 5
    assert browser.execute_script(ROWS) == [list(row) for row in compared.rows]
    place = compared.header.index("ATE [m]")
    assert browser.execute_script(SORT, "ATE [m]")
    shown = browser.execute_script(ROWS)
    assert sorted(shown) == sorted(map(list, compared.rows))
    assert [float(row[place]) for row in shown] == sorted(float(row[place]) for row in compared.rows)
