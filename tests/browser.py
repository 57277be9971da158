"""A real browser for the tests: headless Chromium, without a network, where the machine has it."""

import io
import shutil
import time
from collections.abc import Callable

import numpy as np
import pytest
from PIL import Image

PATIENCE = 1800.0
"""s, after which a page hangs, as any test does: it is drawn without a graphics card, beside other work"""


def start_browser():
    """Chromium by its own driver; skips the test where one of them is missing."""
    chromium, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if chromium is None or driver is None:
        pytest.skip("there is no chromium with its chromedriver (Debian: apt-get install chromium chromium-driver)")
    webdriver = pytest.importorskip("selenium.webdriver")
    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    for argument in (
        "--headless=new",
        "--no-sandbox",
        "--disable-dev-shm-usage",
        "--disable-background-networking",
        "--use-gl=angle",
        "--use-angle=swiftshader",
        "--enable-unsafe-swiftshader",
        "--window-size=620,560",
        # no name is looked up, and nothing but this machine can be reached
        "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
    ):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    return webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))


def wait_for(condition: Callable, what: str, seconds: float = PATIENCE):
    """What the condition returns once it is true; fails with `what` where it never is."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        found = condition()
        if found:
            return found
        time.sleep(0.1)
    pytest.fail(f"{what}: not within {seconds:g} s")


def screenshot(browser) -> np.ndarray:
    """(rows, columns, 3), 0 to 255."""
    timeout = pytest.importorskip("selenium.common.exceptions").TimeoutException

    def taken():
        try:
            return browser.get_screenshot_as_png()
        except timeout:  # the driver waits ten seconds for a picture, software may take longer
            return None

    return np.asarray(Image.open(io.BytesIO(wait_for(taken, "a screenshot"))).convert("RGB"), int)


def is_red(pixels: np.ndarray) -> np.ndarray:
    """Which pixels are red, as struts are: dark in shadow, pink in full light; orange is not."""
    red, green, blue = np.moveaxis(pixels, -1, 0)
    return (red - np.maximum(green, blue) > 40) & (green < 1.3 * blue)
