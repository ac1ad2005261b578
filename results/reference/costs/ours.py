"""What the benchmark's methods cost until their policy scores 0.95 of the expert: the least of a few efforts,
up to that of `full`, that does. Of a fit to demonstrations an effort is a share of its steps,
of the others it is how often they solve RL.

From the root; prints a line: env, method, seed, reached, seconds, env_steps, check_steps, rl_solves, score.
(ours.csv is of commit 2c3ab50, where env_steps were all and rl_steps those that were learned from.)

    python results/reference/costs/ours.py cartpole maxent 0

The seconds are of that fit alone, what JAX compiles included; the policy's evaluation is not counted.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from typing import Any

from harness.learn.seeds import rng_for
from harness.learn.world import TaskWorld, without_rewards
from judging import BUDGET, ENOUGH, Judge

from harness.registry import load_method
from methods.network import Regression
from methods.settings import settings_for

SHARES = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)


def efforts(method: str, env: str) -> list[Any]:
    """The method with each effort, the least first."""
    whole = load_method(method)(**settings_for(method, env, BUDGET))
    if not isinstance(whole, Regression):
        return [replace(whole, iterations=count) for count in range(1, whole.iterations + 1)]
    return [replace(whole, steps=max(1, int(share * whole.steps))) for share in SHARES]


if __name__ == "__main__":
    env, method, seed = sys.argv[1], sys.argv[2], int(sys.argv[3])
    judge = Judge(env, seed)
    demos = without_rewards(judge.demonstrations())
    for tried in efforts(method, env):
        world = TaskWorld(judge.spec, "absorbing", "sbx")
        started = time.perf_counter()
        learned = tried.fit(demos, world, rng_for(seed, env, method, "fit"))
        seconds = time.perf_counter() - started
        score = judge.score(learned.policy)
        print(f"{tried}: {score:.3f} after {seconds:.1f} s", file=sys.stderr)
        if score >= ENOUGH:
            break
    used = f"{world.env_steps},{world.check_steps},{world.rl_solves}"
    print(f"{env},{method},{seed},{score >= ENOUGH},{seconds:.1f},{used},{score:.3f}")
