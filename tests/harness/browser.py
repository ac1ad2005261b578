"""A real Chromium: the one that is installed. Tests of pages skip where there is none."""

import shutil
from collections.abc import Iterator
from typing import Any

import pytest

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


@pytest.fixture(scope="session")
def play() -> Iterator[Any]:
    """Playwright, of which a process can have one."""
    if CHROMIUM is None:
        pytest.skip("no Chromium is installed")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        yield playwright


@pytest.fixture(scope="session")
def browser(play: Any) -> Iterator[Any]:
    with play.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"]) as launched:
        yield launched
