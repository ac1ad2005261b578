"""The distance of a learned reward from the true one, and whether it ranks policies as the true one does.

Under each reward an action has an advantage over what the expert does, and the advantages are compared.
Scale, shift and potential-based shaping (Ng et al. 1999) leave the best policies, and advantages up to scale,
as they are. So this is the distance of STARC (Skalse et al. 2024), with its value canonicalisation for the
expert's policy.

An advantage is a difference of returns over a pair of replays. In one the expert takes another action first,
in the other it acts as always. Where the model is known, the advantage is computed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from envs import EnvSpec
from envs.models import Tabular
from harness.judge.statistics import rank_correlation
from harness.rl.exact import expected_rewards
from harness.rl.simulator import Simulator, Trajectory
from methods.base import Array, Policy, Reward
from methods.network import standardiser
from methods.rewards import fast
from methods.stochastic import roughened
from methods.tabular.model import action_values, greedy, policy_value, value_iteration

LEAST_WEIGHT = 0.01
"""The discount at which a replay ends."""
SAME = 1e-9
"""The share of the largest reward below which an advantage is rounding."""
POLICIES = 20
"""Number of policies that a reward must rank."""
ROUGHEST = 0.5
"""Share of random actions in the worst variant of a policy."""


class Comparison(NamedTuple):
    """The comparison of two advantages.

    `distance`: 0 where they are equal up to scale, 1 where they are opposite, NaN where one is 0 everywhere.
    `rank`: Spearman's correlation of the two. `floor`: the distance of the reward from a shaped copy of
    itself, which would be 0 if replays never ended. `epic`: the `epic_distance`, where the model is known.
    """

    distance: float
    rank: float
    floor: float = math.nan
    epic: float = math.nan


@dataclass(frozen=True)
class Stretches:
    """N parts of episodes, one after the other, in 32 bits.

    `obs`: observations before each of the M steps and at each part's end, (M + N, O). `act`: (M, A).
    `lengths`: steps of each, (N,). `terminated`: whether the episode terminated at its end, (N,).
    """

    obs: NDArray[np.float32]
    act: NDArray[np.float32]
    lengths: NDArray[np.int64]
    terminated: NDArray[np.bool_]

    @classmethod
    def of(cls, episodes: Sequence[Trajectory], starts: Sequence[int]) -> Self:
        """Return each episode from its start step on."""
        both = list(zip(episodes, starts, strict=True))
        return cls(
            np.concatenate([e.obs[t:] for e, t in both]).astype(np.float32),
            np.concatenate([e.act[t:] for e, t in both]).astype(np.float32),
            np.array([len(e.act) - t for e, t in both]),
            np.array([e.terminated for e, _ in both]),
        )

    def arrays(self) -> dict[str, NDArray[np.generic]]:
        """Return its arrays by name, for storage."""
        return dict(vars(self))

    def returns(self, reward: Reward, gamma: float) -> Array:
        """Return the discounted pay of each, (N,), above absorption. After a termination it is 0."""
        before, after = np.ones((2, len(self.obs)), bool)
        before[self._ends] = after[self._ends - self.lengths] = False
        obs, act = self.obs.astype(np.float64), self.act.astype(np.float64)
        paid = fast(reward)(obs[before], act, obs[after]) - reward.absorbing
        first = np.cumsum(self.lengths) - self.lengths
        age = np.arange(len(act)) - np.repeat(first, self.lengths)
        return np.asarray(np.add.reduceat(paid * gamma**age, first))

    @property
    def last(self) -> Array:
        """The observation at each end, (N, O)."""
        return self.obs[self._ends].astype(np.float64)

    @property
    def _ends(self) -> NDArray[np.int64]:
        return np.asarray(np.cumsum(self.lengths + 1) - 1)


@dataclass(frozen=True)
class Replays(Stretches):
    """N pairs of replays from the same moments: first N that take another action first, then N that do not.

    `advantage`: the true reward's, (N,). `gamma`: the discount, ().
    """

    advantage: Array
    gamma: Array

    def advantage_of(self, reward: Reward) -> Array:
        """Return the reward's advantage, (N,). After a termination it pays nothing."""
        other, same = np.split(self.returns(reward, float(self.gamma)), 2)
        return np.asarray(other - same)

    def shaped(self, advantage: Array) -> Array:
        """Return the advantage, (N,), of the same reward shaped by a potential of observations, as large as
        the largest advantage. They differ by the discounted potential where replays end."""
        mean, std = standardiser(self.last)
        direction = np.random.default_rng(0).normal(size=len(mean)) / np.sqrt(len(mean))
        potential = np.abs(advantage).max() * np.tanh((self.last - mean) / std @ direction)
        other, same = np.split(self.gamma**self.lengths * np.where(self.terminated, 0, potential), 2)
        return np.asarray(advantage + other - same)


def replay(spec: EnvSpec, expert: Policy, seeds: Sequence[int], rng: np.random.Generator) -> Replays:
    """Return a pair of replays for each seed, exact where an episode depends on its seed and actions alone.

    They begin in the first half of an episode, the expert's and a random policy's in turn. The other action
    is uniform.
    """
    simulator, by_expert, count = Simulator(spec), Simulator(spec.expert_sees), len(seeds)
    most = math.ceil(math.log(LEAST_WEIGHT) / math.log(spec.gamma))
    visited: dict[int, Trajectory] = {}
    for first, policy in enumerate((expert, lambda obs: spec.random_actions(len(obs), rng))):
        episodes = by_expert.run(policy, seeds[first::2])
        visited |= zip(range(first, count, 2), episodes, strict=True)
    acts = [visited[place].act for place in range(count)]
    until = [act[: rng.integers((len(act) + 1) // 2)] for act in acts]
    others = spec.random_actions(count, rng)
    same = by_expert.run(expert, seeds, until, most)
    changed = [np.vstack([act, other]) for act, other in zip(until, others, strict=True)]
    episodes = [*by_expert.run(expert, seeds, changed, most - 1), *same]
    episodes = simulator.shown(episodes, [*seeds, *seeds])
    starts = [len(act) for act in until] * 2
    rewards = [episode.rewards[start:] for episode, start in zip(episodes, starts, strict=True)]
    values = np.array([float(paid @ spec.gamma ** np.arange(len(paid))) for paid in rewards])
    stretches = Stretches.of(episodes, starts)
    return Replays(**vars(stretches), advantage=values[:count] - values[count:], gamma=np.array(spec.gamma))


def sampled_comparison(reward: Reward | None, replays: Replays) -> Comparison:
    """Return the comparison of a reward, None for the true one, over the replays."""
    own = replays.advantage if reward is None else replays.advantage_of(reward)
    floor = compare(replays.shaped(own), own).distance
    return compare(own, replays.advantage)._replace(floor=floor)


def known_comparison(reward: Reward | None, tabular: Tabular, gamma: float) -> Comparison:
    """Return the same over all states and actions of a known model, whose expert is optimal."""
    true = np.broadcast_to(tabular.reward[:, None], tabular.P.shape[:2])
    paid = true if reward is None else expected_rewards(tabular, reward)
    expert = greedy(value_iteration(tabular.P, tabular.reward, gamma)[1])
    own, known = (policy_advantage(tabular.P, r, expert, gamma) for r in (paid, true))
    return compare(own, known)._replace(floor=0.0, epic=epic_distance(paid, true, gamma))


def policy_advantage(P: Array, r: Array, policy: Array, gamma: float) -> Array:
    """Return the advantage of each action over the policy (S, A) under rewards r (S, A), without rounding."""
    v = policy_value(P, r, policy, gamma)
    advantage = action_values(P, r, v, gamma) - v[:, None]
    return np.where(np.abs(advantage) > SAME * np.abs(r).max() / (1 - gamma), advantage, 0.0)


def epic_distance(own: Array, true: Array, gamma: float) -> float:
    """Return EPIC (Gleave et al. 2021) of rewards (S, A), with uniform states, actions and next states.

    It is 0 where they are equal up to scale, shift and shaping, 1 where they are opposite, and NaN where one
    is constant. It is above 0 between a reward and its advantage, and uses rewards of steps that never
    happen.
    """

    def canonical(r: Array) -> Array:
        mean = r.mean(axis=1)
        return np.asarray((r - mean[:, None])[:, :, None] + gamma * mean).ravel()

    a, b = canonical(own), canonical(true)
    if np.ptp(a) <= SAME * np.abs(own).max() or np.ptp(b) <= SAME * np.abs(true).max():
        return math.nan
    return math.sqrt(max(0.0, (1 - float(np.corrcoef(a, b)[0, 1])) / 2))


def compare(own: Array, true: Array) -> Comparison:
    """Return distance and rank of two advantages of the same states and actions."""
    a, b = own.ravel(), true.ravel()
    size = np.linalg.norm(a) * np.linalg.norm(b)
    if size == 0:
        return Comparison(math.nan, math.nan)
    a, b = a / np.abs(a).max(), b / np.abs(b).max()
    cosine = float(a @ b / (np.linalg.norm(a) * np.linalg.norm(b)))
    distance = math.sqrt(max(0.0, (1 - cosine) / 2))
    # Equally good actions rank equally in spite of rounding.
    constant = np.ptp(a) == 0 or np.ptp(b) == 0
    rank = math.nan if constant else rank_correlation(a.round(9), b.round(9))
    return Comparison(distance, rank)


@dataclass(frozen=True)
class Ranked(Stretches):
    """Episodes of P policies one after the other, equally many of each. `true`: mean true returns, (P,)."""

    true: Array

    def ranking(self, reward: Reward | None) -> float:
        """Return Spearman's correlation of mean returns under the reward and the true one, in [-1, 1].

        It is NaN where all returns under one of the two are equal. None is the true reward.
        """
        own = self.true if reward is None else self.returns(reward, 1.0).reshape(len(self.true), -1).mean(1)
        if np.ptp(own) <= 1e-9 * np.abs(own).max() or np.ptp(self.true) == 0:
            return math.nan
        return rank_correlation(own, self.true)


def ranked(
    spec: EnvSpec, policies: Sequence[Policy], seeds: Sequence[int], rng: np.random.Generator
) -> Ranked:
    """Return episodes of `POLICIES` policies: the given ones with shares of random actions, from 0 on."""
    shares = np.linspace(0, ROUGHEST, POLICIES // len(policies))
    executed = [lambda obs, policy=policy: spec.executed(policy(obs)) for policy in policies]
    rough = [roughened(policy, share, spec.random_actions, rng) for policy in executed for share in shares]
    episodes = [e for group in Simulator(spec.expert_sees).run_each(rough, seeds) for e in group]
    episodes = Simulator(spec).shown(episodes, [*seeds] * len(rough))
    true = np.array([e.rewards.sum() for e in episodes]).reshape(len(rough), -1).mean(axis=1)
    return Ranked(**vars(Stretches.of(episodes, [0] * len(episodes))), true=true)
