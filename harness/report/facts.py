"""Facts of a report besides scores: the request, machines, time, the ends of episodes, warnings."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Mapping, Sequence

from harness.judge import effort
from harness.records import PROGRAM_NAME, CellResult, Row
from harness.report.columns import MEANINGS, NAMES, NO_SCORE
from harness.report.tables import Table, Value, at, number
from harness.store.names import compared_in
from harness.store.request import Request, as_seeds, command_of

NO_RESULT = "NOT A RESULT"
METHOD = at(0, "method", "Method", MEANINGS["method"], "choice")
DETAILS = (
    METHOD,
    at(1, "detail", "Detail of its fit", "The number's name in the method.", "text"),
    at(2, "detail_mean", "Mean over seeds", "The mean over the seeds that report it."),
)
ENDINGS = (
    METHOD,
    at(1, "policy", "Policy", MEANINGS["policy"], "choice"),
    at(2, "endings", "Episodes by ending", "Evaluation episodes of all seeds, by ending.", "note"),
)
STAGES = (
    at(0, "stage", "Stage of a cell", "Stages in turn; 'start' is the process's other time.", "text"),
    at(1, "stage_seconds", "Seconds, all cells", "Wall time, summed over all cells."),
    at(2, "stage_share", "Share", "Share of the time of all stages."),
)
RECORDINGS = (
    at(0, "recording", "Recording", "The file in recordings/.", "text"),
    at(1, "play", "Play", "The command that plays it, to be run in this page's folder.", "text"),
)


def conditions(request: Request, results: Sequence[CellResult]) -> list[str]:
    """Return what was asked for and what computed it, a line each."""
    asked, its = {*request.cells}, request.conditions
    done = sum(result.cell in asked for result in results)
    experts = {row.expert.partition(":")[0] for r in results for row in r.rows if row.expert}
    commits = sorted({r.origin[PROGRAM_NAME] for r in results if PROGRAM_NAME in r.origin})
    days = sorted({r.finished.partition(" ")[0] for r in results if r.finished})
    others = sorted({r.cell.seed for r in results if any(row.source for row in r.rows)})
    seeds = _seeds(request.seeds) + (f" (of the baseline: {_seeds(others)})" if others else "")
    source = ", ".join(sorted(experts)) or "unknown"
    if its.experts == "none":
        source = "a score of 1 is the mean return of the demonstrations"
    lines = [f"not complete: {done} of the {len(asked)} cells asked for"] if done < len(asked) else []
    lines += [
        f"budget {its.budget}, protocol {its.protocol}, {seeds}, RL library {its.rl}, "
        f"instructions {'fixed' if its.deterministic else 'of the machine'}",
        f"experts {its.experts}: {source}",
    ]
    lines += [f"demonstrations of a file, {its.demonstrations}"] if its.demonstrations else []
    lines += [f"arguments of the tasks {its.env_kwargs}"] if its.env_kwargs else []
    lines += [f"variables of the environment {its.env_vars}"] if its.env_vars else []
    lines += [f"encoder of images {its.encoder}"] if its.encoder else []
    when = " to ".join(dict.fromkeys([*days[:1], *days[-1:]])) or "once"
    return [*lines, f"computed {when} by irl-bench {', '.join(commits) or 'of an unknown commit'}"]


def command(request: Request, results: Sequence[CellResult]) -> str:
    """Return the command that asks for it."""
    return f"command: {command_of(request, any(row.source for r in results for row in r.rows))}"


def _seeds(seeds: Sequence[int]) -> str:
    if len(seeds) == 1:
        return f"seed {seeds[0]}"
    return f"seeds 0 to {len(seeds) - 1}" if seeds[-1] == len(seeds) - 1 else f"seeds {as_seeds(seeds)}"


def why_no_result(env: str, request: Request, results: Sequence[CellResult]) -> str:
    """Return why an environment's numbers are not to be quoted; an empty text where they are."""
    if request.conditions.budget == "smoke":
        return "budget smoke only shows that everything runs"
    below = sorted({r.cell.seed for r in results if r.below_bar and r.cell.env == env})
    which = ", ".join(map(str, below))
    return f"the expert of seed {which} misses its bar, or is no better than chance" if below else ""


def warnings(results: Sequence[CellResult], rows: Sequence[Row], budget: str) -> list[str]:
    """Return the warnings for readers, a line each."""
    named = [(r.cell.name, text) for r in results for text in r.warnings]
    lines = [text if text.startswith(name) else f"{name}: {text}" for name, text in named]
    lines += effort.warnings(results, budget)
    machines = {tuple((k, v) for k, v in r.origin.items() if k != PROGRAM_NAME) for r in results}
    if len(machines) > 1:
        lines.append("the cells were computed on different machines or with different versions, see the end")
    unscored = {(r.task, r.seed) for r in rows if r.status == "ok" and math.isnan(r.normalized_score)}
    return lines + [f"{task}, seed {seed}: {NO_SCORE}" for task, seed in sorted(unscored)]


def details(name: str, results: Sequence[CellResult]) -> Table:
    """Return the numbers that methods report of their fits, in the order of the results."""
    values: dict[tuple[str, str], list[float]] = {}
    for result in results:
        for detail, value in sorted(result.details.items()):
            values.setdefault((result.cell.method, detail), []).append(value)
    means = {key: sum(mine) / len(mine) for key, mine in values.items()}
    lines = [(*key, number(mean, ",.0f" if abs(mean) >= 100 else ".2g")) for key, mean in means.items()]
    return Table(name, DETAILS, lines)


def endings(name: str, results: Sequence[CellResult]) -> Table:
    """Return how evaluation episodes ended, in the order of the results."""
    counts: dict[tuple[str, str], Counter[str]] = {}
    for result in results:
        for policy, mine in sorted(result.endings.items()):
            counts.setdefault((result.cell.method, NAMES.get(policy, policy)), Counter()).update(mine)
    return Table(name, ENDINGS, [(*key, _in_words(mine)) for key, mine in counts.items()])


def _in_words(counts: Mapping[str, int]) -> str:
    ordered = sorted(counts.items(), key=lambda item: (-item[1], item[0]))
    return ", ".join(f"{reason} {count}" for reason, count in ordered)


def spent(results: Sequence[CellResult]) -> Table:
    """Return the time of each stage of the cells, the longest first."""
    seconds: Counter[str] = Counter()
    for result in results:
        seconds.update(result.seconds)
    total = sum(seconds.values())
    known = [(name, took) for name, took in seconds.most_common() if took]
    lines = [(name, number(took, ".1f"), Value(f"{took / total:.0%}", took / total)) for name, took in known]
    return Table("time", STAGES, lines)


def origins(results: Sequence[CellResult]) -> list[str]:
    """Return the machines and versions that cells were computed with, and the number of cells with each."""
    lines = (", ".join(f"{name} {value}" for name, value in result.origin.items()) for result in results)
    return [f"{count} cells: {line}" for line, count in sorted(Counter(lines).items())]


def recordings(request: Request, results: Sequence[CellResult], recorded: Collection[str]) -> Table:
    """Return the recordings that exist: all methods on one episode, then each policy, methods first."""
    exist, play = {*recorded}, "irl-bench view . --env"
    names = [compared_in(env) for env in request.envs]
    lines = [(n, f"{play} {env} --compare") for n, env in zip(names, request.envs, strict=True) if n in exist]
    own = [
        (name, f"{play} {result.cell.env} --method {result.cell.method}")
        for result in results
        for name in sorted(result.recordings.keys() & exist)
    ]
    own.sort(key=lambda line: (line[0].split("__")[0], "__control_" in line[0]))
    return Table("recordings", RECORDINGS, lines + own)
