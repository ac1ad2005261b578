"""The third stage of a cell: RL from scratch on the learned reward."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from harness.cell.fitting import OF_RL, Candidate, Fitted
from harness.cell.inputs import Inputs
from harness.cell.phases import Phase
from harness.judge.advantage import known_comparison, sampled_comparison
from harness.judge.evaluation import totals
from harness.registry.bounds import usable
from harness.rl.budget import JUDGING_EPISODES
from harness.rl.seeds import judging_seeds
from harness.rl.simulator import Simulator
from harness.rl.solving import Solution
from harness.rl.world import solver_for
from methods.base import Policy, Reward
from methods.rewards import fast


@dataclass(frozen=True)
class Retrained:
    """The policies of a cell, ready to be scored. columns: columns of all rows of the cell."""

    candidates: Sequence[Candidate]
    columns: Mapping[str, float] = field(default_factory=dict)


def reference(inputs: Inputs) -> Retrained:
    """Return the expert, or the demonstrations that score 1 in its place, and the random policy."""
    expert, random = inputs.shared.expert, Candidate("random", inputs.random_policy())
    if expert.returns:
        columns = {"status": "ok", **dict(expert.returns)}
        return Retrained([Candidate("expert", None, columns=columns), random])
    took = {"env_steps": expert.env_steps, "check_steps": expert.check_steps, "rl_solves": 1}
    columns = {"fit_seconds": expert.seconds, **took}
    curves = {"expert": [*expert.curve]}
    return Retrained([Candidate("expert", expert.policy, columns=columns, curves=curves), random])


def retrain(inputs: Inputs, fitted: Fitted) -> Retrained:
    """Return pi* and pi_R: the solve that earns the most under R* on the judging episodes.

    Ties go to the first solve. Each solve learns from scratch with the expert's budget.
    """
    star, reward = [fitted.star] if fitted.star else [], fitted.reward
    if fitted.skipped:
        rest = Candidate("pi_R", None, columns={"reason": fitted.skipped})
        return Retrained([*star, rest], fitted.columns)
    with inputs.stage("retrain"):
        solutions = [solve(inputs, reward, number) for number in range(inputs.solves)]
        judged, judging_steps = [math.nan], 0
        if reward is not None and len(solutions) > 1:
            judged, judging_steps = judge(inputs, reward, [solution.policy for solution in solutions])
    best = max(range(len(solutions)), key=lambda i: judged[i] if usable(judged[i]) else -math.inf)
    chosen, at = solutions[best], solutions[best].best
    trained = Candidate(
        *("pi_R", chosen.policy, reward),
        columns={
            "fit_seconds": inputs.seconds["retrain"],
            "env_steps": sum(solution.env_steps for solution in solutions),
            "check_steps": sum(solution.check_steps for solution in solutions) + judging_steps,
            "rl_solves": len(solutions),
            "solves": len(solutions),
            **measure(inputs, reward),
        },
        curves=dict(zip(OF_RL, (chosen.curve, chosen.true_curve, chosen.curve[at : at + 1]), strict=True)),
        solves=[(solution.policy, earned) for solution, earned in zip(solutions, judged, strict=True)],
    )
    return Retrained([*star, trained], fitted.columns)


def solve(inputs: Inputs, reward: Reward | None, number: int) -> Solution:
    """Return what RL learns from scratch under the reward.

    number: the number of the solve. It alone decides the random numbers, so that no solve depends on another.
    """
    before, steps = number * inputs.rl_steps, inputs.solves * inputs.rl_steps
    solver = solver_for(
        *(inputs.place, inputs.conditions.protocol, inputs.rng(f"pi_R {number}"), inputs.conditions.rl),
        told=lambda done, values: inputs.report(Phase("retrain", before + done, steps, values=values)),
    )
    return replace(solver.solve(reward, inputs.rl_steps), checkpoints=())


def judge(inputs: Inputs, reward: Reward, policies: Sequence[Policy]) -> tuple[list[float], int]:
    """Return the mean return of each policy under the reward on the judging episodes, and their steps."""
    seeds = judging_seeds(inputs.cell.seed, JUDGING_EPISODES)
    shown = [[(e.obs, e.act) for e in played] for played in Simulator(inputs.place).run_each(policies, seeds)]
    earned = [float(totals(fast(reward), episodes).mean()) for episodes in shown]
    return earned, sum(len(act) for episodes in shown for _, act in episodes)


def measure(inputs: Inputs, reward: Reward | None) -> dict[str, float]:
    """Return the columns that compare the reward with the true one in the task's own dynamics."""
    if inputs.is_transfer:
        return {}
    spec = inputs.spec
    with inputs.stage("measure"):
        if spec.tabular:
            comparison = known_comparison(reward, spec.tabular, spec.gamma)
        else:
            comparison = sampled_comparison(reward, inputs.shared.replays)
        columns = {f"reward_{name}": value for name, value in comparison._asdict().items()}
        if ranked := inputs.shared.ranked:
            columns["policy_ranking"] = ranked.ranking(reward)
    return columns
