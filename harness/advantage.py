"""How well a reward ranks actions: its rank correlation with the true advantage of the expert's policy. That
is the true reward shaped by the expert's values, with the same optimal policies where the expert is optimal,
and what the thesis's R* is built to be (Ng et al. 1999; thesis, section 4.1)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import spearmanr

from envs import EnvSpec
from envs.spec import Tabular
from harness.exact import expected_rewards
from harness.simulator import Simulator, Trajectory
from methods.base import Array, Policy, Reward
from methods.tabular import value_iteration


@dataclass(frozen=True)
class Deviations:
    """Single actions that a policy would not have taken, at moments of its episodes, each of another one."""

    obs: Array
    """(N, O), before the action."""
    act: Array
    """(N, A)."""
    next_obs: Array
    """(N, O), after it."""
    rewards: Array
    """(N,): the true ones."""
    advantage: Array
    """(N,): how much the action changed the discounted return from there on."""


def deviations(spec: EnvSpec, policy: Policy, seeds: Sequence[int], rng: np.random.Generator) -> Deviations:
    """Uniform actions at moments of the first half of each seed's episode; the advantage is exact where an
    episode depends on its seed and its actions alone."""
    simulator = Simulator(spec)
    kept = simulator.run(policy, seeds)
    moments = np.array([rng.integers((len(e.act) + 1) // 2) for e in kept])
    left = simulator.run(policy, seeds, leave=(moments, spec.random_actions(len(seeds), rng)))
    steps = list(zip(moments.tolist(), left, strict=True))

    def value(episode: Trajectory, moment: int) -> float:
        rewards = episode.rewards[moment:]
        return float(rewards @ spec.gamma ** np.arange(len(rewards)))

    return Deviations(
        np.stack([e.obs[t] for t, e in steps]),
        np.stack([e.act[t] for t, e in steps]),
        np.stack([e.obs[t + 1] for t, e in steps]),
        np.array([e.rewards[t] for t, e in steps]),
        np.array(
            [value(after, t) - value(before, t) for (t, after), before in zip(steps, kept, strict=True)]
        ),
    )


def sampled_correlation(reward: Reward | None, sample: Deviations) -> float:
    """Spearman's correlation in [-1, 1] of what the reward pays, None being the true one, with the true
    advantage; NaN where either is the same everywhere, as the advantage is on a balancing task that one wrong
    action does not end."""
    paid = sample.rewards if reward is None else reward(sample.obs, sample.act, sample.next_obs)
    return _spearman(paid, sample.advantage)


def known_correlation(reward: Reward | None, tabular: Tabular, gamma: float) -> float:
    """The same over all states and actions where the model is known; the expert there is optimal."""
    value, q = value_iteration(tabular.P, tabular.reward, gamma)
    true = np.broadcast_to(tabular.reward[:, None], q.shape)
    paid = true if reward is None else expected_rewards(tabular, reward)
    # Equally good actions must rank equally, whatever value iteration left undone.
    return _spearman(paid.ravel(), (q - value[:, None]).round(6).ravel())


def _spearman(paid: Array, advantage: Array) -> float:
    if np.ptp(paid) == 0 or np.ptp(advantage) == 0:
        return math.nan
    return float(spearmanr(paid, advantage).statistic)
