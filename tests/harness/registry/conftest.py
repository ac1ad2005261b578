"""Plug-ins for tests: known while a test lasts, and looked at in its own process where that is asked for."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from harness.records import Cell, Conditions
from harness.registry import KNOWN, keys, loading, plugins
from tests.harness.plugged import MINE

CONDITIONS = Conditions("smoke", "absorbing", "sbx")


def key_of(method: str = "mine", env: str = "swingup", plugin: Path | None = None) -> str:
    """Return the key of a cell. The plug-in of a file is read first."""
    if plugin:
        plugins.add([str(plugin)])
    cell = Cell(env, method, 0)
    return keys.cell_keys([cell], CONDITIONS, {})[cell]


@pytest.fixture(autouse=True)
def _for_now() -> Iterator[None]:
    """Plug-ins, and helpers that they import, go with the test."""
    before = set(sys.modules)
    with KNOWN.for_now():
        yield
    for name in set(sys.modules) - before:
        if name.startswith(("theirs", "its_helper", "far_")):
            del sys.modules[name]


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Plug-ins are looked at in this process, since one of their own takes a second."""
    monkeypatch.setattr(loading, "in_a_process", loading.look)


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    (tmp_path / "mine.py").write_text(MINE)
    return tmp_path / "mine.py"
