"""Solve every reward of a run once more, by DDPG: does the order of methods change with the learner?

    python results/studies/second_learner.py RUN FILE [WORKERS]

A line for each reward of a method is appended to a CSV file as it is solved, and rewards that the file has
are left out. RUN must have kept what it learned. DDPG has the settings and the steps of `--learner ddpg` at
budget full.

Columns: env, demos, method, seed, score (normalised, on the run's evaluation episodes), solved (by what it
earns of R*, `harness.judge.evaluation`), score_pi_R and solved_pi_R (the run's own), seconds (of the
processor).
"""

import csv
import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import cache
from multiprocessing import get_context
from pathlib import Path

from harness.judge.evaluation import evaluate, is_solved
from harness.judge.leaderboard import scored_rows
from harness.process.environment import numeric
from harness.records import CONTROLS, NOMINAL, Cell, Row
from harness.registry import SPECS
from harness.rl.seeds import evaluation_seeds, rng_for
from harness.rl.world import solver_for
from harness.store.opening import open_to_verify

COLUMNS = ("env", "demos", "method", "seed", "score", "solved", "score_pi_R", "solved_pi_R", "seconds")


@cache
def rows_of(run: Path) -> dict[tuple[str, int, str], Row]:
    """Return the run's rows in the tasks' own dynamics by method, seed and policy."""
    with open_to_verify(run) as store:
        results, damaged = store.load()
    assert not damaged
    rows = scored_rows([*results.values()])
    return {(row.method, row.seed, row.policy): row for row in rows if row.dynamics == NOMINAL}


def line(run: Path, cell: Cell) -> list[str]:
    """Return the line of one reward."""
    with open_to_verify(run) as store:
        reward = store.read_learned(store.load()[0][cell])["reward"]
    rows, spec = rows_of(run), SPECS[cell.env].by_ddpg()
    star, found = rows[cell.method, cell.seed, "pi_star"], rows[cell.method, cell.seed, "pi_R"]
    least, most = (rows["reference", cell.seed, name].return_mean for name in ("random", "expert"))
    started = time.process_time()
    solver = solver_for(spec, "absorbing", rng_for(cell.seed, cell.env, cell.method, "second learner"), "sbx")
    policy = solver.solve(reward, spec.rl_steps["full"]).policy
    took = time.process_time() - started
    scored = evaluate(spec, policy, evaluation_seeds(cell.seed, star.episodes), reward)
    solved = is_solved(scored.own_return, star.own_return, star.own_return_random)
    numbers = ((scored.returns.mean() - least) / (most - least), found.normalized_score)
    score, own = (f"{number:.3f}" for number in numbers)
    return [
        *(cell.env, str(cell.shown.demos), cell.method, str(cell.seed)),
        *(score, f"{solved:g}", own, f"{found.solved:g}", f"{took:.0f}"),
    ]


def main(run: Path, path: Path, workers: int) -> None:
    os.environ |= numeric(deterministic=True)
    done = set()
    if path.exists():
        with path.open(encoding="utf-8") as file:
            done = {(row["env"], row["demos"], row["method"], row["seed"]) for row in csv.DictReader(file)}
    else:
        path.write_text(",".join(COLUMNS) + "\n", encoding="utf-8")
    with open_to_verify(run) as store:
        results = store.load()[0].values()
    retrained = [one.cell for one in results if any((r.policy, r.status) == ("pi_R", "ok") for r in one.rows)]
    cells = [
        cell
        for cell in retrained
        if cell.dynamics == NOMINAL and cell.method not in CONTROLS
        if (cell.env, str(cell.shown.demos), cell.method, str(cell.seed)) not in done
    ]
    cells.sort(key=lambda cell: (cell.seed, cell.method))
    with ProcessPoolExecutor(workers, get_context("spawn")) as pool:
        for future in as_completed([pool.submit(line, run, cell) for cell in cells]):
            with path.open("a", newline="", encoding="utf-8") as file:
                csv.writer(file, lineterminator="\n").writerow(future.result())


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]) if len(sys.argv) > 3 else 1)
