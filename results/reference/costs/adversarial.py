"""What GAIL (Ho & Ermon 2016) and AIRL (Fu et al. 2018) of the library `imitation` cost, until their policy
scores 0.95 of the expert or a million environment steps were taken, on the demonstrations that the
benchmark's methods get.

Not part of the package, for that library asks for older ones. In a virtual environment of its own, from the
repository's root; prints one line of adversarial.csv:

    pip install -c constraints.txt -e .
    pip install --no-deps imitation==1.0.1 \\
        tensorboard datasets huggingface_sb3 huggingface_hub seals sacred tqdm
    python results/reference/costs/adversarial.py cartpole gail native 0

Hyper-parameters are those of the library's examples, the policy and its features those of its tuned
configurations. Under `native` episodes end as the environment ends them, which teaches GAIL, whose reward is
positive, to stay alive, and AIRL to die. Under `absorbing` what would terminate goes to an absorbing state
that observations mark, and every episode lasts to the horizon. The policy is evaluated after each round; that
is not counted. Further arguments, told in the line, are how many demonstrations there are (`demos=5`) and
after how many environment steps it gives up (`limit=300000`); all others change PPO's settings and the
discriminator's updates a round, as in `n_steps=256 n_disc_updates_per_round=4`. Seeds from 100: tuning.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium.wrappers import TimeLimit, TransformObservation
from imitation.algorithms.adversarial.airl import AIRL
from imitation.algorithms.adversarial.gail import GAIL
from imitation.data.types import Trajectory
from imitation.data.wrappers import RolloutInfoWrapper
from imitation.policies.base import FeedForward32Policy, NormalizeFeaturesExtractor
from imitation.rewards.reward_nets import BasicRewardNet, BasicShapedRewardNet
from imitation.util import logger
from imitation.util.networks import RunningNorm
from judging import ENOUGH, Judge
from seals.util import AbsorbAfterDoneWrapper
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv

from envs import EnvSpec
from methods.base import Array

COPIES = 8
LIMIT = 1_000_000
"""Environment steps after which a run gives up."""
TRAINERS = {
    "gail": (GAIL, BasicRewardNet, 4e-4, {"demo_batch_size": 1024, "n_disc_updates_per_round": 8}),
    "airl": (AIRL, BasicShapedRewardNet, 5e-4, {"demo_batch_size": 2048, "n_disc_updates_per_round": 16}),
}


def alive(obs: Array) -> Array:
    """(..., O) observations with the indicator of the absorbing state, 0: (..., O + 1)."""
    return np.concatenate([obs, np.zeros((*obs.shape[:-1], 1))], axis=-1).astype(np.float32)


def copy_of(spec: EnvSpec, protocol: str) -> gym.Env:
    """The environment, its observations with the indicator; the absorbing state is all 0 but for that."""
    space = gym.spaces.Box(-np.inf, np.inf, (spec.obs_size + 1,), np.float32)
    absorbed = np.eye(spec.obs_size + 1, dtype=np.float32)[-1]
    env: gym.Env = TransformObservation(spec.make(), alive, space)
    if protocol == "absorbing":
        env = TimeLimit(AbsorbAfterDoneWrapper(env, absorb_obs=absorbed), spec.horizon)
    return RolloutInfoWrapper(env)


def cost(
    env: str, method: str, protocol: str, seed: int, changes: dict[str, Any]
) -> tuple[bool, float, int, float]:
    """Whether 0.95 was reached, the seconds and environment steps until then, and the score at last."""
    torch.manual_seed(seed)
    judge = Judge(env, seed)
    spec, trainer, network, learning_rate, options = judge.spec, *TRAINERS[method]
    demos = judge.demonstrations()[: changes.pop("demos", None)]
    limit = changes.pop("limit", LIMIT)
    options = {name: changes.pop(name, value) for name, value in options.items()}
    started = time.perf_counter()
    copies = DummyVecEnv([lambda: copy_of(spec, protocol)] * COPIES)
    copies.seed(seed)
    settings: dict[str, float] = {"batch_size": 64, "ent_coef": 0.0, "learning_rate": learning_rate}
    settings |= {"clip_range": 0.1, "vf_coef": 0.1, "n_epochs": 5, "gamma": spec.gamma}
    learner = PPO(
        FeedForward32Policy,
        copies,
        **(settings | changes),
        seed=seed,
        device="cpu",
        policy_kwargs={
            "features_extractor_class": NormalizeFeaturesExtractor,
            "features_extractor_kwargs": {"normalize_class": RunningNorm},
        },
    )
    rounds = trainer(
        demonstrations=[
            Trajectory(alive(d.obs), d.act.astype(np.float32), None, terminal=d.terminated) for d in demos
        ],
        gen_replay_buffer_capacity=512,
        venv=copies,
        gen_algo=learner,
        reward_net=network(copies.observation_space, copies.action_space, normalize_input_layer=RunningNorm),
        allow_variable_horizon=protocol == "native",
        custom_logger=logger.configure(None, []),
        **options,
    )

    def act(obs: Array) -> Array:
        return np.clip(learner.predict(alive(obs), deterministic=True)[0], -1, 1).astype(float)

    seconds, score = time.perf_counter() - started, -np.inf
    while score < ENOUGH and learner.num_timesteps < limit:
        started = time.perf_counter()
        rounds.train(rounds.gen_train_timesteps)
        seconds += time.perf_counter() - started
        score = judge.score(act)
        print(f"{learner.num_timesteps} steps, {seconds:.0f} s: {score:.3f}", file=sys.stderr)
    return score >= ENOUGH, seconds, learner.num_timesteps, score


if __name__ == "__main__":
    env, method, protocol, seed, *changed = sys.argv[1:]
    changes = {name: json.loads(value) for name, _, value in (one.partition("=") for one in changed)}
    reached, seconds, steps, score = cost(env, method, protocol, int(seed), changes)
    told = f"{reached},{seconds:.0f},{steps},{score:.3f}"
    print(f"{env},{method},{protocol},{seed},{told},{' '.join(changed)}")
