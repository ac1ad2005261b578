"""What Stable-Baselines3's DDPG scores by itself, `bench`'s comparison, with as many steps as at `full`.

From the repository's root; prints one line of plain_ddpg.csv:

    python results/reference/costs/plain_ddpg.py cartpole 0
"""

from __future__ import annotations

import sys
import time

import numpy as np

from envs import SPECS
from harness.bench import plain_ddpg
from harness.evaluation import evaluate
from harness.experts import expert_for
from harness.seeds import evaluation_seeds, rng_for
from methods.base import Array

BUDGET = "full"

if __name__ == "__main__":
    env, seed = sys.argv[1], int(sys.argv[2])
    spec, rng = SPECS[env], rng_for(seed, env, "random policy")
    judged = evaluation_seeds(seed, spec.eval_episodes[BUDGET])
    started = time.perf_counter()
    learner = plain_ddpg(env, spec.rl_steps[BUDGET], seed)
    seconds = time.perf_counter() - started

    def act(obs: Array) -> Array:
        return learner.predict(obs.astype(np.float32), deterministic=True)[0].astype(float)

    learned, best, worst = (
        float(evaluate(spec, policy, judged).returns.mean())
        for policy in (
            act,
            expert_for(env, BUDGET, "sbx").policy,
            lambda obs: spec.random_actions(len(obs), rng),
        )
    )
    print(f"{env},{seed},{(learned - worst) / (best - worst):.3f},{learned:.1f},{seconds:.0f}")
