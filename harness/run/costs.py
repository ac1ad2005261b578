"""What jobs are expected to take, for their order and the time that is left: what earlier runs measured, kept
in the cache; where they measured nothing, what a machine of ours took, by how much slower this one is; and
where that has nothing, a guess by the environment's RL steps."""

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
from harness.judge.results import ALL_SHOWN, CONTROLS, REFERENCE, Conditions, takes_one_solve
from harness.registry import plugins
from harness.registry.known import Offer
from harness.run.engines import Job
from harness.run.environment import cache_folder
from harness.run.files import read, write_atomic

NO_NUMBERS = "It guesses how long cells take, and orders them: a cell's numbers are the same in any order."

FILE = "seconds.json"
SHIPPED = Path(__file__).with_name(FILE)
"""What one machine took, of the form of the file in the cache."""
WORK = 4.5e-3
"""Seconds that it takes for a little work, in `slowness`."""
SOLVE = ", a solve"
"""End of a job's name where it means one RL solve of a reward; the bare name means all else of the job."""
SHARED = "expert"
"""What stands for a method's name where a job is what cells share."""
FIT, REST = 5.0, 1.5
"""Seconds of a method's fit besides its RL, which is taken to be one solve, and of all else of a cell."""
COMPILED, STEPPED, REPLAYED = 40_000.0, 8_000.0, 1_200.0
"""RL's steps a second: by PPO where dynamics are written down, by PPO elsewhere, and by other learners."""

Seconds = Annotated[float, msgspec.Meta(ge=1e-3, le=1e6)]


class Costs:
    """Seconds that jobs under these conditions take."""

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
        """Whether a job like it was measured here."""
        return name_of(job) in self._measured.by_name

    def of(self, job: Job) -> float:
        """What a job is expected to take, in seconds."""
        besides, solve = self._parts(job)
        return besides + self.solves(job) * solve

    def retraining(self, job: Job) -> float:
        """Return the seconds of it that RL on a reward takes."""
        return self.solves(job) * self._parts(job)[1]

    def solves(self, job: Job) -> int:
        """Return how often RL solves the reward of a job's cell; 1 where that is not known."""
        c, cell = self._conditions, job.cells[0]
        if job.shared or takes_one_solve(cell) or not c.retrain:
            return 1
        try:
            return c.solves or plugins.task(cell.env).solves[c.budget]
        except Exception:  # whatever is wrong with an environment, its own cells tell
            return 1

    def note(self, job: Job, seconds: float, retraining: float = 0.0) -> None:
        """Remember the seconds that it took, and how many of them RL on a reward took."""
        self._noted[name_of(job)] = max(seconds - retraining, 1e-3)
        if retraining:
            self._noted[name_of(job) + SOLVE] = max(retraining / self.solves(job), 1e-3)

    def keep(self) -> None:
        """Stores what was noted for later runs, where that can be done."""
        with suppress(OSError):
            cache_folder().mkdir(parents=True, exist_ok=True)
            stored = _stored(cache_folder() / FILE)
            stored[self._under] = stored.get(self._under, {}) | self._noted
            write_atomic(cache_folder() / FILE, json.dumps(stored, indent=1, sort_keys=True) + "\n")

    def _parts(self, job: Job) -> tuple[float, ...]:
        """Return the two numbers of `_Known.of`, or a guess where the job was not measured."""
        env, c = job.cells[0].env, self._conditions
        known, name = (self._measured, self._shipped), name_of(job)
        exact = [its.of(name) for its in known if name in its.by_name]
        alike = [its.usual[env] for its in known if env in its.usual and not job.shared]
        if found := exact + alike:
            return found[0]
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
    """Seconds that jobs took, by their name. usual: medians of `of` over an environment's cells."""

    def __init__(self, by_name: Mapping[str, float]) -> None:
        self.by_name = by_name
        by_env: dict[str, list[tuple[float, float]]] = {}
        for name in by_name:
            env, _, rest = name.partition(" ")
            if rest not in ("", SHARED) and not name.endswith(SOLVE):
                by_env.setdefault(env, []).append(self.of(name))
        self.usual = {env: tuple(map(_median, zip(*its, strict=True))) for env, its in by_env.items()}

    def of(self, name: str) -> tuple[float, float]:
        """Return the seconds of a job besides RL on a reward, and of one solve of that."""
        return self.by_name[name], self.by_name.get(name + SOLVE, 0.0)


@functools.cache
def slowness() -> float:
    """Return how many times as long as the machine of `SHIPPED` this one takes for a little work."""
    took = []
    for _ in range(5):
        started = time.perf_counter()
        sum(number * number for number in range(100_000))
        took.append(time.perf_counter() - started)
    return min(took) / WORK


def _rate(task: Offer | EnvSpec) -> float:
    """Return about how many steps RL takes in a second there."""
    if not isinstance(task, EnvSpec) or not isinstance(task.rl, PPO):
        return REPLAYED
    return COMPILED if isinstance(task.kwargs.get("physics"), Dynamics) else STEPPED


def name_of(job: Job) -> str:
    """What jobs are measured by: task, method and what is shown; not the seed."""
    cell = job.cells[0]
    shown = f" {cell.shown}" if cell.shown != ALL_SHOWN else ""
    return f"{cell.env} {SHARED}" if job.shared else f"{cell.task} {cell.method}{shown}"


def _median(values: Sequence[float]) -> float:
    return sorted(values)[len(values) // 2]


def _stored(file: Path) -> dict[str, dict[str, float]]:
    """By conditions and job; nothing where the file cannot be used."""
    with suppress(OSError, ValueError):
        return msgspec.json.decode(read(file), type=dict[str, dict[str, Seconds]])
    return {}
