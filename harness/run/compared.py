"""The expert and every method's pi* and pi_R on one episode, as one recording for each environment, from what
a run's cells learned."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from harness.judge.results import (
    ALL_SHOWN,
    CONTROLS,
    NOMINAL,
    REFERENCE,
    CellResult,
    artifact_of,
    compared_in,
)
from harness.learn.seeds import evaluation_seeds
from harness.learn.simulator import Simulator
from harness.registry import KNOWN, SPECS, BadInput
from harness.run.artifacts import read_artifact
from harness.run.files import write_atomic
from methods.base import Policy

SEED = 0
"""Of the run's seeds, the one that is recorded; its first evaluation episode is played."""
POLICIES = ("expert", "pi_star", "pi_R")


def write_compared(
    directory: Path, results: Iterable[CellResult], is_as_written: Callable[[Path], bool]
) -> list[Path]:
    """Writes DIR/recordings/ENV__compare.rrd of each environment with a reference and a method; one that is
    as it was written, of these, stays. Returns the files' paths."""
    learned: dict[str, list[CellResult]] = {}
    for result in results:
        cell = result.cell
        asked = (cell.seed, cell.dynamics, cell.shown) == (SEED, NOMINAL, ALL_SHOWN)
        if asked and result.artifacts and cell.env in KNOWN.entries["env"] and cell.method not in CONTROLS:
            learned.setdefault(cell.env, []).append(result)
    files = []
    for env, its in sorted(learned.items()):
        its.sort(key=lambda result: (result.cell.method != REFERENCE, result.cell.method))
        if its[0].cell.method != REFERENCE or len(its) < 2:
            continue
        file = directory / "recordings" / compared_in(env)
        digests = [digest for result in its for digest in result.artifacts.values()]
        identity = hashlib.sha256("\n".join(digests).encode()).hexdigest()[:16]
        # rerun is 30 MB, which reports of runs without recordings do without.
        from harness.show import comparison

        if not (is_as_written(file) and comparison.identity_of(file) == identity):
            if len(played := _played(directory, env, its)) < 2:
                continue
            write_atomic(file, comparison.record(SPECS[env], identity, played))
        files.append(file)
    return files


def _played(directory: Path, env: str, results: Sequence[CellResult]) -> list[Any]:
    """An episode of each policy that can be read."""
    from harness.show.comparison import Ghost
    from harness.show.scenes import scene

    spec, seed = SPECS[env], evaluation_seeds(SEED, 1)[0]
    found = [
        ("" if name == "expert" else result.cell.method, name, policy)
        for result in results
        for name, policy in _policies(directory, result)
    ]
    episodes = Simulator(spec, len(found)).run_each([policy for *_, policy in found], [seed])
    return [
        Ghost(method, name, trajectory, scene(spec, seed, trajectory.act))
        for (method, name, _), (trajectory,) in zip(found, episodes, strict=True)
    ]


def _policies(directory: Path, result: CellResult) -> list[tuple[str, Policy]]:
    try:
        found = read_artifact(directory / artifact_of(result.cell), result)
    except BadInput:  # damaged, which `verify` says
        return []
    return [(name, found[name]) for name in POLICIES if found.get(name) is not None]
