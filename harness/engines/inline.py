"""The engine for debuggers and tests: jobs in this process, one after the other."""

from __future__ import annotations

import gc
import os
import sys
import traceback
from collections.abc import Callable
from functools import partial
from typing import Self

from harness.cell.phases import Phase
from harness.engines.compute import compute, describe, process_restored
from harness.engines.jobs import WORK, Job, Outcome, ignored
from harness.process.environment import of_this_process
from harness.registry import plugins
from harness.store.cache import compiled_once


class Inline:
    """Jobs in this process. Text that a cell prints is not kept.

    Keys are of this process's environment. So its cells are mixed with other engines' only where that is
    the same.
    """

    workers = 1

    def __init__(self, work: str = WORK) -> None:
        self.variables = of_this_process()
        self.heard: Callable[[str, Phase], None] = ignored
        self._work = work
        self._ended: list[tuple[Job, Outcome]] = []

    def submit(self, job: Job) -> None:
        try:
            with process_restored():
                plugins.check_alone(job.methods, [job.cells[0].env])
                outcome = compute(self._work, job, partial(self.heard, job.name))
        except (Exception, SystemExit, GeneratorExit) as error:
            traceback.print_exc(file=sys.stderr)
            outcome = Outcome(error=describe(error))
        self._ended.append((job, outcome))

    def completed(self) -> list[tuple[Job, Outcome]]:
        ended, self._ended = self._ended, []
        return ended

    def doing(self, name: str) -> Phase:
        return Phase()

    def __enter__(self) -> Self:
        self._before = os.environ.copy()
        os.environ.update(compiled_once())
        return self

    def __exit__(self, *error: object) -> None:
        os.environ.clear()
        os.environ.update(self._before)
        gc.unfreeze()
