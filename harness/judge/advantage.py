"""How far a learned reward is from the true one: both give each action an advantage over what the expert
does, and those are compared. Nothing that leaves the best policies as they are, scale, shift, potential-based
shaping (Ng et al. 1999), changes the advantage; so this is the distance of STARC (Skalse et al. 2024) with
its value canonicalisation, for the expert's policy.

An advantage is a difference of returns over the very same replays: an action that the expert would not take,
and the expert from there on, against the expert all along. Where the model is known it is computed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from envs import EnvSpec
from envs.models import Tabular
from harness.judge.statistics import rank_correlation
from harness.judge.stretches import Stretches
from harness.learn.exact import expected_rewards
from harness.learn.simulator import Simulator, Trajectory
from methods.base import Array, Policy, Reward
from methods.network import standardiser
from methods.tabular.model import action_values, greedy, policy_value, value_iteration

LEAST_WEIGHT = 0.01
"""A replay ends where the discount has fallen to this."""
SAME = 1e-9
"""Advantages below this share of the largest reward are rounding."""


class Comparison(NamedTuple):
    """distance: 0 where the advantages are the same but for scale, 1 where they are opposite, NaN where one
    is 0 everywhere. rank: Spearman's correlation of the two. floor: the distance of the reward from a shaped
    copy of itself, which would be 0 if replays never ended. epic: as of `epic_distance`, where the model is
    known."""

    distance: float
    rank: float
    floor: float = math.nan
    epic: float = math.nan


@dataclass(frozen=True)
class Replays(Stretches):
    """Pairs of replays from the same moments: N in which another action is taken first, then N in which not.

    advantage: (N,), of the true reward. gamma: (), the discount.
    """

    advantage: Array
    gamma: Array

    def advantage_of(self, reward: Reward) -> Array:
        """(N,): of the reward, with nothing to be had once an episode has terminated."""
        left, kept = np.split(self.returns(reward, float(self.gamma)), 2)
        return np.asarray(left - kept)

    def shaped(self, advantage: Array) -> Array:
        """(N,): the advantage of the same reward shaped by a potential of observations, as large as the
        largest advantage is: the same but for what discounting leaves where replays end."""
        mean, std = standardiser(self.last)
        direction = np.random.default_rng(0).normal(size=len(mean)) / np.sqrt(len(mean))
        potential = np.abs(advantage).max() * np.tanh((self.last - mean) / std @ direction)
        left, kept = np.split(self.gamma**self.lengths * np.where(self.terminated, 0, potential), 2)
        return np.asarray(advantage + left - kept)


def replay(spec: EnvSpec, expert: Policy, seeds: Sequence[int], rng: np.random.Generator) -> Replays:
    """One pair for each seed, from states of the expert's episodes and of a random policy's in turn, at a
    moment of the first half of each; the other action is uniform. Exact where an episode depends on its seed
    and its actions alone."""
    simulator = Simulator(spec)
    most = math.ceil(math.log(LEAST_WEIGHT) / math.log(spec.gamma))

    def random(obs: Array) -> Array:
        return spec.random_actions(len(obs), rng)

    count = len(seeds)
    visited: list[Trajectory | None] = [None] * count
    for policy, first in ((expert, 0), (random, 1)):
        for place, episode in zip(
            range(first, count, 2), simulator.run(policy, seeds[first::2]), strict=True
        ):
            visited[place] = episode
    until = [e.act[: rng.integers((len(e.act) + 1) // 2)] for e in visited if e is not None]
    others = spec.random_actions(count, rng)
    kept = simulator.run(expert, seeds, until, most)
    left = simulator.run(
        expert, seeds, [np.vstack([a, other]) for a, other in zip(until, others, strict=True)], most - 1
    )
    starts = [len(a) for a in until]

    def value(episode: Trajectory, start: int) -> float:
        rewards = episode.rewards[start:]
        return float(rewards @ spec.gamma ** np.arange(len(rewards)))

    episodes, starts = [*left, *kept], [*starts, *starts]
    values = np.array([value(episode, start) for episode, start in zip(episodes, starts, strict=True)])
    stretches = Stretches.of(episodes, starts)
    return Replays(**vars(stretches), advantage=values[:count] - values[count:], gamma=np.array(spec.gamma))


def sampled_comparison(reward: Reward | None, replays: Replays) -> Comparison:
    """Of a reward, None being the true one, over the replays."""
    own = replays.advantage if reward is None else replays.advantage_of(reward)
    floor = compare(replays.shaped(own), own).distance
    return compare(own, replays.advantage)._replace(floor=floor)


def known_comparison(reward: Reward | None, tabular: Tabular, gamma: float) -> Comparison:
    """The same over all states and actions where the model is known; the expert there is optimal."""
    true = np.broadcast_to(tabular.reward[:, None], tabular.P.shape[:2])
    paid = true if reward is None else expected_rewards(tabular, reward)
    expert = greedy(value_iteration(tabular.P, tabular.reward, gamma)[1])
    own, known = (policy_advantage(tabular.P, r, expert, gamma) for r in (paid, true))
    return compare(own, known)._replace(floor=0.0, epic=epic_distance(paid, true, gamma))


def policy_advantage(P: Array, r: Array, policy: Array, gamma: float) -> Array:
    """(S, A): of each action under rewards r (S, A), over the policy (S, A), to within rounding."""
    v = policy_value(P, r, policy, gamma)
    advantage = action_values(P, r, v, gamma) - v[:, None]
    return np.where(np.abs(advantage) > SAME * np.abs(r).max() / (1 - gamma), advantage, 0.0)


def epic_distance(own: Array, true: Array, gamma: float) -> float:
    """EPIC (Gleave et al. 2021) of rewards (S, A), all states, actions and next states being as likely: 0 for
    equals but for scale, shift and shaping, 1 for opposites, NaN where one is constant. It tells a reward
    from its own advantage, and asks for the true reward of steps that no dynamics take."""

    def canonical(r: Array) -> Array:
        mean = r.mean(axis=1)
        return np.asarray((r - mean[:, None])[:, :, None] + gamma * mean).ravel()

    a, b = canonical(own), canonical(true)
    if np.ptp(a) <= SAME * np.abs(own).max() or np.ptp(b) <= SAME * np.abs(true).max():
        return math.nan
    return math.sqrt(max(0.0, (1 - float(np.corrcoef(a, b)[0, 1])) / 2))


def compare(own: Array, true: Array) -> Comparison:
    """Distance and rank of two advantages of the same states and actions."""
    a, b = own.ravel(), true.ravel()
    size = np.linalg.norm(a) * np.linalg.norm(b)
    if size == 0:
        return Comparison(math.nan, math.nan)
    a, b = a / np.abs(a).max(), b / np.abs(b).max()
    cosine = float(a @ b / (np.linalg.norm(a) * np.linalg.norm(b)))
    distance = math.sqrt(max(0.0, (1 - cosine) / 2))
    # Equally good actions must rank equally, whatever rounding made of them.
    constant = np.ptp(a) == 0 or np.ptp(b) == 0
    rank = math.nan if constant else rank_correlation(a.round(9), b.round(9))
    return Comparison(distance, rank)
