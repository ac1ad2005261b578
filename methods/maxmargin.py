"""Apprenticeship learning by maximum margin (Abbeel & Ng 2004).

    t(i) = max over |w| <= 1 of min over j < i of w^T (mu_E - mu(j))     (thesis, eq. 3.2)

or, as `maxmargin_projection`, w from the paper's simpler projection method (its section 3.1).

The reward is w^T phi. mu(j) are discounted feature expectations of the policies found so far, mu_E those
of the demonstrations. Features are the environment's, random Fourier features beside them where the model
is not known, and one for the absorbing state, where all others are 0; every episode is counted up to the
horizon, so what absorption pays is learned as well.

Deviates from the paper: where the model is not known, "solve the MDP" is reinforcement learning that goes on
a little under each new w, and feature expectations come from a few rollouts, so a later policy may be further
from the expert. The paper ends with a mixture of all policies found, or one chosen by hand, where here R* has
the mean of the w, each counting by its margin, and the agent learns under that last; pi* is the
policy, of all found, that the margin problem, given it alone, separates least from the expert: the one with
the smallest |mu_E - mu(j)|.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cvxpy as cp
import numpy as np

from envs.spec import Model
from methods.base import Array, Episodes, Learned, Policy, World, seen_by_both
from methods.fourier import FourierFeatures
from methods.rewards import LinearReward
from methods.tabular import state_visitations

TINY = 1e-9
"""A margin at least, of w that separate nothing."""
Phi = Callable[[Array, Array], Array]


@dataclass(frozen=True)
class MaxMargin:
    """Its hyper-parameters."""

    iterations: int = 20
    """At most as many times the learner goes on under new weights."""
    rl_share: float = 0.05
    """Environment steps of each, of those of a solve from scratch."""
    averaged: int = 20
    """Latest iterations, by default all, of whose weights R* has the mean, each counting by its margin."""
    final_share: float = 0.5
    """Environment steps under R*, of those of a solve from scratch."""
    epsilon: float = 0.01
    """Stops where the margin t is at most this. Feature expectations are scaled to sums of 1."""
    rollouts: int = 10
    """Episodes that estimate a policy's feature expectations."""
    waves: int = 200
    """Random Fourier features beside the environment's, where the model is not known."""
    width: float = 0.5
    """Of their kernel: times the root of how many inputs it has, in standard deviations of these."""
    projection: bool = False
    """Whether weights come from the projection method instead of the margin problem."""

    def fit(self, demos: Episodes, world: World, rng: np.random.Generator) -> Learned:
        """Alternate the margin problem and reinforcement learning on its reward."""
        random: Policy = lambda obs: world.random_actions(len(obs), rng)  # noqa: E731
        phi: Phi = world.phi
        if world.model is None and self.waves:
            both = seen_by_both(demos, world.rollout(random, self.rollouts, rng), rng)
            width = self.width * np.sqrt(world.obs_size + world.act_size)
            phi = FourierFeatures.drawn(phi, both, world.act_size, self.waves, width, rng)
        expert = feature_expectations(demos, world, phi)
        found = [self._expectations(random, world, phi, rng)]
        separate = projection if self.projection else max_margin
        w, margin = separate(expert, found)
        margins, policies, weights = [margin], list[Policy](), list[Array]()
        agent = world.agent(rng)
        for _ in range(self.iterations):
            agent.learn(math.ceil(self.rl_share * world.solve_steps), LinearReward(phi, w))
            policies.append(agent.policy)
            weights.append(w)
            found.append(self._expectations(policies[-1], world, phi, rng))
            w, margin = separate(expert, found)
            margins.append(margin)
            if margin <= self.epsilon:
                break
        latest = slice(-self.averaged, None)
        separated = np.maximum(margins[: len(weights)][latest], TINY)
        reward = LinearReward(phi, np.average(weights[latest], axis=0, weights=separated))
        agent.learn(math.ceil(self.final_share * world.solve_steps), reward)
        policies.append(agent.best(reward))
        found.append(self._expectations(policies[-1], world, phi, rng))
        distances = [float(np.linalg.norm(expert - mu)) for mu in found[1:]]
        best = int(np.argmin(distances))
        return Learned(policies[best], reward, {"margin": margins, "distance": distances})

    def _expectations(self, policy: Policy, world: World, phi: Phi, rng: np.random.Generator) -> Array:
        """mu of a policy: exact where the model is known, else from rollouts."""
        if world.model is None:
            return feature_expectations(world.rollout(policy, self.rollouts, rng), world, phi)
        return exact_feature_expectations(policy, world, world.model)


def max_margin(expert: Array, found: list[Array]) -> tuple[Array, float]:
    """Eq. 3.2: the weights (K,), |w| <= 1, that separate the expert's feature expectations (K,) from all
    those found with the largest margin, and that margin. Raises ArithmeticError where it is not solved."""
    w, t = cp.Variable(len(expert)), cp.Variable()
    length = cp.norm(w, 2)  # type: ignore[attr-defined]
    constraints: list[Any] = [length <= 1, np.stack([expert - mu for mu in found]) @ w >= t]
    problem = cp.Problem(cp.Maximize(t), constraints)
    problem.solve(solver=cp.CLARABEL)  # type: ignore[no-untyped-call]
    if w.value is None or problem.status != cp.OPTIMAL:
        raise ArithmeticError(f"the margin problem ended as {problem.status}")
    return np.asarray(w.value), float(problem.value)


def projection(expert: Array, found: list[Array]) -> tuple[Array, float]:
    """Section 3.1: weights (K,), |w| <= 1, and margin, from the expert's distance to a point that comes
    nearer to it with each policy found: its projection on the segment from there to that policy's mu.

    Deviates from the paper, which projects on the whole line: where a policy is not optimal for its reward,
    the point would leave the hull of what was found.
    """
    point = found[0]
    for mu in found[1:]:
        step = mu - point
        length = step @ step
        if length > 0:
            point = point + np.clip(step @ (expert - point) / length, 0, 1) * step
    margin = float(np.linalg.norm(expert - point))
    return (expert - point) / (margin or 1.0), margin


def discounts(world: World) -> Array:
    """(T,): what a step is worth, up to the horizon; they sum to 1."""
    weights: Array = np.power(world.gamma, np.arange(world.horizon, dtype=np.float64))
    weights /= weights.sum()
    return weights


def feature_expectations(episodes: Episodes, world: World, phi: Phi) -> Array:
    """(K + 1,): the mean over episodes of the discounted sum of features up to the horizon, the last being
    the absorbing indicator, scaled such that the discounts sum to 1."""
    weights = discounts(world)
    each = []
    for i, (obs, act, steps) in enumerate(zip(episodes.obs, episodes.act, episodes.steps, strict=True)):
        alive = weights[:steps]
        if episodes.times is not None:  # those that are shown stand for all
            shown = weights[episodes.times[i]]
            alive = shown * (alive.sum() / shown.sum())
        mean = alive @ phi(obs[: len(act)], act)
        absorbed = weights[steps:].sum() if episodes.terminated[i] else 0.0
        each.append(np.append(mean, absorbed))
    return np.asarray(np.mean(each, axis=0))


def exact_feature_expectations(policy: Policy, world: World, model: Model) -> Array:
    """(K + 1,): what `feature_expectations` would be over infinitely many rollouts."""
    act = policy(model.obs)
    choices = np.eye(world.act_size)[act.argmax(axis=1)]
    visits = discounts(world) @ state_visitations(model.P, choices, model.start, world.horizon)
    return np.append(visits @ world.phi(model.obs, choices), 0.0)
