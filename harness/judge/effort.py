"""Comparison of the environment steps of plug-ins' methods, and of those with a user's settings, with
built-in ones."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from harness.records import CONTROLS, NOMINAL, REFERENCE, CellResult, Row
from harness.registry import BUILT_IN, SPECS, plugins

NO_NUMBERS = "It warns of steps that were taken."

MOST = 3
"""The largest ratio of steps at which two methods are compared like with like."""
EPISODES = 10
"""Rollouts that any method may take beside RL's steps."""


def asked(method: Any, rl_steps: int) -> float:
    """Return about how many environment steps a method's settings ask for. `rl_steps`: steps of a solve.

    Only the ratio for two methods of one class is meaningful.
    """
    if hasattr(method, "rl_share"):
        return float(rl_steps * (method.iterations * method.rl_share + getattr(method, "final_share", 0)))
    if hasattr(method, "rl_rounds"):
        return float(method.rl_rounds * rl_steps)
    rolled = getattr(method, "rounds", 0) * getattr(method, "rollouts", 0)
    return float(getattr(method, "rl_steps", rolled))


def times_as_many(method: str, env: str, budget: str) -> float:
    """Return about how many times the steps of the built-in method of its class another method takes.

    By its settings; 1 for all others. The method is imported.
    """
    if not (names := plugins.like(method)):
        return 1.0
    own, usual = (plugins.method_for(name, env, budget) for name in (method, names[0]))
    steps = plugins.task(env).rl_steps[budget]
    most = asked(usual, steps)
    return asked(own, steps) / most if most else 1.0


def warnings(results: Sequence[CellResult], budget: str) -> list[str]:
    """Return a line for each task in which a plug-in's method took more than `MOST` times others' steps.

    It is compared with the built-in methods whose class it has or derives from, where they are among the
    results; checks of checkpoints are included. A method that is like none, or like one that takes no steps,
    is compared with all built-in methods there, and with RL.
    """
    rows: dict[tuple[str, str], dict[str, list[Row]]] = {}
    likes: dict[str, list[str]] = {}
    for result in results:
        cell, row = result.cell, next(iter(result.rows), None)
        counts = cell.dynamics == NOMINAL and cell.method not in (REFERENCE, *CONTROLS)
        if row and row.status == "ok" and counts:
            rows.setdefault((cell.env, str(cell.shown)), {}).setdefault(cell.method, []).append(row)
            if cell.method not in BUILT_IN["method"]:
                likes[cell.method] = result.like
    lines = []
    for (env, shown), methods in sorted(rows.items()):
        for method in sorted(methods.keys() & likes.keys()):
            known = [name for name in BUILT_IN["method"] if name in methods]
            alike = [name for name in known if name in likes[method]]
            checks = any(_mean(methods[name], True) for name in alike)
            if likes[method] and not alike:
                continue  # its own cells warn where its settings ask for more
            others = {name: _mean(methods[name], checks) for name in (alike if checks else known)}
            if not checks and env in BUILT_IN["env"]:
                others["RL at this budget"] = SPECS[env].rl_steps[budget] + EPISODES * SPECS[env].horizon
            took = _mean(methods[method], checks)
            most = max(others, key=others.__getitem__, default="")
            if most and took > MOST * others[most] > 0:
                lines.append(
                    f"{method} in {f'{env}, {shown}' if shown else env} took {took:,.0f} environment steps"
                    f"{' and checks' * checks}, more than {MOST} times the {others[most]:,.0f} of {most}: "
                    "not compared like with like"
                )
    return lines


def _mean(rows: Sequence[Row], checks: bool) -> float:
    return sum(row.env_steps + checks * row.check_steps for row in rows) / len(rows)
