"""Results as a run of three seeds could have them, for tests of what is made of results."""

import dataclasses
import itertools
import math
from typing import Any

import numpy as np

from harness.judge.leaderboard import Entry, leaderboard, scored_rows
from harness.records import Cell, CellResult, Conditions, Row
from harness.store.request import Request

ENVS = ("cartpole", "pendulum")
REQUEST = Request(("bc", "shaped", "maxmargin"), ENVS, (0, 1, 2), Conditions("quick", "absorbing", "sbx"))
RETURNS = {
    ("reference", "expert"): 500.0,
    ("reference", "random"): 20.0,
    ("bc", "pi_star"): 480.0,
    ("maxmargin", "pi_star"): 400.0,
    ("maxmargin", "pi_R"): 350.0,
    ("shaped", "pi_star"): 460.0,
    ("shaped", "pi_R"): 440.0,
    ("control_true", "pi_R"): 499.0,
    ("control_survival", "pi_R"): 450.0,
    ("control_plus1", "pi_R"): 60.0,
    ("control_minus1", "pi_R"): 20.0,
    ("control_untrained", "pi_R"): 110.0,
}
NUMBERS = {"episodes": 100, "return_std": 1 / 3, "discounted_mean": 90.0, "length_mean": 400.0}
COSTS = {"fit_seconds": 12.5, "env_steps": 15_000, "rl_solves": 1}


def make_results(envs: tuple[str, ...] = ENVS, seeds: int = 3) -> list[CellResult]:
    """Return results in which seed k of a method other than the reference earns 5 * k less. bc learns no
    reward; maxmargin fails in the last seed."""
    rng = np.random.default_rng(0)
    results = []
    for env, method, seed in itertools.product(envs, dict.fromkeys(m for m, _ in RETURNS), range(seeds)):
        less = 0 if method == "reference" else 5 * seed
        values = {policy: value - less for (name, policy), value in RETURNS.items() if name == method}
        rows = [make_row(env, method, seed, policy, return_mean=value) for policy, value in values.items()]
        if method == "maxmargin" and seed == seeds - 1 and seeds > 1:
            why = {"status": "failed", "reason": "no | progress\nin LP"}
            rows = [make_row(env, method, seed, policy, **why) for policy in values]
        curves = {}
        if method == "bc":
            rows.append(make_row(env, method, seed, "pi_R", status="skipped", reason="learns no reward"))
        else:
            steps = range(0, 15_001, 1000)
            rise = np.cumsum(rng.normal(3, 4, len(steps)))
            name = "expert" if method == "reference" else "pi_R"
            curves[name] = [(float(x), float(y)) for x, y in zip(steps, rise, strict=True)]
            if name == "pi_R":
                curves["pi_R_true"] = [(x, 500 - y) for x, y in curves[name]]
        if method in ("shaped", "bc"):
            curves["loss"] = [(float(i), math.exp(-i / 30) + 0.02 * rng.random()) for i in range(100)]
        endings = {str(row.policy): {"time limit": 70, "pole fell": 30} for row in rows if row.status == "ok"}
        results.append(CellResult(Cell(env, method, seed), rows, curves, endings))
    return results


def make_row(env: str, method: str, seed: int, policy: str, **values: Any) -> Row:
    numbers: dict[str, Any] = NUMBERS | COSTS if values.get("status", "ok") == "ok" else {}
    return Row(env, method, seed, policy, "absorbing", **{**numbers, **values})  # type: ignore[arg-type]


def entry_of(results: list[CellResult], method: str, policy: str) -> Entry:
    return next(e for e in leaderboard(scored_rows(results)) if (e.method, e.policy) == (method, policy))


def changed(results: list[CellResult], method: str, **values: Any) -> list[CellResult]:
    """Put these values into all rows of the method."""
    for result in results:
        if result.cell.method == method:
            result.rows[:] = [dataclasses.replace(row, **values) for row in result.rows]
    return results
