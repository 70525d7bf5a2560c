"""A browser without a display, and waiting for what its pages show."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

import pytest

TIMEOUT = 180.0


def wait_for(what: Callable[[], Any], name: str) -> Any:
    """Poll a function until it returns a true value, and return that."""
    from selenium.common.exceptions import WebDriverException

    until = time.monotonic() + TIMEOUT
    while time.monotonic() < until:
        with suppress(WebDriverException):  # the page is still being built
            result = what()
            if result:
                return result
        time.sleep(0.2)
    pytest.fail(f"waited for {name} in vain")


@pytest.fixture
def browser() -> Iterator[Any]:
    webdriver = pytest.importorskip("selenium.webdriver", reason="no selenium: pip install selenium")
    program, driver = (shutil.which(name) for name in ("chromium", "chromedriver"))
    if program is None or driver is None:
        pytest.skip("no browser: apt install chromium chromium-driver")
    options = webdriver.ChromeOptions()
    options.binary_location = program
    for argument in ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"):
        options.add_argument(argument)
    options.add_argument("--window-size=1000,800")
    opened = webdriver.Chrome(options, webdriver.ChromeService(driver))
    yield opened
    opened.quit()
