"""The command line: commands, options and their ranges."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, NoReturn

from harness.cli import examples, options, values
from harness.registry import (
    BUDGETS,
    DEMONSTRATORS,
    BadInput,
)

EXIT_CODES = """Exit codes: 0 done; 1 a cell or a check failed, a Ray cluster was lost, a file is
damaged, a bar of `bench` or of an expert is missed, or what was printed is lost; 2 bad
input, too little memory, or a file that cannot be read or written; 130 stopped, such as by Ctrl-C."""


class _Parser(argparse.ArgumentParser):
    def __init__(self, **settings: Any) -> None:
        super().__init__(allow_abbrev=False, **settings)

    def error(self, message: str) -> NoReturn:
        raise BadInput(message, page="commands")

    def format_help(self) -> str:
        return super().format_help() + examples.told(self.prog)


def parser() -> argparse.ArgumentParser:
    """Return the parser of the whole command line, which raises BadInput for mistakes."""
    top = _Parser(prog="irl-bench", description=EXIT_CODES)
    top.add_argument("--version", action="version", version=f"%(prog)s {values.installed_version()}")
    commands = top.add_subparsers(dest="command", required=True)
    options.add_run(commands.add_parser("run", help="compute scores, and report them"))
    options.add_tune(commands.add_parser("tune", help="search methods' hyper-parameters, on tuning seeds"))
    _add_for_runs(commands)
    _add_demos(commands)
    _add_comparisons(commands)
    _add_experts(commands)
    return top


def _add_for_runs(commands: argparse._SubParsersAction[_Parser]) -> None:
    add = commands.add_parser("reproduce", help="the thesis's evaluation, and what it left open")
    add.add_argument(
        "--seeds", type=values.seeds, metavar="K|A,B-C", default=values.seeds("5"), help="default 5"
    )
    add.add_argument("--budget", default="quick", choices=BUDGETS)
    add.add_argument("--out", default=Path("results/reproduce"), type=values.folder, metavar="DIR")
    options.add_how_cells_run(add)
    add = commands.add_parser("report", help="rebuild a run's tables and figures")
    add.add_argument("directory", type=Path, metavar="DIR")
    add.add_argument(
        "--print", action="store_true", help="print the tables instead, within the terminal's width"
    )
    add = commands.add_parser("view", help="play a run's recordings")
    add.add_argument("directory", type=Path, metavar="DIR")
    add.add_argument("--env", help="those of one task")
    add.add_argument("--method", help="those of one method")
    add.add_argument("--compare", action="store_true", help="all methods on one episode")
    how = add.add_mutually_exclusive_group()
    how.add_argument("--web", action="store_true", help="in the browser, served to this machine alone")
    how.add_argument(
        "--export",
        type=values.folder,
        metavar="FOLDER",
        help="new: a page that plays them, offline, in any browser",
    )
    add = commands.add_parser("verify", help="check the files of a run, or of all runs below, for damage")
    add.add_argument("directory", type=Path, metavar="DIR")
    add = commands.add_parser("export", help="a policy and reward of a run, for other programs")
    add.add_argument("directory", type=Path, metavar="DIR")
    add.add_argument("--env", required=True)
    add.add_argument("--method", required=True)
    add.add_argument("--seed", type=values.seed, default=0, metavar="K")
    add.add_argument("--policy", default="pi_star", choices=("pi_star", "pi_R", "expert"))
    add.add_argument(
        "--to", type=values.folder, metavar="FOLDER", help="new; default: named as what is exported"
    )
    options.add_plugins(add)


def _add_demos(commands: argparse._SubParsersAction[_Parser]) -> None:
    add = commands.add_parser("demos", help="write, read and look at demonstrations")
    what = add.add_subparsers(dest="what", required=True)
    for name, does in (
        ("export", "write an expert's demonstrations"),
        ("import", "read a file of another form, and write it anew"),
        ("inspect", "say what is in a file"),
    ):
        add = what.add_parser(name, help=does)
        if name != "export":
            add.add_argument("path", type=Path, metavar="PATH")
            options.add_reading(add)
        add.add_argument("--env", required=name != "inspect")
        options.add_plugins(add)
        options.add_given(add)
        if name == "export":
            add.add_argument("--seed", type=values.seed, default=0, metavar="K")
            add.add_argument("--demos", type=values.count, default=100, metavar="N", help="default 100")
            add.add_argument("--demonstrator", default="expert", choices=DEMONSTRATORS)
        if name != "inspect":
            form = "FILE.npz" if name == "import" else "FILE.npz|FOLDER"
            add.add_argument("--to", type=Path, required=True, metavar=form)


def _add_comparisons(commands: argparse._SubParsersAction[_Parser]) -> None:
    add = commands.add_parser("compare", help="what differs between runs")
    add.add_argument("directory", type=Path, metavar="A", help="the run that others are compared with")
    add.add_argument("others", nargs="+", type=Path, metavar="B")
    for name, kinds in (("figure", "pdf|.svg|.png"), ("table", "tex|.md|.csv")):
        add = commands.add_parser(name, help=f"a {name} of a run's scores, for a paper")
        add.add_argument("directory", type=Path, metavar="DIR")
        add.add_argument("--to", type=Path, required=True, metavar=f"FILE.{kinds}")
        add.add_argument("--env", help="scores of one task (default: all)")
        if name == "figure":
            costs = ("interactions", "env_steps", "fit_seconds", "rl_solves")
            add.add_argument("--cost", choices=costs, help="draw scores against this, with the Pareto front")
    add = commands.add_parser("check", help="whether methods and environments keep the contract")
    add.add_argument("names", nargs="+", metavar="NAME", help="methods and environments, as `run` takes them")
    options.add_plugins(add)
    options.add_given(add)
    add = commands.add_parser("bench", help="what things cost, as ratios")
    add.add_argument(
        "part",
        nargs="?",
        choices=("speed", "growth", "scale", "spread"),
        help="ratios of speed; memory, and how it and time grow; 100,000 cells and rows; "
        "runs on a Ray cluster (default: the first three)",
    )
    add.add_argument("--json", action="store_true", help="as JSON, at the end")
    add = commands.add_parser("list", help="methods and environments")
    add.add_argument("method", nargs="?", metavar="METHOD", help="list its settings, in the task of --env")
    add.add_argument("--env", metavar="ENV", help="the task in which a method's settings are listed")
    add.add_argument("--budget", choices=BUDGETS, default="full", help="the budget of those; default full")
    options.add_plugins(add)
    options.add_given(add)


def _add_experts(commands: argparse._SubParsersAction[_Parser]) -> None:
    add = commands.add_parser("experts", help="train or measure the shipped experts")
    what = add.add_subparsers(dest="what", required=True)
    for name, does in (
        ("train", "train new ones, in an hour a task or less"),
        ("check", "measure them on 1,000 episodes of their own, in a few minutes"),
    ):
        add = what.add_parser(name, help=does)
        add.add_argument("envs", nargs="*", default=["all"], metavar="ENV")
        add.add_argument(
            "--dir",
            type=values.folder,
            metavar="DIR",
            help="default: results/experts to train, the shipped ones to check",
        )
        options.add_plugins(add)
        options.add_given(add)
        if name == "train":
            add.add_argument("--workers", type=values.count, metavar="N", help="processes at a time")
            of_others = "of experts for tasks of others, which are kept in the cache"
            add.add_argument("--budget", choices=BUDGETS, help=f"{of_others}; default full")
            add.add_argument("--seeds", type=values.seeds, metavar="K|A,B-C", help=f"{of_others}; default 5")
