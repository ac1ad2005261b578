"""What Stable-Baselines3's DDPG scores by itself, as `bench` times it, but with the noise of its
documentation's example: our networks, batch, steps and one gradient step a step; neither n-step returns nor
checkpoints nor anything else of `harness/rl.py`.

From the repository's root; prints one line of plain_ddpg.csv:

    python results/reference/costs/plain_ddpg.py cartpole 0
"""

from __future__ import annotations

import sys
import time

import numpy as np
from stable_baselines3 import DDPG
from stable_baselines3.common.noise import NormalActionNoise

from envs import SPECS
from harness.evaluation import evaluate
from harness.experts import expert_for
from harness.rl import WARM_UP
from harness.rl_settings import rl_settings_for
from harness.seeds import evaluation_seeds, rng_for
from methods.base import Array

BUDGET = "full"

if __name__ == "__main__":
    env, seed = sys.argv[1], int(sys.argv[2])
    spec, settings, rng = SPECS[env], rl_settings_for(env), rng_for(seed, env, "random policy")
    judged = evaluation_seeds(seed, spec.eval_episodes[BUDGET])
    started = time.perf_counter()
    learner = DDPG(
        "MlpPolicy",
        spec.make(),
        learning_starts=WARM_UP,
        batch_size=settings.batch,
        train_freq=1,
        action_noise=NormalActionNoise(np.zeros(spec.act_size), np.full(spec.act_size, 0.1)),
        policy_kwargs={"net_arch": list(settings.net)},
        seed=seed,
        device="cpu",
    ).learn(spec.rl_steps[BUDGET])
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
