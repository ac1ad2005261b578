"""Measure policies on roads that nothing was trained on: the expert, clones of it, and RL.

python results/studies/drive_state.py FILE POLICY,POLICY [SEED ...]: a line for each policy, dynamics and
seed, by default 100 to 102, appended to a CSV file. POLICY is expert, random, control_true, or bc_5 for a
clone of 5 episodes.
score: 0 the random policy, 1 the expert in the task's own dynamics, on the same 50 episodes.
to_the_end: share of episodes that last 200 steps. seconds: processor time of the fit or solve.
"""

import csv
import functools
import sys
import time

import numpy as np

from harness.cell.experts import source_for
from harness.judge.evaluation import Evaluation, evaluate
from harness.records import Conditions, Shown
from harness.registry import SPECS
from harness.registry.plugins import method_for
from harness.rl.seeds import evaluation_seeds, rng_for
from harness.rl.world import TaskWorld, solver_for
from methods.base import Policy

ENV, EPISODES = "drive_state", 50
SPEC, CONDITIONS = SPECS[ENV], Conditions("full", "absorbing", "sbx")


@functools.cache
def fitted(name: str, seed: int) -> Policy:
    """Return a policy of the task itself."""
    source = source_for(ENV, seed, CONDITIONS)
    if name == "expert":
        return source.expert.policy
    if name.startswith("bc_"):
        demos = source.demonstrations(Shown(demos=int(name.removeprefix("bc_"))))
        method = method_for("bc", ENV, "full")
        world = TaskWorld(SPEC, "absorbing", "sbx", solve_steps=SPEC.rl_steps["full"])
        return method.fit(demos, world, rng_for(seed, ENV, "bc", "fit")).policy
    if name == "random":
        rng = np.random.default_rng(seed)
        return lambda obs: SPEC.random_actions(len(obs), rng)
    rng = rng_for(seed, ENV, "control_true", "pi_R 0")
    return solver_for(SPEC, "absorbing", rng, "sbx").solve(None, SPEC.rl_steps["full"]).policy


@functools.cache
def scored(name: str, dynamics: str, seed: int) -> Evaluation:
    """Return what a policy of the task itself reaches in these dynamics."""
    spec = SPEC.variant(dynamics) if dynamics else SPEC
    return evaluate(spec, fitted(name, seed), evaluation_seeds(seed, EPISODES))


path, names, *seeds = sys.argv[1:]
for seed in map(int, seeds or (100, 101, 102)):
    for name in names.split(","):
        started = time.process_time()
        fitted(name, seed)
        took = time.process_time() - started
        for dynamics in ("", *SPEC.variants):
            low, its, high = (
                scored(one, place, seed)
                for one, place in (("random", dynamics), (name, dynamics), ("expert", ""))
            )
            least, mean, most = (one.returns.mean() for one in (low, its, high))
            with open(path, "a", newline="", encoding="utf-8") as file:
                row = [name, dynamics, seed, f"{mean:.2f}", f"{(mean - least) / (most - least):.3f}"]
                row += [f"{(its.lengths == SPEC.horizon).mean():.2f}", f"{took:.1f}"]
                csv.writer(file, lineterminator="\n").writerow(row)
