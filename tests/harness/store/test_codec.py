"""The door for stored cells: what is none is named in a line, and what is one can be reported."""

import copy
import csv
import io
import json
import math
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.judge.leaderboard import leaderboard, scored_rows
from harness.records import Cell, CellResult, Conditions, Row
from harness.registry.bounds import LARGEST, MOST_CURVES, MOST_POINTS
from harness.report.files import write_report
from harness.report.model import build
from harness.store.codec import decode, encode, printable
from harness.store.request import Request

ODD: list[Any] = [
    *(None, True, -1, 1.5, 10**400, 1e308, "", "x" * 5000, "1", "../../x", "\x1b[2J", "\udce9", "<b>"),
    *([], [[]], [1, 2, 3], {}, {"a": []}, [None] * 5, "expert", "ok", 0, [[0, "a"]]),
]
Tried = Callable[[str, Counter[str]], None]


def cell_with(seed: int = 0, **changes: Any) -> CellResult:
    rows = [
        Row("cartpole", "shaped", seed, policy, "absorbing", return_mean=400.0 + seed, episodes=5, **changes)
        for policy in ("pi_star", "pi_R")
    ]
    curves = {"loss": [(0.0, 1.0), (1.0, math.nan)], "pi_R": [(0.0, -1.0), (500.0, 2.0)]}
    endings = {"pi_star": {"pole fell": 2, "time limit": 3}}
    origin = {"processor": "one", "numpy": "2"}
    return CellResult(
        Cell("cartpole", "shaped", seed),
        rows,
        curves,
        endings,
        ["low"],
        {"a.rrd": "0" * 64},
        "0" * 64,
        "key",
        origin,
        seconds={"fit": 1.5},
        settings={"method": {"layers": [64, 64], "rate": 1e-3, "name": "a", "on": True}},
    )


REQUEST = Request(("bc",), ("cartpole",), tuple(range(5)), Conditions("quick", "absorbing", "sbx"))


def reference(seed: int = 0) -> CellResult:
    names = ("expert", "random")
    rows = [
        Row("cartpole", "reference", seed, p, "absorbing", return_mean=500.0 * (p == "expert")) for p in names
    ]
    return CellResult(Cell("cartpole", "reference", seed), rows)


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Where something is, at every depth."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in items:
        yield (*path, key)
        yield from places(inner, (*path, key))


def changed(payload: Any, path: tuple[Any, ...], how: Callable[[Any, Any], None]) -> Any:
    mutated = copy.deepcopy(payload)
    holder = mutated
    for key in path[:-1]:
        holder = holder[key]
    how(holder, path[-1])
    return mutated


def test_what_is_stored_is_plain_json() -> None:
    result = replace(cell_with(return_std=np.float64(0.1)), details={"a": np.float64(2.5)})
    stored = json.loads(encode(result))
    assert [row["return_std"] for row in stored["rows"]] == [0.1, 0.1]
    assert encode(result) == json.dumps(stored)
    with pytest.raises(TypeError, match="int64"):
        encode(replace(result, details={"a": np.int64(1)}))


def test_any_ill_typed_cell_is_refused_in_a_line_or_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, tried: Tried
) -> None:
    payload = json.loads(encode(cell_with()))
    mutated = []
    for path in places(payload):
        mutated += [
            changed(payload, path, lambda holder, key, odd=odd: holder.__setitem__(key, odd)) for odd in ODD
        ]
        mutated.append(changed(payload, path, lambda holder, key: holder.__delitem__(key)))
    counts: Counter[str] = Counter()
    for stranger in [*mutated, *ODD]:
        reason, data = "", json.dumps(stranger)
        try:
            found = decode(data)
        except ValueError as error:
            reason = str(error)
        counts["refused" if reason else "taken"] += 1
        if reason:
            assert reason.isprintable()
            assert len(reason) < 300
            continue
        assert found.cell.name.replace("_", "").replace(".", "").isalnum()
        if counts["taken"] % 100 == 0:
            write_report(tmp_path, build(REQUEST, [found, reference()]))
        assert leaderboard(scored_rows([found, reference()]))
    assert counts["refused"] > 1000
    assert counts["taken"] > 50
    tried("stored cells with something else in one place", counts)


@pytest.mark.parametrize("text", ["", "[]", "null", "{}", "[" * 5000, b"\xff\xfe\x00", '{"settings": 1e999}'])
def test_anything_else_is_no_result(text: str | bytes) -> None:
    with pytest.raises(ValueError, match=r"no JSON of a run|Expected|missing|out of range"):
        decode(text)


@given(st.floats() | st.integers(-(2**53), 2**53))
def test_any_number_comes_back_bit_by_bit_or_is_unknown(value: float) -> None:
    there = decode(encode(CellResult(cell_with().cell, cell_with().rows, {"loss": [(0.0, value)]})))
    ((_, found),) = there.curves["loss"]
    assert repr(found) == repr(float(value)) if abs(value) <= LARGEST else math.isnan(found)


def test_fields_that_a_stored_cell_lacks_have_their_defaults() -> None:
    cell = json.loads(encode(cell_with()))
    for name in ("learned", "seconds", "settings"):
        del cell[name]
    found = decode(json.dumps(cell))
    assert (found.learned, found.seconds, found.settings) == ("", {}, {})
    with pytest.raises(ValueError, match="seconds"):  # time does not run back
        decode(json.dumps(cell | {"seconds": {"fit": -1.0}}))


def test_extreme_numbers_can_be_drawn(tmp_path: Path) -> None:
    curves = {"loss": [(0.0, -LARGEST), (1.0, LARGEST)], "pi_R": [(0.0, 1e-300), (LARGEST, 1e-300)]}
    cell = replace(cell_with(), curves=curves, rows=[replace(cell_with().rows[1], return_mean=LARGEST)])
    files = write_report(tmp_path, build(REQUEST, [decode(encode(cell)), reference()]))
    assert all(file.stat().st_size > 0 for file in files)


def test_much_is_refused_at_once_and_what_is_taken_is_reported_in_seconds(tmp_path: Path) -> None:
    many = {f"curve {i}": [(0.0, 1.0)] for i in range(MOST_CURVES + 1)}
    long = {"loss": [(float(i), 1.0) for i in range(MOST_POINTS + 1)]}
    for curves in (many, long):
        with pytest.raises(ValueError, match="of length <="):
            decode(encode(CellResult(cell_with().cell, cell_with().rows, curves)))
    most = {f"curve {i}": [(float(x), 1.0) for x in range(MOST_POINTS)] for i in range(MOST_CURVES)}
    started = time.process_time()
    write_report(tmp_path, build(REQUEST, [replace(cell_with(), curves=most), reference()]))
    assert time.process_time() - started < 20


def test_texts_are_shown_and_do_nothing(tmp_path: Path) -> None:
    said = "=1+1 <script>alert(1)</script> | `rm` [link](javascript:x) & \\"
    failed = cell_with(status="failed", reason=said)
    failed.warnings.append(said)
    failed.origin["processor"] = said
    write_report(tmp_path, build(REQUEST, [decode(encode(failed)), reference()]))
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<script>alert" not in page
    assert "&lt;script&gt;" in page
    table = (tmp_path / "leaderboard.md").read_text(encoding="utf-8")
    assert r"\<script\>alert(1)\</script\> \| \`rm\` [link]\(javascript:x) \& \\" in table
    (row,) = {
        row["reason"]
        for row in csv.DictReader(io.StringIO((tmp_path / "scores.csv").read_text()))
        if row["reason"]
    }
    assert row == f"'{said}"


@given(st.text())
def test_what_is_printable_stays_as_it_is_and_the_rest_is_escaped(text: str) -> None:
    shown = printable(text)
    assert "\x1b" not in shown
    assert "\n" not in shown
    shown.encode()  # raises for what cannot be written
    assert printable(shown) == shown
    if text.isascii() and text.isprintable():
        assert shown == text
