"""The report of a run, rebuilt from its results alone: scores, leaderboard, figures and one page."""

from __future__ import annotations

import dataclasses
import math
import re
import shlex
from collections import Counter
from collections.abc import Collection, Mapping, Sequence, Sized
from dataclasses import dataclass
from itertools import accumulate, islice
from operator import attrgetter

import pandas as pd
from jinja2 import Environment, StrictUndefined

from harness.judge.leaderboard import (
    Entry,
    by_shown,
    indistinct,
    is_on,
    leaderboard,
    overall,
    scored_rows,
    shown_in,
)
from harness.judge.results import (
    COLUMNS,
    NOMINAL,
    PROGRAM_NAME,
    Cell,
    CellResult,
    Request,
    Row,
    Shown,
    as_seeds,
    command_of,
)
from harness.show import figures
from harness.show.axes import draw_axes

HEADINGS = (
    *("Method", "Role", "Policy", "Seeds ok", "Score [95 %]", "Behind the best [95 %]"),
    *(
        "Above best lower control",
        "Share of control_true",
        "Reward: distance (floor)",
        "Reward: rank",
        "Policies: rank",
    ),
    *("Return [95 %]", "Note"),
)
COST_HEADINGS = ("Method", "Policy", "Seconds", "Env steps", "Check steps", "RL solves", "Discounted return")
OVERALL_HEADINGS = (
    "Method",
    "Policy",
    "Environments",
    "Runs",
    "Interquartile mean [95 %]",
    "Runs below 0.95",
)
SPENT_HEADINGS = ("Stage of a cell", "Seconds, all cells", "Share")
DETAIL_HEADINGS = ("Method", "Detail of its fit", "Mean over seeds")
NO_RESULT = "NOT A RESULT"
MOST_LINES, LONGEST_NOTE = 5000, 5000
"""Of leaderboards on the page and in leaderboard.md, by whole boards; characters of what a line notes."""
MANY_ROWS = 20_000
"""Of a run with more of them there are fewer pictures."""
MOST_DRAWN, MOST_DRAWN_OF_MANY = 100, 6
"""Boards that have pictures."""
MOST_PANELS_OF_MANY = 120
"""Of all pictures then."""
MOST_LISTED = 1000
"""Warnings and recordings on the page, each."""


def report_files(
    request: Request, results: Sequence[CellResult], template: str, recorded: Collection[str]
) -> dict[str, bytes | str]:
    """scores.csv, leaderboard.csv, leaderboard.md, figures/*.png and report.html, by name. template: of the
    last. recorded: names of the recordings that are there.

    A run may be partial: what is not known is an empty field, 'n/a' in tables for people.
    """
    rows = scored_rows(results)
    entries = leaderboard(rows)
    made = _made(request, results)
    files: dict[str, bytes | str] = {
        "scores.csv": _scores_csv(rows, request, results),
        "leaderboard.csv": as_csv(entries, [f.name for f in dataclasses.fields(Entry)]),
    }

    every = _boards(entries, rows, results)
    boards = _first(every, MOST_LINES)
    many = len(rows) > MANY_ROWS
    drawn = dict(islice(boards.items(), MOST_DRAWN_OF_MANY if many else MOST_DRAWN))
    made += _left_out(every, boards, drawn)
    whys = {env: _why_no_result(env, request, results) for env in dict.fromkeys(e.env for e in entries)}
    flags = {name: whys[board.entries[0].env] for name, board in boards.items()}
    tables = {
        name: [
            (HEADINGS, [_cells(entry) for entry in board.entries]),
            (COST_HEADINGS, [_costs(entry) for entry in board.entries]),
            (DETAIL_HEADINGS, _details(board.results)),
        ]
        for name, board in boards.items()
    }
    shown, own = _compared_across(rows)
    left_out = indistinct([e for e in entries if e.dynamics == NOMINAL and e.shown == shown])
    across = [
        [
            *(x.method, x.policy, str(x.envs), str(x.runs)),
            *(_range(x.score, x.low, x.high, "z.2f"), f"{x.below:.0%}"),
        ]
        for x in overall(own, tuple(left_out))
    ]
    several = len({row.env for row in own}) > 1
    apart = [f"{env} is left out: {why}" for env, why in left_out.items()] if several else []
    apart += [f"of boards with {shown}"] if several and str(shown) else []
    flag = f"{NO_RESULT}: " if any(whys.values()) else ""
    parts = [f"# {flag}Leaderboard\n", "".join(f"- {_escaped(line)}\n" for line in made)]
    if across or apart:
        said = "".join(f"- {_escaped(line)}\n" for line in apart)
        table = markdown(OVERALL_HEADINGS, across) if across else ""
        parts.append(f"## Across environments\n\n{said}\n{table}")
    for name, its_tables in tables.items():
        text = "\n".join(markdown(headings, table) for headings, table in its_tables if table)
        parts.append(f"## {name}{f': {NO_RESULT}, {flags[name]}' if flags[name] else ''}\n\n{text}")
    origins, spent = _origins(results), _spent(results)
    if spent:
        parts.append(f"## Where the time went\n\n{markdown(SPENT_HEADINGS, spent)}")
    parts.append("## Computed with\n\n" + "".join(f"- {_escaped(line)}\n" for line in origins))
    files["leaderboard.md"] = "\n".join(parts)

    pictures = {}
    for name, board in drawn.items():
        pictures[name] = figures.draw(
            name,
            board.entries,
            board.rows,
            board.results,
            len(drawn),
            f"{NO_RESULT}: {flags[name]}" if flags[name] else "",
            MOST_PANELS_OF_MANY if many else figures.MOST_IN_ALL,
        )
        files |= {f"figures/{picture.file}": picture.png for picture in pictures[name]}

    over = {
        env: draw_axes(
            env,
            [e for e in entries if e.env == env],
            f"{NO_RESULT}: {whys[env]}" if whys[env] else "",
        )
        for env in dict.fromkeys(board.entries[0].env for board in drawn.values())
    }
    files |= {f"figures/{one.file}": one.png for its in over.values() for one in its}

    kept = {*recorded}
    there = sorted(name for result in results for name in result.recordings if name in kept)
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    files["report.html"] = environment.from_string(template).render(
        flag=flag,
        top="what the demonstrations return" if request.conditions.experts == "none" else "the expert",
        flags=flags,
        no_result=NO_RESULT,
        made=made,
        tables=tables,
        overall_headings=OVERALL_HEADINGS,
        overall=across,
        left_out=apart,
        pictures=pictures,
        over=[one for its in over.values() for one in its],
        endings={name: _endings(board.results) for name, board in boards.items()},
        warnings=_some(_warnings(results, rows), "scores.csv has every row"),
        origins=origins,
        spent_headings=SPENT_HEADINGS,
        spent=spent,
        recordings=[
            (name, f"rerun {shlex.quote(f'recordings/{name}')} --bind 127.0.0.1")
            for name in there[:MOST_LISTED]
        ],
        more_recordings=max(0, len(there) - MOST_LISTED),
    )
    return files


@dataclass(frozen=True)
class Board:
    """What is compared with each other: lines, and what they are of."""

    entries: list[Entry]
    rows: list[Row]
    results: list[CellResult]


def _boards(entries: Sequence[Entry], rows: Sequence[Row], results: Sequence[CellResult]) -> dict[str, Board]:
    """By name."""
    by_name: dict[str, list[Entry]] = {}
    for entry in entries:
        by_name.setdefault(entry.board, []).append(entry)
    by_task: dict[str, tuple[list[Row], list[CellResult]]] = {}
    for row in rows:
        by_task.setdefault(row.task, ([], []))[0].append(row)
    for result in results:
        by_task[result.cell.task][1].append(result)
    of_task = {
        task: (by_shown(its_rows, lambda row: row), by_shown(its_results, lambda result: result.rows[0]))
        for task, (its_rows, its_results) in by_task.items()
    }
    boards = {}
    for name, its in by_name.items():
        its_rows, its_results = of_task[its[0].task]
        boards[name] = Board(its, its_rows[its[0].shown], its_results[its[0].shown])
    return boards


def _first(boards: Mapping[str, Board], most: int) -> dict[str, Board]:
    """Those that have so many lines together, and one at least."""
    lines = list(accumulate(len(board.entries) for board in boards.values()))
    fit = max(1, sum(count <= most for count in lines))
    return dict(islice(boards.items(), fit))


def _left_out(every: Sized, shown: Sized, drawn: Sized) -> list[str]:
    """What of all boards is not shown, or not drawn, a line each."""
    lines = []
    if len(shown) < len(every):
        lines.append(
            f"the first {len(shown):,} of {len(every):,} boards are shown; leaderboard.csv has the lines of "
            "all, scores.csv their rows"
        )
    if len(drawn) < len(shown):
        lines.append(f"pictures are of the first {len(drawn):,} boards")
    return lines


def _some(lines: Sequence[str], elsewhere: str) -> list[str]:
    """The first of them, and how many more there are."""
    more = len(lines) - MOST_LISTED
    return [*lines[:MOST_LISTED], *([f"and {more:,} more; {elsewhere}"] if more > 0 else [])]


def _compared_across(rows: Sequence[Row]) -> tuple[Shown, list[Row]]:
    """What is shown to those that are compared across envs, the first that is shown anywhere; and their rows,
    in dynamics as they are."""
    nominal = [row for row in rows if row.dynamics == NOMINAL]
    shown = shown_in(nominal)[0]
    return shown, [row for row in nominal if is_on(row, shown)]


def _seeds(seeds: Sequence[int]) -> str:
    if len(seeds) == 1:
        return f"seed {seeds[0]}"
    return f"seeds 0 to {len(seeds) - 1}" if seeds[-1] == len(seeds) - 1 else f"seeds {as_seeds(seeds)}"


def _made(request: Request, results: Sequence[CellResult]) -> list[str]:
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


def _why_no_result(env: str, request: Request, results: Sequence[CellResult]) -> str:
    """Why an environment's numbers are none to quote, '' where they are."""
    if request.conditions.budget == "smoke":
        return "budget smoke only shows that everything runs"
    below = sorted(r.cell.seed for r in results if r.below_bar and r.cell.env == env)
    seeds = ", ".join(map(str, below))
    return f"the expert of seed {seeds} misses its bar" if below else ""


def _details(results: Sequence[CellResult]) -> list[list[str]]:
    """What methods tell of their fits, means over seeds."""
    found: dict[tuple[str, str], list[float]] = {}
    for result in results:
        for name, value in result.details.items():
            found.setdefault((result.cell.method, name), []).append(value)
    means = {key: sum(values) / len(values) for key, values in found.items()}
    return [[*key, f"{mean:,.0f}" if mean >= 100 else f"{mean:.2g}"] for key, mean in sorted(means.items())]


def _scores_csv(rows: Sequence[Row], request: Request, results: Sequence[CellResult]) -> str:
    """The rows, with what each was computed under."""
    cells = {result.cell: result for result in results}
    frame = _frame(rows, COLUMNS)
    conditions = request.conditions
    frame["budget"], frame["rl"] = conditions.budget, conditions.rl
    mine = [cells[Cell(row.env, row.method, row.seed, row.shown, row.dynamics)] for row in rows]
    frame["program"] = [result.origin.get(PROGRAM_NAME, "") for result in mine]
    frame["finished"] = [result.finished for result in mine]
    return frame.to_csv(index=False, lineterminator="\n")


def as_csv(items: Sequence[Row] | Sequence[Entry], columns: Sequence[str]) -> str:
    """A table of the items, a line each, which a spreadsheet shows as it is."""
    return _frame(items, columns).to_csv(index=False, lineterminator="\n")


def _frame(items: Sequence[Row] | Sequence[Entry], columns: Sequence[str]) -> pd.DataFrame:
    frame = pd.DataFrame(map(attrgetter(*columns), items), columns=list(columns))
    for name in ("reason", "note"):
        if name in frame:  # A spreadsheet would compute what begins like this.
            frame[name] = ["'" + text if text.startswith(tuple("=+-@")) else text for text in frame[name]]
    return frame


def _number(value: float, spec: str) -> str:
    return format(value, spec) if math.isfinite(value) else "n/a"


def _range(mean: float, low: float, high: float, spec: str) -> str:
    return _number(mean, spec) + (f" [{low:{spec}}, {high:{spec}}]" if math.isfinite(low) else "")


def _with_floor(entry: Entry) -> str:
    floor = f" ({entry.reward_floor:z.2f})" if math.isfinite(entry.reward_floor) else ""
    return _number(entry.reward_distance, "z.2f") + floor


def _cells(entry: Entry) -> list[str]:
    """The entry for people, in the order of HEADINGS."""
    behind = _range(entry.behind_mean, entry.behind_low, entry.behind_high, "+z.2f")
    if math.isfinite(entry.behind_mean):
        behind += " tied" if entry.tied else ""
    elif entry.role == "method" and math.isfinite(entry.score_mean):
        behind = "the best"
    else:
        behind = ""
    learned = entry.policy == "pi_R"
    note = [entry.note] if entry.note else []
    if entry.varies == "episodes" and math.isfinite(entry.return_low):
        note.append("one seed: intervals are over episodes")
    noted = " ".join("; ".join(note).split())
    if len(noted) > LONGEST_NOTE:
        noted = f"{noted[:LONGEST_NOTE]} … (all of it in leaderboard.csv)"
    return [
        entry.method,
        entry.role,
        entry.policy,
        f"{entry.seeds_ok} of {entry.seeds}",
        _range(entry.score_mean, entry.score_low, entry.score_high, "z.2f"),
        behind,
        _number(entry.above_best_lower_control, "+z.2f") if learned else "",
        _number(entry.share_of_true, "z.2f") if learned else "",
        _with_floor(entry) if learned else "",
        _number(entry.reward_rank, "z.2f") if learned else "",
        _number(entry.policy_ranking, "z.2f") if learned else "",
        _range(entry.return_mean, entry.return_low, entry.return_high, ".1f"),
        noted,
    ]


def _costs(entry: Entry) -> list[str]:
    """What it cost, in the order of COST_HEADINGS."""
    return [
        entry.method,
        entry.policy,
        _number(entry.fit_seconds, ".1f"),
        _number(entry.env_steps, ",.0f"),
        _number(entry.check_steps, ",.0f"),
        _number(entry.rl_solves, ".0f"),
        _number(entry.discounted_mean, "z.2f"),
    ]


def markdown(headings: Sequence[str], table: Sequence[Sequence[str]]) -> str:
    lines = [headings, ["---"] * len(headings), *table]
    return "".join("| " + " | ".join(map(_escaped, line)) + " |\n" for line in lines)


def _escaped(text: str) -> str:
    """For Markdown, in which it is neither table nor HTML nor link."""
    return re.sub(r"([\\|<>&`]|(?<=\])\()", r"\\\1", text)


def _endings(results: Sequence[CellResult]) -> list[tuple[str, str, list[tuple[str, int]]]]:
    """Method, policy, and how many evaluation episodes ended how, over all seeds."""
    counts: dict[tuple[str, str], Counter[str]] = {}
    for result in results:
        for name, endings in result.endings.items():
            counts.setdefault((result.cell.method, name), Counter()).update(endings)
    return [
        (method, policy, sorted(counter.items(), key=lambda item: (-item[1], item[0])))
        for (method, policy), counter in sorted(counts.items())
    ]


def _spent(results: Sequence[CellResult]) -> list[list[str]]:
    """What each stage of the cells took, the longest first."""
    seconds: Counter[str] = Counter()
    for result in results:
        seconds.update(result.seconds)
    total = sum(seconds.values())
    return [[stage, f"{took:.1f}", f"{took / total:.0%}"] for stage, took in seconds.most_common() if took]


def _origins(results: Sequence[CellResult]) -> list[str]:
    """The machines and versions that cells were computed with, and how many cells with each."""
    lines = (", ".join(f"{name} {value}" for name, value in result.origin.items()) for result in results)
    return [f"{count} cells: {line}" for line, count in sorted(Counter(lines).items())]


def _warnings(results: Sequence[CellResult], rows: Sequence[Row]) -> list[str]:
    found = [f"{r.cell.name}: {text}" for r in sorted(results, key=lambda r: r.cell) for text in r.warnings]
    unscored = {(r.task, r.seed) for r in rows if r.status == "ok" and math.isnan(r.normalized_score)}
    machines = {tuple((k, v) for k, v in r.origin.items() if k != PROGRAM_NAME) for r in results}
    if len(machines) > 1:
        found.append("the cells were computed on different machines or with different versions, see the end")
    for task, seed in sorted(unscored):
        found.append(
            f"{task}, seed {seed}: no scores: what would score 1 is missing, or no better than random"
        )
    return found
