"""Solve highway by PPO of several settings under the true reward, and by the task's own under that of
`control_survival`, on tuning seeds.

python results/studies/highway_rl.py FILE: a line for each setting and seed, written to a CSV file. score: 0
the random policy, 1 the seed's expert, on 50 of the seed's evaluation episodes. seconds: processor time of
the solve with its checks; the first of a setting may compile.
"""

import csv
import sys
import time
from dataclasses import replace
from typing import Any, cast

import numpy as np

from envs.learners import PPO
from harness.cell.experts import source_for
from harness.judge.controls import control_reward
from harness.judge.evaluation import evaluate
from harness.records import Conditions
from harness.registry import SPECS
from harness.rl.seeds import evaluation_seeds, rng_for
from harness.rl.solving import Agent

SPEC = SPECS["highway"]
OWN = cast(PPO, SPEC.rl)
BEFORE = replace(OWN, steps=64, epochs=6, std=1.0, checkpoint_every=40_960)
SETTINGS = [
    ("true", 245_760, BEFORE),
    ("true", 122_880, replace(BEFORE, epochs=10, std=0.6, checkpoint_every=20_480)),
    *(("true", 122_880, replace(OWN, std=std)) for std in (0.6, 1.0)),
    *(("true", 122_880, replace(OWN, gae_lambda=gae)) for gae in (0.8, 0.9)),
    ("survival", 122_880, OWN),
]
"""What pays, environment steps and settings."""
SEEDS = range(100, 120)


def score(pays: str, steps: int, settings: PPO, seed: int) -> tuple[float, float]:
    """Return what one solve scores and the seconds that it took."""
    rng = rng_for(seed, "highway", "control_true", "pi_R 0")
    survival = control_reward("control_survival", _nothing, _nothing, SPEC.random_actions, rng)
    reward = survival if pays == "survival" else None
    started = time.process_time()
    found = Agent(SPEC, "absorbing", rng, "sbx", settings).solve(reward, steps).policy
    seconds, seeds = time.process_time() - started, evaluation_seeds(seed, 50)
    expert = source_for("highway", seed, Conditions("quick", "absorbing", "sbx")).expert.policy
    random = np.random.default_rng(seed)
    policies = (lambda obs: SPEC.random_actions(len(obs), random), expert, found)
    least, most, its = (evaluate(SPEC, policy, seeds).returns.mean() for policy in policies)
    return (its - least) / (most - least), seconds


def _nothing(*_: object) -> Any:
    raise AssertionError("this control needs no demonstrations")


with open(sys.argv[1], "w", newline="", encoding="utf-8") as file:
    write = csv.writer(file, lineterminator="\n").writerow
    write(["reward", "env_steps", "steps", "epochs", "std", "gae_lambda", "seed", "score", "seconds"])
    for what, count, own in SETTINGS:
        for number in SEEDS:
            its, took = score(what, count, own, number)
            row = [what, count, own.steps, own.epochs, own.std, own.gae_lambda, number]
            write([*row, f"{its:.3f}", f"{took:.1f}"])
            file.flush()
