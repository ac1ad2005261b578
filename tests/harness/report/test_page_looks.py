"""The report's page is for everyone: axe-core, contrast, widths, print, and what stands beside what."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from harness.report.files import write_report
from harness.report.model import build
from tests.harness.made_results import REQUEST, make_results, make_row

SCREENSHOTS = Path(__file__).parents[2] / "output" / "report"
"""What the page looks like, for people."""
LINES = "#lines tbody tr"


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


@pytest.mark.parametrize(
    ("name", "width", "media"),
    [
        ("390", 390, {}),
        ("1300", 1300, {}),
        ("dark", 1300, {"color_scheme": "dark"}),
        ("print", 794, {"media": "print"}),
    ],
)
def test_it_fits_every_width(
    browser: Any, reported: Path, name: str, width: int, media: dict[str, Any]
) -> None:
    page = browser.new_page(viewport={"width": width, "height": 900})
    page.goto((reported / "report.html").as_uri())
    page.emulate_media(**media)
    SCREENSHOTS.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=SCREENSHOTS / f"{name}.png", full_page=True)
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
