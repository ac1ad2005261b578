"""Copies of a task that step together, with checks of all that they return."""

import dataclasses
import warnings
from collections.abc import Iterable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from envs.checks import INSTANCES, Misgiven, check_numbers, flags, named, real, started
from envs.spec import Array, Batch, EnvSpec, Flags

TRIED = 100  # steps of a trial of a task


class Copies:
    """Copies of a task in lockstep, by its batch or one by one, numbered from 0. Each is reset before it is
    stepped. `reset` and `step` raise ValueError with task, step and entry unless all values are finite."""

    def __init__(self, spec: EnvSpec, count: int) -> None:
        self._spec, self._name = spec, f"the task {spec.name}"
        self._batch: Batch = spec.batch(count) if spec.batch else _OneByOne(spec)
        self._steps = np.zeros(count, np.int64)

    def reset(self, place: int, seed: int) -> Array:
        """Return the first observation (O,) of the copy's next episode."""
        self._steps[place] = 0
        with named(self._name, [0]):
            obs = real(self._batch.reset(place, seed)).astype(np.float64)
        check_numbers(self._name, self._spec.obs_size, obs[None], np.zeros(1), [0])
        return obs

    def step(self, places: Sequence[int], act: Array) -> tuple[Array, Array, Flags, Flags]:
        """Step the copies by actions (B, A). Return observations (B, O), rewards (B,), and flags of
        termination and of truncation by the task itself, (B,) each."""
        self._steps[places] += 1
        with named(self._name, self._steps[places].tolist()):
            obs, rewards, terminated, *truncated = self._batch.step(places, act)
            obs = np.asarray(real(obs), np.float64)
            rewards = np.asarray(real(rewards, "reward"), np.float64)
            ended = real(terminated, "terminated", "b")
            cut = real(truncated[0], "truncated", "b") if truncated else np.zeros_like(ended)
        check_numbers(self._name, self._spec.obs_size, obs, rewards, self._steps[places].tolist())
        return obs, rewards, ended, cut

    def why_ended(self, place: int) -> str:
        """Return why the copy's episode just terminated."""
        return self._batch.why_ended(place)


def alone(spec: EnvSpec, count: int = 1) -> Copies:
    """Return copies that are stepped one by one."""
    return Copies(dataclasses.replace(spec, batch=None), count)


def try_out(spec: EnvSpec) -> None:
    """Step a task with random actions. Raises ValueError for bad values and for first observations that
    differ in episodes of the same seed, and the task's own errors."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Gymnasium warns of values that are refused here
        for _ in range(INSTANCES):
            spec.make()
        copies, length = Copies(spec, 1), 0
        first = copies.reset(0, 0)
        for seed, act in enumerate(spec.random_actions(TRIED, np.random.default_rng(0)), 1):
            _, _, terminated, truncated = copies.step([0], act[None])
            length += 1
            if terminated[0] or truncated[0] or length == spec.horizon:
                copies.reset(0, seed)
                length = 0
        if not np.array_equal(copies.reset(0, 0), first):
            raise ValueError(
                f"the task {spec.name} observes {first} at first, and something else after a reset with the "
                "same seed; call super().reset(seed=seed) in reset, and draw from self.np_random alone"
            )


class _OneByOne:
    """Environments that are stepped one by one, created on their first reset."""

    def __init__(self, spec: EnvSpec) -> None:
        self._spec = spec
        self._envs: dict[int, gym.Env] = {}

    def reset(self, place: int, seed: int) -> Array:
        if place not in self._envs:
            self._envs[place] = self._spec.make()
        return np.array(real(started(self._envs[place].reset(seed=seed))), np.float64)

    def step(self, places: Sequence[int], act: Array) -> tuple[Array, Array, Flags, Flags]:
        return gathered(
            self._envs[place].step(self._spec.native(action))
            for place, action in zip(places, act, strict=True)
        )

    def why_ended(self, place: int) -> str:
        return self._spec.why_ended(self._envs[place])


def gathered(steps: Iterable[Any]) -> tuple[Array, Array, Flags, Flags]:
    """Return the results of Gymnasium's `step` for each copy as those of `Copies.step`. Raises `Misgiven`."""
    observations, others = list[NDArray[Any]](), list[tuple[float, bool, bool]]()
    for row, (obs, reward, terminated, truncated, _) in enumerate(steps):
        try:
            others.append(flags(reward, terminated, truncated))
            observations.append(real(obs))
        except Misgiven as wrong:
            wrong.row = row
            raise
    rewards, ended, cut = zip(*others, strict=True)
    return np.array(observations, np.float64), np.array(rewards), np.array(ended), np.array(cut)
