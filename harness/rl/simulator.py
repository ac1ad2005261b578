"""Rollouts of many episodes in lockstep, so that the policy answers them in one batch."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from envs import EnvSpec, Shape
from envs.copies import Copies
from methods.base import Array, Policy, Transitions

NO_NUMBERS = {"drawings": "It draws pictures.", "_copied": "It draws pictures."}


@dataclass
class Trajectory:
    """One episode with its true rewards: obs (T+1, O), act (T, A), rewards (T,).

    `ending`: why it ended, in the environment's words, or 'time limit'.
    """

    obs: Array
    act: Array
    rewards: Array
    terminated: bool
    ending: str

    def transitions(self) -> Transitions:
        """Return its steps."""
        into = np.zeros(len(self.act), bool)
        into[-1] = self.terminated
        return Transitions.own(self.obs[:-1], self.act, self.obs[1:], np.zeros_like(into), into)


class Simulator:
    """Copies of an environment side by side, `lanes` at most."""

    def __init__(self, spec: EnvSpec, lanes: int = 100) -> None:
        self.spec, self.lanes = spec, lanes
        self._batch = Copies(spec, lanes)

    def run(
        self, policy: Policy, seeds: Sequence[int], first: Sequence[Array] = (), most: int | None = None
    ) -> list[Trajectory]:
        """Return one trajectory for each seed, in their order.

        `first`: for each episode the actions (T, A) that it begins with, whatever the policy says.
        `most`: steps after those at which an episode is cut, before the horizon.
        Raises ValueError where the policy gives another number of actions.
        """
        return self._run(lambda obs, episodes: policy(obs), seeds, first, most)

    def run_each(self, policies: Sequence[Policy], seeds: Sequence[int]) -> Iterator[list[Trajectory]]:
        """Yield what `run` returns for each policy. As many run side by side as there are lanes for."""
        count = len(seeds)
        together = max(1, self.lanes // count)
        for start in range(0, len(policies), together):
            some = policies[start : start + together]
            episodes = self._run(partial(_each, some, count), [*seeds] * len(some))
            yield from (episodes[i : i + count] for i in range(0, len(episodes), count))

    def shown(self, played: list[Trajectory], seeds: Sequence[int]) -> list[Trajectory]:
        """Return trajectories of `spec.expert_sees` as this task shows them, by their actions and seeds.

        Raises RuntimeError where they pay something else here.
        """
        if self.spec.expert_task is None:
            return played
        acts = [one.act for one in played]
        still = np.zeros((self.lanes, self.spec.act_size))
        here = self.run(lambda obs: still[: len(obs)], seeds, acts, most=0)
        if not all(np.array_equal(a.rewards, b.rewards) for a, b in zip(here, played, strict=True)):
            raise RuntimeError(f"{self.spec.name}: episodes differ from {self.spec.expert_task.name}'s")
        return here

    def _run(
        self,
        answer: Callable[[Array, list[int]], Array],
        seeds: Sequence[int],
        first: Sequence[Array] = (),
        most: int | None = None,
    ) -> list[Trajectory]:
        """Run an episode for each seed. `answer`: gives the actions (B, A) for observations (B, O) of B
        episodes, which come with their numbers."""
        spec, lanes = self.spec, min(self.lanes, len(seeds))
        obs = np.empty((lanes, spec.horizon + 1, spec.obs_size))
        act, rewards = np.empty((lanes, spec.horizon, spec.act_size)), np.empty((lanes, spec.horizon))
        length = np.zeros(lanes, np.int64)
        begun = np.array([*map(len, first)] or [0] * len(seeds))
        last = np.minimum(spec.horizon, begun + (spec.horizon if most is None else most))
        waiting = iter(range(len(seeds)))
        playing: dict[int, int] = {}
        done: dict[int, Trajectory] = {}

        def enter(place: int) -> None:
            if (episode := next(waiting, None)) is not None:
                playing[place] = episode
                obs[place, 0], length[place] = self._batch.reset(place, int(seeds[episode])), 0

        def leave(place: int, terminated: bool) -> None:
            end, ending = length[place], self._batch.why_ended(place) if terminated else "time limit"
            parts = obs[place, : end + 1], act[place, :end], rewards[place, :end]
            own, acted, paid = (part.copy() for part in parts)
            done[playing.pop(place)] = Trajectory(own, acted, paid, terminated, ending)

        for place in range(lanes):
            enter(place)
        while playing:
            places = np.array(sorted(playing))
            now = length[places]
            episodes = [playing[place] for place in places.tolist()]
            chosen = spec.executed(answer(obs[places, now], episodes))
            if len(chosen) != len(places):
                raise ValueError(f"a policy gave {len(chosen)} actions for {len(places)} observations")
            act[places, now] = chosen
            for i in np.flatnonzero(now < begun[episodes]):
                act[places[i], now[i]] = first[episodes[i]][now[i]]
            stepped = self._batch.step(places.tolist(), act[places, now])
            obs[places, now + 1], rewards[places, now], terminated, truncated = stepped
            length[places] += 1
            for i in np.flatnonzero(terminated | truncated | (now + 1 == last[episodes])):
                leave(int(places[i]), bool(terminated[i]))
                enter(int(places[i]))
        return [done[episode] for episode in range(len(seeds))]


def _each(policies: Sequence[Policy], count: int, obs: Array, episodes: list[int]) -> Array:
    """Return what each policy does in its own episodes, `count` of each."""
    owners = np.array(episodes) // count
    return np.concatenate([policies[owner](obs[owners == owner]) for owner in np.unique(owners)])


def drawings(spec: EnvSpec, seed: int, act: Array) -> list[dict[str, Shape]]:
    """Return the scene after the reset and after each of the episode's actions (T, A)."""
    env = spec.make()
    env.reset(seed=seed)
    frames = [_copied(spec.draw(env))]
    for action in act:
        env.step(spec.native(action))
        frames.append(_copied(spec.draw(env)))
    return frames


def _copied(drawn: dict[str, Shape]) -> dict[str, Shape]:
    """Return the drawing in arrays of its own, because some tasks draw the next one into the same."""
    return {name: Shape(np.array(shape.points), shape.colour) for name, shape in drawn.items()}
