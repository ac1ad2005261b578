"""Coherent soft imitation learning (Watson, Huang & Heess 2023): behaviour cloning read as a reward.

    R*(s, a) = alpha (log q(a|s) - log p(a))

q is a cloned policy and p a prior one, alpha is 1 over the number of an action's entries. Under the
entropy that alpha weighs, and with p as what is preferred, q is the best policy of R*. Where q returns to p
far from the demonstrations, R* is 0 there, and higher in demonstrated states. Soft actor-critic goes on from
a clone.

q is a Gaussian process, whose posterior is known without any descent; its width and noise have the highest
evidence.

Deviates from the paper: its q is a network with a periodic last layer, fitted with its variance by gradient;
its critic is trained on the demonstrations first, where here they are half of what it learns from all along
(if every step is shown); its reward goes on learning, by a bound on the policy's distance, which here it
does not, and is never below 0 here; soft actor-critic weighs entropy as it finds best, that over uniform
actions and not over p, so what is played is not the game of which q is the solution. Where the model is
known, q counts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import cdist

from envs.spec import Model
from methods.base import Array, Episodes, Learned, Unsuitable, World, seen_by_both
from methods.bc import BehaviourCloning
from methods.network import ROWS, standardiser
from methods.tabular import TabularReward
from methods.visits import demonstrated

UNIFORM = 3**-0.5
"""Standard deviation of uniform actions; p is normal with it."""
WIDTHS = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Of the kernel, in standard deviations of the observations, times the root of their number: those that are
tried."""
NOISES = (0.3, 0.1, 0.03, 0.01)
"""Standard deviations of q's actions where there are demonstrations: those that are tried."""
JITTER = 1e-6
"""Added to the kernel of a place with itself, for places may be alike."""


@dataclass(frozen=True)
class CSIL(BehaviourCloning):
    """Its hyper-parameters, besides those of the clone that reinforcement learning goes on from."""

    places: int = 256
    """Demonstrated observations at which q is told."""
    least_noise: float = 0.03
    """Standard deviation of q's actions at least."""
    floor: float = 0.0
    """Of R*. At 0 no step pays less than an end, or than a step where q is p; in the paper one can."""
    kept: int = 20_000
    """Demonstrated pairs that q is fitted to at most."""
    rl_steps: int = 40_000
    """Environment steps under R*, from which pi* is the best checkpoint."""
    rollouts: int = 10
    """Episodes of random actions, with which observations are standardised."""

    def fit(self, demos: Episodes, world: World, rng: np.random.Generator) -> Learned:
        """Fit q, and learn under its reward. Raises Unsuitable where actions are choices and the model is not
        known."""
        if world.model is not None:
            known = known_reward(demonstrated(demos, world.model).sum(axis=0) * len(demos), world.model)
            return Learned(world.solve(known, rng, self.rl_steps), known)
        if world.discrete:
            raise Unsuitable("CSIL's cloned policy is of continuous actions")
        random = world.rollout(lambda obs: world.random_actions(len(obs), rng), self.rollouts, rng)
        seen = seen_by_both(demos, random, rng)
        rows = rng.permutation(len(demos.pairs()[1]))[: self.kept]
        obs, act = (shown[rows] for shown in demos.pairs())
        q = GaussianProcess.fitted(obs, act, standardiser(seen), self.places, self.least_noise, rng)
        reward = CoherentReward(q, self.floor)
        clone = super().fit(demos, world, rng)
        mixed = demos if demos.whole else None
        agent = world.agent(rng, kind="soft", init=clone.policy, demonstrations=mixed)
        agent.learn(self.rl_steps, reward)
        return Learned(agent.best(reward), reward, clone.curves, {"width": q.width, "noise": q.noise})


def known_reward(counts: Array, model: Model) -> TabularReward:
    """log q - log p where each state has its own q, of a Dirichlet prior that counts as one action. counts
    (S, A): how often each was demonstrated."""
    actions = counts.shape[1]
    q = (counts + 1 / actions) / (counts.sum(axis=1, keepdims=True) + 1)
    return TabularReward(model.obs, np.log(q * actions))


@dataclass(frozen=True)
class GaussianProcess:
    """Normal actions (B, A), independent and of one variance, at observations (B, O): a Gaussian process with
    a Gaussian kernel, whose values at some places stand for it (the deterministic training conditional of
    Quinonero-Candela & Rasmussen 2005). Far from what it was fitted to its mean is 0 and its standard
    deviation, noise included, `UNIFORM`.

    places: (M, O), standardised by mean and std. weights: (M, A), of the kernel at these. known: (M, M), of
    whose product with the kernel the squares sum to the variance that demonstrations take away.
    """

    mean: Array
    std: Array
    places: Array
    weights: Array
    known: Array
    width: float
    noise: float

    @classmethod
    def fitted(
        cls,
        obs: Array,
        act: Array,
        standard: tuple[Array, Array],
        count: int,
        least: float,
        rng: np.random.Generator,
    ) -> GaussianProcess:
        """With the width and the noise, `least` at least, under which act (N, A) is most likely at obs
        (N, O), some of which, `count` or all, are its places. standard: mean and spread of observations."""
        x = (obs - standard[0]) / standard[1]
        places = x[rng.permutation(len(x))[:count]]
        most = -np.inf
        for width in WIDTHS:
            root = inverse_root(places, width)
            phi = kernel(x, places, width) @ root
            squares, axes = np.linalg.eigh(phi.T @ phi)
            squares, along = squares.clip(0), axes.T @ (phi.T @ act)
            for noise in sorted({max(noise, least) for noise in NOISES}):
                if (found := evidence(squares, along, act, noise)) > most:
                    most, prior = found, UNIFORM**2 - noise**2
                    gains = prior / (noise**2 + prior * squares)
                    weights = root @ axes @ (gains[:, None] * along)
                    known = root @ axes * np.sqrt(prior * gains * squares)
                    best = cls(*standard, places, weights, known, width, noise)
        return best

    def __call__(self, obs: Array) -> tuple[Array, Array]:
        """Mean (B, A) and variance (B, 1)."""
        near = kernel((obs - self.mean) / self.std, self.places, self.width)
        taken = np.square(near @ self.known).sum(axis=1, keepdims=True)
        return near @ self.weights, np.maximum(UNIFORM**2 - taken, self.noise**2)


def kernel(x: Array, places: Array, width: float) -> Array:
    """(B, M): exp(-|x - place|^2 / 2 w^2), w being `width` times the root of O, of (B, O) and (M, O)."""
    distances: Array = cdist(x, places, "sqeuclidean")
    values: Array = np.exp(-distances / (2 * width**2 * places.shape[1]))
    return values


def inverse_root(places: Array, width: float) -> Array:
    """(M, M): R with R R^T the inverse of the kernel between places (M, O)."""
    within = kernel(places, places, width) + JITTER * np.eye(len(places))
    root: Array = np.linalg.inv(np.linalg.cholesky(within)).T
    return root


def evidence(squares: Array, along: Array, act: Array, noise: float) -> float:
    """Logarithm of the density of act (N, A), but for a constant. squares: eigenvalues (M,) of the features'
    second moments, summed over rows; along (M, A): the features' products with act, along their axes."""
    prior = UNIFORM**2 - noise**2
    explained = float(prior / (noise**2 + prior * squares) @ np.square(along).sum(axis=1))
    distance = (float(np.square(act).sum()) - explained) / noise**2
    volume = act.size * np.log(noise**2) + act.shape[1] * float(np.log1p(prior * squares / noise**2).sum())
    return -0.5 * float(distance + volume)


@dataclass(frozen=True)
class CoherentReward:
    """(log q - log p) / A, of actions of A entries, and `floor` at least; 0 in the absorbing state, where q
    is p."""

    q: GaussianProcess
    floor: float
    absorbing: float = 0.0

    def __call__(self, obs: Array, act: Array, next_obs: Array, /) -> Array:
        if len(obs) > ROWS:
            parts = (slice(start, start + ROWS) for start in range(0, len(obs), ROWS))
            return np.concatenate([self(obs[part], act[part], next_obs[part]) for part in parts])
        mean, variance = self.q(obs)
        ratio: Array = (
            np.square(act / UNIFORM) - np.square(act - mean) / variance - np.log(variance / UNIFORM**2)
        )
        paid: Array = np.maximum(0.5 * ratio.mean(axis=1), self.floor)
        return paid
