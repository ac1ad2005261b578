"""Fit clones of tuning seeds' experts, on their demonstrations of budget full.

python results/studies/clone_fits.py NAME TASKS FILE: a line for each task, tuning seed, number of
demonstrations and method, appended to a CSV file; NAME says what fits. Columns: that name, task, seed,
demonstrations, method, pairs, seconds, error of what is fitted, error of 30 more demonstrations. Errors are
mean squares of what the cloned action is off by, in units of its standard deviation over all 100
demonstrations. seconds: processor time of the fit alone.
"""

import csv
import sys
import time

import numpy as np

from harness.cell.experts import source_for
from harness.records import Conditions
from harness.registry import SPECS
from harness.rl.seeds import demonstration_seeds
from harness.rl.simulator import Simulator
from harness.rl.world import TaskWorld
from methods.base import Episodes
from methods.bc import BehaviourCloning
from methods.shaped import Shaped

SEEDS = (100, 101, 102)
MORE = 30
CONDITIONS = Conditions("full", "absorbing", "sbx")


def fits(name: str, env: str, seed: int) -> list[list[str]]:
    """Return the lines of one task and tuning seed."""
    spec = SPECS[env]
    full = spec.demo_episodes["full"]
    expert = source_for(env, seed, CONDITIONS).expert.policy
    shown = Simulator(spec).run(expert, demonstration_seeds(seed, full + MORE))
    world = TaskWorld(spec, "absorbing", "sbx")
    unit = np.concatenate([t.act for t in shown[:full]]).std(axis=0)
    held = [np.concatenate(side) for side in zip(*((t.obs[:-1], t.act) for t in shown[full:]), strict=True)]
    lines = []
    for count in (5, full):
        first = shown[:count]
        demos = Episodes(*(tuple(getattr(t, name) for t in first) for name in ("obs", "act", "terminated")))
        for method in (BehaviourCloning(), Shaped()):
            started = time.process_time()
            policy = method.fit(demos, world, np.random.default_rng(seed)).policy
            seconds = time.process_time() - started
            errors = [np.square((act - policy(obs)) / unit).mean() for obs, act in (demos.pairs(), held)]
            row = [name, env, seed, count, type(method).__name__, len(demos.pairs()[0]), f"{seconds:.1f}"]
            lines.append([*map(str, row), *(f"{error:.3g}" for error in errors)])
    return lines


name, tasks, path = sys.argv[1:]
for task in tasks.split(","):
    for number in SEEDS:
        with open(path, "a", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows(fits(name, task, number))
