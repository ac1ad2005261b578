"""The thesis's evaluation: what it computes, and the tables and figures that it makes of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, ClassVar

import pandas as pd
import pytest

from harness.benchmarks.reproduce import PROTOCOLS, STUDIED, TRAJECTORIES
from harness.cli.main import main
from harness.records import CONTROLS, REFERENCE, UNSHOWN, Cell, CellResult, Conditions, Row, row_of
from harness.store.opening import stored_request


class InstantGrid:
    """Scores every cell at once: 500 the expert, 0 the random policy, methods by what is shown to them."""

    computed: ClassVar[list[Cell]] = []

    def __init__(self, conditions: Conditions, sink: Any, *more: Any) -> None:
        self.protocol, self.sink = conditions.protocol, sink

    def run(self, cells: Sequence[Cell]) -> None:
        for cell in cells:
            InstantGrid.computed.append(cell)
            self.sink.save(self.result(cell), {})

    def result(self, cell: Cell) -> CellResult:
        def row(policy: Any, value: float) -> Row:
            moved = value + cell.seed * (cell.method != REFERENCE)
            return row_of(cell, policy, self.protocol, return_mean=moved)

        level = cell.shown.demos if cell.method in STUDIED else 400
        rows = [row("pi_star", 2.0 * level), row("pi_R", level)]
        if cell.method == "bc":
            rows[1] = row_of(cell, "pi_R", self.protocol, status="skipped", reason="learns no reward")
        if cell.method == REFERENCE:
            rows = [row("expert", 500), row("random", 0)]
        elif cell.method in CONTROLS:
            rows = rows[1:]
        curve = [(float(x), x * 1.5) for x in range(0, 1000, 100)]
        return CellResult(cell, rows, {"pi_R": curve, "pi_R_true": [(x, -y) for x, y in curve]})


@pytest.fixture
def reproduce(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], int]:
    monkeypatch.setattr("harness.schedule.grid.Grid", InstantGrid)
    monkeypatch.setattr("harness.cli.runs.handle_signals", lambda: None)
    InstantGrid.computed.clear()
    return lambda: main(["reproduce", "--seeds", "3", "--out", str(tmp_path)])


def test_every_arm_and_control_is_in_the_table_under_both_protocols(
    reproduce: Callable[[], int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert reproduce() == 0
    methods = {REFERENCE, *CONTROLS, *STUDIED}
    cells = len(UNSHOWN) + len(TRAJECTORIES) * (len(methods) - len(UNSHOWN))
    assert len(InstantGrid.computed) == cells * 2 * 3 * 2  # envs, seeds, protocols
    scores, table = pd.read_csv(tmp_path / "scores.csv"), pd.read_csv(tmp_path / "study.csv")
    assert set(scores["protocol"]) == set(PROTOCOLS)
    for protocol in PROTOCOLS:
        request: Any = stored_request(tmp_path / protocol)
        asked = request.conditions
        assert (asked.learner, asked.solves, asked.experts) == ("ddpg", 3, "trained")
    assert set(scores["method"]) == methods
    learned = table[table["method"].isin(STUDIED)]
    assert len(learned) == len(STUDIED) * len(TRAJECTORIES) * 2 * 2 * 2  # policies, envs, protocols
    learned = learned[learned["score"].notna()]
    assert len(learned) == len(TRAJECTORIES) * (2 * len(STUDIED) - 1) * 2 * 2  # bc has no pi_R
    for _, line in learned.iterrows():
        times = 2 if line["policy"] == "pi_star" else 1
        assert line["score"] == pytest.approx((times * line["trajectories"] + 1) / 500)
        assert line["low"] < line["score"] < line["high"]
    text = (tmp_path / "study.md").read_text()
    assert text.count("\n") == 2 + len(table)
    # 100 a trajectory, and as many more as the seed, of 500.
    scored = "cartpole, absorbing: pi* 0.40 [0.15, 0.78], pi_R 0.20 [0.07, 0.71]; control_survival "
    assert scored in capsys.readouterr().out
    pictures = {path.name: path.read_bytes() for path in tmp_path.glob("*.png")}
    assert {*pictures} == {f"{env}_figure_5_3.png" for env in ("cartpole", "pendulum")}
    # What a later run adds to its directories is no part of it.
    more = "run --methods bc --envs cartpole,highway --seeds 3 --protocol native --experts trained"
    more += " --learner ddpg --solves 3 --out"
    assert main([*more.split(), str(tmp_path / "native")]) == 0
    computed = len(InstantGrid.computed)
    assert reproduce() == 0
    assert len(InstantGrid.computed) == computed
    assert (tmp_path / "study.md").read_text() == text
    assert pictures == {path.name: path.read_bytes() for path in tmp_path.glob("*.png")}
