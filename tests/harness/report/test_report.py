"""The report: tables, figures and a page, rebuilt from results alone."""

from __future__ import annotations

import csv
import io
import math
import os
import re
import shutil
import subprocess
import sys
import warnings
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pandas as pd
import pytest
from scipy.stats import norm

import irl_bench
from harness.judge.across_tasks import indistinct, overall
from harness.judge.leaderboard import leaderboard, scored_rows
from harness.records import COLUMNS, CONTROLS, UNSHOWN, Cell, CellResult, Conditions, PolicyName, Shown
from harness.registry import BadInput
from harness.report import curves, spreadsheet
from harness.report.figures import styled
from harness.report.files import figure, recorded_in, table, write_report
from harness.report.model import build
from tests.harness.made_results import ENVS, REQUEST, entry_of, make_results, make_row

STORED = Path(__file__).parents[3] / "results/reference/quick_one_seed"


def read_csv(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(path.read_text())))


class Page(HTMLParser):
    """The links of a page, and its text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.text = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag == "a":
            self.links.append(dict(attrs)["href"] or "")

    def handle_data(self, data: str) -> None:
        self.text += data


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of `make_results` with a warning and a recording."""
    directory = tmp_path_factory.mktemp("report")
    (directory / "recordings").mkdir()
    (directory / "recordings" / "cartpole__shaped__seed0__pi_R.rrd").touch()
    write_report(directory, build(REQUEST, with_warning(make_results()), recorded_in(directory)))
    return directory


def with_warning(results: list[CellResult]) -> list[CellResult]:
    """The first has a warning, and was computed elsewhere; one has a recording."""
    results[0].warnings.append("expert <misses> its bar")
    recorded = next(r for r in results if r.cell == Cell("cartpole", "shaped", 0))
    recorded.recordings["cartpole__shaped__seed0__pi_R.rrd"] = "0" * 64
    old, new = ({"processor": "<old>", "torch": "1"}, {"processor": "new", "torch": "2"})
    return [replace(result, origin=new if i else old) for i, result in enumerate(results)]


def test_scores_hold_every_row_in_order_with_its_normalized_score(report: Path) -> None:
    results = make_results()
    rows = read_csv(report / "scores.csv")
    assert tuple(rows[0]) == (*COLUMNS, "budget", "rl", "program", "finished")
    assert len(rows) == sum(len(result.rows) for result in results)
    order = ["reference", "bc", "maxmargin", "shaped", *CONTROLS]
    policies: list[PolicyName] = ["expert", "random", "pi_star", "pi_R"]
    keys = [(r["env"], order.index(r["method"]), int(r["seed"]), policies.index(r["policy"])) for r in rows]  # type: ignore[arg-type]
    assert keys == sorted(keys)
    by_key = {(r["env"], r["method"], r["seed"], r["policy"]): r for r in rows}
    assert float(by_key["cartpole", "reference", "1", "expert"]["normalized_score"]) == 1
    assert float(by_key["cartpole", "reference", "1", "random"]["normalized_score"]) == 0
    shaped = by_key["pendulum", "shaped", "2", "pi_R"]
    assert float(shaped["normalized_score"]) == (430 - 20) / 480
    assert float(shaped["return_std"]) == 1 / 3  # to the last bit
    skipped = by_key["cartpole", "bc", "0", "pi_R"]
    assert (skipped["status"], skipped["reason"]) == ("skipped", "learns no reward")
    assert skipped["return_mean"] == skipped["normalized_score"] == ""


def test_equal_results_give_equal_files_in_whatever_order_they_come(report: Path, tmp_path: Path) -> None:
    (tmp_path / "recordings").mkdir()
    (tmp_path / "recordings" / "cartpole__shaped__seed0__pi_R.rrd").touch()
    write_report(tmp_path, build(REQUEST, with_warning(make_results())[::-1], recorded_in(tmp_path)))
    files = sorted(path.relative_to(report) for path in report.rglob("*") if path.is_file())
    tables = ["leaderboard.csv", "leaderboard.md", "report.html", "scores.csv"]
    recordings = ["recordings/cartpole__shaped__seed0__pi_R.rrd"]
    assert sorted(map(str, files)) == sorted(tables + recordings)
    for file in files:
        assert (report / file).read_bytes() == (tmp_path / file).read_bytes(), file


def test_equal_results_give_equal_files_in_whatever_order_sets_are(tmp_path: Path) -> None:
    written = []
    for order in "12":
        run = tmp_path / order
        shutil.copytree(STORED, run)
        command = [sys.executable, "-m", "harness", "report", str(run)]
        subprocess.run(command, check=True, capture_output=True, env=os.environ | {"PYTHONHASHSEED": order})
        written.append([(run / file).read_bytes() for file in ("report.html", "leaderboard.md")])
    assert written[0] == written[1]


def test_a_run_without_its_reference_has_no_scores_and_says_so(tmp_path: Path) -> None:
    results = [r for r in make_results(seeds=1) if r.cell.method != "reference" or r.cell.env == "pendulum"]
    write_report(tmp_path, build(REQUEST, results))
    for row in read_csv(tmp_path / "scores.csv"):
        known = row["env"] == "pendulum" and row["status"] == "ok"
        assert (row["normalized_score"] != "") == known
    cartpole = (tmp_path / "leaderboard.md").read_text().split("## pendulum")[0]
    assert "| shaped | π_R | n/a |  | n/a | 1 of 1 | not scored (seed 0)" in cartpole
    assert "| shaped | π_R | 440.0 [439.9, 440.1] | 12.5 |" in cartpole
    assert "nan" not in (tmp_path / "leaderboard.md").read_text()
    text = Page((tmp_path / "report.html").read_text()).text
    assert "cartpole, seed 0: no scores" in text
    assert "pendulum, seed 0: no normalized scores" not in text


def test_a_run_that_has_only_its_reference_yet_draws_nothing(tmp_path: Path) -> None:
    write_report(tmp_path, build(REQUEST, [r for r in make_results(seeds=1) if r.cell.method == "reference"]))
    assert "<svg" not in (tmp_path / "report.html").read_text()
    assert "reference" in (tmp_path / "leaderboard.md").read_text()


def test_the_report_says_where_the_time_went(tmp_path: Path) -> None:
    results = make_results(("cartpole",), seeds=1)
    write_report(tmp_path, build(REQUEST, results))
    assert "Where the time went" not in (tmp_path / "leaderboard.md").read_text()  # of cells that do not say
    for result in results:
        result.seconds.update(fit=1.0, start=0.5)
    results[0].seconds["retrain"] = 3.5
    write_report(tmp_path, build(REQUEST, results))
    spent = 1.5 * len(results) + 3.5
    table = (tmp_path / "leaderboard.md").read_text().partition("Where the time went")[2]
    for stage, took in (("fit", len(results)), ("start", len(results) / 2), ("retrain", 3.5)):
        assert f"| {stage} | {took:.1f} | {took / spent:.0%} |" in table
    assert "Where the time went" in Page((tmp_path / "report.html").read_text()).text


def test_one_seed_has_the_interval_over_episodes_and_says_so(tmp_path: Path) -> None:
    results = make_results(("cartpole",), seeds=1)
    shaped = entry_of(results, "shaped", "pi_R")
    error = (1 / 3) / math.sqrt(100)
    assert (shaped.return_low, shaped.return_high) == pytest.approx(norm.interval(0.95, 440, error))
    assert shaped.score_high - shaped.score_low == pytest.approx(
        (shaped.return_high - shaped.return_low) / 480
    )
    assert shaped.varies == "episodes"
    write_report(tmp_path, build(REQUEST, results))
    assert "one seed: intervals are over episodes" in (tmp_path / "leaderboard.md").read_text()


def test_what_an_uninformed_control_wins_is_left_out_of_the_summary_and_said(tmp_path: Path) -> None:
    results = make_results()
    for result in results:
        if result.cell.method == "control_survival":
            value = 500.0 if result.cell.env == "pendulum" else 200.0
            cell = result.cell
            result.rows[:] = [make_row(cell.env, cell.method, cell.seed, "pi_R", return_mean=value)]
    rows = scored_rows(results)
    left_out = indistinct(leaderboard(rows))
    assert list(left_out) == ["pendulum"]
    assert "control_survival scores 1.00 there, the best method 0.86" in left_out["pendulum"]
    assert overall(rows, tuple(left_out)) == []  # one env is left
    write_report(tmp_path, build(REQUEST, results))
    for name in ("leaderboard.md", "report.html"):
        assert "pendulum is left out: control\\_survival" in (text := (tmp_path / name).read_text()) or (
            "pendulum is left out: control_survival" in text
        )


def test_across_environments_boards_of_the_same_demonstrations_are_compared(tmp_path: Path) -> None:
    results = []
    for result in make_results():
        cell = result.cell
        if cell.method == "control_survival":
            for demos, value in ((5, 500.0 if cell.env == "pendulum" else 100.0), (20, 100.0)):
                its = replace(cell, method="control_shuffled", shown=Shown(demos))
                row = make_row(cell.env, its.method, cell.seed, "pi_R", return_mean=value)
                results.append(replace(result, cell=its, rows=[replace(row, demos=demos)]))
        elif cell.method in UNSHOWN:
            results.append(result)
        else:
            for demos in (5, 20):
                rows = [replace(row, demos=demos) for row in result.rows]
                results.append(replace(result, cell=replace(cell, shown=Shown(demos)), rows=rows))
    write_report(tmp_path, build(REQUEST, results))
    text = (tmp_path / "leaderboard.md").read_text()
    across = text[text.index("## Across environments") : text.index("## cartpole")]
    assert "pendulum is left out: control_shuffled scores 1.00" in across
    assert "cartpole is left out" not in across
    assert "of boards with 5 demonstrations" in across
    assert "| shaped |" not in across  # one env is left


@pytest.mark.parametrize("why", ["smoke", "below its bar", ""])
def test_what_is_no_result_is_headed_so_everywhere(tmp_path: Path, why: str) -> None:
    results = make_results(seeds=1)
    if why == "below its bar":
        results = [replace(r, below_bar=r.cell == Cell("pendulum", "reference", 0)) for r in results]
    conditions = Conditions("smoke" if why == "smoke" else "quick", "absorbing", "sbx")
    files = write_report(tmp_path, build(replace(REQUEST, conditions=conditions), results))
    table, page = ((tmp_path / name).read_text() for name in ("leaderboard.md", "report.html"))
    assert table.startswith("# NOT A RESULT: Leaderboard" if why else "# Leaderboard")
    assert ("<h1>NOT A RESULT" in page) == bool(why)
    for env in ENVS:
        flagged = why == "smoke" or (why != "" and env == "pendulum")
        assert (f"## {env}: NOT A RESULT" in table) == flagged
        title = re.search(rf'<div id="board-{env}"><h3>(.*?)</h3>', page, re.DOTALL)
        assert title
        assert ("NOT A RESULT" in title[1]) == flagged
    assert len(files) == 4


@pytest.mark.parametrize(("kind", "begins"), [("pdf", b"%PDF"), ("svg", b"<?xml"), ("png", b"\x89PNG")])
def test_figures_for_papers_are_equal_for_equal_results_and_say_what_is_no_result(
    kind: str, begins: bytes
) -> None:
    report = build(REQUEST, make_results(seeds=1))
    drawn = figure(report, kind, "cartpole")
    assert drawn.startswith(begins)
    assert drawn == figure(report, kind, "cartpole")
    below = [replace(r, below_bar=r.cell.method == "reference") for r in report.results]
    assert drawn != figure(build(REQUEST, below), kind, "cartpole")
    if kind == "svg":
        assert b">control_survival<" in drawn
        assert b">pendulum<" in figure(report, kind)


def test_tables_for_papers_have_the_boards_scores() -> None:
    report = build(REQUEST, make_results())
    tex, md, csv_ = (table(report, kind, "cartpole") for kind in ("tex", "md", "csv"))
    assert tex.count(r"\begin{tabular}{llrrrrl}") == tex.count(r"\bottomrule") == 1
    assert r"shaped & $\pi_R$ & 0.86 [0.84, 0.89] & the best &" in tex
    assert md.startswith("## cartpole\n\n| Method | Policy | Score [95 %] |")
    lines = list(csv.DictReader(io.StringIO(csv_)))
    assert {line["env"] for line in lines} == {"cartpole"}
    assert len(lines) == sum(entry.env == "cartpole" for entry in report.entries)
    assert table(report, "tex").count(r"\begin{tabular}") == len(ENVS)
    with pytest.raises(BadInput, match="no env of this run named 'cartpol'"):
        table(report, "tex", "cartpol")


def test_tables_and_pages_say_what_they_are_of(tmp_path: Path) -> None:
    results = [
        replace(
            r,
            origin={"irl-bench": "0.1.0 (abc)"},
            finished="2026-11-23 10:00",
            rows=[replace(row, expert="1a2b3c4d:0") for row in r.rows],
        )
        for r in make_results(("cartpole",))
    ]
    write_report(tmp_path, build(REQUEST, results))
    for name in ("leaderboard.md", "report.html"):
        text = (tmp_path / name).read_text()
        for said in (
            "budget quick, protocol absorbing, seeds 0 to 2, RL library sbx, instructions fixed",
            "experts shipped: 1a2b3c4d",
            "computed 2026-11-23 by irl-bench 0.1.0 (abc)",
            "command: irl-bench run --methods bc,shaped,maxmargin --envs cartpole,pendulum --seeds 3",
        ):
            assert said in text, said
    assert "--fast" not in text
    fast = replace(REQUEST, conditions=replace(REQUEST.conditions, deterministic=False))
    write_report(tmp_path, build(fast, results))
    text = (tmp_path / "leaderboard.md").read_text()
    assert "instructions of the machine" in text
    assert (
        "--seeds 3 --budget quick --protocol absorbing --rl sbx --experts shipped --record both --fast"
        in text
    )
    (row, *_) = read_csv(tmp_path / "scores.csv")
    assert (row["budget"], row["rl"], row["program"], row["expert"]) == (
        "quick",
        "sbx",
        "0.1.0 (abc)",
        "1a2b3c4d:0",
    )


def test_one_rule_tells_who_is_best_wherever_it_is_told(tmp_path: Path) -> None:
    kept = {"shaped": 0, "maxmargin": 1}
    results = [r for r in make_results(("cartpole",)) if kept.get(r.cell.method, r.cell.seed) == r.cell.seed]
    write_report(tmp_path, build(REQUEST, results))
    (line,) = [
        line
        for line in (tmp_path / "leaderboard.md").read_text().splitlines()
        if line.startswith("| maxmargin | π_R | 0.") and "seed in common" in line
    ]
    assert "the best" not in line
    page = (tmp_path / "report.html").read_text()
    assert page.count("<b>★</b>") == 3  # the legend, and one of each policy
    tile = "maxmargin, π_R, cartpole: 0.68 [0.68, 0.68], 1 of 1 seeds; interval over episodes; no seed"
    assert tile in page
    assert "(1 with no seed in common)" in page


def test_the_command_is_told_once(report: Path) -> None:
    page = (report / "report.html").read_text()
    assert "<code>command: irl-bench run --methods" in page
    assert "command: command:" not in page


def test_numbers_beyond_all_bounds_are_short_everywhere(tmp_path: Path) -> None:
    results = make_results(("cartpole",))
    for result in results:
        if result.cell.method == "shaped":
            result.rows[:] = [replace(row, return_mean=-1e99, own_return=1e99) for row in result.rows]
            result.details["size"] = -1e99
            result.curves["pi_R_chosen"] = [(5000.0, 1e99)]
            result.curves["pi_R_true"] = [(5000.0, 1e99)]
    write_report(tmp_path, build(REQUEST, results))
    for name in ("leaderboard.md", "report.html"):
        text = (tmp_path / name).read_text()
        assert "-1e+99" in text
        assert not re.search(r"\d{3}(,?\d{3}){10}", re.sub('id="files".*', "", text)), name


def test_texts_that_a_spreadsheet_would_compute_are_marked_and_read_back(tmp_path: Path) -> None:
    texts = ["=1+1", "+1", "-1", "@A1", "\tx", "\rx", "'=1", "''-1", "\uff1d1", "'", "plain -1", "'s"]
    file = tmp_path / "a.csv"
    table = pd.DataFrame({"text": texts, "number": [-float(i) for i in range(len(texts))]})
    file.write_text(spreadsheet.as_csv(table), newline="")
    with file.open(newline="") as raw:
        lines = list(csv.DictReader(raw))
    assert not [line["text"] for line in lines if line["text"][0] in "=+-@\t\r\uff1d"]
    assert [line["number"] for line in lines] == [str(-float(i)) for i in range(len(texts))]
    with file.open("rb") as binary:
        again = spreadsheet.read_csv(binary, {"text": str})
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
        cells = {value for row in read_csv(tmp_path / name) for value in row.values()}
        assert not [cell for cell in cells if cell[:1] in tuple("=+-@")]
    found = irl_bench.load(tmp_path).scores
    assert {*found.program, *found.finished, *found.reason} == {evil}
    assert {*found.expert, *found.source} == {"@x", "-1+1"}


def test_details_of_fits_are_told(tmp_path: Path) -> None:
    results = [
        replace(
            r,
            details={"eigenvalues of LLᵀ, mean": 1e-5 * (1 + r.cell.seed)}
            if r.cell.method == "shaped"
            else {},
        )
        for r in make_results(("cartpole",))
    ]
    write_report(tmp_path, build(REQUEST, results))
    assert "| shaped | eigenvalues of LLᵀ, mean | 2e-05 |" in (tmp_path / "leaderboard.md").read_text()
    assert "eigenvalues of LLᵀ, mean" in (tmp_path / "report.html").read_text()


def test_curves_mark_the_checkpoint_that_counts_at_its_true_return() -> None:
    results = make_results(("cartpole",))
    for result in results:
        if "pi_R" in result.curves:
            result.curves["pi_R_chosen"] = [result.curves["pi_R"][9]]
    (board,) = build(REQUEST, results).boards
    with styled():
        chart, few = curves.learning(board, 60), curves.learning(board, 2)
    assert chart is not None
    assert few is not None
    (plot,) = chart.plots
    assert plot.count('font-weight="700"') == 7, "control_true and the other controls, shaped, maxmargin"
    chosen = [dict(r.curves["pi_R_true"])[9000.0] for r in results if r.cell.method == "shaped"]
    for value in chosen:
        assert f'data-tip="shaped, steps 9,000: true return {value:.1f}"' in plot
    assert few.note == "The first 2 of 7 panels."
    assert few.data is not None
    drawn = {"maxmargin", "shaped", "control_true"}  # the last in each of the two panels
    assert {*few.data["method"]} - {"reference"} == drawn


def test_glyphs_that_fonts_lack_warn_nobody(tmp_path: Path) -> None:
    with warnings.catch_warnings(record=True) as told:
        results = [
            CellResult(
                Cell("cartpole", "bc", 0),
                [make_row("cartpole", "bc", 0, "pi_R", return_mean=1.0)],
                {"\u8a9e": [(0.0, 1.0)]},
            )
        ]
        write_report(tmp_path, build(REQUEST, results))
    assert [str(one.message) for one in told] == []


def test_markdown_tables_are_rectangular(report: Path) -> None:
    sections = (report / "leaderboard.md").read_text().split("## ")[1:]
    tables = [part for section in sections for part in section.split("\n\n") if part.startswith("|")]
    assert [section.split("\n")[0] for section in sections] == [
        *("Across environments", "cartpole", "pendulum"),
        "Computed with",
    ]
    assert len(tables) == 6  # three for each env
    for one in tables:
        lines = [line.replace(r"\|", "") for line in one.splitlines() if line.startswith("|")]
        assert len({line.count("|") for line in lines}) == 1
        assert lines[0].count("|") <= 9  # eight columns


def test_page_shows_endings_warnings_and_recordings(report: Path) -> None:
    page = Page((report / "report.html").read_text())
    links = [link for link in page.links if not link.startswith("#")]
    assert links == ["recordings/cartpole__shaped__seed0__pi_R.rrd"]
    assert "irl-bench view . --env cartpole --method shaped" in page.text
    assert "cartpole__reference__seed0: expert <misses> its bar" in page.text
    assert "time limit 210, pole fell 90" in page.text
    score = next(
        row["normalized_score"]
        for row in read_csv(report / "scores.csv")
        if (row["env"], row["method"], row["seed"], row["policy"]) == ("cartpole", "shaped", "0", "pi_R")
    )
    assert f"__pi_R.rrd{float(score):.2f}time limit" in "".join(page.text.split("\n"))
    others = len(make_results()) - 1
    for text, old in ((page.text, "<old>"), ((report / "leaderboard.md").read_text(), r"\<old\>")):
        assert f"1 cells: processor {old}, torch 1" in text
        assert f"{others} cells: processor new, torch 2" in text
    assert "computed on different machines" in page.text


def test_a_recording_of_a_policy_without_a_row_has_no_score(tmp_path: Path) -> None:
    results = with_warning(make_results())
    shaped = next(i for i, r in enumerate(results) if r.recordings)
    kept = [row for row in results[shaped].rows if row.policy != "pi_R"]
    results[shaped] = replace(results[shaped], rows=kept)
    write_report(tmp_path, build(REQUEST, results, ["cartpole__shaped__seed0__pi_R.rrd"]))
    text = Page((tmp_path / "report.html").read_text()).text
    assert "__pi_R.rrdn/atime limit" in "".join(text.split("\n"))


def test_one_machine_is_no_warning(tmp_path: Path) -> None:
    write_report(tmp_path, build(REQUEST, make_results()))
    assert "different machines" not in (tmp_path / "report.html").read_text()


def test_no_results_make_an_empty_report(tmp_path: Path) -> None:
    write_report(tmp_path, build(REQUEST, []))
    assert read_csv(tmp_path / "scores.csv") == []
    assert (tmp_path / "scores.csv").read_text() == ",".join(
        [*COLUMNS, "budget", "rl", "program", "finished"]
    ) + "\n"
    assert "No results yet" in (tmp_path / "report.html").read_text()
