"""The page in a real Chromium: it says what scores.csv says, asks for nothing, and is for everyone."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from harness.records import NOMINAL, UNSHOWN, CellResult, Shown
from harness.report.columns import visible
from harness.report.files import write_report
from harness.report.model import build
from tests.harness.made_results import REQUEST, make_results, make_row

LINES = "#lines tbody tr"
FIRST = [column.key for column in visible("first")]


def of_two_demonstrations_and_a_variant() -> list[CellResult]:
    """Return results for every chart of a page: two numbers of demonstrations, and a variant."""
    made = []
    for result in make_results():
        cell, rows = result.cell, result.rows
        if cell.method == "control_survival":  # or its control would tie
            rows[:] = [make_row(cell.env, cell.method, cell.seed, "pi_R", return_mean=100.0)]
        if "pi_R" in result.curves:
            result.curves["pi_R_chosen"] = [result.curves["pi_R"][5]]
        far = 0.1 + 0.1 * cell.seed
        rows[:] = [
            replace(r, reward_distance=far, reward_floor=0.01) if r.policy == "pi_R" else r for r in rows
        ]
        result.details["networks"] = 3.0
        result.seconds.update(start=0.5, fit=2.0)
        for shown in [cell.shown] if cell.method in UNSHOWN else [Shown(5), Shown(20)]:
            for dynamics in (NOMINAL, "heavy") if cell.env == "cartpole" else (NOMINAL,):
                its = replace(cell, shown=shown, dynamics=dynamics)
                told = {"demos": shown.demos, "dynamics": dynamics}
                made.append(replace(result, cell=its, rows=[replace(row, **told) for row in rows]))
    return made


@pytest.fixture(scope="module")
def reported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with a report."""
    directory = tmp_path_factory.mktemp("run")
    (directory / "recordings").mkdir()
    results = of_two_demonstrations_and_a_variant()
    name = "cartpole__bc__seed0__5_demos__pi_star.rrd"
    next(r for r in results if r.cell.name == name[:-13]).recordings[name] = "0" * 64
    (directory / "recordings" / name).touch()
    write_report(directory, build(REQUEST, results, [name]))
    return directory


@pytest.fixture(scope="module")
def looked(browser: Any, reported: Path) -> Iterator[tuple[Any, list[str]]]:
    """The page, and what it asked for, said or did wrong."""
    page, noted = browser.new_page(viewport={"width": 1300, "height": 900}), list[str]()
    page.on("request", lambda request: noted.append(request.url))
    page.on("console", lambda message: noted.append(message.text))
    page.on("pageerror", lambda error: noted.append(str(error)))
    page.goto((reported / "report.html").as_uri())
    yield page, noted
    page.close()


@pytest.fixture
def page(looked: tuple[Any, list[str]]) -> Iterator[Any]:
    """With its filters as they were."""
    yield looked[0]
    for select in looked[0].query_selector_all("select"):
        select.select_option("")


def texts(page: Any, column: str) -> list[str]:
    """Return the texts of a column of the leaderboard, of the visible lines, from top to bottom."""
    shown: list[str] = page.evaluate(
        """column => {
            const table = document.querySelector("#lines table");
            const at = table.querySelector(`th[data-column="${column}"]`).cellIndex;
            const shown = [...table.tBodies[0].rows].filter(row => row.offsetParent);
            return shown.map(row => row.cells[at].textContent);
        }""",
        column,
    )
    return shown


def test_it_asks_for_nothing_says_nothing_and_runs_nothing_that_was_added(
    browser: Any, looked: tuple[Any, list[str]], reported: Path, tmp_path: Path
) -> None:
    page, noted = looked
    page.mouse.wheel(0, 20_000)
    assert noted == [(reported / "report.html").as_uri()]
    policy = page.get_attribute("meta[http-equiv=Content-Security-Policy]", "content")
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    text = (reported / "report.html").read_text()
    (tmp_path / "page.html").write_text(text.replace("</body>", "<script>window.ran = 1</script></body>"))
    added = browser.new_page()
    added.goto((tmp_path / "page.html").as_uri())
    assert added.evaluate("window.ran") is None
    added.close()


def test_its_numbers_are_those_of_the_scores(page: Any, reported: Path) -> None:
    scores: dict[tuple[str, ...], list[float]] = {}
    for row in csv.DictReader(io.StringIO((reported / "scores.csv").read_text())):
        key = (row["env"], row["dynamics"], row["demos"], row["method"], row["policy"])
        scores.setdefault(key, []).append(float(row["normalized_score"] or "nan"))
    headings = ("env", "dynamics", "demonstrations", "method", "policy", "score")
    told = list(zip(*(texts(page, heading) for heading in headings), strict=True))
    exact = page.eval_on_selector_all(LINES, "rows => rows.map(row => row.cells[4].dataset.v ?? 'NaN')")
    assert len(told) == len(exact) > 50
    for (env, dynamics, shown, method, policy, text), value in zip(told, exact, strict=True):
        demos = "0" if method in UNSHOWN else shown.split()[0]
        key = env, dynamics, demos, method, {"π*": "pi_star", "π_R": "pi_R"}.get(policy, policy)
        known = [score for score in scores[key] if math.isfinite(score)]
        mean = sum(known) / len(known) if known else math.nan
        assert float(value) == pytest.approx(mean, rel=1e-9, abs=1e-9, nan_ok=True)
        assert text.partition(" ")[0] == (f"{mean:z.2f}" if known else "n/a")


def test_filters_leave_what_they_say(page: Any) -> None:
    every = len(texts(page, "method"))
    chosen = {"env": "cartpole", "method": "shaped", "dynamics": "heavy"}
    chosen["demonstrations"] = "20 demonstrations"
    for heading, choice in chosen.items():
        page.select_option(f"select[data-filter='{heading}']", choice)
        assert set(texts(page, heading)) == {choice}
    assert sorted(texts(page, "policy")) == ["π*", "π_R"]
    assert page.text_content("#lines [role=status]") == f"2 of {every} lines"


def test_columns_that_matter_are_there_at_once_and_the_others_behind_a_switch(page: Any) -> None:
    headings = page.locator("#lines thead th:visible")
    keys = "all => all.map(one => one.dataset.column)"
    assert headings.evaluate_all(keys) == FIRST
    page.click("#more")
    assert len(headings.evaluate_all(keys)) > 20
    page.click("#more")
    assert headings.evaluate_all(keys) == FIRST


def test_a_switch_shows_the_plots_of_one_cost_and_without_scripts_all_are_shown(
    browser: Any, reported: Path
) -> None:
    plots = "#cost .plots > :visible"
    with_script, without = (browser.new_context(java_script_enabled=on).new_page() for on in (True, False))
    for page in (with_script, without):
        page.goto((reported / "report.html").as_uri())
    charts = with_script.locator("#cost figure").count()
    for name in ("seconds", "environment steps", "RL solves", "interactions"):
        with_script.get_by_role("radio", name=name, exact=True).check()
        words = with_script.locator(plots).locator("svg").evaluate_all("all => all.map(one => one.ariaLabel)")
        assert len(words) == charts > 1
        assert all(f"against {name}." in one for one in words)
    assert without.locator(plots).count() == 4 * charts
    assert without.locator("#cost [type=radio]:visible").count() == 0
    for page in (with_script, without):
        page.context.close()


def saved(page: Any, what: str) -> list[dict[str, str]]:
    """Click a button that saves; return the rows of the file."""
    with page.expect_download() as download:
        page.locator(what).first.click()
    return list(csv.DictReader(io.StringIO(download.value.path().read_text())))


def test_the_leaderboard_is_saved_as_it_is_filtered_and_curves_point_by_point(page: Any) -> None:
    page.select_option("select[data-filter='method']", "shaped")
    rows = saved(page, "#lines [data-save=csv]")
    assert len(rows) == len(texts(page, "method"))
    assert {row["Method"] for row in rows} == {"shaped"}
    assert all(float(r["Score low"]) < float(r["Score"]) < float(r["Score high"]) for r in rows)
    assert {row["Env steps"] for row in rows} == {"15000"}
    rows = saved(page, "#learning [data-file]")
    assert {row["curve"] for row in rows} == {"expert", "pi_R", "pi_R_true"}
    mine = [r for r in rows if (r["method"], r["curve"]) == ("shaped", "pi_R_true")]
    assert len(mine) == 16
    assert all(float(r["low"]) <= float(r["mean"]) <= float(r["high"]) for r in mine)


def test_a_text_that_a_spreadsheet_would_compute_is_marked_where_it_is_saved(page: Any) -> None:
    saved = page.evaluate(
        """text => {
            const table = document.querySelector("#lines table").cloneNode(true);
            table.querySelector("td.note").textContent = text;
            return csv(table);
        }""",
        "=1+1",
    )
    (row, *_) = csv.DictReader(io.StringIO(saved))
    assert row["Note"] == "'=1+1"


def test_tooltips_follow_the_pointer_and_the_keyboard(page: Any) -> None:
    page.locator(".heat td[data-tip]").first.hover()
    assert re.search(r": \d\.\d\d \[\d\.\d\d, \d\.\d\d\], 3 of 3 seeds", page.text_content("#tip"))
    page.mouse.move(0, 0)
    page.locator("#lines th[data-column=score] button").focus()
    assert "0 random, 1 the expert" in page.text_content("#tip")
    assert page.evaluate("document.activeElement.getAttribute('aria-describedby')") == "tip"
    page.keyboard.press("Escape")
    assert not page.is_visible("#tip")


def test_each_figure_has_words_and_its_data_and_links_lead_somewhere(page: Any) -> None:
    told = page.evaluate(
        """() => [...document.querySelectorAll("figure")].map(figure => [
            Boolean(figure.querySelector("details.data table, [data-file]")),
            [...figure.querySelectorAll("div > svg[role=img]")].map(plot => plot.ariaLabel.length),
            figure.querySelectorAll(":is(.plots, .panels) > *").length,
        ])"""
    )
    assert len(told) > 13
    for has_data, words, plots in told:
        assert has_data
        assert len(words) == plots > 0
        assert min(words) > 30
    ids = page.eval_on_selector_all("[id]", "all => all.map(one => one.id)")
    assert len(ids) == len({*ids})
    anchors = page.eval_on_selector_all("a[href^='#']", "all => all.map(one => one.hash.slice(1))")
    assert {*anchors} <= {*ids}


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_no_fault(browser: Any, reported: Path, scheme: str) -> None:
    import axe_playwright_python

    (script,) = Path(axe_playwright_python.__file__).parent.rglob("axe.min.js")
    page = browser.new_page(color_scheme=scheme, viewport={"width": 900, "height": 900})
    page.goto((reported / "report.html").as_uri())
    page.evaluate(f"{script.read_text(encoding='utf-8')};0")
    found = page.evaluate("axe.run({ resultTypes: ['violations'] })")["violations"]
    page.close()
    assert [(one["id"], [node["html"] for node in one["nodes"]][:3]) for one in found] == []


@pytest.mark.parametrize(("width", "media"), [(390, "screen"), (1300, "screen"), (794, "print")])
def test_it_fits_every_width(browser: Any, reported: Path, width: int, media: str) -> None:
    page = browser.new_page(viewport={"width": width, "height": 900})
    page.goto((reported / "report.html").as_uri())
    page.emulate_media(media=media)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.locator(".heat").bounding_box()["y"] < 500, "on the first screen"
    widths = page.eval_on_selector_all(
        "figure svg", "all => all.map(one => one.getBoundingClientRect().width)"
    )
    assert not [width for width in widths if 0 < width < 200], "those that are folded away have none"
    page.close()


def test_cautions_stand_beside_the_numbers_that_they_are_about(browser: Any, tmp_path: Path) -> None:
    results = make_results(seeds=1)
    for result in results:
        if result.cell.method == "control_survival" and result.cell.env == "pendulum":
            result.rows[:] = [make_row("pendulum", "control_survival", 0, "pi_R", return_mean=500.0)]
    results = [
        replace(r, below_bar=(r.cell.env, r.cell.method) == ("cartpole", "reference")) for r in results
    ]
    write_report(tmp_path, build(REQUEST, results))
    page = browser.new_page()
    page.goto((tmp_path / "report.html").as_uri())
    heads = page.locator(".heat thead tr:last-child th:has(a)")
    told = heads.evaluate_all("""all => Object.fromEntries(all.slice(2).map(head => [
        head.querySelector("a").textContent,
        [...head.querySelectorAll("button")].map(button => button.textContent),
    ]))""")
    assert told == {
        "cartpole": ["not a result", "one seed", "controls tie"],
        "pendulum": ["one seed", "controls tie"],
    }
    warning = page.locator(".heat .warn").get_by_text("not a result").first
    warning.focus()
    assert "the expert of seed 0 misses its bar" in page.text_content("#tip")
    assert page.locator(LINES).get_by_text("NOT A RESULT: the expert of seed 0").count() > 5
    page.close()
