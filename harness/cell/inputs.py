"""The first stage of a cell: everything that it starts from."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from envs import EnvSpec
from harness.cell.phases import Phase
from harness.cell.shared import Shared
from harness.cell.sharing import takes_one_solve
from harness.records import NOMINAL, REFERENCE, Cell, Conditions
from harness.registry import ASKING, base
from harness.registry.tasks import task_for
from harness.rl.seeds import evaluation_seeds, rng_for
from harness.rl.world import TaskWorld
from methods.base import Policy


@dataclass(frozen=True)
class Inputs:
    """A cell, its conditions, and the expert, demonstrations and replays that it shares with others.

    `report`: a callable that receives the name of the stage that begins, and how far it is.
    `seconds`: the wall time of each stage so far.
    """

    cell: Cell
    conditions: Conditions
    shared: Shared
    report: Callable[[Phase], None] = lambda phase: None
    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str, returns: Mapping[str, float] | None = None) -> Iterator[None]:
        """Report that a stage begins, and measure its wall time."""
        self.report(Phase(name, returns=returns or {}))
        began = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - began

    @cached_property
    def spec(self) -> EnvSpec:
        """The task in which the method learns."""
        return task_for(self.cell.env, self.conditions)

    @cached_property
    def place(self) -> EnvSpec:
        """The task in which policies are scored: the same one, or a variant with other dynamics."""
        return self.spec if self.cell.dynamics == NOMINAL else self.spec.variant(self.cell.dynamics)

    @property
    def is_transfer(self) -> bool:
        """True where policies are scored in other dynamics than they were learned in."""
        return self.place is not self.spec

    @property
    def seeds(self) -> range:
        """The seeds of the evaluation episodes."""
        return evaluation_seeds(self.cell.seed, self.spec.eval_episodes[self.conditions.budget])

    @property
    def rl_steps(self) -> int:
        """The environment steps of one RL solve."""
        return self.spec.rl_steps[self.conditions.budget]

    @property
    def solves(self) -> int:
        """The number of RL solves of the reward."""
        asked = self.conditions.solves or self.spec.solves[self.conditions.budget]
        return 1 if takes_one_solve(self.cell) else asked

    def rng(self, purpose: str) -> np.random.Generator:
        """Return the random numbers of this cell for one purpose, the same for all settings of its method."""
        return rng_for(self.cell.seed, self.cell.env, base(self.cell.method), purpose)

    def random_policy(self) -> Policy:
        """Return the random policy of the environment and seed, whose actions are the same in every cell."""
        rng, place = rng_for(self.cell.seed, self.cell.env, REFERENCE, "random policy"), self.place
        return lambda obs: place.random_actions(len(obs), rng)

    def world(self) -> TaskWorld:
        """Return a new world for a method, in which the expert answers only methods that ask it."""
        expert = self.shared.expert.policy if base(self.cell.method) in ASKING else None
        return TaskWorld(
            *(self.spec, self.conditions.protocol, self.conditions.rl, expert),
            told=lambda steps, values: self.report(Phase("fit", steps, values=values)),
            solve_steps=self.rl_steps,
            budget=self.conditions.budget,
        )
