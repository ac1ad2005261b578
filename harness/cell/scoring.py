"""The fourth stage of a cell: every policy scored in the original task, by the true reward and by its own."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from harness.cell.fitting import Candidate, random_policy
from harness.cell.inputs import Inputs, Seconds, added
from harness.cell.phases import Phase
from harness.cell.retraining import Retrained
from harness.cell.watched import Watched
from harness.judge.evaluation import Evaluation, evaluate, is_solved
from harness.judge.numbers import as_text
from harness.records import CONTROLS, REFERENCE, PolicyName, Row, Solve, row_of
from methods.base import Policy, Reward
from methods.rewards import fast

Evaluations = Mapping[PolicyName, Evaluation]


@dataclass(frozen=True)
class Scored:
    """The rows of a cell, with the evaluations that they come from.

    `watched`: the policies whose episodes are recorded, with their actions.
    `below_bar`: the reason why the expert cannot be trusted, '' where it meets its bar.
    """

    candidates: Sequence[Candidate]
    evaluations: Evaluations
    rows: Sequence[Row]
    solves: Sequence[Solve]
    watched: Mapping[PolicyName, Watched]
    below_bar: str
    seconds: Seconds


def score(inputs: Inputs, retrained: Retrained) -> Scored:
    """Return the rows of the cell, from native episodes of each policy."""
    candidates = retrained.candidates
    watched = {one.name: Watched(one.policy) for one in candidates if one.policy and _is_recorded(inputs)}
    with inputs.stage("score") as stopwatch:
        columns = {**retrained.columns, **_return_of_random(inputs, candidates)}
        evaluations = _evaluations(inputs, candidates, watched)
        solves = _solves(inputs, candidates, evaluations, columns)
    return Scored(
        candidates,
        evaluations,
        [_row(inputs, one, evaluations, columns) for one in candidates],
        solves,
        watched,
        _below_bar(inputs, evaluations["expert"]) if "expert" in evaluations else "",
        added(retrained.seconds, {"score": stopwatch.seconds}),
    )


def means(evaluations: Evaluations) -> dict[str, float]:
    """Return the mean return of each policy."""
    return {str(name): float(result.returns.mean()) for name, result in evaluations.items()}


def evaluated(inputs: Inputs, policy: Policy, reward: Reward | None) -> Evaluation:
    """Return the evaluation of a policy, by the true reward and by its own."""
    return evaluate(inputs.place, policy, inputs.seeds, reward and fast(reward))


def _is_recorded(inputs: Inputs) -> bool:
    return inputs.cell.seed == 0 and inputs.conditions.record != "none"


def _return_of_random(inputs: Inputs, candidates: Sequence[Candidate]) -> dict[str, float]:
    """Return the random policy's return under a learned reward, where RL was run on that."""
    trained = candidates[-1]
    if inputs.cell.method in (REFERENCE, *CONTROLS) or trained.policy is None:
        return {}
    return {"own_return_random": evaluated(inputs, random_policy(inputs), trained.reward).own_return}


def _evaluations(
    inputs: Inputs, candidates: Sequence[Candidate], watched: Mapping[PolicyName, Watched]
) -> dict[PolicyName, Evaluation]:
    """Return the evaluation of each policy, each reported as soon as it is known."""
    evaluations: dict[PolicyName, Evaluation] = {}
    for one in candidates:
        if one.policy:
            evaluations[one.name] = evaluated(inputs, watched.get(one.name, one.policy), one.reward)
            inputs.report(Phase("score", returns=means(evaluations)))
    return evaluations


def _solves(
    inputs: Inputs, candidates: Sequence[Candidate], evaluations: Evaluations, columns: Mapping[str, float]
) -> list[Solve]:
    """Return every solve of pi_R, with its returns on the evaluation episodes."""
    solves = []
    for one in candidates:
        for policy, judged in one.solves:
            is_chosen = policy is one.policy
            result = evaluations[one.name] if is_chosen else evaluated(inputs, policy, one.reward)
            solved = _solved(result, evaluations, columns)
            solves.append(Solve(judged, result.own_return, float(result.returns.mean()), solved))
    return solves


def _solved(result: Evaluation, evaluations: Evaluations, columns: Mapping[str, float]) -> float:
    """Return `is_solved` of a policy that RL learned under R*."""
    star = evaluations["pi_star"].own_return if "pi_star" in evaluations else math.nan
    return is_solved(result.own_return, star, columns.get("own_return_random", math.nan))


def _row(inputs: Inputs, candidate: Candidate, evaluations: Evaluations, columns: Mapping[str, float]) -> Row:
    result = evaluations.get(candidate.name)
    values: dict[str, Any] = {"status": "ok" if result else "skipped"}
    values |= {"expert": inputs.shared.expert.column(inputs.cell.method), **columns, **candidate.columns}
    values |= result.columns() if result else {}
    if result and candidate.name == "pi_R":
        values["solved"] = _solved(result, evaluations, columns)
    return row_of(inputs.cell, candidate.name, inputs.conditions.protocol, **values)


def _below_bar(inputs: Inputs, expert: Evaluation) -> str:
    """Return the reason why the expert cannot be trusted, '' where it meets its bar."""
    episodes, allowed = len(expert.returns), inputs.place.max_terminated[inputs.conditions.budget]
    terminated = (episodes - expert.endings.get("time limit", 0)) / episodes
    bar = inputs.place.bar(inputs.seeds)
    if expert.returns.mean() >= bar and terminated <= allowed:
        return ""
    reached = as_text(expert.returns.mean(), ".2f")
    return (
        f"{inputs.cell.env}, seed {inputs.cell.seed}: the expert misses its bar: mean return "
        f"{reached} (at least {bar:.2f}), {terminated:.0%} of episodes terminated "
        f"early (at most {allowed:.0%})"
    )
