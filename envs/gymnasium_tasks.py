"""Specs of Gymnasium's environments, derived from the environments themselves."""

import math
import warnings
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.wrappers import OrderEnforcing, PassiveEnvChecker, TimeLimit
from numpy.typing import NDArray

from envs.checks import INSTANCES, check_numbers, flags, named, real, started
from envs.encoders import channels_last
from envs.flat import entries
from envs.learners import DQN
from envs.scaled import combinations, standard, time_limit, wrappers
from envs.spec import EnvSpec, Quantity

RANDOM_STEPS = 1000  # steps of random actions that estimate a typical size of observations
SLOW_STEPS = 100  # the same in highway-env, where a step can take half a second
NO_LIMIT = "--env-kwargs max_episode_steps=200, or kwargs={'max_episode_steps': 200} of from_gymnasium"


def from_gymnasium(env_id: str, name: str, **fields: Any) -> EnvSpec:
    """Return the spec of a Gymnasium environment, derived from the environment: sizes, names, horizon,
    whether actions are choices, and typical observations under random actions.

    `fields`: fields of `EnvSpec` that replace derived ones. `wrap` is applied first, and all is derived from
    what it returns. Observations are made vectors (`envs.flat`), actions are scaled to [-1, 1] or made
    choices (`envs.scaled`), and Gymnasium's own MuJoCo tasks get a batch. Raises ValueError where that is
    impossible, and unless values are finite and all instances have one time limit.
    """
    wrap, kwargs = fields.pop("wrap", None), dict(fields.pop("kwargs", {}))
    bare = gym.make(env_id, **kwargs)
    if own_limit := _own_limit(bare):
        kwargs["max_episode_steps"] = own_limit
        bare = gym.make(env_id, **kwargs)
    instances = [bare, *(gym.make(env_id, **kwargs) for _ in range(INSTANCES - 1))]
    first, *others = map(wrap, instances) if wrap else instances
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Gymnasium warns of what is refused here or below
            started(first.reset(seed=0))
        names, env = entries(first.observation_space), standard(first)
    except ValueError as error:
        raise ValueError(f"{env_id}: {error}") from error
    if (limit := time_limit(env)) is None:
        raise ValueError(f"{env_id}: it has no time limit; give one: {NO_LIMIT}")
    if other := [steps for steps in map(time_limit, others) if steps != limit]:
        raise ValueError(f"{env_id}: its time limit is {limit} in one instance and {other[0]} in another")
    derived = _of_actions(env) | {
        "obs_size": len(names),
        "obs_names": _named([name for name, _ in names]),
        "horizon": limit,
        "summary": f"Gymnasium's {env_id}",
        "wrap": partial(standard, wrap=wrap) if wrap else standard,
        "kwargs": kwargs,
        "encoder": "small" if channels_last(first.observation_space) else "",
    }
    if "obs_scale" not in fields:
        steps = SLOW_STEPS if own_limit else RANDOM_STEPS
        typical = _typical(_random_observations(env, env_id, steps))
        derived["obs_scale"] = tuple(1.0 if flag else x for x, (_, flag) in zip(typical, names, strict=True))
    if wrap is None and not derived.get("discrete") and _is_gymnasiums_mujoco(bare):
        from envs.mujoco_batch import MujocoBatch

        derived["batch"] = partial(MujocoBatch, env_id, fields.get("why_ended", EnvSpec.why_ended), **kwargs)
    return EnvSpec(name, env_id, **(derived | fields))


def _of_actions(env: gym.Env[Any, Any]) -> dict[str, Any]:
    """Return fields that depend on actions."""
    act, native = env.action_space, env.get_wrapper_attr("env").action_space
    if not isinstance(act, spaces.Discrete):
        return {"act_size": act.shape[0]}  # type: ignore[index]
    derived = {"act_size": int(act.n), "discrete": True, "rl": DQN()}
    if not isinstance(native, spaces.Discrete):
        values = [",".join(map(str, one.ravel().tolist())) for one in combinations(native)]
        derived["act_names"] = _named([f"act {value}" for value in values])
    return derived


def _named(names: Sequence[str]) -> tuple[Quantity, ...] | None:
    """Return names of entries, None where two are the same."""
    return tuple(map(Quantity, names)) if len({*names}) == len(names) else None


def _own_limit(env: gym.Env[Any, Any]) -> int:
    """Return the steps after which a task of highway-env truncates its episodes by its own code, 0 for tasks
    with a time limit and all others."""
    config = getattr(env.unwrapped, "config", None)
    if time_limit(env) is None and isinstance(config, Mapping):
        return math.ceil((config.get("duration") or 0) * (config.get("policy_frequency") or 0))
    return 0


def _is_gymnasiums_mujoco(env: gym.Env[Any, Any]) -> bool:
    """Return whether Gymnasium's own code alone makes and steps a MuJoCo task. Another class may change the
    model, or keep state that copies would share."""
    if not {type(wrapper) for wrapper in wrappers(env)} <= {TimeLimit, OrderEnforcing, PassiveEnvChecker}:
        return False
    entry = env.spec.entry_point if env.spec else None
    module = entry if isinstance(entry, str) else entry.__module__ if isinstance(entry, type) else ""
    own = "gymnasium.envs.mujoco."
    return module.startswith(own) and type(env.unwrapped).__module__.startswith(own)


def _random_observations(env: gym.Env[Any, Any], env_id: str, steps: int) -> NDArray[Any]:
    """Return observations (N, O) of steps under random actions. Raises ValueError as `check_numbers`."""
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
        for _ in range(steps):
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
