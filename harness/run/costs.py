"""What jobs are expected to take, for their order and the time that is left: what earlier runs measured, kept
in the cache; where they measured nothing, a guess by the environment's RL steps."""

from __future__ import annotations

import json
from contextlib import suppress
from typing import Annotated

import msgspec

from harness.judge.results import ALL_SHOWN, Conditions
from harness.run.engines import Job
from harness.run.environment import cache_folder
from harness.run.files import read, write_atomic
from harness.run.plugins import rl_steps

NO_NUMBERS = "It guesses how long cells take, and orders them: a cell's numbers are the same in any order."

FILE = "seconds.json"
SHARED = "expert"
"""What stands for a method's name where a job is what cells share."""
BEGINNING, STEPS_PER_SECOND = 5.0, 1200.0
"""Seconds that a job takes besides RL, and RL's steps: what a first guess goes by. At full it is 30, 38, 55
and 30 s for a cell of cart-pole, pendulum, highway and the swing-up; the medians in results/reference are
26, 45, 49 and 43."""


Seconds = Annotated[float, msgspec.Meta(ge=1e-3, le=1e6)]


class Costs:
    """Seconds that jobs under these conditions take."""

    def __init__(self, conditions: Conditions) -> None:
        self._budget = conditions.budget
        c = conditions
        told = (c.rl, f"experts {c.experts}", *(() if c.retrain else ("without pi_R",)))
        self._under = ", ".join([c.budget, *told])
        self._measured: dict[str, float] = _stored().get(self._under, {})
        self._noted: dict[str, float] = {}
        by_env: dict[str, list[float]] = {}
        for name, seconds in self._measured.items():
            env, _, rest = name.partition(" ")
            if rest not in ("", SHARED):
                by_env.setdefault(env, []).append(seconds)
        self._usual = {env: sorted(known)[len(known) // 2] for env, known in by_env.items()}
        """The median of an environment's cells."""

    def known(self, job: Job) -> bool:
        """Whether a job like it was measured."""
        return name_of(job) in self._measured

    def of(self, job: Job) -> float:
        """What a job is expected to take, in seconds."""
        return self._measured.get(name_of(job)) or self._guess(job)

    def note(self, job: Job, seconds: float) -> None:
        """Remembers what it took."""
        self._noted[name_of(job)] = max(seconds, 1e-3)

    def keep(self) -> None:
        """Stores what was noted for later runs, where that can be done."""
        with suppress(OSError):
            cache_folder().mkdir(parents=True, exist_ok=True)
            stored = _stored()
            stored[self._under] = stored.get(self._under, {}) | self._noted
            write_atomic(cache_folder() / FILE, json.dumps(stored, indent=1, sort_keys=True) + "\n")

    def _guess(self, job: Job) -> float:
        env = job.cells[0].env
        if env in self._usual and not job.shared:
            return self._usual[env]
        try:
            steps = rl_steps(env)[self._budget]
        except Exception:  # whatever is wrong with an environment, its own cells tell
            return BEGINNING
        return BEGINNING + steps / STEPS_PER_SECOND * (0.1 if job.shared else 1.0)


def name_of(job: Job) -> str:
    """What jobs are measured by: task, method and what is shown; not the seed."""
    cell = job.cells[0]
    shown = f" {cell.shown}" if cell.shown != ALL_SHOWN else ""
    return f"{cell.env} {SHARED}" if job.shared else f"{cell.task} {cell.method}{shown}"


def _stored() -> dict[str, dict[str, float]]:
    """By conditions and job; nothing where the file cannot be used."""
    with suppress(OSError, ValueError):
        return msgspec.json.decode(read(cache_folder() / FILE), type=dict[str, dict[str, Seconds]])
    return {}
