"""A page in headless Chromium."""

import shutil
from contextlib import contextmanager

import pytest

# As root, in a container, Chromium's sandbox cannot start; nothing is fetched, and nothing is looked for
ARGUMENTS = ("--no-sandbox", "--disable-quic", "--disable-background-networking", "--disable-component-update")


@contextmanager
def opened(address: str, width: int, height: int):
    """Yield the page at an address in a window of this size, px; skip the test where no Chromium is installed."""
    playwright = pytest.importorskip("playwright.sync_api", reason="needs the Python package playwright")
    program = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if program is None:
        pytest.skip("needs Chromium: apt install chromium")
    with playwright.sync_playwright() as driver:
        opened_browser = driver.chromium.launch(executable_path=program, args=list(ARGUMENTS))
        page = opened_browser.new_page(viewport={"width": width, "height": height})
        page.set_default_timeout(60_000)
        errors = []
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto(address)
        yield page
        opened_browser.close()
        assert not errors
