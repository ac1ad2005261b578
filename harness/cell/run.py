"""A cell from its inputs to its result: Inputs -> Fitted -> Retrained -> Scored -> CellResult."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from harness.cell.fitting import fit, fit_control
from harness.cell.inputs import Inputs, Seconds, added
from harness.cell.phases import Phase
from harness.cell.retraining import Retrained, reference, retrain
from harness.cell.scoring import Scored, means, score
from harness.cell.settings import settings_of
from harness.cell.shared import Shared
from harness.cell.shared import prepare as shared_by
from harness.judge import effort
from harness.records import CONTROLS, LEARNED, REFERENCE, UNSHOWN, Cell, CellResult, Conditions
from harness.registry import plugins
from harness.store.artifacts import artifact
from harness.store.files import sha256_of
from methods.base import Policy, Reward

Files = dict[str, bytes]
"""Files that a cell adds to its run, by their path there."""


def prepare(cells: Sequence[Cell], conditions: Conditions) -> Files:
    """Return what these cells, of one environment and seed, share, by name."""
    shown = sorted({cell.shown for cell in cells if cell.method not in UNSHOWN})
    return shared_by(cells[0].env, cells[0].seed, shown, conditions)


def run_cell(
    cell: Cell,
    conditions: Conditions,
    shared: Mapping[str, bytes],
    report: Callable[[Phase], None] = lambda phase: None,
) -> tuple[CellResult, Files]:
    """Return the result of a cell, and the files that it adds to its run.

    shared: the result of `prepare`, and what the cell before learned. report: as of `Inputs`. Raises whatever
    the cell's method raises.
    """
    inputs = Inputs(cell, conditions, Shared(shared), report)
    scored = score(inputs, _retrained(inputs))
    learned, unstored, storing = learned_file(inputs, scored)
    recordings, unrecorded, recording = _record(inputs, scored)
    warnings = [warning for one in scored.candidates for warning in one.warnings]
    warnings += [*filter(None, [scored.below_bar, _effort(inputs)]), *unstored, *unrecorded]
    result = CellResult(
        cell,
        rows=list(scored.rows),
        curves={name: curve for one in scored.candidates for name, curve in one.curves.items()},
        endings={name: evaluation.endings for name, evaluation in scored.evaluations.items()},
        warnings=warnings,
        recordings={name: sha256_of(data) for name, data in recordings.items()},
        learned=sha256_of(learned) if learned else "",
        below_bar=bool(scored.below_bar),
        details={name: value for one in scored.candidates for name, value in one.details.items()},
        like=list(plugins.like(cell.method)),
        solves=list(scored.solves),
        seconds=added(scored.seconds, storing, recording),
        settings=settings_of(cell.method, cell.env, conditions),
    )
    files = {f"recordings/{name}": data for name, data in recordings.items()}
    return result, files | ({LEARNED: learned} if learned else {})


def _retrained(inputs: Inputs) -> Retrained:
    """Return the policies that the cell scores."""
    if inputs.cell.method == REFERENCE:
        return reference(inputs)
    return retrain(inputs, fit_control(inputs) if inputs.cell.method in CONTROLS else fit(inputs))


def learned_file(inputs: Inputs, scored: Scored) -> tuple[bytes, list[str], Seconds]:
    """Return what was learned as bytes, warnings of what is not in them, and the wall time."""
    candidates = scored.candidates
    learned: dict[str, Policy | Reward | None] = {
        one.name: one.policy for one in candidates if one.policy and one.name != "random"
    }
    if learned and inputs.cell.method not in (REFERENCE, "control_true"):
        learned["reward"] = candidates[0].reward
    with inputs.stage("record", means(scored.evaluations)) as stopwatch:
        data, warnings = artifact(inputs.cell, inputs.conditions, learned)
    return data, warnings, {"record": stopwatch.seconds}


def _record(inputs: Inputs, scored: Scored) -> tuple[Files, list[str], Seconds]:
    """Return the recordings by file name, warnings of those that are missing, and the wall time."""
    if not scored.watched:
        return {}, [], {}
    from harness.cell.recording import record  # imports rerun, 30 MB that other seeds do without

    files, warnings = Files(), list[str]()
    with inputs.stage("record", means(scored.evaluations)) as stopwatch:
        for one in scored.candidates:
            if watched := scored.watched.get(one.name):
                recordings, missing = record(inputs, one, scored.evaluations[one.name], watched)
                files |= recordings
                warnings += missing
    return files, warnings, {"record": stopwatch.seconds}


def _effort(inputs: Inputs) -> str:
    """Return a warning where a plug-in's settings ask for many more environment steps than others' do."""
    cell = inputs.cell
    more = effort.times_as_many(cell.method, cell.env, inputs.conditions.budget)
    if more <= effort.MOST:
        return ""
    asked = f"about {more:.0f} times the environment steps of {plugins.like(cell.method)[0]}"
    return f"{cell.name}: its own settings ask for {asked}: not compared like with like"
