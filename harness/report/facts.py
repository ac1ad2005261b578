"""Facts of a report besides scores: the request, machines, time, the ends of episodes, warnings."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Sequence

from harness.judge import effort
from harness.records import PROGRAM_NAME, CellResult, Row
from harness.report.columns import METHOD, NAMES, POLICY
from harness.report.tables import Column, Table, Value, number
from harness.store.names import compared_in
from harness.store.request import Request, as_seeds, command_of

NO_RESULT = "NOT A RESULT"
DETAILS = (
    METHOD.at(0),
    Column("detail", "Detail of its fit", "The number's name in the method.", str, "text").at(1),
    Column("detail_mean", "Mean over seeds", "The mean over the seeds that report it.", str).at(2),
)
ENDINGS = (
    METHOD.at(0),
    POLICY.at(1),
    Column("endings", "Episodes by ending", "Evaluation episodes of all seeds, by ending.", str, "note").at(
        2
    ),
)
STAGES = (
    Column(
        "stage", "Stage of a cell", "Stages in turn; 'start' is the process's other time.", str, "text"
    ).at(0),
    Column("stage_seconds", "Seconds, all cells", "Wall time, summed over all cells.", str).at(1),
    Column("stage_share", "Share", "Share of the time of all stages.", str).at(2),
)
RECORDINGS = (
    Column("recording", "Recording", "The file in recordings/.", str, "text").at(0),
    Column("recorded_score", "Score", "Mean score of all episodes of the policy.", str).at(1),
    Column(
        "ended", "How all episodes ended", "Evaluation episodes of the policy, by ending.", str, "note"
    ).at(2),
    Column("play", "Play", "The command that plays it, to be run in this page's folder.", str, "text").at(3),
)


def made(request: Request, results: Sequence[CellResult]) -> list[str]:
    """Return what was asked for and what computed it, a line each; the last is the command."""
    conditions = request.conditions
    asked = {*request.cells}
    done = sum(result.cell in asked for result in results)
    experts = {row.expert.partition(":")[0] for r in results for row in r.rows if row.expert}
    commits = sorted({r.origin[PROGRAM_NAME] for r in results if PROGRAM_NAME in r.origin})
    days = sorted({r.finished.partition(" ")[0] for r in results if r.finished})
    others = sorted({r.cell.seed for r in results if any(row.source for row in r.rows)})
    seeds = _seeds(request.seeds) + (f" (of the baseline: {_seeds(others)})" if others else "")
    source = ", ".join(sorted(experts)) or "unknown"
    if conditions.experts == "none":
        source = "a score of 1 is the mean return of the demonstrations"
    return [
        *([f"not complete: {done} of the {len(asked)} cells asked for"] if done < len(asked) else []),
        f"budget {conditions.budget}, protocol {conditions.protocol}, {seeds}, RL library {conditions.rl}, "
        f"instructions {'fixed' if conditions.deterministic else 'of the machine'}",
        f"experts {conditions.experts}: {source}",
        *([f"demonstrations of a file, {conditions.demonstrations}"] if conditions.demonstrations else []),
        f"computed {' to '.join(dict.fromkeys([*days[:1], *days[-1:]])) or 'once'} by irl-bench "
        f"{', '.join(commits) or 'of an unknown commit'}",
        f"command: {command_of(request, bool(others))}",
    ]


def _seeds(seeds: Sequence[int]) -> str:
    if len(seeds) == 1:
        return f"seed {seeds[0]}"
    return f"seeds 0 to {len(seeds) - 1}" if seeds[-1] == len(seeds) - 1 else f"seeds {as_seeds(seeds)}"


def why_no_result(env: str, request: Request, results: Sequence[CellResult]) -> str:
    """Return why an environment's numbers are not to be quoted; an empty text where they are."""
    if request.conditions.budget == "smoke":
        return "budget smoke only shows that everything runs"
    below = sorted({r.cell.seed for r in results if r.below_bar and r.cell.env == env})
    return f"the expert of seed {', '.join(map(str, below))} misses its bar" if below else ""


def warnings(results: Sequence[CellResult], rows: Sequence[Row], budget: str) -> list[str]:
    """Return the warnings for readers, a line each."""
    lines = [f"{r.cell.name}: {text}" for r in results for text in r.warnings]
    lines += effort.warnings(results, budget)
    machines = {tuple((k, v) for k, v in r.origin.items() if k != PROGRAM_NAME) for r in results}
    if len(machines) > 1:
        lines.append("the cells were computed on different machines or with different versions, see the end")
    unscored = {(r.task, r.seed) for r in rows if r.status == "ok" and math.isnan(r.normalized_score)}
    return lines + [
        f"{task}, seed {seed}: no scores: the return that would score 1 is missing, or no better than random"
        for task, seed in sorted(unscored)
    ]


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
            key = result.cell.method, NAMES.get(policy, policy)
            counts.setdefault(key, Counter()).update(mine)
    return Table(name, ENDINGS, [(*key, _in_words(counter)) for key, counter in counts.items()])


def _in_words(counts: dict[str, int]) -> str:
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


def recordings(
    request: Request, results: Sequence[CellResult], rows: Sequence[Row], recorded: Collection[str]
) -> Table:
    """Return the recordings that exist: all methods on one episode, then each policy, methods first."""
    exist, play = {*recorded}, "irl-bench view . --env"
    scores: dict[tuple[object, ...], float] = {}
    for row in rows if exist else ():
        scores[row.task, row.method, row.seed, row.shown, row.policy] = row.normalized_score
    lines = []
    for result in results:
        cell = result.cell
        for name in sorted(result.recordings.keys() & exist):
            policy = next((p for p in result.endings if name.startswith(f"{cell.name}__{p}.")), None)
            score = scores.get((cell.task, cell.method, cell.seed, cell.shown, policy), math.nan)
            ended = _in_words(result.endings[policy]) if policy else ""
            command = f"{play} {cell.env} --method {cell.method}"
            lines.append((name, number(score, "z.2f"), ended, command))
    lines.sort(key=lambda line: (line[0].split("__")[0], "__control_" in line[0]))
    compared = [
        (compared_in(env), Value(""), "all methods on one episode", f"{play} {env} --compare")
        for env in request.envs
        if compared_in(env) in exist
    ]
    return Table("recordings", RECORDINGS, [*compared, *lines])
