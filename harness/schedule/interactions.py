"""Environment interactions that cells would take, as far as that is known before a run."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

from envs import EnvSpec
from harness.cell.sharing import takes_one_solve
from harness.judge import effort
from harness.judge.numbers import as_text
from harness.records import CONTROL_METHODS, CONTROLS, NOMINAL, REFERENCE, Cell, Conditions
from harness.registry import BUILT_IN, UNREWARDED, base, plugins
from harness.rl import budget

NO_NUMBERS = "It says what cells would take."


@dataclass(frozen=True)
class Interactions:
    """Interactions of cells, as their rows count them.

    `rl`: steps of RL on rewards. `checks`: the most steps of episodes that choose its checkpoints, and one of
    several solves, NaN where unknown. Equal checkpoints are checked again beyond that. `fit`: steps of RL in
    fits by methods' settings. `open`: True where fits take others besides.
    """

    rl: int = 0
    checks: float = 0.0
    fit: int = 0
    open: bool = False

    def __add__(self, other: Interactions) -> Interactions:
        sums = self.rl + other.rl, self.checks + other.checks, self.fit + other.fit
        return Interactions(*sums, self.open or other.open)

    def __mul__(self, count: int) -> Interactions:
        return Interactions(count * self.rl, count * self.checks, count * self.fit, self.open)

    def __str__(self) -> str:
        checks = as_text(self.checks, ",.0f")
        fits = f"{'at least ' * self.open}{self.fit:,} of fits"
        return f"{self.rl:,} of RL on rewards, up to {checks} that choose its checkpoints, {fits}"


def by_env(cells: Sequence[Cell], conditions: Conditions) -> dict[str, Interactions]:
    """Return the interactions of cells by environment."""
    totals: dict[str, Interactions] = {}
    for cell, count in Counter(replace(cell, seed=0) for cell in cells).items():
        totals[cell.env] = totals.get(cell.env, Interactions()) + interactions(cell, conditions) * count
    return totals


def interactions(cell: Cell, conditions: Conditions) -> Interactions:
    """Return the interactions of a cell."""
    if cell.method == REFERENCE:
        return Interactions()
    with suppress(Exception):  # an environment or a method that fails is reported by its own cells
        task = plugins.task(cell.env)
        own = conditions.learner == "own"
        steps = (task.rl_steps if own else task.ddpg_steps)[conditions.budget]
        solves = _solves(cell, conditions, task.solves)
        if not isinstance(task, EnvSpec):
            return Interactions(solves * steps, math.nan, open=True)
        judging = solves * budget.JUDGING_EPISODES * (solves > 1)
        if task.tabular:
            return Interactions(checks=judging * task.horizon)
        learner = task.rl if own else task.ddpg
        fit, is_open = _fit(cell, conditions, steps)
        rl, checked = steps, budget.checkpoints(learner, steps)
        if _pays_nothing(cell.method, conditions.protocol):
            rl, checked = budget.warm_up(learner, steps), 1
        episodes = solves * checked * budget.check_episodes(learner, steps) + judging
        return Interactions(solves * rl, episodes * task.horizon, fit, is_open)
    return Interactions(checks=math.nan, open=True)


def _solves(cell: Cell, conditions: Conditions, solves: Mapping[str, int]) -> int:
    """Return the number of RL solves of a cell's reward, 0 for methods that learn none."""
    if cell.method not in CONTROLS and (base(cell.method) in UNREWARDED or not conditions.retrain):
        return 0
    return 1 if takes_one_solve(cell) else conditions.solves or solves[conditions.budget]


def _fit(cell: Cell, conditions: Conditions, steps: int) -> tuple[int, bool]:
    """Return the steps of RL in a fit by the method's settings, and whether the fit takes others besides."""
    method = CONTROL_METHODS.get(cell.method, cell.method)
    if method in CONTROLS or cell.dynamics != NOMINAL:
        return 0, False
    if base(method) not in BUILT_IN["method"]:
        return 0, True
    made = plugins.method_for(method, cell.env, conditions.budget)
    return round(effort.asked(made, steps)), hasattr(made, "rollouts")


def _pays_nothing(control: str, protocol: str) -> bool:
    """Return whether a control's reward is 0 everywhere once an end's pay is taken off: RL ends early."""
    return control in ("control_plus1", "control_minus1") and protocol in ("absorbing", "offset")
