"""The site in a real browser, from the disk: headless Chromium, led by selenium. `./check full` builds it and names its folder.

Skipped where CANOPEN_SITE names no site (`python docs/build.py --into FOLDER`), and without chromium, its driver and `selenium`.
"""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

SITE = Path(os.environ.get("CANOPEN_SITE", ""))
CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
if not os.environ.get("CANOPEN_SITE"):
    pytest.skip("CANOPEN_SITE names no site", allow_module_level=True)
if CHROMIUM is None or DRIVER is None:
    pytest.skip("no chromium with chromium-driver here", allow_module_level=True)
webdriver = pytest.importorskip("selenium.webdriver")
from selenium.webdriver.chrome.options import Options  # noqa: E402 - only where it is
from selenium.webdriver.chrome.service import Service  # noqa: E402
from selenium.webdriver.common.by import By  # noqa: E402

PAGES = ("index", "first-move", "objects", "from-canopen", "commands/canopen-drive", "states", "api/canopen_master")
DESK, PHONE = (1400, 1000), (375, 812)
PATIENCE = 60
"""Seconds until a condition that does not come is a failure."""


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    options = Options()
    options.binary_location = CHROMIUM
    for argument in ("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--disable-gpu"):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(DRIVER))
    yield driver
    driver.quit()


def until(fits: Callable[[], Any]) -> Any:
    """Wait until something is there, and return it."""
    end = time.monotonic() + PATIENCE
    while not (found := fits()):
        assert time.monotonic() < end, "it did not come"
        time.sleep(0.05)
    return found


def visit(browser: Any, page: str, size: tuple[int, int], scheme: str) -> None:
    """Open a page as a screen of this size, and a user who likes this scheme of colours, has it."""
    width, height = size
    metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": size == PHONE}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
    browser.get("about:blank")
    browser.get_log("browser")
    name, _, query = page.partition("?")
    browser.get(f"{(SITE / name).with_suffix('.html').resolve().as_uri()}{'?' * bool(query)}{query}")


def silent(browser: Any) -> None:
    """Nothing stands in the browser's console."""
    assert [each for each in browser.get_log("browser") if each["level"] in ("SEVERE", "WARNING")] == []


def lightness(browser: Any, css: str) -> float:
    """The mean of red, green and blue behind the first element that fits, 0 to 255."""
    script = "return getComputedStyle(document.querySelector(arguments[0])).backgroundColor.match(/[0-9.]+/g).slice(0, 3)"
    return sum(map(float, browser.execute_script(script, css))) / 3


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("size", [DESK, PHONE], ids=["desk", "phone"])
@pytest.mark.parametrize("page", PAGES)
def test_a_page_fits_its_screen(browser: Any, page: str, size: tuple[int, int], scheme: str) -> None:
    """No scrolling sideways (tables and code scroll by themselves), each picture is there, and the console is empty."""
    visit(browser, page, size, scheme)
    assert browser.execute_script("return document.documentElement.scrollWidth <= document.documentElement.clientWidth")
    assert (lightness(browser, "body") > 128) is (scheme == "light")
    loaded = "return [...document.images].filter(each => each.getClientRects().length).every(each => each.naturalWidth > 0)"
    assert until(lambda: browser.execute_script(loaded))
    assert "- canopen-proto " in browser.title or page == "index"
    assert browser.find_element(By.TAG_NAME, "h1").text
    silent(browser)


@pytest.mark.parametrize(
    ("words", "title"),
    [
        ("heartbeat", "Network management and heartbeat"),
        ("homing", "Homing (hm"),
        ("CO402", "Errors"),
        ("first move", "From the box to the first move"),
        ("install", "Start without hardware"),
        ("6081", "Objects by number"),  # without its 0x
    ],
)
def test_the_search_works_without_a_server_and_has_pages_first(browser: Any, words: str, title: str) -> None:
    visit(browser, f"search?q={words}", DESK, "light")
    until(lambda: "Search finished" in browser.find_element(By.CSS_SELECTOR, "#search-results").text)
    found = [each.text for each in browser.find_elements(By.CSS_SELECTOR, "#search-results li > a")]
    assert any(each.startswith(title) for each in found[:5]), found[:10]
    silent(browser)


def test_the_search_says_if_it_finds_nothing(browser: Any) -> None:
    visit(browser, "search?q=qqqqzzzz", DESK, "light")
    until(lambda: "did not match any documents" in browser.find_element(By.CSS_SELECTOR, "#search-results").text)
    silent(browser)


def test_the_sidebar_of_a_phone_opens(browser: Any) -> None:
    visit(browser, "index", PHONE, "light")
    link = browser.find_element(By.CSS_SELECTOR, ".sidebar-tree a[href='start-no-hardware.html']")
    assert link.rect["x"] < 0, "outside, until it is asked for"
    browser.find_element(By.CSS_SELECTOR, ".mobile-header label[for='__navigation']").click()
    until(lambda: link.rect["x"] >= 0)
    link.click()
    until(lambda: "Start without hardware" in browser.title)
