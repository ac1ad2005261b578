"""A cell from its inputs to its result: Inputs -> Fitted -> Retrained -> Scored -> CellResult."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from envs import EnvSpec
from harness.cell.fitting import Candidate, fit, fit_control
from harness.cell.inputs import Inputs
from harness.cell.phases import Phase
from harness.cell.retraining import Retrained, reference, retrain
from harness.cell.settings import settings_of
from harness.cell.shared import Shared
from harness.cell.shared import prepare as shared_by
from harness.judge import effort
from harness.judge.evaluation import Evaluation, evaluate, is_solved
from harness.judge.numbers import as_text
from harness.records import (
    CONTROLS,
    LEARNED,
    NOMINAL,
    REFERENCE,
    UNSHOWN,
    Cell,
    CellResult,
    Conditions,
    PolicyName,
    Row,
    Solve,
    row_of,
)
from harness.registry import plugins
from harness.store.artifacts import artifact
from harness.store.files import sha256_of
from methods.base import Policy, Reward
from methods.rewards import fast

Files = dict[str, bytes]
"""Files that a cell adds to its run, by their path there."""


@dataclass(frozen=True)
class Scored:
    """The rows of a cell, with the evaluations that they come from.

    `below_bar`: the reason why the expert cannot be trusted, '' where it meets its bar.
    """

    candidates: Sequence[Candidate]
    evaluations: Mapping[PolicyName, Evaluation]
    rows: Sequence[Row]
    solves: Sequence[Solve]
    below_bar: str


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


def means(evaluations: Mapping[PolicyName, Evaluation]) -> dict[str, float]:
    """Return the mean return of each policy."""
    return {str(name): float(result.returns.mean()) for name, result in evaluations.items()}


def score(inputs: Inputs, retrained: Retrained) -> Scored:
    """Return the rows of the cell, from native episodes of each policy."""
    candidates, columns = retrained.candidates, {**retrained.columns}
    evaluations = dict[PolicyName, Evaluation]()
    with inputs.stage("score"):
        trained = candidates[-1]
        if inputs.cell.method not in (REFERENCE, *CONTROLS) and trained.policy:
            by_chance = evaluated(inputs, inputs.random_policy(), trained.reward)
            columns["own_return_random"] = by_chance.own_return
        for one in candidates:
            if one.policy:
                place = inputs.place.expert_sees if one.name == "expert" else inputs.place
                evaluations[one.name] = evaluated(inputs, one.policy, one.reward, place)
                inputs.report(Phase("score", returns=means(evaluations)))
        star = evaluations["pi_star"].own_return if "pi_star" in evaluations else math.nan

        def solved(result: Evaluation) -> float:
            """Return whether RL solved R*, by a policy that it learned."""
            return is_solved(result.own_return, star, columns.get("own_return_random", math.nan))

        solves = []
        for policy, judged in trained.solves:
            is_chosen = policy is trained.policy
            result = evaluations["pi_R"] if is_chosen else evaluated(inputs, policy, trained.reward)
            solves.append(Solve(judged, result.own_return, float(result.returns.mean()), solved(result)))
    rows = []
    for one in candidates:
        name = inputs.shared.expert.column(inputs.cell.method)
        values: dict[str, Any] = {"status": "skipped", "expert": name, **columns, **one.columns}
        if scored := evaluations.get(one.name):
            values |= {"status": "ok", **scored.columns()}
            values |= {"solved": solved(scored)} if one.name == "pi_R" else {}
        rows.append(row_of(inputs.cell, one.name, inputs.conditions.protocol, **values))
    below_bar = ""
    if "expert" in evaluations:
        below_bar = _below_bar(inputs, *(evaluations[name] for name in ("expert", "random")))
    return Scored(candidates, evaluations, rows, solves, below_bar)


def evaluated(
    inputs: Inputs, policy: Policy, reward: Reward | None, place: EnvSpec | None = None
) -> Evaluation:
    """Return the evaluation of a policy, by the true reward and by its own. place: None for the inputs'."""
    return evaluate(place or inputs.place, policy, inputs.seeds, reward and fast(reward))


def _below_bar(inputs: Inputs, expert: Evaluation, random: Evaluation) -> str:
    """Return the reason why the expert cannot be trusted, '' where it meets its bar and beats chance."""
    episodes, allowed = len(expert.returns), inputs.place.max_terminated[inputs.conditions.budget]
    terminated = (episodes - expert.endings.get("time limit", 0)) / episodes
    reached, bar, chance = expert.returns.mean(), inputs.place.bar(inputs.seeds), random.returns.mean()
    where = f"{inputs.cell.env}, seed {inputs.cell.seed}"
    if reached <= chance and inputs.cell.dynamics == NOMINAL:
        return f"{where}: the expert is no better than a random policy: {reached:.2f}, not above {chance:.2f}"
    if reached >= bar and terminated <= allowed:
        return ""
    return (
        f"{where}: the expert misses its bar: mean return "
        f"{as_text(reached, '.2f')} (at least {bar:.2f}), {terminated:.0%} of episodes terminated early "
        f"(at most {allowed:.0%})"
    )


def _artifact(inputs: Inputs, scored: Scored) -> tuple[bytes, list[str]]:
    """Return what was learned as bytes, and warnings of what is not in them."""
    learned: dict[str, Policy | Reward | None] = {
        one.name: one.policy for one in scored.candidates if one.policy and one.name != "random"
    }
    if learned and inputs.cell.method not in (REFERENCE, "control_true"):
        learned |= {"reward": scored.candidates[0].reward, **scored.candidates[0].others}
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
