"""Rollouts: many episodes in lockstep, so that the policy answers them in one batch."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import gymnasium as gym
import numpy as np

from envs import EnvSpec
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
    env: gym.Env
    index: int
    obs: list[Array]
    act: list[Array] = field(default_factory=list)
    rewards: list[float] = field(default_factory=list)


class Simulator:
    """Steps up to `lanes` copies of an environment side by side."""

    def __init__(self, spec: EnvSpec, lanes: int = 25) -> None:
        self.spec = spec
        self.lanes = lanes
        self._envs: list[gym.Env] = []

    def run(
        self,
        policy: Policy,
        seeds: Sequence[int],
        watch: Callable[[int, gym.Env], None] | None = None,
    ) -> list[Trajectory]:
        """One trajectory for each seed, in their order. `watch` is called after every reset and step
        with the place of the seed in `seeds` and the environment."""
        while len(self._envs) < min(self.lanes, len(seeds)):
            self._envs.append(self.spec.make())
        waiting = iter(range(len(seeds)))
        done: dict[int, Trajectory] = {}

        def enter(env: gym.Env) -> _Lane | None:
            index = next(waiting, None)
            if index is None:
                return None
            obs, _ = env.reset(seed=int(seeds[index]))
            if watch:
                watch(index, env)
            return _Lane(env, index, [np.asarray(obs, np.float64)])

        lanes = [lane for env in self._envs if (lane := enter(env))]
        while lanes:
            actions = self.spec.executed(policy(np.stack([lane.obs[-1] for lane in lanes])))
            going = []
            for lane, action in zip(lanes, actions, strict=True):
                obs, reward, terminated, truncated, _ = lane.env.step(self.spec.native(action))
                lane.obs.append(np.asarray(obs, np.float64))
                lane.act.append(action)
                lane.rewards.append(float(reward))
                if watch:
                    watch(lane.index, lane.env)
                if not (terminated or truncated):
                    going.append(lane)
                    continue
                ending = self.spec.why_ended(lane.env) if terminated else "time limit"
                done[lane.index] = Trajectory(
                    np.stack(lane.obs), np.stack(lane.act), np.array(lane.rewards), terminated, ending
                )
                if follower := enter(lane.env):
                    going.append(follower)
            lanes = going
        return [done[index] for index in range(len(seeds))]
