"""Copies of a MuJoCo task of Gymnasium that step together and share one compiled model."""

import copy
from collections.abc import Callable, Sequence
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
from gymnasium.envs.mujoco import MujocoEnv
from gymnasium.envs.mujoco.hopper_v5 import HopperEnv
from gymnasium.envs.mujoco.walker2d_v5 import Walker2dEnv
from numpy.typing import NDArray

from envs.checks import real
from envs.copies import gathered
from envs.scaled import scaled
from envs.spec import Array, Flags

WALKERS = (HopperEnv, Walker2dEnv)
"""Tasks that are stepped without their own code, which takes up to a third of a step's time."""
STATE = mujoco.mjtState.mjSTATE_QPOS | mujoco.mjtState.mjSTATE_QVEL


class MujocoBatch:
    """Tasks of one id in lockstep (`envs.spec.Batch`), actions scaled from [-1, 1]. `kwargs`: arguments of
    the environment. Its own code steps it, unless it is one of `WALKERS`. A batch saves wrappers,
    recompilation, and the search for contacts where there are none."""

    def __init__(self, env_id: str, why_ended: Callable[[gym.Env], str], count: int, **kwargs: Any) -> None:
        self._scaled = scaled(gym.make(env_id, **kwargs))
        env = self._scaled.unwrapped
        assert isinstance(env, MujocoEnv)
        if not may_touch(env.model):
            env.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        self._envs = [twin(env) for _ in range(count)]
        self._why_ended = why_ended

    def reset(self, place: int, seed: int) -> Array:
        return np.array(real(self._envs[place].reset(seed=seed)[0]), np.float64)

    def step(self, places: Sequence[int], act: Array) -> tuple[Array, Array, Flags, Flags]:
        native, envs = self._scaled.action(act.astype(np.float32)), [self._envs[place] for place in places]
        if type(envs[0]) in WALKERS:
            return walk(envs, native)
        return gathered(env.step(action) for env, action in zip(envs, native, strict=True))

    def why_ended(self, place: int) -> str:
        return self._why_ended(self._envs[place])


def walk(envs: Sequence[Any], act: NDArray[Any]) -> tuple[Array, Array, Flags, Flags]:
    """Step walkers, and return the results of their own code, computed at once for all."""
    first, model = envs[0], envs[0].model
    states = np.empty((2, len(envs), model.nq + model.nv))
    for row, env in enumerate(envs):
        mujoco.mj_getState(model, env.data, states[0, row], STATE)
        env.data.ctrl[:] = act[row]
        mujoco.mj_step(model, env.data, first.frame_skip)
        mujoco.mj_getState(model, env.data, states[1, row], STATE)
    before, after = states
    x, z, angle = after[:, :3].T
    (low, high), (left, right) = first._healthy_z_range, first._healthy_angle_range
    healthy = (low < z) & (z < high) & (left < angle) & (angle < right)
    if isinstance(first, HopperEnv):
        least, most = first._healthy_state_range
        healthy &= ((least < after[:, 2:]) & (after[:, 2:] < most)).all(axis=1)
    forward = first._forward_reward_weight * ((x - before[:, 0]) / first.dt)
    cost = first._ctrl_cost_weight * np.square(act).sum(axis=1)
    after[:, model.nq :] = np.clip(after[:, model.nq :], -10, 10)
    obs = after[:, int(first._exclude_current_positions_from_observation) :]
    ended = ~healthy & first._terminate_when_unhealthy
    return obs, forward + healthy * first._healthy_reward - cost, ended, np.zeros_like(ended)


def may_touch(model: mujoco.MjModel) -> bool:
    """Return whether any two geoms may collide. MuJoCo looks for contacts even if none may."""
    pairs = model.geom_contype[:, None] & model.geom_conaffinity
    return bool(pairs.any() or model.npair or model.nflex)


def twin(env: MujocoEnv) -> MujocoEnv:
    """Return a copy with data and attributes of its own, but the same model and renderer."""
    # Gymnasium's own copy would compile the model again.
    result = object.__new__(type(env))
    shared = (env, result), (env.model, env.model), (env.mujoco_renderer, env.mujoco_renderer)
    known = {id(old): new for old, new in (*shared, (env.data, mujoco.MjData(env.model)))}
    vars(result).update(copy.deepcopy(vars(env), known))
    return result
