"""Any input: done, or one clear line and exit code 2, and nothing of the user's is touched."""

import contextlib
import io
import json
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from harness.cli import commands, outcome
from harness.cli import main as cli
from harness.records import Cell, CellResult
from harness.registry import ENVS, METHODS, VARIANTS
from harness.store.opening import open_for_run
from harness.store.request import Request
from harness.store.store import Store
from methods.base import Episodes
from tests.harness.small_runs import REQUEST, store

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


def compute(run: Store, request: Request, *_: object) -> dict[Cell, CellResult]:
    """In place of the cells' work."""
    return {cell: CellResult(cell, []) for cell in request.cells}


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
            patch.setattr(commands, "_compute", compute)
            patch.setattr(outcome, "report", lambda *_, **__: True)
            patch.setattr("harness.benchmarks.reproduce.write_study", write_study)
            patch.setattr(commands, "handle_signals", lambda: None)
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


odd_arrays = st.one_of(
    st.tuples(st.integers(0, 4), st.integers(0, 3)).map(np.zeros),
    st.sampled_from([np.full((3, 2), np.nan), np.full((2, 2), np.inf), np.zeros(3), np.zeros((2, 2, 2))]),
)


@st.composite
def demonstrations(draw: st.DrawFn) -> tuple[tuple[Any, ...], ...]:
    """Observations, actions, ends: of one step or more and of unequal lengths, often with something wrong."""
    lengths = draw(st.lists(st.integers(0, 4), min_size=0, max_size=3))
    obs, act = [np.zeros((n + 1, 2)) for n in lengths], [np.zeros((n, 1)) for n in lengths]
    for some in (obs, act):
        if some and draw(st.booleans()) and draw(st.booleans()):
            some[draw(st.integers(0, len(some) - 1))] = draw(odd_arrays)
        if draw(st.integers(0, 9)) == 0:
            some.append(draw(odd_arrays))
    return tuple(obs), tuple(act), tuple(draw(st.booleans()) for _ in lengths)


def test_demonstrations_of_any_shape_are_taken_or_refused(tried: Tried) -> None:
    @settings(max_examples=800, deadline=None)
    @given(demonstrations())
    def check(parts: tuple[tuple[Any, ...], ...]) -> None:
        message = ""
        try:
            episodes = Episodes(*parts)
        except ValueError as error:
            message = str(error)
        counts["refused" if message else "taken"] += 1
        assert "\n" not in message
        if not message:
            states, actions = episodes.pairs()
            assert len(states) == len(actions) == episodes.lengths.sum() > 0
            assert np.isfinite(states).all()
            assert np.isfinite(actions).all()

    counts: Counter[str] = Counter()
    check()
    assert min(counts["taken"], counts["refused"]) > 40
    tried("demonstrations", counts)


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | text,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(text, inner, max_size=3),
    max_leaves=8,
)
requests = st.one_of(
    st.binary(max_size=40),
    json_values.map(lambda value: json.dumps(value).encode()),
    st.fixed_dictionaries(
        {"methods": json_values},
        optional=dict.fromkeys(("envs", "seeds", "conditions", "shown", "variants"), json_values),
    ).map(lambda value: json.dumps(value).encode()),
)


def test_any_request_that_is_none_is_refused_in_a_line(place: Path, tried: Tried) -> None:
    @settings(max_examples=300, deadline=None)
    @given(content=requests, command=st.sampled_from(["report", "verify"]))
    def check(content: bytes, command: str) -> None:
        store(place / "asked", content, "request", "run")
        before = (place / "asked/run.sqlite").read_bytes()
        err = io.StringIO()
        with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stderr(err):
            patch.chdir(place)
            assert cli.main([command, "asked"]) == 2
        assert err.getvalue().startswith("irl-bench: error: ")
        assert err.getvalue().count("\n") == 1
        assert (place / "asked/run.sqlite").read_bytes() == before
        counts[command] += 1

    with open_for_run(place / "asked", REQUEST):
        pass
    counts: Counter[str] = Counter()
    check()
    tried("damaged requests", counts)
