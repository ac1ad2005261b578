"""Exact solutions of a Markov decision process whose model is known.

P: (S, A, S), probability of each next state given state and action, without terminal states. r: rewards,
(S,) or (S, A), paid when the action is taken. policy: (S, A) probabilities of each action. gamma: discount.
Raise ValueError for rewards that do not fit P or are not finite, a discount or a horizon out of range.

Soft values are those of maximum causal entropy (Ziebart, Bagnell & Dey 2010): return plus the entropy of the
actions, in nats. A temperature t is the reward divided by t: t V(r / t).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from methods.base import Array

if TYPE_CHECKING:
    from scipy.spatial import KDTree


@dataclass(frozen=True)
class Table:
    """obs (S, O): how each state is known, by the nearest observation; values (S, A)."""

    obs: Array
    values: Array

    def at(self, obs: Array) -> Array:
        """(B, A): the values of the states that are observed, (B, O)."""
        return self.values[self._tree.query(obs)[1]]

    @cached_property
    def _tree(self) -> KDTree:
        from scipy.spatial import KDTree  # half a second, which other tasks do without

        return KDTree(self.obs)


@dataclass(frozen=True)
class TabularPolicy(Table):
    """values: what it does in each state."""

    def __call__(self, obs: Array, /) -> Array:
        return self.at(obs)


@dataclass(frozen=True)
class TabularReward(Table):
    """values: what each action pays in each state, of which none is absorbing."""

    absorbing: float = 0.0

    def __call__(self, obs: Array, act: Array, next_obs: Array, /) -> Array:
        paid: Array = (self.at(obs) * act).sum(axis=1)
        return paid


def action_values(P: Array, r: Array, v: Array, gamma: float) -> Array:
    """(S, A): r + gamma E[v(s')]."""
    if r.shape not in (P.shape[:1], P.shape[:2]) or not np.isfinite(r).all():
        raise ValueError(f"rewards must be finite, of shape (S,) or (S, A) of P {P.shape}, not {r.shape}")
    q: Array = r.reshape(len(P), -1) + gamma * (P @ v)
    return q


def advantage(P: Array, r: Array, v: Array, gamma: float) -> Array:
    """(S, A): r + gamma E[v(s')] - v(s), the advantage of each action over values v (S,), and equally the
    expected reward when v is the potential that shapes it (Ng, Harada & Russell 1999)."""
    return action_values(P, r, v, gamma) - v[:, None]


def value_iteration(P: Array, r: Array, gamma: float, tol: float = 1e-9) -> tuple[Array, Array]:
    """V (S,) and Q (S, A) of the best policy, to within `tol` or the rounding of floats."""
    return _fixed_point(P, r, gamma, tol, lambda q: np.max(q, axis=1))


def soft_value_iteration(P: Array, r: Array, gamma: float, tol: float = 1e-9) -> tuple[Array, Array]:
    """Soft V (S,) and Q (S, A), to within `tol` or rounding; `soft_policy(Q)` is their policy."""
    return _fixed_point(P, r, gamma, tol, _soft_maximum)


def finite_soft_value_iteration(P: Array, r: Array, horizon: int, gamma: float = 1.0) -> tuple[Array, Array]:
    """Soft V (T, S) and policies (T, S, A) at times 0 to T-1, of T = `horizon` actions and nothing after."""
    _check_horizon(horizon)
    if not 0 <= gamma <= 1:
        raise ValueError(f"gamma must lie in [0, 1], not {gamma}")
    values, policies = np.empty((horizon, len(P))), np.empty((horizon, *P.shape[:2]))
    v = np.zeros(len(P))
    for t in reversed(range(horizon)):
        q = action_values(P, r, v, gamma)
        v = values[t] = _soft_maximum(q)
        policies[t] = soft_policy(q)
    return values, policies


def greedy(q: Array) -> Array:
    """The policy (S, A) that takes the first of the best actions by q (S, A)."""
    policy: Array = np.eye(q.shape[1])[q.argmax(axis=1)]
    return policy


def soft_policy(q: Array) -> Array:
    """The policy (S, A) in proportion to exp(q), q (S, A)."""
    policy: Array = np.exp(q - _soft_maximum(q)[:, None])
    return policy


def policy_value(P: Array, r: Array, policy: Array, gamma: float) -> Array:
    """V (S,): the expected discounted return of a policy, without entropy."""
    _check_discount(gamma)
    rewards = (policy * action_values(P, r, np.zeros(len(P)), gamma)).sum(axis=1)
    return np.linalg.solve(np.eye(len(P)) - gamma * _state_chain(P, policy), rewards)


def state_visitations(P: Array, policy: Array, start: Array, horizon: int) -> Array:
    """(T, S): the distribution over states at times 0 to T-1, from `start` (S,); it sums to T = `horizon`.

    policy: (S, A), or (T, S, A) where it depends on time. start: also (T, S), what comes in at each time.
    """
    _check_horizon(horizon)
    policies = np.broadcast_to(policy, (horizon, *P.shape[:2]))
    visits = np.zeros((horizon, len(P)))
    visits[: 1 if start.ndim == 1 else horizon] = start
    for t in range(1, horizon):
        visits[t] += (visits[t - 1, :, None] * policies[t - 1]).reshape(-1) @ P.reshape(-1, len(P))
    return visits


def discounted_visitations(P: Array, policy: Array, start: Array, gamma: float) -> Array:
    """(S,): the expected visits to each state, at time t worth gamma^t; they sum to 1 / (1 - gamma)."""
    _check_discount(gamma)
    visits = np.linalg.solve(np.eye(len(P)) - gamma * _state_chain(P, policy).T, start)
    return np.asarray(visits, np.float64)


def _fixed_point(
    P: Array, r: Array, gamma: float, tol: float, maximum: Callable[[Array], Array]
) -> tuple[Array, Array]:
    """V and Q with V = maximum(Q), iterated from 0. Iteration contracts by gamma, which bounds its error by
    gamma / (1 - gamma) times the last change, and bounds that change even where rounding keeps it up.
    P is taken as sparse, which grids of any size are."""
    from scipy import sparse

    _check_discount(gamma)
    if not tol > 0:
        raise ValueError(f"tol must be positive, not {tol}")
    q = rewards = action_values(P, r, np.zeros(len(P)), gamma)
    v = maximum(q)
    model = sparse.csr_array(P.reshape(-1, len(P)))
    change = float(np.abs(v).max())
    while gamma * change > tol * (1 - gamma):
        q = rewards + gamma * (model @ v).reshape(rewards.shape)
        before, v = v, maximum(q)
        change = min(gamma * change, float(np.abs(v - before).max()))
    return v, q


def _soft_maximum(q: Array) -> Array:
    """(S,): log sum_a exp q(s, a)."""
    v: Array = np.logaddexp.reduce(q, axis=1)
    return v


def _state_chain(P: Array, policy: Array) -> Array:
    """(S, S): probability of each next state, given the state."""
    chain: Array = (policy[:, None] @ P)[:, 0]
    return chain


def _check_discount(gamma: float) -> None:
    if not 0 <= gamma < 1:
        raise ValueError(f"gamma must lie in [0, 1), not {gamma}")


def _check_horizon(horizon: int) -> None:
    if horizon < 1:
        raise ValueError(f"horizon must be positive, not {horizon}")
