"""Copies of a MuJoCo task of Gymnasium that step together: one compiled model, and all else for each."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
from gymnasium.envs.mujoco import MujocoEnv
from numpy.typing import NDArray

from envs.copies import gathered
from envs.spec import Array, real, scaled


class MujocoBatch:
    """Tasks of one id in lockstep (`envs.spec.Batch`), actions scaled from [-1, 1]. kwargs: what the
    environment is made with. Its own code steps it; what is saved is its wrappers, and compiling again."""

    def __init__(self, env_id: str, why_ended: Callable[[gym.Env], str], count: int, **kwargs: Any) -> None:
        self._scaled = scaled(gym.make(env_id, **kwargs))
        self._envs = [twin(self._scaled.unwrapped) for _ in range(count)]
        self._why_ended = why_ended

    def reset(self, place: int, seed: int) -> Array:
        return np.array(real(self._envs[place].reset(seed=seed)[0]), np.float64)

    def step(
        self, places: Sequence[int], act: Array
    ) -> tuple[Array, Array, NDArray[np.bool_], NDArray[np.bool_]]:
        native = self._scaled.action(act.astype(np.float32))
        return gathered(self._envs[place].step(action) for place, action in zip(places, native, strict=True))

    def why_ended(self, place: int) -> str:
        return self._why_ended(self._envs[place])


def twin(env: gym.Env) -> MujocoEnv:
    """A copy with data and attributes of its own, but the same model and renderer."""
    assert isinstance(env, MujocoEnv)
    # Gymnasium's own way to copy one makes it anew, model and all.
    made = object.__new__(type(env))
    kept = (env, made), (env.model, env.model), (env.mujoco_renderer, env.mujoco_renderer)
    known = {id(old): new for old, new in (*kept, (env.data, mujoco.MjData(env.model)))}
    vars(made).update(copy.deepcopy(vars(env), known))
    return made
