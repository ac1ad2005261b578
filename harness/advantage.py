"""How well a reward ranks actions: its rank correlation with the true advantage of the expert's policy. That
is the true reward shaped by the expert's values, with the same optimal policies where the expert is optimal,
and what the thesis's R* is built to be (Ng et al. 1999; thesis, section 4.1)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from envs import EnvSpec
from envs.spec import Tabular
from harness.exact import expected_rewards
from harness.simulator import Simulator, Trajectory
from methods.base import Array, Policy, Reward
from methods.tabular import value_iteration


def rank_correlation(
    reward: Reward | None, spec: EnvSpec, expert: Policy, seeds: Sequence[int], rng: np.random.Generator
) -> float:
    """Spearman's correlation in [-1, 1] of what the reward pays, None being the true one, with the true
    advantage: over all states and actions where the model is known, elsewhere over uniform actions in states
    of the expert's episodes, one for each seed.

    NaN where either is the same everywhere, as the advantage is on a balancing task that one wrong action
    does not end.
    """
    from scipy.stats import spearmanr

    if spec.tabular:
        paid, advantage = _known(reward, spec.tabular, spec.gamma)
    else:
        paid, advantage = _sampled(reward, spec, expert, seeds, rng)
    if np.ptp(paid) == 0 or np.ptp(advantage) == 0:
        return math.nan
    return float(spearmanr(paid, advantage).statistic)


def _known(reward: Reward | None, tabular: Tabular, gamma: float) -> tuple[Array, Array]:
    """(S A,): what is paid, and the advantage of the optimal policy."""
    value, q = value_iteration(tabular.P, tabular.reward, gamma)
    true = np.broadcast_to(tabular.reward[:, None], q.shape)
    paid = true if reward is None else expected_rewards(tabular, reward)
    # Equally good actions must rank equally, whatever value iteration left undone.
    return paid.ravel(), (q - value[:, None]).round(6).ravel()


def _sampled(
    reward: Reward | None, spec: EnvSpec, expert: Policy, seeds: Sequence[int], rng: np.random.Generator
) -> tuple[Array, Array]:
    """(N,): what is paid for one uniform action at one moment of the first half of each episode, and how much
    that changes the discounted return from there on: exact where an episode depends on its seed and its
    actions alone."""
    simulator = Simulator(spec)
    kept = simulator.run(expert, seeds)
    moments = np.array([rng.integers((len(e.act) + 1) // 2) for e in kept])
    left = simulator.run(expert, seeds, leave=(moments, spec.random_actions(len(seeds), rng)))
    pairs = list(zip(moments.tolist(), kept, left, strict=True))

    def value(episode: Trajectory, moment: int) -> float:
        rewards = episode.rewards[moment:]
        return float(rewards @ spec.gamma ** np.arange(len(rewards)))

    advantage = np.array([value(after, t) - value(before, t) for t, before, after in pairs])
    if reward is None:
        return np.array([after.rewards[t] for t, _, after in pairs]), advantage
    obs, act, next_obs = (
        np.stack(rows)
        for rows in zip(*[(e.obs[t], e.act[t], e.obs[t + 1]) for t, _, e in pairs], strict=True)
    )
    return reward(obs, act, next_obs), advantage
