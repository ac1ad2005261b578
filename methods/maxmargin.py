"""Apprenticeship learning by maximum margin (Abbeel & Ng 2004).

    t(i) = max over |w| <= 1 of min over j < i of w^T (mu_E - mu(j))     (thesis, eq. 3.2)

`maxmargin_projection` has w from the paper's simpler projection method instead (its section 3.1).

The reward is w^T phi. mu(j) are discounted feature expectations of the policies so far, and mu_E those of the
demonstrations. Features are the environment's, random Fourier features where the model is not known, and one
for the absorbing state, where all others are 0. Every episode is counted up to the horizon, so the reward of
absorption is learned as well. Where the model is known, solves and feature expectations are exact.

Deviates from the paper: where the model is not known, "solve the MDP" is reinforcement learning that goes on
a little under each new w. Feature expectations come from a few rollouts, so a later policy may be further
from the expert. The paper ends with a mixture of all policies, or one chosen by hand. Here R* has the mean of
the w, each counting by its margin, and the agent learns under that last. pi* is the policy that the margin
problem separates least from the expert by itself, the one with the smallest |mu_E - mu(j)|.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

import cvxpy as cp
import numpy as np

from envs.models import Model
from methods.base import Array, Episodes, Learned, Phi, Policy, Rng, World
from methods.fourier import FourierFeatures
from methods.ranges import Between, Count, CountOrNone, Positive, Weight
from methods.rewards import LinearReward
from methods.tabular.model import state_visitations
from methods.visits import seen_by_both

TINY = 1e-9  # smallest margin that counts, for weights that separate nothing


@dataclass(frozen=True)
class MaxMargin:
    """Hyper-parameters of maximum margin."""

    iterations: Count = 20
    """Times that the learner goes on under new weights, at most."""
    rl_share: Positive = 0.05
    """Environment steps of each iteration, as a share of a solve from scratch."""
    averaged: Count = 20
    """Latest iterations, by default all, whose weights R* is the mean of. Each counts by its margin."""
    final_share: Positive = 0.5
    """Environment steps under R*, as a share of a solve from scratch."""
    epsilon: Annotated[Weight, Between(1e-3, 0.1)] = 0.01
    """Largest margin t at which the loop stops, for feature expectations with discounts that sum to 1."""
    projection: bool = False
    """True for weights of the projection method, False for those of the margin problem."""
    rollouts: Count = 10
    """Episodes that estimate a policy's feature expectations."""
    waves: Annotated[CountOrNone, Between(50, 500)] = 200
    """Random Fourier features besides the environment's, where the model is not known."""
    width: Annotated[Positive, Between(0.1, 2)] = 0.5
    """Width of their kernel in standard deviations of its inputs, times the root of the number of inputs."""

    def fit(self, demos: Episodes, world: World, rng: Rng) -> Learned:
        """Alternate weights and reinforcement learning, with feature expectations from rollouts, or exact
        ones where the model is known."""
        phi: Phi = world.phi
        if self.waves and world.model is None:
            random = world.rollout(lambda obs: world.random_actions(len(obs), rng), self.rollouts, rng)
            width = self.width * np.sqrt(world.obs_size + world.act_size)
            both = seen_by_both(demos, random, rng)
            phi = FourierFeatures.drawn(phi, both, world.act_size, self.waves, width, rng)

        def expectations(policy: Policy) -> Array:
            if world.model is not None:
                return exact_feature_expectations(policy, world, world.model)
            return feature_expectations(world.rollout(policy, self.rollouts, rng), world, phi)

        return self.alternate(feature_expectations(demos, world, phi), expectations, phi, world, rng)

    def alternate(
        self, expert: Array, expectations: Callable[[Policy], Array], phi: Phi, world: World, rng: Rng
    ) -> Learned:
        """Alternate new weights and reinforcement learning on their reward.

        `expert`: mu_E (K + 1,). `expectations`: mu of a policy, (K + 1,). `phi`: features (B, K).
        """
        learned = [expectations(lambda obs: world.random_actions(len(obs), rng))]
        separate = projection if self.projection else max_margin
        w, margin = separate(expert, learned)
        margins, policies, weights = [margin], list[Policy](), list[Array]()
        world.log({"margin": margin})
        agent = world.agent(rng)
        for _ in range(self.iterations):
            agent.learn(math.ceil(self.rl_share * world.solve_steps), LinearReward(phi, w))
            policies.append(agent.policy)
            weights.append(w)
            learned.append(expectations(policies[-1]))
            w, margin = separate(expert, learned)
            margins.append(margin)
            world.log({"margin": margin})
            if margin <= self.epsilon:
                break
        latest = slice(-self.averaged, None)
        counted = np.maximum(margins[: len(weights)][latest], TINY)
        reward = LinearReward(phi, np.average(weights[latest], axis=0, weights=counted))
        agent.learn(math.ceil(self.final_share * world.solve_steps), reward)
        policies.append(agent.best(reward))
        learned.append(expectations(policies[-1]))
        distances = [float(np.linalg.norm(expert - mu)) for mu in learned[1:]]
        best = int(np.argmin(distances))
        return Learned(policies[best], reward, {"distance": distances})


def max_margin(expert: Array, learned: list[Array]) -> tuple[Array, float]:
    """Return weights w (K,), |w| <= 1, and their margin, by eq. 3.2. They separate the expert's feature
    expectations (K,) from all learned ones by the largest margin. Raises ArithmeticError if unsolved."""
    w, t = cp.Variable(len(expert)), cp.Variable()
    length = cp.norm(w, 2)  # type: ignore[attr-defined]
    constraints: list[Any] = [length <= 1, np.stack([expert - mu for mu in learned]) @ w >= t]
    problem = cp.Problem(cp.Maximize(t), constraints)
    problem.solve(solver=cp.CLARABEL)  # type: ignore[no-untyped-call]
    if w.value is None or problem.status != cp.OPTIMAL:
        raise ArithmeticError(f"the margin problem ended as {problem.status}")
    return np.asarray(w.value), float(problem.value)


def projection(expert: Array, learned: list[Array]) -> tuple[Array, float]:
    """Return weights w (K,), |w| <= 1, and their margin, by section 3.1. The margin is the expert's distance
    to a point. Each learned mu moves the point to the expert's projection on the segment from it to that mu.

    Deviates from the paper: it projects on the whole line. A policy that is not optimal for its reward would
    then move the point out of the hull of the learned mu.
    """
    point = learned[0]
    for mu in learned[1:]:
        step = mu - point
        length = step @ step
        if length > 0:
            point = point + np.clip(step @ (expert - point) / length, 0, 1) * step
    margin = float(np.linalg.norm(expert - point))
    return (expert - point) / (margin or 1.0), margin


def discounts(world: World) -> Array:
    """Return the weight of each step up to the horizon, (T,). They sum to 1."""
    weights: Array = np.power(world.gamma, np.arange(world.horizon, dtype=np.float64))
    weights /= weights.sum()
    return weights


def feature_expectations(episodes: Episodes, world: World, phi: Phi) -> Array:
    """Return the episodes' mean discounted sum of features up to the horizon, (K + 1,). The last feature is
    the absorbing indicator, and discounts sum to 1."""
    weights = discounts(world)
    each = []
    for i, (obs, act, steps) in enumerate(zip(episodes.obs, episodes.act, episodes.lengths, strict=True)):
        alive = weights[:steps]
        if episodes.times is not None:  # the steps shown stand for all
            shown = weights[episodes.times[i]]
            alive = shown * (alive.sum() / shown.sum())
        mean = alive @ phi(obs[: len(act)], act)
        absorbed = weights[steps:].sum() if episodes.terminated[i] else 0.0
        each.append(np.append(mean, absorbed))
    return np.asarray(np.mean(each, axis=0))


def exact_feature_expectations(policy: Policy, world: World, model: Model) -> Array:
    """Return the limit of `feature_expectations` over infinitely many rollouts, (K + 1,)."""
    act = policy(model.obs)
    choices = np.eye(world.act_size)[act.argmax(axis=1)]
    visits = discounts(world) @ state_visitations(model.P, choices, model.start, world.horizon)
    return np.append(visits @ world.phi(model.obs, choices), 0.0)
