"""The report's page in a real Chromium: the one that is installed; tests of it skip where none is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from harness.judge.results import NOMINAL, UNSHOWN, CellResult, Shown
from harness.run.reporting import write_report
from harness.show import figures, report
from tests.harness.conftest import CHROMIUM
from tests.harness.made_results import REQUEST, make_results, make_row


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


@pytest.fixture(scope="session")
def reported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of them."""
    directory = tmp_path_factory.mktemp("run")
    (directory / "recordings").mkdir()
    results = of_two_demonstrations_and_a_variant()
    name = "cartpole__bc__seed0__5_demos__pi_star.rrd"
    next(r for r in results if r.cell.name == name[:-13]).recordings[name] = "0" * 64
    (directory / "recordings" / name).touch()
    with pytest.MonkeyPatch.context() as without:  # figures, which the page does not show
        without.setattr(figures, "draw_scores", lambda board: None)
        without.setattr(report, "draw_axes", lambda *its: [])
        write_report(directory, REQUEST, results)
    return directory


@pytest.fixture(scope="session")
def browser(play: Any) -> Iterator[Any]:
    browser = play.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
    yield browser
    browser.close()
