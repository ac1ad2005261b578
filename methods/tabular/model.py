"""Exact solutions of a Markov decision process whose model is known.

`P` (S, A, S): probability of each next state, given state and action, without terminal states. `r`: rewards
of actions, (S,) or (S, A). `policy` (S, A): probability of each action. `gamma`: discount. All functions
raise ValueError for rewards that do not fit `P` or are not finite, and for discounts and horizons out of
range.

Soft values are those of maximum causal entropy (Ziebart, Bagnell & Dey 2010): return plus the entropy of the
actions, in nats. At a temperature t the soft value is t V(r / t).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from envs.models import Model
from methods.base import Array, Episodes


@dataclass(frozen=True)
class Table:
    """A value for each state and action, `values` (S, A). States are known by the nearest of `obs` (S, O)."""

    obs: Array
    values: Array

    def at(self, obs: Array) -> Array:
        """Return the values (B, A) of the states at observations (B, O)."""
        return np.asarray(self.values[self._tree.query(obs)[1]])

    @cached_property
    def _tree(self) -> Any:
        from scipy.spatial import KDTree  # takes half a second, which other tasks do not need

        return KDTree(self.obs)


@dataclass(frozen=True)
class TabularPolicy(Table):
    """A policy; `values` are its actions."""

    def __call__(self, obs: Array, /) -> Array:
        return self.at(obs)


@dataclass(frozen=True)
class TabularReward(Table):
    """A reward without absorbing states; `values` are the rewards."""

    absorbing: float = 0.0

    def __call__(self, obs: Array, act: Array, next_obs: Array, /) -> Array:
        return np.asarray((self.at(obs) * act).sum(axis=1))


def demonstrated(demos: Episodes, model: Model) -> Array:
    """Return mu_D (T, S, A): the share of the demonstrations that show each state and choice at each time.
    Where actions are not known, it is the first choice's. Raises ValueError unless all demonstrations have T
    steps."""
    if demos.lengths.min() < demos.lengths.max():
        raise ValueError("in a known model, demonstrations must be equally long")
    mu = np.zeros((demos.lengths[0], *model.P.shape[:2]))
    for i, (obs, act) in enumerate(zip(demos.obs, demos.act, strict=True)):
        times = np.arange(len(act)) if demos.times is None else demos.times[i]
        choices = act.argmax(axis=1) if demos.has_actions else 0
        mu[times, model.states(obs[: len(act)]), choices] += 1 / len(demos)
    return mu


def action_values(P: Array, r: Array, v: Array, gamma: float) -> Array:
    """Return r + gamma E[v(s')], (S, A), of values v (S,)."""
    if r.shape not in (P.shape[:1], P.shape[:2]) or not np.isfinite(r).all():
        raise ValueError(f"rewards must be finite, of shape (S,) or (S, A) of P {P.shape}, not {r.shape}")
    return np.asarray(r.reshape(len(P), -1) + gamma * (P @ v))


def value_iteration(P: Array, r: Array, gamma: float, tol: float = 1e-9) -> tuple[Array, Array]:
    """Return V (S,) and Q (S, A) of the best policy, to within `tol` or rounding."""
    return _fixed_point(P, r, gamma, tol, lambda q: np.max(q, axis=1))


def soft_value_iteration(P: Array, r: Array, gamma: float, tol: float = 1e-9) -> tuple[Array, Array]:
    """Return soft V (S,) and Q (S, A), to within `tol` or rounding. Their policy is `soft_policy(Q)`."""
    return _fixed_point(P, r, gamma, tol, _soft_maximum)


def finite_soft_value_iteration(P: Array, r: Array, horizon: int, gamma: float = 1.0) -> tuple[Array, Array]:
    """Return soft V (T, S) and policies (T, S, A) at times 0 to T-1, for T = `horizon` actions in all."""
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
    """Return the policy (S, A) of the best actions by q (S, A). Ties go to the first."""
    return np.asarray(np.eye(q.shape[1])[q.argmax(axis=1)])


def soft_policy(q: Array) -> Array:
    """Return the policy (S, A) in proportion to exp(q), q (S, A)."""
    return np.asarray(np.exp(q - _soft_maximum(q)[:, None]))


def policy_value(P: Array, r: Array, policy: Array, gamma: float) -> Array:
    """Return the expected discounted return of a policy, without entropy, V (S,)."""
    _check_discount(gamma)
    rewards = (policy * action_values(P, r, np.zeros(len(P)), gamma)).sum(axis=1)
    return np.linalg.solve(np.eye(len(P)) - gamma * _state_chain(P, policy), rewards)


def state_visitations(P: Array, policy: Array, start: Array, horizon: int) -> Array:
    """Return the distribution over states at times 0 to T-1, (T, S). It sums to T = `horizon`.

    `policy`: (S, A), or (T, S, A) where it depends on time. `start`: (S,), or (T, S) where probability enters
    at each time.
    """
    _check_horizon(horizon)
    policies = np.broadcast_to(policy, (horizon, *P.shape[:2]))
    visits = np.zeros((horizon, len(P)))
    visits[: 1 if start.ndim == 1 else horizon] = start
    for t in range(1, horizon):
        visits[t] += (visits[t - 1, :, None] * policies[t - 1]).reshape(-1) @ P.reshape(-1, len(P))
    return visits


def discounted_visitations(P: Array, policy: Array, start: Array, gamma: float) -> Array:
    """Return expected visits (S,), with weight gamma^t at time t. They sum to 1 / (1 - gamma)."""
    _check_discount(gamma)
    visits = np.linalg.solve(np.eye(len(P)) - gamma * _state_chain(P, policy).T, start)
    return np.asarray(visits, np.float64)


def _fixed_point(
    P: Array, r: Array, gamma: float, tol: float, maximum: Callable[[Array], Array]
) -> tuple[Array, Array]:
    """Return V and Q with V = maximum(Q), iterated from 0.

    Iteration contracts by gamma. This bounds its error by gamma / (1 - gamma) times the last change, and
    bounds that change even where rounding keeps it up. P is used as a sparse matrix, which suits grids.
    """
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
    """Return log sum_a exp q(s, a), (S,)."""
    return np.asarray(np.logaddexp.reduce(q, axis=1))


def _state_chain(P: Array, policy: Array) -> Array:
    """Return the probability of each next state, given the state, (S, S)."""
    return np.asarray((policy[:, None] @ P)[:, 0])


def _check_discount(gamma: float) -> None:
    if not 0 <= gamma < 1:
        raise ValueError(f"gamma must lie in [0, 1), not {gamma}")


def _check_horizon(horizon: int) -> None:
    if horizon < 1:
        raise ValueError(f"horizon must be positive, not {horizon}")
