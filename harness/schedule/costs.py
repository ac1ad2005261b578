"""Expected seconds of jobs, by which they are ordered and the time that is left is estimated.

They come from earlier runs, which the cache has. Jobs that this machine did not measure take the shipped
seconds of another machine. Others are guessed by the RL steps of their task.
"""

from __future__ import annotations

import json
import statistics
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import msgspec

from envs.learners import PPO
from harness.cell.sharing import takes_one_solve
from harness.engines.jobs import Job
from harness.process.environment import cache_folder
from harness.records import ALL_SHOWN, CONTROLS, REFERENCE, Conditions
from harness.registry import base, plugins
from harness.registry.keys import expert_files
from harness.store.files import read, write_atomic

NO_NUMBERS = "It guesses how long cells take, and orders them: a cell's numbers are the same in any order."

FILE = "seconds.json"
SHIPPED = Path(__file__).with_name(FILE)
"""The seconds of one machine, in the form of the file in the cache."""
SOLVE = ", a solve"
"""The end of a job's name that stands for one RL solve. The bare name stands for the rest of the job."""
SHARED = "expert"
"""The method's name of a job that makes shared inputs."""
FIT, REST = 5.0, 1.5
"""Guessed seconds of a fit besides its RL, which counts as one solve, and of the rest of a cell."""
PPO_RATE, OTHER_RATE, IMAGE_RATE = 8_000.0, 1_200.0, 500.0
"""Guessed RL steps a second: of PPO, of other learners, and of any that sees images."""

Seconds = Annotated[float, msgspec.Meta(ge=1e-3, le=1e6)]


class Costs:
    """Expected seconds of jobs under one set of conditions."""

    def __init__(self, conditions: Conditions) -> None:
        self._conditions = c = conditions
        words = [c.budget, c.rl, f"experts {c.experts}"]
        words += ([] if c.retrain else ["without pi_R"]) + ([c.learner] if c.learner != "own" else [])
        self._under = ", ".join(words)
        stored = [_stored(file).get(self._under, {}) for file in (cache_folder() / FILE, SHIPPED)]
        self._measured, self._shipped = stored
        self._usual = [*map(_usual, stored)]
        self._noted: dict[str, float] = {}

    def known(self, job: Job) -> bool:
        """Return whether this machine measured such a job."""
        return name_of(job) in self._measured

    def of(self, job: Job) -> float:
        """Return the expected seconds of a job."""
        besides, solve = self._parts(job)
        return besides + self.solves(job) * solve

    def retraining(self, job: Job) -> float:
        """Return the expected seconds of RL on a reward in a job."""
        return self.solves(job) * self._parts(job)[1]

    def solves(self, job: Job) -> int:
        """Return the number of RL solves of a job's reward, 1 where it is unknown."""
        c, cell = self._conditions, job.cells[0]
        if job.shared or takes_one_solve(cell) or not c.retrain:
            return 1
        with suppress(Exception):  # an environment that fails is reported by its own cells
            return c.solves or plugins.task(cell.env).solves[c.budget]
        return 1

    def note(self, job: Job, seconds: float, retraining: float = 0.0) -> None:
        """Remember the seconds of a job, and how many of them RL on a reward took."""
        self._noted[name_of(job)] = max(seconds - retraining, 1e-3)
        if retraining:
            self._noted[name_of(job) + SOLVE] = max(retraining / self.solves(job), 1e-3)

    def keep(self) -> None:
        """Store the noted seconds for later runs, where the cache can be written."""
        with suppress(OSError):
            cache_folder().mkdir(parents=True, exist_ok=True)
            stored = _stored(cache_folder() / FILE)
            stored[self._under] = stored.get(self._under, {}) | self._noted
            write_atomic(cache_folder() / FILE, json.dumps(stored, indent=1, sort_keys=True) + "\n")

    def _parts(self, job: Job) -> tuple[float, float]:
        """Return the seconds besides RL and of one RL solve, or a guess."""
        cell = job.cells[0]
        plain = replace(job, cells=(replace(cell, method=base(cell.method)),))
        for name in (name_of(job), name_of(plain)):
            for by_name in (self._measured, self._shipped):
                if name in by_name:
                    return by_name[name], by_name.get(name + SOLVE, 0.0)
        for usual in self._usual:
            if cell.env in usual and not job.shared:
                return usual[cell.env]
        own = self._conditions.learner == "own"
        try:
            task = plugins.task(cell.env)
            steps = (task.rl_steps if own else task.ddpg_steps)[self._conditions.budget]
        except Exception:  # as in `solves`
            return FIT, 0.0
        rate = PPO_RATE if own and isinstance(getattr(task, "rl", None), PPO) else OTHER_RATE
        took = steps / (IMAGE_RATE if task.encoder else rate)
        if job.shared:
            experts = self._conditions.experts
            trained = experts == "trained" or (experts != "none" and not expert_files(cell.env))
            return REST + (took if trained else 0.1 * took), 0.0
        if cell.method == REFERENCE:
            return REST, 0.0
        return (REST if cell.method in CONTROLS else REST + FIT + took), took


def name_of(job: Job) -> str:
    """Return the name under which jobs are measured: task, method and demonstrations, without the seed."""
    cell = job.cells[0]
    shown = f" {cell.shown}" if cell.shown != ALL_SHOWN else ""
    return f"{cell.env} {SHARED}" if job.shared else f"{cell.task} {cell.method}{shown}"


def _usual(by_name: Mapping[str, float]) -> dict[str, tuple[float, float]]:
    """Return the median seconds of cells besides RL, and of one RL solve, by environment."""
    by_env: dict[str, list[tuple[float, float]]] = {}
    for name, seconds in by_name.items():
        env, _, rest = name.partition(" ")
        if rest not in ("", SHARED) and not name.endswith(SOLVE):
            by_env.setdefault(env, []).append((seconds, by_name.get(name + SOLVE, 0.0)))
    medians = {env: [*map(statistics.median_high, zip(*pairs, strict=True))] for env, pairs in by_env.items()}
    return {env: (besides, solve) for env, (besides, solve) in medians.items()}


def _stored(file: Path) -> dict[str, dict[str, float]]:
    """Return seconds by conditions and job, nothing where the file cannot be used."""
    with suppress(OSError, ValueError, msgspec.MsgspecError):
        return msgspec.json.decode(read(file), type=dict[str, dict[str, Seconds]])
    return {}
