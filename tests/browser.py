"""A headless Chromium for tests of pages; found on the PATH."""

import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from matplotlib.image import imread

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
SOFTWARE_WEBGL = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist")


def chromium() -> str | None:
    """Return the program, if there is one."""
    return next(filter(None, map(shutil.which, NAMES)), None)


@contextmanager
def started() -> Iterator[object]:
    """Yield a browser that draws WebGL without a graphics card."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium(), args=["--no-sandbox", *SOFTWARE_WEBGL])
        try:
            yield browser
        finally:
            browser.close()


@dataclass
class Opened:
    """A page as it was opened, with what went wrong and what it asked the network for."""

    page: object
    errors: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)

    def text(self, selector: str) -> str:
        return self.page.locator(selector).first.inner_text()

    def slide(self, control: str, value: int) -> None:
        """Move a slider, as a hand would: its value, then the event."""
        self.page.eval_on_selector(
            f'[data-control="{control}"]',
            "(slider, value) => { slider.value = value; slider.dispatchEvent(new Event('input', {bubbles: true})); }",
            value,
        )

    def until(self, holds: Callable[[], bool], within_s: float = 60.0) -> None:
        """Wait until something holds: a page draws when it comes to it."""
        ends = time.monotonic() + within_s
        while not holds():
            assert time.monotonic() < ends
            self.page.wait_for_timeout(50)

    def picture(self, selector: str, path: Path) -> np.ndarray:
        """Return the pixels of a part of the page, (row, column, colour), from 0 to 1."""
        self.page.locator(selector).first.screenshot(path=path)
        return imread(path)[..., :3]


def opened(browser: object, path: Path, width: int = 1000) -> Opened:
    """Return a page once it has drawn itself."""
    # A third of the pixels each way: WebGL is drawn by the processor.
    found = Opened(browser.new_page(viewport={"width": width, "height": 700}, device_scale_factor=0.35))
    found.page.set_default_timeout(120_000)
    found.page.on("console", lambda said: found.errors.append(said.text) if said.type == "error" else None)
    found.page.on("pageerror", lambda error: found.errors.append(str(error)))
    found.page.on("request", lambda asked: found.requests.append(asked.url))
    found.page.goto(path.as_uri())
    found.page.wait_for_selector("body[data-ready]")
    return found


def colours_in(picture: np.ndarray) -> int:
    """Return how many clearly different colours a picture has."""
    return len(np.unique((picture * 15).round().astype(int).reshape(-1, 3), axis=0))
