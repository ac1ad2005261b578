"""The page in a real Chromium: it says what scores.csv says, sorts, filters, and asks for nothing."""

from __future__ import annotations

import csv
import io
import json
import math
import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from harness.judge.results import CONTROLS, NOMINAL, UNSHOWN, CellResult, Shown
from harness.run.reporting import write_report
from harness.show.tables import FIRST
from tests.harness.made_results import REQUEST, make_results, make_row

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")
SCREENSHOTS = Path(__file__).parents[2] / "output" / "report"
"""What the page looks like, for people."""
FIRST_PAINT = 5000
"""Milliseconds, of a machine that does other things too."""
LINES = "#lines tbody tr"


def of_two_demonstrations_and_a_variant() -> list[CellResult]:
    """Results with all that a page has charts of."""
    found = []
    for result in make_results():
        cell, rows = result.cell, result.rows
        if cell.method == "control_survival":  # or no task would tell rewards apart
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
                found.append(replace(result, cell=its, rows=[replace(row, **told) for row in rows]))
    return found


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of them."""
    directory = tmp_path_factory.mktemp("run")
    (directory / "recordings").mkdir()
    results = of_two_demonstrations_and_a_variant()
    name = "cartpole__bc__seed0__5_demos__pi_star.rrd"
    next(r for r in results if r.cell.name == name[:-13]).recordings[name] = "0" * 64
    (directory / "recordings" / name).touch()
    write_report(directory, REQUEST, results)
    return directory


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def looked(browser: Any, run: Path) -> Iterator[tuple[Any, list[str]]]:
    """The page, and what it asked for, said or did wrong."""
    page, noted = browser.new_page(viewport={"width": 1300, "height": 900}), list[str]()
    page.on("request", lambda request: noted.append(request.url))
    page.on("console", lambda message: noted.append(message.text))
    page.on("pageerror", lambda error: noted.append(str(error)))
    page.goto((run / "report.html").as_uri())
    yield page, noted
    page.close()


@pytest.fixture
def page(looked: tuple[Any, list[str]]) -> Iterator[Any]:
    """With its filters as they were."""
    yield looked[0]
    for select in looked[0].query_selector_all("select"):
        select.select_option("")


def texts(page: Any, heading: str) -> list[str]:
    """Of a column of the leaderboard, of the lines that are shown, from top to bottom."""
    told: list[str] = page.evaluate(
        """heading => {
            const table = document.querySelector("#lines table");
            const at = [...table.tHead.rows[0].cells].findIndex(cell => cell.textContent === heading);
            const shown = [...table.tBodies[0].rows].filter(row => row.offsetParent);
            return shown.map(row => row.cells[at].textContent);
        }""",
        heading,
    )
    return told


def sort_by(page: Any, heading: str) -> str:
    """By keyboard; returns what the heading then says of its order."""
    button = page.locator("#lines thead button").get_by_text(heading, exact=True)
    button.focus()
    page.keyboard.press("Enter")
    order: str = button.evaluate("button => button.closest('th').ariaSort")
    return order


def test_it_asks_for_nothing_and_says_nothing(looked: tuple[Any, list[str]], run: Path) -> None:
    page, noted = looked
    page.mouse.wheel(0, 20_000)
    assert noted == [(run / "report.html").as_uri()]
    policy = page.get_attribute("meta[http-equiv=Content-Security-Policy]", "content")
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy


def test_what_is_added_to_it_does_not_run(browser: Any, run: Path, tmp_path: Path) -> None:
    text = (run / "report.html").read_text()
    (tmp_path / "page.html").write_text(text.replace("</body>", "<script>window.ran = 1</script></body>"))
    page = browser.new_page()
    page.goto((tmp_path / "page.html").as_uri())
    assert page.evaluate("window.ran") is None
    page.close()


def test_it_is_painted_at_once(looked: tuple[Any, list[str]]) -> None:
    painted = looked[0].evaluate(
        """() => new Promise(done => new PerformanceObserver(seen => done(seen.getEntries()[0].startTime))
            .observe({ type: "paint", buffered: true }))"""
    )
    assert 0 < painted < FIRST_PAINT


def test_its_numbers_are_those_of_the_scores(page: Any, run: Path) -> None:
    scores: dict[tuple[str, ...], list[float]] = {}
    for row in csv.DictReader(io.StringIO((run / "scores.csv").read_text())):
        key = (row["env"], row["dynamics"], row["demos"], row["method"], row["policy"])
        scores.setdefault(key, []).append(float(row["normalized_score"] or "nan"))
    headings = ("Task", "Dynamics", "Demonstrations", "Method", "Policy", "Score [95 %]")
    told = list(zip(*(texts(page, heading) for heading in headings), strict=True))
    exact = page.eval_on_selector_all(LINES, "rows => rows.map(row => row.cells[4].dataset.v ?? 'NaN')")
    assert len(told) == len(exact) > 50
    for (env, dynamics, shown, method, policy, text), value in zip(told, exact, strict=True):
        demos = "0" if method in UNSHOWN else shown.split()[0]
        known = [score for score in scores[env, dynamics, demos, method, policy] if math.isfinite(score)]
        mean = sum(known) / len(known) if known else math.nan
        assert float(value) == pytest.approx(mean, rel=1e-9, abs=1e-9, nan_ok=True)
        assert text.partition(" ")[0] == (f"{mean:z.2f}" if known else "n/a")


def test_any_column_sorts_both_ways_and_what_is_unknown_stays_last(page: Any) -> None:
    for heading in FIRST:
        if heading == "Score [95 %]":
            continue
        for _ in range(2):
            assert sort_by(page, heading) in ("ascending", "descending")
    for order, sign in (("descending", -1), ("ascending", 1)):
        assert sort_by(page, "Score [95 %]") == order
        told = [text.partition(" ")[0] for text in texts(page, "Score [95 %]")]
        numbers = [sign * float(text) for text in told if text != "n/a"]
        assert numbers == sorted(numbers)
        assert set(told[len(numbers) :]) == {"n/a"}
    assert sort_by(page, "Method") == "ascending"
    assert texts(page, "Method") == sorted(texts(page, "Method"))
    assert page.locator("#lines th[aria-sort]").count() == 1


def test_filters_leave_what_they_say(page: Any) -> None:
    every = len(texts(page, "Method"))
    chosen = {
        "Task": "cartpole",
        "Method": "shaped",
        "Demonstrations": "20 demonstrations",
        "Dynamics": "heavy",
    }
    for heading, choice in chosen.items():
        page.select_option(f"select[data-column='{heading}']", choice)
        assert set(texts(page, heading)) == {choice}
    assert texts(page, "Policy") == ["pi_star", "pi_R"]
    assert page.text_content("#lines [role=status]") == f"2 of {every} lines"


def test_columns_that_matter_are_there_at_once_and_the_others_behind_a_switch(page: Any) -> None:
    def headings() -> list[str]:
        return [h.inner_text() for h in page.query_selector_all("#lines thead button") if h.is_visible()]

    names = lambda: [re.sub(r" [▲▼]$", "", name) for name in headings()]  # noqa: E731
    assert names() == list(FIRST)
    page.click("#more")
    assert page.get_attribute("#more", "aria-pressed") == "true"
    assert len(names()) > 20
    page.click("#more")
    assert names() == list(FIRST)


@pytest.mark.parametrize("kind", ["csv", "tex"])
def test_the_leaderboard_is_saved_as_it_is_filtered(page: Any, kind: str, tmp_path: Path) -> None:
    page.select_option("select[data-column='Method']", "shaped")
    lines = len(texts(page, "Method"))
    with page.expect_download() as saved:
        page.click(f"#lines [data-save={kind}]")
    assert saved.value.suggested_filename == f"leaderboard.{kind}"
    saved.value.save_as(tmp_path / "saved")
    text = (tmp_path / "saved").read_text()
    if kind == "tex":
        assert text.count(r"shaped & pi\_") == lines
        assert r"Score [95 \%]" in text
        assert text.rstrip().endswith(r"\end{tabular}")
        return
    rows = list(csv.DictReader(io.StringIO(text)))
    assert len(rows) == lines
    assert {row["Method"] for row in rows} == {"shaped"}
    assert [float(r["Score low"]) < float(r["Score"]) < float(r["Score high"]) for r in rows] == [
        True
    ] * lines
    assert {row["Env steps"] for row in rows} == {"15000"}


def test_curves_are_saved_with_a_line_for_each_point(page: Any, tmp_path: Path) -> None:
    with page.expect_download() as saved:
        page.locator("#learning [data-file]").first.click()
    saved.value.save_as(tmp_path / "saved")
    rows = list(csv.DictReader(io.StringIO((tmp_path / "saved").read_text())))
    assert {row["curve"] for row in rows} == {"expert", "pi_R", "pi_R_true"}
    mine = [r for r in rows if (r["method"], r["curve"]) == ("shaped", "pi_R_true")]
    assert len(mine) == 16
    assert all(float(r["low"]) <= float(r["mean"]) <= float(r["high"]) for r in mine)


def test_an_interval_is_told_to_the_pointer_and_to_the_keyboard(page: Any) -> None:
    tile = page.locator(".heat td[data-tip]").first
    tile.hover()
    hovered = page.text_content("#tip")
    assert re.search(r": \d\.\d\d \[\d\.\d\d, \d\.\d\d\], 3 of 3 seeds", hovered)
    page.mouse.move(0, 0)
    tile.focus()
    assert page.text_content("#tip") == hovered
    page.keyboard.press("ArrowDown")
    assert page.text_content("#tip") != hovered
    assert page.evaluate("document.activeElement.getAttribute('aria-describedby')") == "tip"
    page.keyboard.press("Escape")
    assert not page.is_visible("#tip")
    assert page.locator(".heat td[tabindex='0']").count() == 1


def test_every_heading_is_explained_under_its_table_and_at_the_pointer(page: Any) -> None:
    told = page.evaluate(
        """() => [...document.querySelectorAll(".table")].map(table => {
            const texts = kind => [...table.querySelectorAll(kind)].map(one => one.textContent);
            return [texts("thead button"), texts("dt"), texts("dd")];
        })"""
    )
    assert len(told) > 20
    for headings, names, meanings in told:
        assert names == headings
        assert min(map(len, meanings)) > 10
    button = page.locator("#lines thead button").get_by_text("Score [95 %]", exact=True)
    button.hover()
    assert "0 random, 1 the expert" in page.text_content("#tip")


def test_each_figure_has_words_and_its_data(page: Any) -> None:
    told = page.evaluate(
        """() => [...document.querySelectorAll("figure")].map(figure => [
            Boolean(figure.querySelector("details.data table, [data-file]")),
            [...figure.querySelectorAll(".plots > svg[role=img]")].map(plot => plot.ariaLabel.length),
            figure.querySelectorAll(".plots > *").length,
        ])"""
    )
    assert len(told) > 15
    for has_data, words, plots in told:
        assert has_data
        assert len(words) == plots > 0
        assert min(words) > 30
    sections = page.eval_on_selector_all("section", "all => all.map(one => one.id)")
    every = ("summary", "leaderboard", "seeds", "transfer", "cost", "runs", "demonstrations", "distances")
    assert {*every, "learning", "training", "more-tables", "recordings", "computed"} <= {*sections}
    ids = page.eval_on_selector_all("[id]", "all => all.map(one => one.id)")
    assert len(ids) == len({*ids})
    anchors = page.eval_on_selector_all("a[href^='#']", "all => all.map(one => one.hash.slice(1))")
    assert {*anchors} <= {*ids}


def test_the_best_is_marked_and_what_is_not_told_apart_from_it(page: Any) -> None:
    marks = page.eval_on_selector_all(
        ".heat td b", "all => all.map(b => [b.textContent, b.parentElement.dataset.tip])"
    )
    assert {mark for mark, _ in marks} <= {"★", "≈"}
    assert all(("the best" in tip) for _, tip in marks)
    best = {tip.partition(",")[0] for mark, tip in marks if mark == "★"}
    assert best == {"bc", "shaped"}
    assert not best & {*CONTROLS}


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_no_fault(browser: Any, run: Path, scheme: str) -> None:
    import axe_playwright_python

    (script,) = Path(axe_playwright_python.__file__).parent.rglob("axe.min.js")
    page = browser.new_page(color_scheme=scheme, viewport={"width": 900, "height": 900})
    page.goto((run / "report.html").as_uri())
    page.evaluate(f"{script.read_text(encoding='utf-8')};0")
    found = page.evaluate("axe.run({ resultTypes: ['violations'] })")["violations"]
    page.close()
    assert [(one["id"], [node["html"] for node in one["nodes"]][:3]) for one in found] == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_numbers_stand_out_from_their_tiles(browser: Any, run: Path, scheme: str) -> None:
    page = browser.new_page(color_scheme=scheme)
    page.goto((run / "report.html").as_uri())
    colours = page.evaluate(
        """() => {
            const context = new OffscreenCanvas(1, 1).getContext("2d", { willReadFrequently: true });
            const seen = colour => {
                context.fillStyle = colour;
                context.fillRect(0, 0, 1, 1);
                return [...context.getImageData(0, 0, 1, 1).data].slice(0, 3);
            };
            const tile = document.querySelector(".heat td[data-tip]");
            return [...Array(11).keys()].map(shade => {
                tile.className = `h${shade}`;
                const style = getComputedStyle(tile);
                return [seen(style.color), seen(style.backgroundColor)];
            });
        }"""
    )
    page.close()

    def luminance(colour: list[int]) -> float:
        linear = [
            c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in (v / 255 for v in colour)
        ]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    grounds = [luminance(ground) for _, ground in colours]
    assert grounds == sorted(grounds, reverse=scheme == "light")
    for text, ground in colours:
        dark, light = sorted((luminance(text), luminance(ground)))
        assert (light + 0.05) / (dark + 0.05) > 4.5


@pytest.mark.parametrize(
    ("name", "width", "media"),
    [
        ("390", 390, {}),
        ("768", 768, {}),
        ("1300", 1300, {}),
        ("dark", 1300, {"color_scheme": "dark"}),
        ("print", 794, {"media": "print"}),
    ],
)
def test_it_fits_every_width(browser: Any, run: Path, name: str, width: int, media: dict[str, Any]) -> None:
    page = browser.new_page(viewport={"width": width, "height": 900})
    page.goto((run / "report.html").as_uri())
    page.emulate_media(**media)
    SCREENSHOTS.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=SCREENSHOTS / f"{name}.png", full_page=True)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.locator(".heat").bounding_box()["y"] < 500, "on the first screen"
    small = page.eval_on_selector_all(
        ".plots svg", "all => all.map(one => one.getBoundingClientRect().width).filter(width => width < 200)"
    )
    assert small == []
    page.close()


def test_without_scripts_it_is_whole_but_for_buttons(browser: Any, run: Path) -> None:
    context = browser.new_context(java_script_enabled=False)
    page = context.new_page()
    page.goto((run / "report.html").as_uri())
    assert page.locator(LINES).first.is_visible()
    assert not page.locator(".filters").is_visible()
    context.close()


def test_what_to_beware_of_stands_beside_what_it_concerns(browser: Any, tmp_path: Path) -> None:
    results = make_results(seeds=1)
    for result in results:
        if result.cell.method == "control_survival" and result.cell.env == "pendulum":
            result.rows[:] = [make_row("pendulum", "control_survival", 0, "pi_R", return_mean=500.0)]
    results = [
        replace(r, below_bar=(r.cell.env, r.cell.method) == ("cartpole", "reference")) for r in results
    ]
    write_report(tmp_path, REQUEST, results)
    page = browser.new_page()
    page.goto((tmp_path / "report.html").as_uri())
    told = {
        column.query_selector("a").text_content(): [
            b.text_content() for b in column.query_selector_all("button")
        ]
        for column in page.query_selector_all(".heat thead tr:last-child th:has(a)")[2:]
    }
    assert told == {
        "cartpole": ["not a result", "one seed", "controls tie"],
        "pendulum": ["one seed", "controls tie"],
    }
    warning = page.locator(".heat .warn").get_by_text("not a result").first
    warning.focus()
    assert "the expert of seed 0 misses its bar" in page.text_content("#tip")
    assert page.locator(LINES).get_by_text("NOT A RESULT: the expert of seed 0").count() > 5
    page.close()


def test_a_json_block_cannot_end_early(run: Path) -> None:
    text = (run / "report.html").read_text()
    (block,) = re.findall(r'<script type="application/json" id="files">(.*?)</script>', text)
    assert any(name.startswith("learning cartpole") for name in json.loads(block))
