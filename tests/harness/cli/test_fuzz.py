"""Any input: done, or one clear line and exit code 2, and nothing of the user's is touched."""

import contextlib
import io
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from harness.api import running
from harness.api.preparing import Prepared
from harness.api.running import Reported
from harness.cli import main as cli
from harness.cli import messages, runs
from harness.records import Cell, CellResult
from harness.registry import ENVS, METHODS, VARIANTS
from harness.store.store import Store

Tried = Callable[[str, Counter[str]], None]
NAMES = [*METHODS, *VARIANTS, *ENVS, "all", "smoke", "quick", "full", "absorbing", "native", "sbx", "sb3"]
FLAGS = ["--methods", "--envs", "--seeds", "--budget", "--protocol", "--rl", "--out", "--workers"]
FLAGS += ["--cell-timeout", "--retry-failed", "--help", "--json", "--"]
COMMANDS = ["run", "report", "verify", "reproduce", "list"]
PLACES = ["new", "mine", "mine/file", "run", "run/run.sqlite", "damaged", "", ".", "/dev/null/x"]
text = st.text(max_size=12)
word = st.one_of(st.sampled_from(NAMES + FLAGS + COMMANDS + PLACES), st.integers().map(str), text)
right = {
    "--methods": st.sampled_from(["all", "bc", "shaped, maxent", *VARIANTS]),
    "--envs": st.sampled_from(["all", *ENVS]),
    "--seeds": st.integers(1, 3).map(str),
    "--budget": st.sampled_from(["smoke", "quick", "full"]),
    "--protocol": st.sampled_from(["absorbing", "native"]),
    "--rl": st.sampled_from(["sbx", "sb3"]),
    "--cell-timeout": st.integers(1, 99).map(str),
}
new = {"--out": st.integers(0, 10**6).map("new{}".format)}
right_options = st.fixed_dictionaries(new, optional=right).map(
    lambda options: [part for option in options.items() for part in option]
)
command_line = st.one_of(
    right_options.map(lambda options: ["run", *options]),
    st.lists(word, max_size=6),
    st.tuples(st.sampled_from(COMMANDS), st.lists(word, max_size=6)).map(lambda pair: [pair[0], *pair[1]]),
    st.tuples(st.sampled_from(COMMANDS), st.lists(st.tuples(st.sampled_from(FLAGS), word), max_size=4)).map(
        lambda pair: [pair[0], *(part for option in pair[1] for part in option)]
    ),
)


def compute(prepared: Prepared, run: Store, watch: object) -> dict[Cell, CellResult]:
    """Return empty results in place of the cells' work."""
    return {cell: CellResult(cell, []) for cell in prepared.request.cells}


def report(run: Store, results: dict[Cell, CellResult], **settings: Any) -> Any:
    """Return a report of nothing."""
    return Reported(run.path, None, results, (), (), (), {})  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a user has: files of his own, a run, a damaged one."""
    place = tmp_path_factory.mktemp("fuzz")
    for name in ("mine", "run", "damaged"):
        (place / name).mkdir()
    (place / "mine/file").write_text("precious")
    (place / "damaged/run.sqlite").write_text("SQLite format 3")
    return place


def write_study(directory: Path, found: object) -> None:
    (directory / "study.md").write_text("a table")


def test_any_command_line_is_done_or_refused_in_a_line(place: Path, tried: Tried) -> None:
    @settings(max_examples=400, deadline=None)
    @given(argv=command_line)
    def check(argv: list[str]) -> None:
        err = io.StringIO()
        with (
            pytest.MonkeyPatch.context() as patch,
            contextlib.redirect_stdout(io.StringIO()),
            contextlib.redirect_stderr(err),
        ):
            patch.chdir(place)
            patch.setattr(running, "_computed", compute)
            patch.setattr(running, "report", report)
            patch.setattr(messages, "show", lambda *_, **__: None)
            patch.setattr("harness.benchmarks.reproduce.write_study", write_study)
            patch.setattr(runs, "handle_signals", lambda: None)
            code = cli.main(argv)
        assert code in (0, 1, 2)
        if code == 2:
            assert err.getvalue().startswith("irl-bench: error: ")
            assert err.getvalue().count("\n") == 1
        assert (place / "mine/file").read_bytes() == b"precious"
        assert [path.name for path in (place / "mine").iterdir()] == ["file"]
        assert (place / "damaged/run.sqlite").read_bytes() == b"SQLite format 3"
        codes[f"exit {code}"] += 1

    codes: Counter[str] = Counter()
    check()
    assert codes["exit 0"] > 20
    assert codes["exit 2"] > 100
    tried("command lines", codes)
