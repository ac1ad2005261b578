"""The page in a real Chromium: it says what scores.csv says, sorts, filters, and asks for nothing."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from harness.records import UNSHOWN
from harness.report.columns import visible

LINES = "#lines tbody tr"
FIRST = [column.key for column in visible("first")]


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


def sort_by(page: Any, column: str) -> str:
    """Sort by keyboard; return the order that the heading then has."""
    button = page.locator(f"#lines th[data-column={column}] button")
    button.focus()
    page.keyboard.press("Enter")
    order: str = button.evaluate("button => button.closest('th').ariaSort")
    return order


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


def test_any_column_sorts_both_ways_and_what_is_unknown_stays_last(page: Any) -> None:
    for heading in FIRST:
        if heading == "score":
            continue
        for _ in range(2):
            assert sort_by(page, heading) in ("ascending", "descending")
    for order, sign in (("descending", -1), ("ascending", 1)):
        assert sort_by(page, "score") == order
        told = [text.partition(" ")[0] for text in texts(page, "score")]
        numbers = [sign * float(text) for text in told if text != "n/a"]
        assert numbers == sorted(numbers)
        assert set(told[len(numbers) :]) == {"n/a"}
    assert sort_by(page, "method") == "ascending"
    assert texts(page, "method") == sorted(texts(page, "method"))
    assert page.locator("#lines th[aria-sort]").count() == 1


def test_filters_leave_what_they_say(page: Any) -> None:
    every = len(texts(page, "method"))
    chosen = {
        "env": "cartpole",
        "method": "shaped",
        "demonstrations": "20 demonstrations",
        "dynamics": "heavy",
    }
    for heading, choice in chosen.items():
        page.select_option(f"select[data-filter='{heading}']", choice)
        assert set(texts(page, heading)) == {choice}
    assert sorted(texts(page, "policy")) == ["π*", "π_R"]
    assert page.text_content("#lines [role=status]") == f"2 of {every} lines"


def test_columns_that_matter_are_there_at_once_and_the_others_behind_a_switch(page: Any) -> None:
    def headings() -> list[str]:
        cells = page.query_selector_all("#lines thead th")
        return [cell.get_attribute("data-column") for cell in cells if cell.is_visible()]

    assert headings() == FIRST
    page.click("#more")
    assert page.get_attribute("#more", "aria-pressed") == "true"
    assert len(headings()) > 20
    page.click("#more")
    assert headings() == FIRST


def test_the_leaderboard_is_saved_as_it_is_filtered(page: Any, tmp_path: Path) -> None:
    page.select_option("select[data-filter='method']", "shaped")
    lines = len(texts(page, "method"))
    with page.expect_download() as saved:
        page.click("#lines [data-save=csv]")
    assert saved.value.suggested_filename == "leaderboard.csv"
    saved.value.save_as(tmp_path / "saved")
    rows = list(csv.DictReader(io.StringIO((tmp_path / "saved").read_text())))
    assert len(rows) == lines
    assert {row["Method"] for row in rows} == {"shaped"}
    assert all(float(r["Score low"]) < float(r["Score"]) < float(r["Score high"]) for r in rows)
    assert {row["Env steps"] for row in rows} == {"15000"}


@pytest.mark.parametrize("text", ["=1+1", "-1+1", "\tx", "'=1"])
def test_a_text_that_a_spreadsheet_would_compute_is_marked_where_it_is_saved(page: Any, text: str) -> None:
    saved = page.evaluate(
        """text => {
            const table = document.querySelector("#lines table").cloneNode(true);
            table.querySelector("td.note").textContent = text;
            return csv(table);
        }""",
        text,
    )
    (row, *_) = csv.DictReader(io.StringIO(saved))
    assert row["Note"] == f"'{text}"


def test_curves_are_saved_with_a_line_for_each_point(page: Any, tmp_path: Path) -> None:
    with page.expect_download() as saved:
        page.locator("#learning [data-file]").first.click()
    saved.value.save_as(tmp_path / "saved")
    rows = list(csv.DictReader(io.StringIO((tmp_path / "saved").read_text())))
    assert {row["curve"] for row in rows} == {"expert", "pi_R", "pi_R_true"}
    mine = [r for r in rows if (r["method"], r["curve"]) == ("shaped", "pi_R_true")]
    assert len(mine) == 16
    assert all(float(r["low"]) <= float(r["mean"]) <= float(r["high"]) for r in mine)


def test_tooltips_follow_the_pointer_and_the_keyboard(page: Any) -> None:
    page.locator(".heat td[data-tip]").first.hover()
    assert re.search(r": \d\.\d\d \[\d\.\d\d, \d\.\d\d\], 3 of 3 seeds", page.text_content("#tip"))
    page.mouse.move(0, 0)
    page.locator("#lines th[data-column=score] button").focus()
    assert "0 random, 1 the expert" in page.text_content("#tip")
    assert page.evaluate("document.activeElement.getAttribute('aria-describedby')") == "tip"
    page.keyboard.press("Escape")
    assert not page.is_visible("#tip")


def test_every_heading_is_explained_in_the_glossary(page: Any) -> None:
    keys, titles, meanings = page.evaluate(
        """() => {
            const all = (kind, read) => [...document.querySelectorAll(kind)].map(read);
            return [all("th[data-column]", th => [th.dataset.column, th.textContent]),
                    all("#glossary dt", dt => dt.textContent),
                    Object.fromEntries(all("#glossary dd", dd => [dd.id, dd.textContent]))];
        }"""
    )
    assert len(titles) == len(meanings) > 30
    for key, title in keys:
        assert title.removesuffix(" [95 %]") in titles
        assert len(meanings[f"column-{key}"]) > 10


def test_each_figure_has_words_and_its_data(page: Any) -> None:
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
    sections = page.eval_on_selector_all("section", "all => all.map(one => one.id)")
    every = ("summary", "leaderboard", "seeds", "transfer", "cost", "demonstrations", "distances")
    assert {*every, "learning", "training", "more-tables", "recordings", "computed", "glossary"} <= {
        *sections
    }
    ids = page.eval_on_selector_all("[id]", "all => all.map(one => one.id)")
    assert len(ids) == len({*ids})
    anchors = page.eval_on_selector_all("a[href^='#']", "all => all.map(one => one.hash.slice(1))")
    assert {*anchors} <= {*ids}
