"""Whole cells on the smallest budget, in a cache of their own."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from harness.cell.run import prepare, run_cell
from harness.process.environment import CACHE_VARIABLE
from harness.records import Cell, CellResult, Conditions
from harness.store.files import sha256_of

BC = Cell("cartpole", "bc", 0)
SMOKE = Conditions("smoke", "absorbing", "sb3")


@pytest.fixture(scope="module", autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """An empty cache, which the first test that needs the expert fills."""
    with pytest.MonkeyPatch.context() as patch:
        path = tmp_path_factory.mktemp("cache")
        patch.setenv(CACHE_VARIABLE, str(path))
        yield path


def run(cell: Cell, directory: Path, conditions: Conditions = SMOKE) -> CellResult:
    """Return the result of a cell, whose files go to the directory."""
    result, files = run_cell(cell, conditions, prepare([cell], conditions))
    assert result.files == {name: sha256_of(data) for name, data in files.items()}
    for name, data in files.items():
        (directory / name).parent.mkdir(parents=True, exist_ok=True)
        (directory / name).write_bytes(data)
    return result
