"""One cell: its stages, what is kept of what was learned, and the recordings. What its numbers come from is
`harness.run.stages`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from harness.judge import effort
from harness.judge.evaluation import Evaluation
from harness.judge.results import (
    REFERENCE,
    UNSHOWN,
    Cell,
    CellResult,
    Conditions,
    PolicyName,
    name_of,
)
from harness.registry import plugins
from harness.run import given, without_expert
from harness.run.artifacts import KIND, artifact
from harness.run.cache import as_bytes
from harness.run.experts import Shared
from harness.run.experts import prepare as shared_by
from harness.run.files import sha256_of
from harness.run.phases import returned
from harness.run.stages import Made, Task, missed_bar, policies, row, score, solves
from harness.run.watched import Watched
from methods.base import Policy, Reward


def run_cell(
    cell: Cell,
    conditions: Conditions,
    inputs: Mapping[str, bytes],
    tell: Callable[[str], None] = lambda doing: None,
) -> tuple[CellResult, dict[str, bytes]]:
    """Return everything of one cell, and the files that it adds to the run, by their path there.

    inputs: from `prepare`. tell: called with what is being done. Raises what its method raises.
    """
    told = _Told(tell)
    task = Task(cell, conditions, Shared(inputs), tell=told)
    made = policies(task)
    nobody = cell.method == REFERENCE and conditions.experts == "none"
    if nobody:
        made = [Made("expert", None), *made[1:]]
    watched = watched_policies(task, made)
    scored = {
        one.name: told.scored(one.name, score(task, watched.get(one.name, one.policy), one.reward))
        for one in made
        if one.policy
    }
    missed = [missed_bar(task, scored["expert"])] if "expert" in scored else []
    below = any(missed)
    learned, lost = learned_file(task, made)
    artifacts = {f"{cell.name}.{KIND}": learned} if learned else {}
    from_file = conditions.demonstrations and cell.method not in UNSHOWN
    rows = [row(task, one, scored) for one in made]
    if nobody:
        rows[0] = without_expert.in_its_place(rows[0], conditions)
    tried = [solve for one in made for solve in solves(task, one, scored)]
    recordings, troubles = dict[str, bytes](), list[str]()
    for one in made:
        if one.name in watched:
            files, false = recorded(task, one, scored[one.name], watched[one.name])
            recordings |= files
            troubles += false
    more = effort.times_as_many(cell.method, cell.env, conditions.budget)
    if more > effort.MOST:
        its = f"about {more:.0f} times the environment steps of {plugins.like(cell.method)[0]}"
        missed.append(f"{cell.name}: its own settings ask for {its}: not compared like with like")
    result = CellResult(
        cell,
        rows=[
            replace(r, expert=given.source_of(conditions.demonstrations)) if from_file else r for r in rows
        ],
        curves={name: curve for one in made for name, curve in one.curves.items()},
        endings={name: its.endings for name, its in scored.items()},
        warnings=[w for one in made for w in one.warnings] + [*filter(None, missed), *lost, *troubles],
        recordings={name: sha256_of(data) for name, data in recordings.items()},
        artifacts={name: sha256_of(data) for name, data in artifacts.items()},
        below_bar=below,
        details={name: value for one in made for name, value in one.details.items()},
        like=list(plugins.like(cell.method)),
        solves=tried,
        seconds=task.seconds,
    )
    folders = {"recordings": recordings, "artifacts": artifacts}
    kept = {f"{at}/{name}": data for at, those in folders.items() for name, data in those.items()}
    return result, kept


class _Told:
    """Tells what is being done, with what policies returned that were scored by now."""

    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell, self._returns = tell, dict[str, float]()

    def __call__(self, doing: str) -> None:
        self._tell("; ".join([doing, *([returned(self._returns)] if self._returns else [])]))

    def scored(self, name: str, its: Evaluation) -> Evaluation:
        """What was found, which is told from now on."""
        self._returns[name] = float(its.returns.mean())
        return its


def prepare(cells: Sequence[Cell], conditions: Conditions) -> dict[str, bytes]:
    """What these cells, of one environment and seed, share."""
    env, seed, said = cells[0].env, cells[0].seed, conditions.demonstrations
    shown = sorted({cell.shown for cell in cells if cell.method not in UNSHOWN})
    if not said:
        return shared_by(env, seed, shown, conditions)
    theirs = {name_of(one): as_bytes(given.shown(said, env, seed, one)) for one in shown}
    if conditions.experts == "none":
        return without_expert.prepare(env, seed, conditions) | theirs
    return shared_by(env, seed, (), conditions) | theirs


def learned_file(task: Task, made: Sequence[Made]) -> tuple[bytes, list[str]]:
    """What was learned, as a file, and why some of that is not in it."""
    learned: dict[str, Policy | Reward | None] = {
        one.name: one.policy for one in made if one.policy is not None
    }
    learned.pop("random", None)
    if learned and task.cell.method not in (REFERENCE, "control_true"):
        learned["reward"] = made[0].reward
    with task.during("record"):
        return artifact(task.cell, task.conditions, learned)


def watched_policies(task: Task, made: Sequence[Made]) -> dict[PolicyName, Watched]:
    """Policies of which episodes are recorded, by name."""
    records = task.cell.seed == 0 and task.conditions.record != "none"
    return {one.name: Watched(one.policy) for one in made if records and one.policy is not None}


def recorded(
    task: Task, made: Made, scored: Evaluation, watched: Watched
) -> tuple[dict[str, bytes], list[str]]:
    """The recordings of its evaluation episodes, by the files' names, and why some are missing."""
    from harness.run import episodes  # 30 MB of rerun, which other seeds do without

    return episodes.recorded(task, made, scored, watched)
