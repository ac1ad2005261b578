"""What an environment of this benchmark is: `EnvSpec`, and `Shape`, the unit of its drawings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

BUDGETS = ("smoke", "quick", "full")


@dataclass(frozen=True)
class Shape:
    """One line strip of a drawing.

    points: (P, 2) in metres, x to the right and y up; a closed outline repeats its first point.
    colour: red, green, blue, each 0 to 255.
    """

    points: Array
    colour: tuple[int, int, int]


@dataclass(frozen=True)
class EnvSpec:
    """One task: the environment itself and everything about it that a benchmark must know.

    The environment has flat float observations and actions in [-1, 1]^A, terminates as its authors
    meant it to, and truncates at `horizon`. Raises ValueError where a field contradicts another or
    the environment.
    """

    name: str
    """What `--envs` calls it."""
    summary: str
    """One line for `list`."""
    env_id: str
    """Gymnasium id; `import envs` registers it."""
    obs_size: int
    act_size: int
    obs_scale: tuple[float, ...]
    """A typical size of each observation while the task goes well; RL divides by it."""
    horizon: int
    """Steps after which an episode is truncated."""
    gamma: float
    """Discount in (0, 1) for discounted returns and for every RL solve."""
    time_step: float
    """Seconds between actions."""
    bar: Callable[[Sequence[int]], float]
    """Mean undiscounted true return that the expert must reach on the episodes of these seeds."""
    max_terminated: Mapping[str, float]
    """Largest share of the expert's episodes that may terminate early, for each of `BUDGETS`."""
    rl_steps: Mapping[str, int]
    """Environment steps of one RL solve, for each of `BUDGETS`."""
    eval_episodes: Mapping[str, int]
    """Evaluation episodes for each policy, for each of `BUDGETS`."""
    demo_episodes: Mapping[str, int]
    """Demonstration episodes drawn for each seed, for each of `BUDGETS`."""
    phi: Callable[[Array, Array], Array]
    """Features for linear rewards: (B, O) observations and (B, A) actions to (B, K), within [-1, 1]."""
    draw: Callable[[gym.Env], dict[str, Shape]]
    """The scene as it stands, in metres; the same names throughout an episode."""
    why_ended: Callable[[gym.Env], str]
    """Why the episode just terminated, in a few words, e.g. 'pole fell'."""

    def __post_init__(self) -> None:
        if not 0 < self.gamma < 1:
            raise ValueError(f"{self.name}: gamma must lie in (0, 1), not {self.gamma}")
        if len(self.obs_scale) != self.obs_size or min(self.obs_scale) <= 0:
            raise ValueError(f"{self.name}: obs_scale must hold a positive number for each observation")
        tables = (self.rl_steps, self.eval_episodes, self.demo_episodes)
        counts = [self.obs_size, self.act_size, self.horizon, *(t[b] for t in tables for b in BUDGETS)]
        if min(counts) < 1:
            raise ValueError(f"{self.name}: sizes, horizon, steps and episodes must be positive")

    def make(self) -> gym.Env:
        """A new instance, checked against the sizes above."""
        env = gym.make(self.env_id)
        obs, act = env.observation_space, env.action_space
        if obs.shape != (self.obs_size,) or act.shape != (self.act_size,):
            raise ValueError(f"{self.name}: spaces {obs}, {act} contradict the spec's sizes")
        return env
