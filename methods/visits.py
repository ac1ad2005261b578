"""Visited states and actions as the inputs of reward networks.

A row is (standardised observation, action, absorbing indicator), or without the action. In the absorbing
state it is all zeros and 1.
"""

import numpy as np
import torch
from numpy.typing import ArrayLike

from methods.base import Array, Episodes, Rng, Transitions


def visitations(episodes: Episodes, stay: ArrayLike, mean: Array, std: Array, actions: bool = True) -> Array:
    """Return a row for every step shown, and `stay` absorbing rows for each episode that terminated: (N, O +
    A + 1), or (N, O + 1) without actions. `stay` is one number, or one for each episode."""
    obs, act = episodes.pairs()
    scaled = (obs - mean) / std
    steps = np.concatenate([scaled, act], axis=1) if actions else scaled
    return with_absorbing_steps(steps, episodes, stay)


def with_absorbing_steps(steps: Array, episodes: Episodes, stay: ArrayLike) -> Array:
    """Return descriptions of the steps shown, (M, K), with an absorbing indicator, (N, K + 1).

    Each episode that terminated adds `stay` absorbing rows, thinned out as much as the steps that are shown.
    """
    absorbed = int((np.broadcast_to(stay, len(episodes)) * np.array(episodes.terminated)).sum())
    added = round(absorbed * len(steps) / sum(episodes.lengths))
    visits = np.zeros((len(steps) + added, steps.shape[1] + 1))
    visits[: len(steps), :-1] = steps
    visits[len(steps) :, -1] = 1
    return visits


def visited(steps: Transitions, mean: Array, std: Array, actions: bool = True) -> Array:
    """Return a row for each step, (N, O + A + 1), or (N, O + 1) without actions."""
    scaled = (steps.obs - mean) / std
    columns = [scaled, steps.act] if actions else [scaled]
    living = np.where(steps.absorbing[:, None], 0.0, np.concatenate(columns, axis=1))
    return np.column_stack([living, steps.absorbing])


def seen_by_both(demos: Episodes, rollouts: Episodes, rng: Rng) -> Array:
    """Return the observations of N steps of rollouts and of as many demonstrated steps, (2N, O).

    Their spread standardises inputs. That of the demonstrations alone would make outliers of all other states
    where an expert hardly moves.
    """
    visited = rollouts.pairs()[0]
    return np.concatenate([rng.choice(demos.pairs()[0], len(visited)), visited])


def sample(visits: Array, batch: int, rng: Rng) -> torch.Tensor:
    """Return a uniform minibatch of rows."""
    return torch.as_tensor(visits[rng.integers(len(visits), size=batch)], dtype=torch.float32)
