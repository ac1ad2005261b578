"""What a node of a cluster does: jobs, one after the other, by an engine that starts processes."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace

from harness.registry import plugins
from harness.run import given
from harness.run.engines import Job, Outcome
from harness.run.files import write_atomic
from harness.run.isolated import Isolated

GIVEN = "given"
"""The name of demonstrations of a file among what a job is sent."""


@dataclass(frozen=True)
class How:
    """As the arguments of `Isolated`."""

    timeout: float | None
    deterministic: bool
    modules: tuple[str, ...]
    work: str


class _Node:
    """The engine of this process, kept for its next job: what it imported and what JAX compiled serve all."""

    how: How | None = None
    engine: Isolated
    stack = ExitStack()


def compute_there(job: Job, how: How, names: Sequence[str], *inputs: bytes) -> Outcome:
    """Does a job in a process that this one starts. names: of the inputs."""
    if _Node.how != how:
        _Node.stack.close()
        engine = Isolated(1, how.timeout, how.deterministic, how.modules, how.work)
        _Node.engine = _Node.stack.enter_context(engine)
        _Node.how = how
    sent = dict(zip(names, inputs, strict=True))
    if demonstrations := sent.pop(GIVEN, b""):
        file = given.file_of(job.conditions.demonstrations)
        file.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(file, demonstrations)
    here = plugins.unpacked(job.plugins)
    _Node.engine.start(replace(job, inputs={**sent, **job.inputs}, plugins=here))
    while not (ended := _Node.engine.finished()):
        pass
    return ended[0][1]
