"""The command line. Exit codes: 0 done; 1 a cell failed, a file is damaged, a bar of `bench` or of an
expert is missed, or the output could not be written; 2 bad input; 130 stopped, such as by Ctrl-C."""

from __future__ import annotations

import argparse
import importlib.util
import json
import logging
import os
import shlex
import subprocess
import sys
import threading
from collections.abc import Sequence
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

from harness.arguments import parser
from harness.registry import ENVS, GROUPS, METHODS, VARIANTS, BadInput, choose
from harness.run.environment import can_fix_instructions
from harness.run.signals import ignore_stops, stop_cleanly

if TYPE_CHECKING:
    from harness.judge.results import Cell, CellResult, Request
    from harness.run.engines import Engine
    from harness.run.store import RunDirectory

MOST_NAMED = 20
"""Files that a line names, but for the first."""


def main(argv: Sequence[str] | None = None) -> int:
    """Does what `argv` (default: the command line) asks for; returns the exit code."""
    argv = list(sys.argv[1:] if argv is None else argv)
    try:
        return _dispatch(argv)
    except (BadInput, OSError, ImportError) as error:
        print(f"irl-bench: error: {_plain(' '.join(str(error).split()))}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        ignore_stops()
        again = _plain(shlex.join([*_program(), *argv]))
        kept = "what is finished is kept. To go on, run the same again:\n  " + again
        resumes = argv[0] in ("run", "reproduce") or argv[:2] == ["experts", "train"]
        print(f"\nstopped; {kept if resumes else 'nothing is kept'}", file=sys.stderr)
        return 130


def _program() -> list[str]:
    """What the user typed, or may type, to start this program."""
    name = sys.argv[0]
    return [sys.executable, "-m", "harness"] if Path(name).name == "__main__.py" else [name]


def _plain(text: str) -> str:
    """The text with all escaped that is not shown as it is."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def _dispatch(argv: list[str]) -> int:
    try:
        args = parser().parse_args(argv)
    except SystemExit:  # --help, the only other way out of a parser whose error() raises
        return 0
    if args.command == "list":
        return _list()
    _check_python()
    if args.command == "report":
        return _report(args.directory)
    if args.command == "verify":
        return _verify(args.directory)
    if args.command == "bench":
        return _bench(args.json)
    if args.command == "experts":
        return _experts(args)
    if args.command == "reproduce":
        return _reproduce(args)
    return _run(args)


def _check_python() -> None:
    """Raises BadInput where Python was started in a way in which cells cannot be computed."""
    if sys.flags.optimize > 1:
        raise BadInput("run Python without -OO and PYTHONOPTIMIZE: libraries need their docstrings")
    if sys.flags.ignore_environment:
        raise BadInput(
            "run Python without -E and -I: processes of cells are told by variables what to import"
        )
    for name in ("envs", "methods"):
        spec = importlib.util.find_spec(name)
        found = Path(spec.origin) if spec and spec.origin else Path(name).absolute()
        if found.resolve() != Path(__file__).resolve().parents[1] / name / "__init__.py":
            raise BadInput(f"{found} hides this program's package {name!r}; run it from another folder")


def _list() -> int:
    methods, variants = ({n: e.summary for n, e in table.items()} for table in (METHODS, VARIANTS))
    envs = {name: entry.summary for name, entry in ENVS.items()}
    groups = {name: ", ".join(members) for name, members in GROUPS.items()}
    sections = {"methods": methods, "variants of methods, not part of 'all'": variants}
    sections |= {"envs": envs, "groups of envs": groups}
    width = max(len(name) for section in sections.values() for name in section)
    for title, section in sections.items():
        print(f"{title}:")
        for name, summary in section.items():
            print(f"  {name:{width}} {summary}")
    return 0


def _run(args: argparse.Namespace) -> int:
    methods = choose("method", args.methods, METHODS, VARIANTS)
    envs = choose("env", args.envs, ENVS, groups=GROUPS)
    # Imported here, for `--help` and `list` to answer at once.
    from harness.judge.results import Conditions, Request, Shown
    from harness.run.store import open_for_run

    _prepare()
    seeds = args.seeds or tuple(range(5 if args.budget == "full" else 1))
    fixed = _is_deterministic(args)
    conditions = Conditions(
        args.budget, args.protocol, args.rl, fixed, args.experts, args.record, not args.no_retrain
    )
    shown = tuple(Shown(demos, args.subsample, args.demonstrator) for demos in args.demos)
    if args.demonstrator == "medium" and args.experts == "trained":
        raise BadInput("medium demonstrators are shipped ones; leave out --experts trained")
    variants = _variants(envs) if args.transfer else ()
    request = Request(methods, envs, seeds, conditions, shown, variants)
    _handle_signals()
    engine = _engine(args, envs)
    if args.engine == "inline":
        _check_all_inline(args.out, engine)
    with open_for_run(args.out, request, engine.variables) as run:
        results = _compute(run, request, args, engine)
        whole = _write_report(run, list(results.values()), anew=False)
        failed = _tell_troubles([results[cell] for cell in request.cells])
    return int(failed or not whole)


def _variants(envs: Sequence[str]) -> tuple[str, ...]:
    """Tasks of other dynamics. Raises BadInput where there are none."""
    from harness.registry import SPECS

    found = tuple(f"{env}.{name}" for env in envs for name in SPECS[env].variants)
    if not found:
        raise BadInput(f"there are no other dynamics of {', '.join(envs)} to carry anything over to")
    return found


def _is_deterministic(args: argparse.Namespace) -> bool:
    return not args.fast and can_fix_instructions()


def _reproduce(args: argparse.Namespace) -> int:
    from harness.judge.results import Conditions, Request, Shown
    from harness.reproduce import ENVS, PROTOCOLS, STUDIED, TRAJECTORIES, open_study, write_study
    from harness.run.progress import say
    from harness.run.request import merged
    from harness.run.store import open_for_run

    _prepare()
    _handle_signals()
    engine, found = _engine(args, ENVS), {}
    with open_study(args.out):
        requests, fixed = {}, _is_deterministic(args)
        for protocol in PROTOCOLS:
            conditions = Conditions(args.budget, protocol, "sbx", fixed, "trained", args.record)
            shown = tuple(map(Shown, TRAJECTORIES))
            requests[protocol] = Request(STUDIED, ENVS, args.seeds, conditions, shown)
            merged(args.out / protocol, requests[protocol])  # refused now, and not hours later
        for protocol, request in requests.items():
            with open_for_run(args.out / protocol, request, engine.variables) as run:
                results = _compute(run, request, args, engine)
            found[protocol] = [results[cell] for cell in request.cells]
        write_study(args.out, found)
        say("\n" + _text(args.out / "study.md"))
    return int(_tell_troubles([result for results in found.values() for result in results]))


def _prepare() -> None:
    """Raises BadInput where nothing could be computed or drawn, before anything is written."""
    from harness.run import keys, scratch

    scratch.remove_abandoned(scratch.base())
    keys.versions(keys.PACKAGES)
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # such as where it would keep fonts
    if keys.TEMPLATE not in keys.program():
        raise BadInput(f"{keys.TEMPLATE} is missing; install the program again")
    try:
        importlib.import_module("harness.run.isolated")
        importlib.import_module("harness.run.grid")
        importlib.import_module("harness.run.reporting")
    except (ImportError, ValueError, SyntaxError) as error:  # such as of a matplotlibrc that is no text
        raise BadInput(f"nothing can draw the report: {error}") from error


def _bench(as_json: bool) -> int:
    from harness.run.processes import as_in_cells
    from harness.run.progress import say, tell

    measures, missed = [], False
    with as_in_cells():
        from harness.bench import bench  # in that environment
        from harness.growth import growth
        from harness.run.keys import origin

        try:
            for measure in chain(bench(), growth()):
                measures.append(measure.to_json())
                missed |= measure.missed
                if as_json:
                    tell(str(measure))
                else:
                    say(str(measure))
        except (RuntimeError, subprocess.SubprocessError) as error:
            tell(f"FAILED: {error}")
            missed = True
        if as_json:
            say(json.dumps({"cores": os.cpu_count(), **origin(), "measures": measures}, indent=1))
    return int(missed)


def _experts(args: argparse.Namespace) -> int:
    envs = choose("env", ",".join(args.envs), ENVS, groups=GROUPS)
    from harness import expert_training
    from harness.registry import SPECS
    from harness.run import expert_set
    from harness.run.scratch import base

    base()
    _handle_signals()
    if none := [env for env in envs if not SPECS[env].shipped and "all" not in args.envs]:
        raise BadInput(f"there are no experts of {none[0]} to train or check: its model is known")
    envs = tuple(env for env in envs if SPECS[env].shipped)
    if args.what == "check":
        return int(not expert_training.check(envs, args.dir or expert_set.folder()))
    expert_training.train_all(envs, args.dir or Path("results/experts"), args.workers or _cores())
    return 0


def _engine(args: argparse.Namespace, envs: Sequence[str]) -> Engine:
    """What the cells of these environments are computed on. Raises BadInput for what it cannot do."""
    from harness.run import engines, isolated

    if args.engine == "isolated":
        modules = [ENVS[env].target.partition(":")[0] for env in envs]
        fixed = _is_deterministic(args)
        return isolated.Isolated(args.workers or _cores(), args.cell_timeout, fixed, modules)
    if args.workers or args.cell_timeout:
        raise BadInput("--engine inline computes one cell after the other and cannot stop any")
    return engines.Inline()


def _check_all_inline(directory: Path, engine: Engine) -> None:
    """Raises BadInput where the directory holds cells of another engine, which inline ones would replace."""
    from harness.run.keys import cell_keys
    from harness.run.request import stored_request
    from harness.run.store import open_to_verify

    if stored_request(directory) is None:
        return
    with open_to_verify(directory) as run:
        results, _ = run.load()
        keys = cell_keys(results, run.request.conditions, engine.variables)
    if any(result.key != keys[cell] for cell, result in results.items()):
        raise BadInput(f"{directory} holds cells that were computed otherwise; give another --out")


def _compute(
    run: RunDirectory, request: Request, args: argparse.Namespace, engine: Engine
) -> dict[Cell, CellResult]:
    """Computes what the request asks for and the directory lacks; returns all that is there then."""
    from harness.judge.results import failed_rows
    from harness.run.environment import cache_folder
    from harness.run.files import can_write
    from harness.run.grid import Grid
    from harness.run.progress import say, tell
    from harness.run.store import LOG

    known, unusable = run.load()
    _tell_unusable(unusable, "left out, computed again if asked for")
    again = {cell for cell, result in known.items() if args.retry_failed and _has_failed(result)}
    cells = [cell for cell in request.cells if cell not in known or cell in again]
    kept = len(request.cells) - len(cells)
    conditions = request.conditions
    say(f"{len(cells)} cells to run, {kept} kept from before, {conditions.budget} budget, in {run.path}")
    if cells and not can_write(cache_folder()):
        tell(f"the cache {cache_folder()} cannot be written to: experts are trained for this run alone")
    grid = Grid(conditions, run, engine)
    grid.run(cells)
    results, _ = run.load()
    if lost := [cell for cell in request.cells if cell not in results]:
        tell(f"lost or damaged while the run went on, computed again: {lost[0].name}, {len(lost)} in all")
        grid.run(lost)
        results, unusable = run.load()
        for cell in [cell for cell in request.cells if cell not in results]:
            reason = unusable.get(run.path / "cells" / f"{cell.name}.json", "it is gone")
            results[cell] = failed_rows(
                cell, conditions.protocol, f"its stored result cannot be used: {reason}"
            )
            run.save(results[cell])
    if any(_has_failed(results[cell]) for cell in request.cells):
        tell(f"tracebacks are in {run.path / LOG}; --retry-failed tries again")
    return results


def _report(directory: Path) -> int:
    from harness.run.store import open_for_report

    _prepare()
    with open_for_report(directory) as run:
        results, unusable = run.load()
        _tell_unusable(unusable, "left out")
        if not results:
            raise BadInput(f"{directory} holds no finished cell")
        whole = _write_report(run, list(results.values()), anew=True)
    failed = _tell_troubles(list(results.values()))
    return int(failed or not whole or bool(unusable))


def _verify(directory: Path) -> int:
    from harness.run.progress import say
    from harness.run.store import open_to_verify

    with open_to_verify(directory) as run:
        damaged = run.damaged()
    for path, reason in sorted(damaged.items()):
        say(f"{path}: {reason}")
    if not damaged:
        say(f"{directory}: every file is as it was written")
    return int(bool(damaged))


def _write_report(run: RunDirectory, results: list[CellResult], anew: bool) -> bool:
    """Writes and shows what these results come to. anew: even where it is as it was written. Returns whether
    all is there that the run stored."""
    from harness.run.progress import say, tell
    from harness.run.reporting import write_report
    from harness.run.store import SUMS

    incomplete = run.why_incomplete(results) if anew else ""
    forgotten = run.forgotten(results)
    damaged = run.damaged_files(results) | run.swapped(results)
    if anew or not run.is_sealed(results):
        run.seal(results, write_report(run.path, run.request, results))
    say("\n" + _text(run.path / "leaderboard.md"))
    shown = ["scores.csv", "report.html"]
    shown += ["recordings"] * any(result.recordings for result in results)
    shown += ["artifacts"] * any(result.artifacts for result in results)
    for name in shown:
        say(f"{name:11} {run.path / name}")
    there = {result.cell for result in results}
    if absent := [cell.name for cell in run.request.cells if cell not in there]:
        say(f"not computed yet, or gone: {absent[0]}{_and_more(absent)}")
    _tell_unusable(damaged, "damaged")
    if forgotten:
        tell(f"stored once and gone, left out: {forgotten[0]}{_and_more(forgotten)}")
    if incomplete:
        tell(f"damaged: {run.path / SUMS}: {incomplete}; what was stored once and is gone cannot be told")
    return not (forgotten or damaged or incomplete)


def _and_more(names: Sequence[str]) -> str:
    return f" and {len(names) - 1} more" if names[1:] else ""


def _text(file: Path) -> str:
    """What can be shown of a text file."""
    from harness.run.files import read

    return read(file).decode(errors="replace")


def _tell_troubles(results: list[CellResult]) -> bool:
    """Says on stderr what must not be overlooked, last. Returns whether any cell failed."""
    from harness.run.progress import tell

    for warning in dict.fromkeys(warning for result in results for warning in result.warnings):
        tell(f"WARNING: {warning}")
    failed = [result for result in results if _has_failed(result)]
    for result in failed:
        reason = next(row.reason for row in result.rows if row.status == "failed")
        tell(f"FAILED: {result.cell.name}: {reason}")
    return bool(failed)


def _tell_unusable(files: dict[Path, str], what_happens: str) -> None:
    """A line for each reason."""
    from harness.run.progress import tell

    for reason in sorted(set(files.values())):
        first, *others = sorted(path for path, its_reason in files.items() if its_reason == reason)
        names = ", ".join([str(first), *(path.name for path in others[:MOST_NAMED])])
        more = f" and {len(others) - MOST_NAMED} more" if len(others) > MOST_NAMED else ""
        tell(f"{what_happens}: {names}{more}: {reason}")


def _has_failed(result: CellResult) -> bool:
    return any(row.status == "failed" for row in result.rows)


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _handle_signals() -> None:
    """Whatever stops a run stops it cleanly, and Ctrl-Z suspends all of it."""
    from harness.run.processes import let_cells_sleep

    if threading.current_thread() is threading.main_thread():
        stop_cleanly()
        let_cells_sleep()
