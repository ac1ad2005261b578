"""What a report says besides scores: what was asked for, what computed it, how episodes ended, warnings."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

from harness.judge import effort
from harness.judge.command_line import as_seeds, command_of
from harness.judge.results import PROGRAM_NAME, CellResult, Request, Row
from harness.show.tables import Item, Number, Table, number

NO_RESULT = "NOT A RESULT"


def made(request: Request, results: Sequence[CellResult]) -> list[str]:
    """What was asked for and what computed it, a line each."""
    conditions = request.conditions
    experts = sorted({row.expert.partition(":")[0] for r in results for row in r.rows if row.expert})
    commits = sorted({r.origin[PROGRAM_NAME] for r in results if PROGRAM_NAME in r.origin})
    days = sorted(r.finished.partition(" ")[0] for r in results if r.finished)
    spans = f"{days[0]} to {days[-1]}" if days and days[0] != days[-1] else "".join(days[:1])
    instructions = "fixed" if conditions.deterministic else "of the machine"
    asked = {*request.cells}
    there = sum(result.cell in asked for result in results)
    others = sorted({r.cell.seed for r in results if any(row.source for row in r.rows)})
    seeds = _seeds(request.seeds) + (f" (of the baseline: {_seeds(others)})" if others else "")
    told = ", ".join(experts) or "unknown"
    if conditions.experts == "none":
        told = "a score of 1 is the mean return of the demonstrations"
    return [
        *([f"not complete: {there} of the {len(asked)} cells asked for"] if there < len(asked) else []),
        f"budget {conditions.budget}, protocol {conditions.protocol}, {seeds}, "
        f"RL library {conditions.rl}, instructions {instructions}",
        f"experts {conditions.experts}: {told}",
        *([f"demonstrations of a file, {conditions.demonstrations}"] if conditions.demonstrations else []),
        f"computed {spans or 'once'} by irl-bench {', '.join(commits) or 'of an unknown commit'}",
        f"command: {command_of(request, bool(others))}",
    ]


def _seeds(seeds: Sequence[int]) -> str:
    if len(seeds) == 1:
        return f"seed {seeds[0]}"
    return f"seeds 0 to {len(seeds) - 1}" if seeds[-1] == len(seeds) - 1 else f"seeds {as_seeds(seeds)}"


def why_no_result(env: str, request: Request, results: Sequence[CellResult]) -> str:
    """Why an environment's numbers are none to quote, '' where they are."""
    if request.conditions.budget == "smoke":
        return "budget smoke only shows that everything runs"
    below = sorted({r.cell.seed for r in results if r.below_bar and r.cell.env == env})
    seeds = ", ".join(map(str, below))
    return f"the expert of seed {seeds} misses its bar" if below else ""


def warnings(results: Sequence[CellResult], rows: Sequence[Row], budget: str) -> list[str]:
    """What the reader must be told, a line each. results: in order."""
    found = [f"{r.cell.name}: {text}" for r in results for text in r.warnings]
    found += effort.warnings(results, budget)
    unscored = {(r.task, r.seed) for r in rows if r.status == "ok" and math.isnan(r.normalized_score)}
    machines = {tuple((k, v) for k, v in r.origin.items() if k != PROGRAM_NAME) for r in results}
    if len(machines) > 1:
        found.append("the cells were computed on different machines or with different versions, see the end")
    for task, seed in sorted(unscored):
        found.append(
            f"{task}, seed {seed}: no scores: what would score 1 is missing, or no better than random"
        )
    return found


def details(name: str, results: Sequence[CellResult]) -> Table:
    """What methods tell of their fits, means over seeds."""
    found: dict[tuple[str, str], list[float]] = {}
    for result in results:
        for detail, value in result.details.items():
            found.setdefault((result.cell.method, detail), []).append(value)
    lines: list[list[Item]] = []
    for key, values in sorted(found.items()):
        mean = sum(values) / len(values)
        lines.append([*key, number(mean, ",.0f" if abs(mean) >= 100 else ".2g")])
    return Table(name, ("Method", "Detail of its fit", "Mean over seeds"), lines)


def endings(name: str, results: Sequence[CellResult]) -> Table:
    """How many evaluation episodes ended how, over all seeds."""
    counts: dict[tuple[str, str], Counter[str]] = {}
    for result in results:
        for policy, its in result.endings.items():
            counts.setdefault((result.cell.method, policy), Counter()).update(its)
    lines: list[list[Item]] = [
        [*key, ", ".join(f"{reason} {count}" for reason, count in _by_count(counter))]
        for key, counter in sorted(counts.items())
    ]
    return Table(name, ("Method", "Policy", "Episodes by ending"), lines)


def _by_count(counter: Counter[str]) -> list[tuple[str, int]]:
    return sorted(counter.items(), key=lambda item: (-item[1], item[0]))


def spent(results: Sequence[CellResult]) -> Table:
    """What each stage of the cells took, the longest first."""
    seconds: Counter[str] = Counter()
    for result in results:
        seconds.update(result.seconds)
    total = sum(seconds.values())
    lines: list[list[Item]] = [
        [stage, number(took, ".1f"), Number(f"{took / total:.0%}", took / total)]
        for stage, took in seconds.most_common()
        if took
    ]
    return Table("time", ("Stage of a cell", "Seconds, all cells", "Share"), lines)


def origins(results: Sequence[CellResult]) -> list[str]:
    """The machines and versions that cells were computed with, and how many cells with each."""
    lines = (", ".join(f"{name} {value}" for name, value in result.origin.items()) for result in results)
    return [f"{count} cells: {line}" for line, count in sorted(Counter(lines).items())]
