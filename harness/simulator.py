"""Rollouts: many episodes in lockstep, so that the policy answers them in one batch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from envs import EnvSpec, Shape
from envs.spec import Batch
from methods.base import Array, Policy


@dataclass
class Trajectory:
    """One episode with its true rewards: obs (T+1, O), act (T, A), rewards (T,)."""

    obs: Array
    act: Array
    rewards: Array
    terminated: bool
    ending: str
    """Why it ended: the environment's words, or 'time limit'."""


@dataclass
class _Lane:
    place: int
    index: int
    obs: list[Array]
    act: list[Array] = field(default_factory=list)
    rewards: list[float] = field(default_factory=list)


class Simulator:
    """Steps up to `lanes` copies of an environment side by side."""

    def __init__(self, spec: EnvSpec, lanes: int = 25) -> None:
        self.spec = spec
        self.lanes = lanes
        self._batch: Batch = spec.batch(lanes) if spec.batch else _Copies(spec)

    def run(self, policy: Policy, seeds: Sequence[int]) -> list[Trajectory]:
        """One trajectory for each seed, in their order."""
        waiting = iter(range(len(seeds)))
        done: dict[int, Trajectory] = {}

        def enter(place: int) -> _Lane | None:
            index = next(waiting, None)
            if index is None:
                return None
            return _Lane(place, index, [self._batch.reset(place, int(seeds[index]))])

        lanes = [lane for place in range(self.lanes) if (lane := enter(place))]
        while lanes:
            actions = self.spec.executed(policy(np.stack([lane.obs[-1] for lane in lanes])))
            observed, rewards, terminated = self._batch.step([lane.place for lane in lanes], actions)
            going = []
            for lane, action, obs, reward, ended in zip(
                lanes, actions, observed, rewards.tolist(), terminated.tolist(), strict=True
            ):
                lane.obs.append(obs)
                lane.act.append(action)
                lane.rewards.append(reward)
                if not ended and len(lane.act) < self.spec.horizon:
                    going.append(lane)
                    continue
                ending = self._batch.why_ended(lane.place) if ended else "time limit"
                done[lane.index] = Trajectory(
                    np.stack(lane.obs), np.stack(lane.act), np.array(lane.rewards), ended, ending
                )
                if follower := enter(lane.place):
                    going.append(follower)
            lanes = going
        return [done[index] for index in range(len(seeds))]


def drawings(spec: EnvSpec, seed: int, act: Array) -> list[dict[str, Shape]]:
    """The scene after the reset and after each of the episode's actions (T, A)."""
    env = spec.make()
    env.reset(seed=seed)
    frames = [spec.draw(env)]
    for action in act:
        env.step(spec.native(action))
        frames.append(spec.draw(env))
    return frames


class _Copies:
    """Environments that are stepped one by one, made when they are needed."""

    def __init__(self, spec: EnvSpec) -> None:
        self._spec = spec
        self._envs: dict[int, gym.Env] = {}

    def reset(self, place: int, seed: int) -> Array:
        if place not in self._envs:
            self._envs[place] = self._spec.make()
        return np.asarray(self._envs[place].reset(seed=seed)[0], np.float64)

    def step(self, places: Sequence[int], act: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        steps = [
            self._envs[place].step(self._spec.native(action))
            for place, action in zip(places, act, strict=True)
        ]
        obs, rewards, terminated, _, _ = zip(*steps, strict=True)
        return np.array(obs, np.float64), np.array(rewards, np.float64), np.array(terminated, bool)

    def why_ended(self, place: int) -> str:
        return self._spec.why_ended(self._envs[place])
