"""The report that tests of the page look at."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from harness.records import NOMINAL, UNSHOWN, CellResult, Shown
from harness.report.files import write_report
from harness.report.model import build
from tests.harness.made_results import REQUEST, make_results, make_row


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


@pytest.fixture(scope="session")
def reported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with their report."""
    directory = tmp_path_factory.mktemp("run")
    (directory / "recordings").mkdir()
    results = of_two_demonstrations_and_a_variant()
    name = "cartpole__bc__seed0__5_demos__pi_star.rrd"
    next(r for r in results if r.cell.name == name[:-13]).recordings[name] = "0" * 64
    (directory / "recordings" / name).touch()
    write_report(directory, build(REQUEST, results, [name]))
    return directory
