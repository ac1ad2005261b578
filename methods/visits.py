"""What is visited, as the inputs of reward networks: rows of (observation, action, absorbing indicator),
or of (observation, absorbing indicator), the observations standardised; all zeros and 1 in the absorbing
state."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import ArrayLike

from envs.spec import Model
from methods.base import Array, Episodes, Transitions


def visitations(episodes: Episodes, stay: ArrayLike, mean: Array, std: Array, actions: bool = True) -> Array:
    """(N, O + A + 1), or (N, O + 1) without actions: every step that is shown, and `stay`, a number or one
    for each episode, steps in the absorbing state for those that terminated."""
    obs, act = episodes.pairs()
    scaled = (obs - mean) / std
    steps = np.concatenate([scaled, act], axis=1) if actions else scaled
    return with_absorbing_steps(steps, episodes, stay)


def with_absorbing_steps(steps: Array, episodes: Episodes, stay: ArrayLike) -> Array:
    """(N, K + 1): what describes each step that is shown of the episodes, (M, K), and an absorbing indicator;
    episodes that terminated add `stay` steps, all zeros and 1, or as many of them as are shown of others."""
    absorbed = int((np.broadcast_to(stay, len(episodes)) * np.array(episodes.terminated)).sum())
    left = round(absorbed * len(steps) / sum(episodes.lengths))
    visits = np.zeros((len(steps) + left, steps.shape[1] + 1))
    visits[: len(steps), :-1] = steps
    visits[len(steps) :, -1] = 1
    return visits


def visited(steps: Transitions, mean: Array, std: Array, actions: bool = True) -> Array:
    """(N, O + A + 1), or (N, O + 1) without actions: a row for each step."""
    scaled = (steps.obs - mean) / std
    columns = [scaled, steps.act] if actions else [scaled]
    living = np.where(steps.absorbing[:, None], 0.0, np.concatenate(columns, axis=1))
    return np.column_stack([living, steps.absorbing])


def demonstrated(demos: Episodes, model: Model) -> Array:
    """mu_D (T, S, A): the share of the demonstrations, all of T steps, that are shown in each state and
    choosing each action at each time. Raises ValueError where their lengths differ."""
    if demos.lengths.min() < demos.lengths.max():
        raise ValueError("in a known model, demonstrations must be equally long")
    mu = np.zeros((demos.lengths[0], *model.P.shape[:2]))
    for i, (obs, act) in enumerate(zip(demos.obs, demos.act, strict=True)):
        times = np.arange(len(act)) if demos.times is None else demos.times[i]
        mu[times, model.states(obs[: len(act)]), act.argmax(axis=1)] += 1 / len(demos)
    return mu


def sample(visits: Array, batch: int, rng: np.random.Generator) -> torch.Tensor:
    """A uniform minibatch of rows."""
    return torch.as_tensor(visits[rng.integers(len(visits), size=batch)], dtype=torch.float32)
