"""The fourth stage of a cell: every policy scored in the original task, by the true reward and by its own."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from harness.cell.fitting import Candidate
from harness.cell.inputs import Inputs
from harness.cell.phases import Phase
from harness.cell.retraining import Retrained
from harness.judge.evaluation import Evaluation, evaluate
from harness.judge.numbers import as_text
from harness.judge.solved import is_solved
from harness.records import CONTROLS, REFERENCE, PolicyName, Row, Solve, row_of
from methods.base import Policy, Reward
from methods.rewards import fast


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
                evaluations[one.name] = evaluated(inputs, one.policy, one.reward)
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
    below_bar = _below_bar(inputs, evaluations["expert"]) if "expert" in evaluations else ""
    return Scored(candidates, evaluations, rows, solves, below_bar)


def evaluated(inputs: Inputs, policy: Policy, reward: Reward | None) -> Evaluation:
    """Return the evaluation of a policy, by the true reward and by its own."""
    return evaluate(inputs.place, policy, inputs.seeds, reward and fast(reward))


def _below_bar(inputs: Inputs, expert: Evaluation) -> str:
    """Return the reason why the expert cannot be trusted, '' where it meets its bar."""
    episodes, allowed = len(expert.returns), inputs.place.max_terminated[inputs.conditions.budget]
    terminated = (episodes - expert.endings.get("time limit", 0)) / episodes
    reached, bar = expert.returns.mean(), inputs.place.bar(inputs.seeds)
    if reached >= bar and terminated <= allowed:
        return ""
    return (
        f"{inputs.cell.env}, seed {inputs.cell.seed}: the expert misses its bar: mean return "
        f"{as_text(reached, '.2f')} (at least {bar:.2f}), {terminated:.0%} of episodes terminated early "
        f"(at most {allowed:.0%})"
    )
