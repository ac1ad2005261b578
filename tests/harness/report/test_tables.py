"""CSV files hold no formulas, and are read back as they were written."""

from __future__ import annotations

import csv
import io
from dataclasses import replace
from pathlib import Path

import pandas as pd

import irl_bench
from harness.report.files import write_report
from harness.report.model import build
from harness.report.tables import as_csv, read_csv
from tests.harness.made_results import REQUEST, make_results


def test_texts_that_a_spreadsheet_would_compute_are_marked_and_read_csv(tmp_path: Path) -> None:
    texts = ["=1+1", "+1", "-1", "@A1", "\tx", "\rx", "'=1", "''-1", "\uff1d1", "'", "plain -1", "'s"]
    file = tmp_path / "a.csv"
    table = pd.DataFrame({"text": texts, "number": [-float(i) for i in range(len(texts))]})
    file.write_text(as_csv(table), newline="")
    with file.open(newline="") as raw:
        lines = list(csv.DictReader(raw))
    assert not [line["text"] for line in lines if line["text"][0] in "=+-@\t\r\uff1d"]
    assert [line["number"] for line in lines] == [str(-float(i)) for i in range(len(texts))]
    with file.open("rb") as binary:
        again = read_csv(binary, {"text": str})
    assert [*again.text] == texts
    assert [*again.number] == [*table.number]


def test_no_column_of_texts_holds_a_formula(tmp_path: Path) -> None:
    evil = '=HYPERLINK("http://x";1)'
    results = [
        replace(
            r,
            origin={"irl-bench": evil},
            finished=evil,
            rows=[replace(row, expert="@x", source="-1+1", reason=evil, status="skipped") for row in r.rows],
        )
        for r in make_results(("cartpole",))
    ]
    write_report(tmp_path, build(REQUEST, results))
    for name in ("scores.csv", "leaderboard.csv"):
        lines = csv.DictReader(io.StringIO((tmp_path / name).read_text()))
        cells = {value for line in lines for value in line.values()}
        assert not [cell for cell in cells if cell[:1] in tuple("=+-@")]
    loaded = irl_bench.load(tmp_path).scores
    assert {*loaded.program, *loaded.finished, *loaded.reason} == {evil}
    assert {*loaded.expert, *loaded.source} == {"@x", "-1+1"}
