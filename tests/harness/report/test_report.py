"""The report: tables, figures and a page, rebuilt from results alone."""

from __future__ import annotations

import csv
import html
import io
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

import irl_bench
from harness.records import COLUMNS, CONTROLS, Cell, CellResult, Conditions
from harness.report.files import recorded_in, write_report
from harness.report.model import build
from tests.harness.made_results import ENVS, REQUEST, make_results

STORED = Path(__file__).parents[3] / "results/reference/board/cartpole_5"
RECORDING = "cartpole__shaped__seed0__pi_R.rrd"


def read_csv(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(path.read_text())))


def words_of(path: Path) -> str:
    """Return the text of a page."""
    return html.unescape(re.sub("<[^>]*>", "", path.read_text()))


def results_of_two_machines() -> list[CellResult]:
    """The first has a warning, and was computed elsewhere; one has a recording."""
    results = make_results()
    results[0].warnings.append("expert <misses> its bar")
    next(r for r in results if r.cell == Cell("cartpole", "shaped", 0)).recordings[RECORDING] = "0" * 64
    old, new = ({"processor": "<old>", "torch": "1"}, {"processor": "new", "torch": "2"})
    return [replace(result, origin=new if i else old) for i, result in enumerate(results)]


def written(directory: Path, results: list[CellResult]) -> Path:
    (directory / "recordings").mkdir()
    (directory / "recordings" / RECORDING).touch()
    write_report(directory, build(REQUEST, results, recorded_in(directory)))
    return directory


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("report"), results_of_two_machines())


def test_scores_hold_every_row_in_order_with_its_normalized_score(report: Path) -> None:
    rows = read_csv(report / "scores.csv")
    assert tuple(rows[0]) == (*COLUMNS, "budget", "rl", "program", "finished")
    assert len(rows) == sum(len(result.rows) for result in make_results())
    order, policies = ["reference", "bc", "maxmargin", "shaped", *CONTROLS], ["expert", "random", "pi_star"]
    keys = [
        (r["env"], order.index(r["method"]), int(r["seed"]), [*policies, "pi_R"].index(r["policy"]))
        for r in rows
    ]
    assert keys == sorted(keys)
    by_key = {(r["env"], r["method"], r["seed"], r["policy"]): r for r in rows}
    assert float(by_key["cartpole", "reference", "1", "expert"]["normalized_score"]) == 1
    shaped = by_key["pendulum", "shaped", "2", "pi_R"]
    assert float(shaped["normalized_score"]) == (430 - 20) / 480
    assert float(shaped["return_std"]) == 1 / 3  # to the last bit
    skipped = by_key["cartpole", "bc", "0", "pi_R"]
    assert (skipped["status"], skipped["reason"]) == ("skipped", "learns no reward")
    assert skipped["return_mean"] == skipped["normalized_score"] == ""


def test_equal_results_give_equal_files_in_whatever_order_they_come(report: Path, tmp_path: Path) -> None:
    written(tmp_path, results_of_two_machines()[::-1])
    for name in ("leaderboard.csv", "leaderboard.md", "report.html", "scores.csv"):
        assert (report / name).read_bytes() == (tmp_path / name).read_bytes(), name


def test_equal_results_give_equal_files_in_whatever_order_sets_are(tmp_path: Path) -> None:
    pages = []
    for order in "12":
        run = shutil.copytree(STORED, tmp_path / order)
        command = [sys.executable, "-m", "harness", "report", str(run)]
        subprocess.run(command, check=True, capture_output=True, env=os.environ | {"PYTHONHASHSEED": order})
        pages.append([(run / file).read_bytes() for file in ("report.html", "leaderboard.md")])
    assert pages[0] == pages[1]


def test_a_run_without_its_reference_has_no_scores_and_says_so(tmp_path: Path) -> None:
    results = [r for r in make_results(seeds=1) if r.cell.method != "reference" or r.cell.env == "pendulum"]
    write_report(tmp_path, build(REQUEST, results))
    for row in read_csv(tmp_path / "scores.csv"):
        assert (row["normalized_score"] != "") == (row["env"] == "pendulum" and row["status"] == "ok")
    cartpole = (tmp_path / "leaderboard.md").read_text().split("## pendulum")[0]
    assert "| shaped | π_R | n/a | n/a | n/a |  |  | n/a | 1 of 1 | not scored (seed 0)" in cartpole
    assert "| shaped | π_R | 440.0 | 12.5 |" in cartpole
    text = words_of(tmp_path / "report.html")
    assert "cartpole, seed 0: no score" in text
    assert "pendulum, seed 0: no score" not in text


def test_a_run_with_nothing_to_draw_has_an_empty_report(tmp_path: Path) -> None:
    write_report(tmp_path, build(REQUEST, []))
    assert read_csv(tmp_path / "scores.csv") == []
    assert (tmp_path / "scores.csv").read_text().startswith(",".join(COLUMNS))
    assert "No results yet" in (tmp_path / "report.html").read_text()
    write_report(tmp_path, build(REQUEST, [r for r in make_results(seeds=1) if r.cell.method == "reference"]))
    assert "<svg" not in (tmp_path / "report.html").read_text()
    assert "reference" in (tmp_path / "leaderboard.md").read_text()


def test_one_seed_says_next_to_nothing_of_the_mean(tmp_path: Path) -> None:
    write_report(tmp_path, build(REQUEST, make_results(("cartpole",), seeds=1)))
    assert "| shaped | π_R | 0.88 [0.04, 0.99] |" in (tmp_path / "leaderboard.md").read_text()


def test_what_rl_did_not_solve_is_a_state_and_a_hollow_mark(tmp_path: Path) -> None:
    results = make_results(seeds=1)
    for result in results:
        if result.cell.method == "shaped":
            distant = {"reward_distance": 0.1, "solved": 0.0}
            result.rows[1] = replace(result.rows[1], **distant)  # type: ignore[arg-type]
    write_report(tmp_path, build(REQUEST, results))
    assert "| shaped | π_R | not solved (0.88) |" in (tmp_path / "leaderboard.md").read_text()
    page = (tmp_path / "report.html").read_text()
    assert "not solved (0.88)" in page
    for section in ("seeds", "cost"):
        plot = page.partition(f'<section id="{section}"')[2].partition("</svg>")[0]
        (mark,) = re.findall(r'<use data-tip="shaped π_R:? not solved[^>]*', plot)
        assert 'fill="var(--bg)"' in mark
    lines = [row for row in read_csv(tmp_path / "leaderboard.csv") if row["method"] == "shaped"]
    told = {(r["policy"], r["unsolved"], r["score_mean"] == "", r["score_unsolved"] == "") for r in lines}
    assert told == {("pi_star", "0", False, True), ("pi_R", "1", True, False)}


@pytest.mark.parametrize("why", ["smoke", "below its bar", ""])
def test_numbers_that_are_no_result_are_headed_so_everywhere(tmp_path: Path, why: str) -> None:
    results = make_results(seeds=1)
    if why == "below its bar":
        results = [replace(r, below_bar=r.cell == Cell("pendulum", "reference", 0)) for r in results]
    conditions = Conditions("smoke" if why == "smoke" else "quick", "absorbing", "sbx")
    write_report(tmp_path, build(replace(REQUEST, conditions=conditions), results))
    table, page = ((tmp_path / name).read_text() for name in ("leaderboard.md", "report.html"))
    assert table.startswith("# NOT A RESULT: Leaderboard" if why else "# Leaderboard")
    assert ("<h1>NOT A RESULT" in page) == bool(why)
    for env in ENVS:
        flagged = why == "smoke" or (why != "" and env == "pendulum")
        assert (f"## {env}: NOT A RESULT" in table) == flagged
        title = re.search(rf'<div id="board-{env}"><h3>(.*?)</h3>', page, re.DOTALL)
        assert title
        assert ("NOT A RESULT" in title[1]) == flagged


def test_tables_and_pages_say_how_they_were_computed(tmp_path: Path) -> None:
    origin, results = {"irl-bench": "0.1.0 (abc)"}, []
    for result in make_results(("cartpole",)):
        rows = [replace(row, expert="1a2b3c4d:0") for row in result.rows]
        results.append(replace(result, origin=origin, finished="2026-11-23 10:00", rows=rows))
    fast = replace(REQUEST, conditions=replace(REQUEST.conditions, deterministic=False))
    for request, words in ((REQUEST, "instructions fixed"), (fast, "instructions of the machine")):
        write_report(tmp_path, build(request, results))
        for name in ("leaderboard.md", "report.html"):
            text = (tmp_path / name).read_text()
            for fact in (
                f"budget quick, protocol absorbing, seeds 0 to 2, RL library sbx, {words}",
                "experts shipped: 1a2b3c4d",
                "computed 2026-11-23 by irl-bench 0.1.0 (abc)",
                "command: irl-bench run --methods bc,shaped,maxmargin --envs cartpole,pendulum --seeds 3",
            ):
                assert text.count(fact) == 1, fact
    (row, *_) = read_csv(tmp_path / "scores.csv")
    conditions = (row["budget"], row["rl"], row["program"], row["expert"])
    assert conditions == ("quick", "sbx", "0.1.0 (abc)", "1a2b3c4d:0")


def test_the_page_shows_endings_warnings_recordings_and_machines(report: Path) -> None:
    page, text = (report / "report.html").read_text(), words_of(report / "report.html")
    assert [link for link in re.findall('<a [^>]*href="([^"]*)"', page) if link[0] != "#"] == [
        f"recordings/{RECORDING}"
    ]
    assert "cartpole__reference__seed0: expert <misses> its bar" in text
    assert "time limit 210, pole fell 90" in text
    for words, old in ((text, "<old>"), ((report / "leaderboard.md").read_text(), r"\<old\>")):
        assert f"1 cells: processor {old}, torch 1" in words
        assert f"{len(make_results()) - 1} cells: processor new, torch 2" in words
    assert "computed on different machines" in text


def test_no_column_of_texts_holds_a_formula(tmp_path: Path) -> None:
    evil, results = '=HYPERLINK("http://x";1)', []
    for result in make_results(("cartpole",)):
        rows = [
            replace(row, expert="@x", source="-1+1", reason=evil, status="skipped") for row in result.rows
        ]
        results.append(replace(result, origin={"irl-bench": evil}, finished=evil, rows=rows))
    write_report(tmp_path, build(REQUEST, results))
    for name in ("scores.csv", "leaderboard.csv"):
        cells = {value for line in read_csv(tmp_path / name) for value in line.values()}
        assert not [cell for cell in cells if cell[:1] in tuple("=+-@")]
    loaded = irl_bench.load(tmp_path).scores
    assert {*loaded.program, *loaded.finished, *loaded.reason} == {evil}
    assert {*loaded.expert, *loaded.source} == {"@x", "-1+1"}
