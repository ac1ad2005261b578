"""Solve tasks under the true reward, as `control_true` does at budget full, on tuning seeds.

python results/studies/control_true.py TASKS FILE [SEED ...]: a line for each task and seed, by default 100
to 119, appended to a CSV file. Locomotion has seeds 110 to 114.
score: 0 the random policy, 1 the seed's expert, on the seed's 100 evaluation episodes; under other dynamics,
1 is that expert's return in the task's own. seconds: processor time of the solve with its checks, in one
process one after the other; the first of a task may compile.
"""

import csv
import sys
import time

import numpy as np

from harness.cell.experts import source_for
from harness.judge.evaluation import evaluate
from harness.records import Conditions
from harness.registry import SPECS
from harness.rl.seeds import evaluation_seeds, rng_for
from harness.rl.world import solver_for

SEEDS = range(100, 120)
CONDITIONS = Conditions("full", "absorbing", "sbx")


def line(env: str, seed: int) -> list[str]:
    """Return the line of one solve."""
    name, _, dynamics = env.partition(".")
    spec = SPECS[name].variant(dynamics) if dynamics else SPECS[name]
    seeds, random = evaluation_seeds(seed, 100), np.random.default_rng(seed)
    steps, started = spec.rl_steps["full"], time.process_time()
    solver = solver_for(spec, "absorbing", rng_for(seed, env, "control_true", "pi_R 0"), "sbx")
    found = solver.solve(None, steps).policy
    took = time.process_time() - started
    expert = source_for(name, seed, CONDITIONS).expert.policy
    least = evaluate(spec, lambda obs: spec.random_actions(len(obs), random), seeds).returns.mean()
    most = evaluate(SPECS[name].expert_sees, expert, seeds).returns.mean()
    score = (evaluate(spec, found, seeds).returns.mean() - least) / (most - least)
    return [env, str(steps), str(seed), f"{score:.3f}", f"{took:.1f}"]


tasks, path, *seeds = sys.argv[1:]
for task in tasks.split(","):
    for seed in map(int, seeds or SEEDS):
        with open(path, "a", newline="", encoding="utf-8") as file:
            csv.writer(file).writerow(line(task, seed))
