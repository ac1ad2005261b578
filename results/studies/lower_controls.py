"""Solve tasks under rewards that know nothing, as the lower controls do at budget full, on tuning seeds.

python results/studies/lower_controls.py TASKS FILE: a line for each task, control and seed, appended to a
CSV file. score: 0 the random policy, 1 the seed's expert, on the seed's 100 evaluation episodes.
"""

import csv
import sys

import numpy as np

from harness.cell.experts import source_for
from harness.judge.controls import control_reward
from harness.judge.evaluation import evaluate
from harness.records import ALL_SHOWN, LOWER_CONTROLS, Conditions
from harness.registry import SPECS
from harness.rl.seeds import evaluation_seeds, rng_for
from harness.rl.world import solver_for
from methods.base import Episodes, Learned, Policy

SEEDS = range(100, 120)
CONDITIONS = Conditions("full", "absorbing", "sbx")
CONTROLS = (*LOWER_CONTROLS, "control_survival")


def scores(env: str, seed: int) -> list[list[str]]:
    """Return a line for each control."""
    spec, random = SPECS[env], np.random.default_rng(seed)

    def shown() -> Episodes:
        return source_for(env, seed, CONDITIONS).demonstrations(ALL_SHOWN)

    policies: list[Policy] = [lambda obs: spec.random_actions(len(obs), random)]
    policies.append(source_for(env, seed, CONDITIONS).expert.policy)
    for control in CONTROLS:
        rng = rng_for(seed, env, control, "control")
        reward = control_reward(control, shown, _no_fit, spec.random_actions, rng)
        solver = solver_for(spec, "absorbing", rng_for(seed, env, control, "pi_R 0"), "sbx")
        policies.append(solver.solve(reward, spec.rl_steps["full"]).policy)
    seeds = evaluation_seeds(seed, 100)
    least, most, *found = (evaluate(spec, policy, seeds).returns.mean() for policy in policies)
    reached = zip(CONTROLS, found, strict=True)
    return [[env, control, str(seed), f"{(its - least) / (most - least):.3f}"] for control, its in reached]


def _no_fit(method: str, demos: Episodes) -> Learned:
    raise AssertionError("no lower control is fitted")


tasks, path = sys.argv[1:]
for task in tasks.split(","):
    for number in SEEDS:
        with open(path, "a", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows(scores(task, number))
