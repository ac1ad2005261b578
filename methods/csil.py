"""Coherent soft imitation learning (Watson, Huang & Heess 2023): behaviour cloning read as a reward.

    R*(s, a) = alpha (log q(a|s) - log p(a))

q is a cloned policy and p a prior one. alpha is 1 over the number of an action's entries. If alpha weighs
entropy relative to p, then q is the best policy of R*. Far from the demonstrations q returns to p and R* is
0, and in demonstrated states R* is higher. Soft actor-critic goes on from a clone. q is a Gaussian process,
whose posterior is known without descent. Its width and noise have the highest evidence.

Deviates from the paper: its q is a network with a periodic last layer, fitted with its variance by gradient.
Its critic is trained on the demonstrations first, while here they are half of every batch if every step is
shown. Its reward goes on learning, by a bound on the policy's distance. Here R* is fixed, and never below 0.
The floor pays actions that q avoids, so q is then not soft-optimal for R*. In a small table the soft-optimal
policy is off by more than 0.15 in total variation (`tests/methods/test_csil_sqil_dagger.py`). With -5 instead
pi* scored less on three of three seeds of cartpole_swingup, and pi_R on two
(`results/studies/adversarial_tuning.csv`). Soft actor-critic tunes its own
entropy weight, relative to uniform actions and not to p, so q does not solve the game that is played. In
known models q is a table of counts, and its reward is solved exactly.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.spatial.distance import cdist

from envs.models import Model
from methods.base import Array, Episodes, Learned, Rng, Unsuitable, World
from methods.bc import BehaviourCloning
from methods.network import ROWS, standardiser
from methods.ranges import Between, Count, Layers, Level, Positive
from methods.tabular.model import TabularReward, demonstrated
from methods.visits import seen_by_both

UNIFORM = 3**-0.5  # standard deviation of uniform actions, and of p, which is normal
WIDTHS = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Candidate widths of the kernel, in standard deviations of observations times the root of their number."""
NOISES = (0.3, 0.1, 0.03, 0.01)  # candidate standard deviations of q's actions near demonstrations
JITTER = 1e-6  # term added to the kernel of a place with itself, because places may be alike


@dataclass(frozen=True)
class CSIL(BehaviourCloning):
    """CSIL's hyper-parameters, besides those of the clone that reinforcement learning goes on from."""

    layers: Layers = (64, 64)
    """Hidden layers of the clone, which must be those of the learner's actor."""
    places: Annotated[Count, Between(64, 512)] = 256
    """Demonstrated observations that stand for q."""
    least_noise: Annotated[Positive, Between(0.01, 0.3)] = 0.03
    """Smallest standard deviation of q's actions."""
    floor: Level = 0.0
    """Smallest R*. At 0 no step pays less than an end, or than a step where q is p. In the paper one can."""
    kept: Count = 20_000
    """Demonstrated pairs that q is fitted to, at most."""
    rl_steps: Count = 40_000
    """Environment steps under R*. pi* is the best checkpoint of these."""
    rollouts: Count = 10
    """Episodes of random actions that standardise observations."""

    def fit(self, demos: Episodes, world: World, rng: Rng) -> Learned:
        """Fit q, and learn under its reward. Raises Unsuitable for choices, unless the model is known."""
        if world.model is not None:
            counts = demonstrated(demos, world.model).sum(axis=0) * len(demos)
            known = coherent_table(counts, world.model)
            return Learned(world.solve(known, rng, self.rl_steps), known)
        if world.discrete:
            raise Unsuitable("CSIL's cloned policy is of continuous actions")
        random = world.rollout(lambda obs: world.random_actions(len(obs), rng), self.rollouts, rng)
        both = seen_by_both(demos, random, rng)
        rows = rng.permutation(len(demos.pairs()[1]))[: self.kept]
        obs, act = (pairs[rows] for pairs in demos.pairs())
        q = GaussianProcess.fitted(obs, act, standardiser(both), self.places, self.least_noise, rng)
        reward = CoherentReward(q, self.floor)
        clone = super().fit(demos, world, rng)
        mixed = demos if demos.whole else None
        agent = world.agent(rng, kind="soft", init=clone.policy, demonstrations=mixed)
        agent.learn(self.rl_steps, reward)
        return Learned(agent.best(reward), reward, clone.curves, {"width": q.width, "noise": q.noise})


@dataclass(frozen=True)
class GaussianProcess:
    """Normal actions (B, A), independent and of one variance, at observations (B, O).

    It is a Gaussian process with a Gaussian kernel. Its values at some places stand for it (the deterministic
    training conditional of Quinonero-Candela & Rasmussen 2005). Far from demonstrations its mean is 0, and
    its standard deviation, noise included, `UNIFORM`.

    `places`: (M, O), standardised by `mean` and `std`. `weights`: (M, A), of the kernel at places. `known`:
    (M, M). The squares of its product with the kernel sum to the variance that demonstrations remove.
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
        cls, obs: Array, act: Array, standard: tuple[Array, Array], count: int, least: float, rng: Rng
    ) -> GaussianProcess:
        """Return the process under which actions (N, A) at observations (N, O) are most likely.

        Its places are `count` of the observations, or all. `standard`: mean and spread of observations.
        `least`: smallest noise.
        """
        x = (obs - standard[0]) / standard[1]
        places = x[rng.permutation(len(x))[:count]]
        most = -np.inf
        for width in WIDTHS:
            within = kernel(places, places, width) + JITTER * np.eye(len(places))
            root = np.linalg.inv(np.linalg.cholesky(within)).T
            phi = kernel(x, places, width) @ root
            squares, axes = np.linalg.eigh(phi.T @ phi)
            squares, along = squares.clip(0), axes.T @ (phi.T @ act)
            for noise in sorted({max(noise, least) for noise in NOISES}):
                if (likelihood := evidence(squares, along, act, noise)) > most:
                    most, prior = likelihood, UNIFORM**2 - noise**2
                    gains = prior / (noise**2 + prior * squares)
                    weights = root @ axes @ (gains[:, None] * along)
                    known = root @ axes * np.sqrt(prior * gains * squares)
                    best = cls(*standard, places, weights, known, width, noise)
        return best

    def __call__(self, obs: Array) -> tuple[Array, Array]:
        """Return the mean (B, A) and variance (B, 1)."""
        near = kernel((obs - self.mean) / self.std, self.places, self.width)
        removed = np.square(near @ self.known).sum(axis=1, keepdims=True)
        return near @ self.weights, np.maximum(UNIFORM**2 - removed, self.noise**2)


def kernel(x: Array, places: Array, width: float) -> Array:
    """Return exp(-|x - place|^2 / 2 w^2), (B, M), for x (B, O) and places (M, O). w is `width` * sqrt(O)."""
    distances: Array = cdist(x, places, "sqeuclidean")
    return np.asarray(np.exp(-distances / (2 * width**2 * places.shape[1])))


def evidence(squares: Array, along: Array, act: Array, noise: float) -> float:
    """Return the log density of actions (N, A), up to a constant.

    `squares` (M,): eigenvalues of the features' second moments, summed over rows. `along` (M, A): the
    features' products with the actions, along their axes.
    """
    prior = UNIFORM**2 - noise**2
    explained = float(prior / (noise**2 + prior * squares) @ np.square(along).sum(axis=1))
    distance = (float(np.square(act).sum()) - explained) / noise**2
    volume = act.size * np.log(noise**2) + act.shape[1] * float(np.log1p(prior * squares / noise**2).sum())
    return -0.5 * float(distance + volume)


@dataclass(frozen=True)
class CoherentReward:
    """The reward (log q - log p) / A for A entries, at least `floor`. In the absorbing state q is p."""

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
        return np.asarray(np.maximum(0.5 * ratio.mean(axis=1), self.floor))


def coherent_table(counts: Array, model: Model) -> TabularReward:
    """Return log q - log p where the model is known. `counts` (S, A): demonstrations of each action. q is the
    mean of a Dirichlet posterior in each state, whose prior counts as one action."""
    actions = counts.shape[1]
    q = (counts + 1 / actions) / (counts.sum(axis=1, keepdims=True) + 1)
    return TabularReward(model.obs, np.log(q * actions))
