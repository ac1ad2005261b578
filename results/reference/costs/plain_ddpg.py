"""What Stable-Baselines3's DDPG scores by itself, `bench`'s comparison, with as many steps as at `full`.

From the repository's root; prints one line of plain_ddpg.csv:

    python results/reference/costs/plain_ddpg.py cartpole 0
"""

from __future__ import annotations

import sys
import time

import numpy as np
from judging import BUDGET, Judge

from harness.bench import plain_ddpg
from methods.base import Array

if __name__ == "__main__":
    env, seed = sys.argv[1], int(sys.argv[2])
    judge = Judge(env, seed)
    started = time.perf_counter()
    learner = plain_ddpg(env, judge.spec.rl_steps[BUDGET], seed)
    seconds = time.perf_counter() - started

    def act(obs: Array) -> Array:
        return learner.predict(obs.astype(np.float32), deterministic=True)[0].astype(float)

    print(f"{env},{seed},{judge.score(act):.3f},{seconds:.0f}")
