"""A cell from its inputs to its result: Inputs -> Fitted -> Retrained -> Scored -> CellResult."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from harness.cell.fitting import fit, fit_control
from harness.cell.inputs import Inputs
from harness.cell.phases import Phase
from harness.cell.retraining import reference, retrain
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
    if cell.method == REFERENCE:
        scored = score(inputs, reference(inputs))
    else:
        scored = score(inputs, retrain(inputs, (fit_control if cell.method in CONTROLS else fit)(inputs)))
    with inputs.stage("record", means(scored.evaluations)):
        learned, unstored = _artifact(inputs, scored)
        recordings = _recordings(inputs, scored)
    warnings = [warning for one in scored.candidates for warning in one.warnings]
    result = CellResult(
        cell,
        rows=[*scored.rows],
        curves={name: curve for one in scored.candidates for name, curve in one.curves.items()},
        endings={name: evaluation.endings for name, evaluation in scored.evaluations.items()},
        warnings=[*warnings, *filter(None, [scored.below_bar, _effort(inputs)]), *unstored],
        recordings={name: sha256_of(data) for name, data in recordings.items()},
        learned=sha256_of(learned) if learned else "",
        below_bar=bool(scored.below_bar),
        details={name: value for one in scored.candidates for name, value in one.details.items()},
        like=list(plugins.like(cell.method)),
        solves=[*scored.solves],
        seconds=inputs.seconds,
        settings=settings_of(cell.method, cell.env, conditions),
    )
    files = {f"recordings/{name}": data for name, data in recordings.items()}
    return result, files | ({LEARNED: learned} if learned else {})


def _artifact(inputs: Inputs, scored: Scored) -> tuple[bytes, list[str]]:
    """Return what was learned as bytes, and warnings of what is not in them."""
    learned: dict[str, Policy | Reward | None] = {
        one.name: one.policy for one in scored.candidates if one.policy and one.name != "random"
    }
    if learned and inputs.cell.method not in (REFERENCE, "control_true"):
        learned["reward"] = scored.candidates[0].reward
    return artifact(inputs.cell, inputs.conditions, learned)


def _recordings(inputs: Inputs, scored: Scored) -> Files:
    """Return the recordings of seed 0 by file name."""
    if inputs.cell.seed != 0 or inputs.conditions.record == "none":
        return {}
    from harness.cell.recording import record  # imports rerun, 30 MB that other seeds do without

    files = Files()
    for one in scored.candidates:
        if one.policy:
            files |= record(inputs, one, scored.evaluations[one.name])
    return files


def _effort(inputs: Inputs) -> str:
    """Return a warning where a plug-in's settings ask for many more environment steps than others' do."""
    cell = inputs.cell
    more = effort.times_as_many(cell.method, cell.env, inputs.conditions.budget)
    if more <= effort.MOST:
        return ""
    asked = f"about {more:.0f} times the environment steps of {plugins.like(cell.method)[0]}"
    return f"{cell.name}: its own settings ask for {asked}: not compared like with like"
