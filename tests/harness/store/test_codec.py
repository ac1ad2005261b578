"""The door for stored cells: what is none is named in a line, and what is one can be reported."""

import csv
import json
import math
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.records import Cell, CellResult, Conditions, Row
from harness.registry.bounds import LARGEST
from harness.report.files import write_report
from harness.report.model import build
from harness.store.codec import decode, encode
from harness.store.request import Request

ODD: list[Any] = [
    *(None, True, -1, 1.5, 10**400, 1e308, "", "x" * 5000, "1", "../../x", "\x1b[2J", "\udce9", "<b>"),
    *([], [[]], [1, 2, 3], {}, {"a": []}, [None] * 5, "expert", "ok", 0, [[0, "a"]]),
]
Tried = Callable[[str, Counter[str]], None]
REQUEST = Request(("bc",), ("cartpole",), tuple(range(5)), Conditions("quick", "absorbing", "sbx"))


def cell_with(**changes: Any) -> CellResult:
    values = {"return_mean": 400.0, "episodes": 5} | changes
    rows = [Row("cartpole", "shaped", 0, policy, "absorbing", **values) for policy in ("pi_star", "pi_R")]
    return CellResult(
        Cell("cartpole", "shaped", 0),
        rows,
        {"loss": [(0.0, 1.0), (1.0, math.nan)], "pi_R": [(0.0, -1.0), (500.0, 2.0)]},
        {"pi_star": {"pole fell": 2, "time limit": 3}},
        ["low"],
        {"a.rrd": "0" * 64},
        "0" * 64,
        "key",
        {"processor": "one", "numpy": "2"},
        seconds={"fit": 1.5},
        settings={"method": {"layers": [64, 64], "rate": 1e-3, "name": "a", "on": True}},
    )


def reference() -> CellResult:
    returns = {"expert": 500.0, "random": 0.0}
    rows = [Row("cartpole", "reference", 0, p, "absorbing", return_mean=r) for p, r in returns.items()]
    return CellResult(Cell("cartpole", "reference", 0), rows)


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield where something is, at every depth."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in items:
        yield (*path, key)
        yield from places(inner, (*path, key))


def test_what_is_stored_is_plain_json() -> None:
    result = replace(cell_with(return_std=np.float64(0.1)), details={"a": np.float64(2.5)})
    stored = json.loads(encode(result))
    assert [row["return_std"] for row in stored["rows"]] == [0.1, 0.1]
    assert encode(result) == json.dumps(stored)
    with pytest.raises(TypeError, match="int64"):
        encode(replace(result, details={"a": np.int64(1)}))


@pytest.mark.parametrize("text", ["", "null", "{}", "[" * 5000, b"\xff\xfe\x00", '{"settings": 1e999}'])
def test_anything_else_is_no_result(text: str | bytes) -> None:
    with pytest.raises(ValueError, match=r"no JSON of a run|Expected|missing|out of range"):
        decode(text)


@given(st.floats() | st.integers(-(2**53), 2**53))
def test_any_number_comes_back_bit_by_bit_or_is_unknown(value: float) -> None:
    there = decode(encode(replace(cell_with(), curves={"loss": [(0.0, value)]})))
    ((_, found),) = there.curves["loss"]
    assert repr(found) == repr(float(value)) if abs(value) <= LARGEST else math.isnan(found)


def test_fields_that_a_stored_cell_lacks_have_their_defaults() -> None:
    cell = json.loads(encode(cell_with()))
    for name in ("learned", "seconds", "settings"):
        del cell[name]
    found = decode(json.dumps(cell))
    assert (found.learned, found.seconds, found.settings) == ("", {}, {})


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
    with (tmp_path / "scores.csv").open() as file:
        assert {row["reason"] for row in csv.DictReader(file)} == {"", f"'{said}"}
