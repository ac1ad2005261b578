"""Expected seconds of jobs, by which they are ordered and the time that is left is estimated.

They come from earlier runs, which the cache has. Jobs that this machine did not measure take the shipped
seconds of another machine, scaled by how slow this one is. Others are guessed by the RL steps of their task.
"""

from __future__ import annotations

import functools
import json
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import msgspec

from envs import EnvSpec
from envs.dynamics import Dynamics
from envs.learners import PPO
from harness.engines.jobs import Job
from harness.process.environment import cache_folder
from harness.records import ALL_SHOWN, CONTROLS, REFERENCE, Conditions, takes_one_solve
from harness.registry import plugins
from harness.registry.known import Offer
from harness.store.files import read, write_atomic

NO_NUMBERS = "It guesses how long cells take, and orders them: a cell's numbers are the same in any order."

FILE = "seconds.json"
SHIPPED = Path(__file__).with_name(FILE)
"""The seconds of one machine, in the form of the file in the cache."""
WORK = 4.5e-3
"""Seconds of that machine for the work that `slowness` times."""
SOLVE = ", a solve"
"""The end of a job's name that stands for one RL solve. The bare name stands for the rest of the job."""
SHARED = "expert"
"""The method's name of a job that makes shared inputs."""
FIT, REST = 5.0, 1.5
"""Guessed seconds of a fit besides its RL, which counts as one solve, and of the rest of a cell."""
COMPILED, STEPPED, REPLAYED = 40_000.0, 8_000.0, 1_200.0
"""Guessed RL steps a second: PPO with compiled dynamics, PPO elsewhere, and other learners."""

Seconds = Annotated[float, msgspec.Meta(ge=1e-3, le=1e6)]


class Costs:
    """Expected seconds of jobs under one set of conditions."""

    def __init__(self, conditions: Conditions) -> None:
        self._conditions = c = conditions
        told = (c.rl, f"experts {c.experts}", *(() if c.retrain else ("without pi_R",)))
        told += (c.learner,) if c.learner != "own" else ()
        self._under = ", ".join([c.budget, *told])
        self._measured = _Known(_stored(cache_folder() / FILE).get(self._under, {}))
        self._noted: dict[str, float] = {}
        elsewhere = _stored(SHIPPED).get(self._under, {})
        slower = slowness() if elsewhere else 1.0
        self._shipped = _Known({name: seconds * slower for name, seconds in elsewhere.items()})

    def known(self, job: Job) -> bool:
        """Return whether this machine measured such a job."""
        return name_of(job) in self._measured.by_name

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
        try:
            return c.solves or plugins.task(cell.env).solves[c.budget]
        except Exception:  # an environment that fails is reported by its own cells
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

    def _parts(self, job: Job) -> tuple[float, ...]:
        """Return the seconds besides RL and of one RL solve, or a guess."""
        env, c = job.cells[0].env, self._conditions
        known, name = (self._measured, self._shipped), name_of(job)
        exact = [one.of(name) for one in known if name in one.by_name]
        alike = [one.usual[env] for one in known if env in one.usual and not job.shared]
        if measured := exact + alike:
            return measured[0]
        try:
            task = plugins.task(env)
            steps = (task.rl_steps if c.learner == "own" else task.ddpg_steps)[c.budget]
        except Exception:  # as in `solves`
            return FIT, 0.0
        took = steps / (_rate(task) if c.learner == "own" else REPLAYED)
        if job.shared:
            return REST + 0.1 * took, 0.0
        cell = job.cells[0]
        if cell.method == REFERENCE:
            return REST, 0.0
        return (REST if cell.method in CONTROLS else REST + FIT + took), took


class _Known:
    """Measured seconds of jobs by name. usual: their medians by environment."""

    def __init__(self, by_name: Mapping[str, float]) -> None:
        self.by_name = by_name
        by_env: dict[str, list[tuple[float, float]]] = {}
        for name in by_name:
            env, _, rest = name.partition(" ")
            if rest not in ("", SHARED) and not name.endswith(SOLVE):
                by_env.setdefault(env, []).append(self.of(name))
        self.usual = {env: tuple(map(_median, zip(*pairs, strict=True))) for env, pairs in by_env.items()}

    def of(self, name: str) -> tuple[float, float]:
        """Return the seconds of a job besides RL on a reward, and of one solve of that."""
        return self.by_name[name], self.by_name.get(name + SOLVE, 0.0)


@functools.cache
def slowness() -> float:
    """Return the time of a little work, in units of the shipped machine's."""
    seconds = []
    for _ in range(5):
        started = time.perf_counter()
        sum(number * number for number in range(100_000))
        seconds.append(time.perf_counter() - started)
    return min(seconds) / WORK


def _rate(task: Offer | EnvSpec) -> float:
    """Return a guess of the RL steps a second in a task."""
    if not isinstance(task, EnvSpec) or not isinstance(task.rl, PPO):
        return REPLAYED
    return COMPILED if isinstance(task.kwargs.get("physics"), Dynamics) else STEPPED


def name_of(job: Job) -> str:
    """Return the name under which jobs are measured: task, method and demonstrations, without the seed."""
    cell = job.cells[0]
    shown = f" {cell.shown}" if cell.shown != ALL_SHOWN else ""
    return f"{cell.env} {SHARED}" if job.shared else f"{cell.task} {cell.method}{shown}"


def _median(values: Sequence[float]) -> float:
    return sorted(values)[len(values) // 2]


def _stored(file: Path) -> dict[str, dict[str, float]]:
    """Return seconds by conditions and job, nothing where the file cannot be used."""
    with suppress(OSError, ValueError):
        return msgspec.json.decode(read(file), type=dict[str, dict[str, Seconds]])
    return {}
