"""Is it the reward that fails, or RL on it? Learns a cell's reward as the run did, and solves it more often.

Appends a line for each solve to solves.csv beside this file: env, method, seed, demos, solve, score,
own_return (what it earns of R*), own_return_star (what pi* earns). Solve 0 is the run's pi_R; others differ
from it by the seed of RL alone. Budget full, protocol absorbing. From the root, with the variable that the
cells of the board were computed with:

    OPENBLAS_L2_SIZE=512 python results/reference/solves.py swingup f_irl 1 5 6
"""

from __future__ import annotations

import csv
import os
import subprocess
import sys
from pathlib import Path

from harness.judge.results import REFERENCE, Cell, Conditions, Shown
from harness.learn.seeds import rng_for
from harness.learn.world import solver_for
from harness.run.cells import prepare
from harness.run.environment import SAME_INSTRUCTIONS
from harness.run.experts import Shared
from harness.engines.cell_environment import as_in_cells
from harness.run.stages import Task, demonstrations, fit, reference, score

FILE = Path(__file__).with_suffix(".csv")
COLUMNS = ("env", "method", "seed", "demos", "solve", "score", "own_return", "own_return_star")


def solves(env: str, method: str, seed: int, demos: int, count: int) -> None:
    """Adds lines to the file as they come."""
    conditions = Conditions("full", "absorbing", "sbx")
    cells = Cell(env, REFERENCE, seed), Cell(env, method, seed, Shown(demos))
    shared = Shared(prepare(cells, conditions))
    scale, task = (Task(cell, conditions, shared) for cell in cells)
    expert, random = (
        score(scale, made.policy, None).returns.mean() for made in reference(scale) if made.policy
    )
    star = fit(task, demonstrations(task))
    assert star.policy is not None
    own_star = score(task, star.policy, star.reward).columns()["own_return"]
    for number in range(count):
        rng = task.rng("pi_R") if not number else rng_for(seed, env, method, f"pi_R, solve {number}")
        policy = solver_for(task.place, "absorbing", rng, "sbx").solve(star.reward, task.rl_steps).policy
        found = score(task, policy, star.reward)
        reached = (found.returns.mean() - random) / (expert - random)
        line = (env, method, seed, demos, number, reached, found.columns()["own_return"], own_star)
        new = not FILE.exists()
        with FILE.open("a", encoding="utf-8", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows([COLUMNS] * new + [line])


if __name__ == "__main__":
    _, env, method, *numbers = sys.argv
    if SAME_INSTRUCTIONS.items() <= os.environ.items():
        solves(env, method, *map(int, numbers))
    else:
        with as_in_cells():  # which counts for what is started
            subprocess.run([sys.executable, *sys.argv], check=True)
