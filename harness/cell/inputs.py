"""The first stage of a cell: everything that it starts from."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from envs import EnvSpec
from harness.cell.experts import task_for
from harness.cell.phases import Phase
from harness.cell.shared import Shared
from harness.records import NOMINAL, Cell, Conditions, takes_one_solve
from harness.registry import ASKING
from harness.rl.seeds import evaluation_seeds, rng_for
from harness.rl.world import TaskWorld

Seconds = Mapping[str, float]
"""Wall time by stage."""


@dataclass
class Stopwatch:
    """The wall time of a block of code, in seconds, known once the block has ended."""

    seconds: float = 0.0


@dataclass(frozen=True)
class Inputs:
    """A cell, its conditions, and the expert, demonstrations and replays that it shares with others.

    `report`: a callable that receives the name of the stage that begins, and how far it is.
    """

    cell: Cell
    conditions: Conditions
    shared: Shared
    report: Callable[[Phase], None] = lambda phase: None

    @contextmanager
    def stage(self, name: str, returns: Mapping[str, float] | None = None) -> Iterator[Stopwatch]:
        """Report that a stage begins, and measure its wall time."""
        self.report(Phase(name, returns=returns or {}))
        stopwatch, began = Stopwatch(), time.perf_counter()
        try:
            yield stopwatch
        finally:
            stopwatch.seconds = time.perf_counter() - began

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
        """Return the random numbers of this cell for one purpose."""
        return rng_for(self.cell.seed, self.cell.env, self.cell.method, purpose)

    def world(self) -> TaskWorld:
        """Return a new world for a method, in which the expert answers only methods that ask it."""
        expert = self.shared.expert.policy if self.cell.method in ASKING else None
        return TaskWorld(
            *(self.spec, self.conditions.protocol, self.conditions.rl, expert),
            told=lambda steps: self.report(Phase("fit", steps)),
            solve_steps=self.rl_steps,
            budget=self.conditions.budget,
        )


def added(*stages: Seconds) -> dict[str, float]:
    """Return the wall time of each stage, summed over these measurements."""
    names = dict.fromkeys(name for stage in stages for name in stage)
    return {name: sum(stage.get(name, 0.0) for stage in stages) for name in names}
