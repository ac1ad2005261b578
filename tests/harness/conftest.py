"""Fixtures of several files."""

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from harness.cli import main as cli
from harness.cli import runs
from harness.demonstrations import apart
from harness.engines import inline, processes
from harness.process.environment import CACHE_VARIABLE
from harness.schedule import grid
from tests.harness.browser import browser, play  # noqa: F401, fixtures of all tests below
from tests.harness.odd_env import task  # noqa: F401, the same

HERE = Path(__file__).parent
Main = Callable[..., tuple[int, str, str]]


@pytest.fixture
def main(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Main:
    """The command line with the cells of fake_cells.py, in an empty directory; returns code, out and err."""
    monkeypatch.syspath_prepend(HERE)
    monkeypatch.chdir(tmp_path)
    import fake_cells

    # Set as they are, so that what is installed over them goes with the test.
    for module, name in ((grid, "Grid"), (processes, "Processes"), (inline, "Inline")):
        monkeypatch.setattr(module, name, getattr(module, name))
    monkeypatch.setenv(fake_cells.FOLDER, "")
    monkeypatch.setitem(sys.modules, "harness.report.files", None)
    monkeypatch.setattr(runs, "handle_signals", lambda: None)
    fake_cells.install()
    return lambda *argv: (cli.main(argv), *capsys.readouterr())


@pytest.fixture
def read_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Files of demonstrations are read in this process, hundreds in the time that another takes to start."""
    monkeypatch.setattr(apart, "recording_in", apart.recording_here)


@pytest.fixture
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is kept between runs is in the test's folder."""
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))
