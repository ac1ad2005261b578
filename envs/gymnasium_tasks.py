"""Specs of Gymnasium's environments, derived from the environments themselves."""

import warnings
from collections.abc import Mapping
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.wrappers import OrderEnforcing, PassiveEnvChecker, TimeLimit
from numpy.typing import NDArray

from envs.checks import INSTANCES, check_numbers, flags, named, real
from envs.learners import DQN
from envs.scaled import scaled, time_limit, wrappers
from envs.spec import EnvSpec

RANDOM_STEPS = 1000  # steps of random actions that estimate a typical size of observations


def from_gymnasium(env_id: str, name: str, **fields: Any) -> EnvSpec:
    """Return the spec of a Gymnasium environment, derived from the environment: sizes, horizon, whether
    actions are choices, and typical observations under random actions.

    Continuous actions are scaled to [-1, 1], and Gymnasium's own MuJoCo tasks get a batch. `fields`: fields
    of `EnvSpec` that replace derived ones. Raises ValueError unless observations are flat, actions are
    choices or bounded real numbers, values are finite, and all instances have one time limit.
    """
    kwargs = fields.get("kwargs", {})
    env, *others = (gym.make(env_id, **kwargs) for _ in range(INSTANCES))
    obs, limit = env.observation_space, time_limit(env)
    if not isinstance(obs, spaces.Box) or obs.shape is None or len(obs.shape) != 1:
        raise ValueError(f"{env_id}: observations must be a flat box, not {obs}")
    if limit is None:
        raise ValueError(f"{env_id}: it has no time limit")
    if other := [steps for steps in map(time_limit, others) if steps != limit]:
        raise ValueError(f"{env_id}: its time limit is {limit} in one instance and {other[0]} in another")
    derived = _of_actions(env, env_id, fields) | {
        "obs_size": obs.shape[0],
        "obs_scale": _typical(_random_observations(scaled(env), env_id)),
        "horizon": limit,
        "summary": f"Gymnasium's {env_id}",
    }
    return EnvSpec(name, env_id, **(derived | fields))


def _of_actions(env: gym.Env[Any, Any], env_id: str, fields: Mapping[str, Any]) -> dict[str, Any]:
    """Return fields that depend on actions. Raises ValueError unless these are choices or bounded reals."""
    act = env.action_space
    if isinstance(act, spaces.Discrete):
        return {"act_size": int(act.n), "discrete": True, "rl": DQN()}
    if isinstance(act, spaces.Box) and act.dtype.kind != "f":
        raise ValueError(f"{env_id}: actions must be choices or real numbers, not whole ones, {act}")
    if not (isinstance(act, spaces.Box) and len(act.shape) == 1 and act.is_bounded()):
        raise ValueError(f"{env_id}: actions must be choices or a bounded box, not {act}")
    derived: dict[str, Any] = {"act_size": act.shape[0], "wrap": scaled}
    usual = {TimeLimit, OrderEnforcing, PassiveEnvChecker}  # of `gym.make`
    bare = "wrap" not in fields and {type(wrapper) for wrapper in wrappers(env)} <= usual
    if bare and _is_gymnasiums_mujoco(env):
        from envs.mujoco_batch import MujocoBatch

        ending = fields.get("why_ended", EnvSpec.why_ended)
        derived["batch"] = partial(MujocoBatch, env_id, ending, **fields.get("kwargs", {}))
    return derived


def _is_gymnasiums_mujoco(env: gym.Env[Any, Any]) -> bool:
    """Return whether Gymnasium's own code alone makes and steps a MuJoCo task. Another class may change the
    model, or keep state that copies would share."""
    entry = env.spec.entry_point if env.spec else None
    module = entry if isinstance(entry, str) else entry.__module__ if isinstance(entry, type) else ""
    own = "gymnasium.envs.mujoco."
    return module.startswith(own) and type(env.unwrapped).__module__.startswith(own)


def _random_observations(env: gym.Env[Any, Any], env_id: str) -> NDArray[Any]:
    """Return observations (N, O) under random actions. Raises ValueError as `check_numbers` does."""
    env.action_space.seed(0)
    observed, length = list[NDArray[Any]](), 0

    def observe(obs: Any, *others: object) -> bool:
        """Add an observation, and return whether the episode ended."""
        with named(env_id, [length]):
            reward, *ended = flags(*others)
            observed.append(np.array(real(obs)))  # a copy: some environments reuse their array
        rows = np.array(observed[-1:], np.float64)
        check_numbers(env_id, env.observation_space.shape[0], rows, np.array([reward]), [length])  # type: ignore[index]
        return any(ended)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Gymnasium warns of values that are refused here
        observe(env.reset(seed=0)[0], 0.0, False, False)
        for _ in range(RANDOM_STEPS):
            obs, reward, terminated, truncated, _ = env.step(env.action_space.sample())
            length += 1
            if observe(obs, reward, terminated, truncated):
                length = 0
                observed.pop()
                observe(env.reset()[0], 0.0, False, False)
    return np.array(observed)


def _typical(obs: NDArray[Any]) -> tuple[float, ...]:
    """Return the root mean square of each column of (N, O): its largest size if squares overflow or
    underflow, and 1 if all are 0."""
    obs = obs.astype(np.result_type(obs, np.float32), copy=False)
    with np.errstate(over="ignore", under="ignore"):
        roots = np.sqrt(np.square(obs).mean(axis=0))
    usual = (roots > 0) & (roots < np.inf)
    return tuple(float(x) or 1.0 for x in np.where(usual, roots, np.abs(obs).max(axis=0)))
