"""Rewards that nobody learned, under which scores of pi_R show what a score is worth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch

from harness.records import CONTROL_METHODS
from methods.base import Array, Episodes, Learned, Policy, RandomActions, Reward
from methods.network import mlp, standardiser
from methods.rewards import Constant, NetworkReward, default_absorbing


@dataclass(frozen=True)
class Distance:
    """Minus the squared distance to a policy's action."""

    policy: Policy
    absorbing: float = 0.0

    def __call__(self, obs: Array, act: Array, next_obs: Array, /) -> Array:
        paid: Array = -np.square(act - self.policy(obs)).sum(axis=1)
        return paid


def control_reward(
    name: str,
    demos: Callable[[], Episodes],
    fit: Callable[[str, Episodes], Learned],
    random_actions: RandomActions,
    rng: np.random.Generator,
) -> Reward | None:
    """Return a control's reward by its name; None is the environment's own. `fit`: fits a method by its name
    to demonstrations. Raises KeyError for another name."""
    if name == "control_untrained":
        return untrained(demos(), random_actions, rng)
    if name == "control_shuffled":
        return fit(CONTROL_METHODS[name], shuffled(demos(), rng)).reward
    if name == "control_clone":
        shown = demos()
        reward = Distance(fit(CONTROL_METHODS[name], shown).policy)
        return replace(reward, absorbing=default_absorbing(reward, shown, random_actions, rng))
    return {
        "control_true": None,
        "control_plus1": Constant(1.0, absorbing=1.0),
        "control_minus1": Constant(-1.0, absorbing=-1.0),
        "control_survival": Constant(0.0, absorbing=-1.0),
    }[name]


def shuffled(demos: Episodes, rng: np.random.Generator) -> Episodes:
    """Return the same states and the same actions, paired at random."""
    act = rng.permutation(demos.pairs()[1])
    ends = np.cumsum([len(act) for act in demos.act])
    return replace(demos, act=tuple(a.copy() for a in np.split(act, ends[:-1])))


def untrained(demos: Episodes, random_actions: RandomActions, rng: np.random.Generator) -> Reward:
    """Return a network of random initial weights, within [-1, 1], on observations standardised by
    demonstrations."""
    mean, std = standardiser(demos.pairs()[0])
    generator = torch.Generator().manual_seed(int(rng.integers(1 << 31)))
    act_size = random_actions(1, np.random.default_rng(0)).shape[1]
    layers = mlp(len(mean) + act_size + 1, 64, 64, 1, generator=generator)
    reward = NetworkReward.of(layers, mean, std, bound=1.0)
    return replace(reward, absorbing=default_absorbing(reward, demos, random_actions, rng))
