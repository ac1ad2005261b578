"""The cells of `reproduce`: the thesis's model on more or fewer trajectories, with and without weight
regularisation, which section 5.3 suspects. A `harness.run.Work`."""

from __future__ import annotations

from pathlib import Path

from harness import cells
from harness.cells import Variation, failed_rows, train_expert
from harness.results import Cell, CellResult

__all__ = ["ARMS", "DECAYS", "THESIS", "TRAJECTORIES", "arm", "failed_rows", "run_cell", "train_expert"]

TRAJECTORIES = (1, 5, 20, 100)
DECAYS = (0.0, 1e-3)
"""Weights of the squared parameters in the loss."""


def arm(trajectories: int, decay: float) -> str:
    """The method's name in the study's cells."""
    return f"shaped_{trajectories}_trajectories_decay_{decay:g}"


ARMS = {arm(n, d): Variation("shaped", n, {"weight_decay": d}) for n in TRAJECTORIES for d in DECAYS}
THESIS = arm(100, 0.0)
"""What the thesis evaluates."""


def run_cell(cell: Cell, budget: str, protocol: str, directory: Path) -> CellResult:
    """Like `harness.cells.run_cell`, for arms too."""
    return cells.run_cell(cell, budget, protocol, directory, ARMS.get(cell.method))
