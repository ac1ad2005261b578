"""The command line: commands, options and their ranges."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import NoReturn

from harness.cli import examples
from harness.registry import (
    BUDGETS,
    DEMONSTRATORS,
    ENGINES,
    ENVS,
    EXPERTS,
    GROUPS,
    LEARNERS,
    LIBRARIES,
    METHODS,
    PROTOCOLS,
    RECORDS,
    VARIANTS,
    BadInput,
)

MOST = 1000
"""Largest count that --seeds, --solves and --workers take; seeds lie below it."""
NARROWEST = 1e-9
"""Smallest width that --action-bounds takes."""
LONGEST = 10**6
"""Largest number of seconds that --cell-timeout takes."""
EXIT_CODES = """Exit codes: 0 done; 1 a cell or a check failed, a Ray cluster was lost, a file is
damaged, a bar of `bench` or of an expert is missed, or what was printed is lost; 2 bad
input, too little memory, or a file that cannot be read or written; 130 stopped, such as by Ctrl-C."""


class _Once(argparse.Action):
    """An option that may not be given twice: of two, one would be ignored."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: object,
        option: object = None,
    ) -> None:
        if getattr(namespace, self.dest) is not None:
            parser.error(f"{option} is given twice; one file is read")
        setattr(namespace, self.dest, values)


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise BadInput(message, page="commands")

    def format_help(self) -> str:
        return super().format_help() + examples.told(self.prog)


def parser() -> argparse.ArgumentParser:
    """Return the parser of the whole command line, which raises BadInput for mistakes."""
    top = _Parser(prog="irl-bench", description=EXIT_CODES, allow_abbrev=False)
    top.add_argument("--version", action="version", version=f"%(prog)s {installed_version()}")
    commands = top.add_subparsers(dest="command", required=True)
    add = commands.add_parser("run", help="compute scores, and report them", allow_abbrev=False)
    add.add_argument(
        "--methods",
        default="all",
        metavar="all|A,B",
        help=", ".join([*METHODS, *VARIANTS]) + "; plugins: those of plug-ins, which 'all' does not include",
    )
    add.add_argument(
        "--envs",
        default="all",
        metavar="all|A,B",
        help=", ".join([*ENVS, *GROUPS]) + "; gym:ID, a task of Gymnasium; plugins: those of plug-ins",
    )
    _add_plugins(add)
    add.add_argument(
        "--seeds",
        type=seeds,
        metavar="K|A,B-C",
        help="how many, from 0, or which: 0,3,5-9 (7-7 is seed 7 alone; default 1; 5 for full)",
    )
    add.add_argument("--budget", default="quick", choices=BUDGETS)
    add.add_argument("--protocol", default="absorbing", choices=PROTOCOLS, help="what an episode's end means")
    add.add_argument("--rl", default="sbx", choices=LIBRARIES, help="whose learners: SB3 in JAX, or SB3")
    add.add_argument(
        "--learner",
        default="own",
        choices=LEARNERS,
        help="of every RL: each task's own, or DDPG, the thesis's",
    )
    add.add_argument(
        "--solves",
        type=_count,
        metavar="K",
        default=0,
        help="RL solves of each learned reward, of which the one that earns most counts (default: by budget "
        "and task); controls and variants take one",
    )
    add.add_argument("--experts", default="shipped", choices=EXPERTS, help="or trained now, one a seed")
    add.add_argument(
        "--demos",
        type=_demos,
        metavar="N[,N]",
        default=(0,),
        help="demonstrations, each number in turn; 0 (default): as many as the budget says",
    )
    add.add_argument(
        "--subsample", type=_count, metavar="K", default=1, help="show every K-th step of them (default: all)"
    )
    add.add_argument(
        "--demos-from",
        type=_folder,
        action=_Once,
        metavar="PATH",
        help="demonstrations of a file instead of the experts' (docs/demonstrations.md)",
    )
    _add_bounds(add)
    add.add_argument(
        "--demonstrator",
        default="expert",
        choices=DEMONSTRATORS,
        help="who is shown: the expert, a worse one, or the expert with noise on its actions",
    )
    add.add_argument(
        "--transfer",
        nargs="?",
        const="all",
        metavar="all|A,B",
        help="in the variants of each task too, or in those named, such as flipped: pi* carried over, and RL "
        "on R* there",
    )
    add.add_argument("--no-retrain", action="store_true", help="pi* alone: neither pi_R nor controls")
    add.add_argument(
        "--baseline",
        action="append",
        default=[],
        type=_folder,
        metavar="DIR",
        help="a run, or a folder of runs, to be shown beside: what it has is not computed again",
    )
    add.add_argument("--out", default=Path("results/latest"), type=_folder, metavar="DIR")
    add.add_argument("--plan", action="store_true", help="say what it would take; compute and write nothing")
    _add_how_cells_run(add)
    add = commands.add_parser(
        "reproduce", help="the thesis's evaluation, and what it left open", allow_abbrev=False
    )
    add.add_argument("--seeds", type=seeds, metavar="K|A,B-C", default=seeds("5"), help="default 5")
    add.add_argument("--budget", default="quick", choices=BUDGETS)
    add.add_argument("--out", default=Path("results/reproduce"), type=_folder, metavar="DIR")
    _add_how_cells_run(add)
    add = commands.add_parser("report", help="rebuild a run's tables and figures", allow_abbrev=False)
    add.add_argument("directory", type=Path, metavar="DIR")
    add.add_argument(
        "--print", action="store_true", help="print the tables, too, within the terminal's width"
    )
    add = commands.add_parser("view", help="play a run's recordings", allow_abbrev=False)
    add.add_argument("directory", type=Path, metavar="DIR")
    add.add_argument("--env", help="those of one task")
    add.add_argument("--method", help="those of one method")
    add.add_argument("--compare", action="store_true", help="all methods on one episode")
    how = add.add_mutually_exclusive_group()
    how.add_argument("--web", action="store_true", help="in the browser, served to this machine alone")
    how.add_argument(
        "--export",
        type=_folder,
        metavar="FOLDER",
        help="new: a page that plays them, offline, in any browser",
    )
    add = commands.add_parser("verify", help="check a run's files for damage", allow_abbrev=False)
    add.add_argument("directory", type=Path, metavar="DIR")
    add = commands.add_parser(
        "export", help="a policy and reward of a run, for other programs", allow_abbrev=False
    )
    add.add_argument("directory", type=Path, metavar="DIR")
    add.add_argument("--env", required=True)
    add.add_argument("--method", required=True)
    add.add_argument("--seed", type=_seed, default=0, metavar="K")
    add.add_argument("--policy", default="pi_star", choices=("pi_star", "pi_R", "expert"))
    add.add_argument("--to", type=_folder, metavar="FOLDER", help="new; default: named as what is exported")
    _add_plugins(add)
    add = commands.add_parser("demos", help="write, read and look at demonstrations", allow_abbrev=False)
    what = add.add_subparsers(dest="what", required=True)
    for name, does in (
        ("export", "write an expert's demonstrations"),
        ("import", "read a file of another form, and write it anew"),
        ("inspect", "say what is in a file"),
    ):
        add = what.add_parser(name, help=does, allow_abbrev=False)
        if name != "export":
            add.add_argument("path", type=Path, metavar="PATH")
            _add_bounds(add)
        add.add_argument("--env", required=True)
        _add_plugins(add)
        if name == "export":
            add.add_argument("--seed", type=_seed, default=0, metavar="K")
            add.add_argument("--demos", type=_count, default=100, metavar="N", help="default 100")
            add.add_argument("--demonstrator", default="expert", choices=DEMONSTRATORS)
        if name != "inspect":
            form = "FILE.npz" if name == "import" else "FILE.npz|FOLDER"
            add.add_argument("--to", type=Path, required=True, metavar=form)
    add = commands.add_parser("compare", help="what differs between runs", allow_abbrev=False)
    add.add_argument("directory", type=Path, metavar="A", help="the run that others are compared with")
    add.add_argument("others", nargs="+", type=Path, metavar="B")
    for name, kinds in (("figure", "pdf|.svg|.png"), ("table", "tex|.md|.csv")):
        add = commands.add_parser(name, help=f"a {name} of a run's scores, for a paper", allow_abbrev=False)
        add.add_argument("directory", type=Path, metavar="DIR")
        add.add_argument("--to", type=Path, required=True, metavar=f"FILE.{kinds}")
        add.add_argument("--env", help="scores of one task (default: all)")
    add = commands.add_parser(
        "check", help="whether methods and environments keep the contract", allow_abbrev=False
    )
    add.add_argument("names", nargs="+", metavar="NAME", help="methods and environments, as `run` takes them")
    _add_plugins(add)
    add = commands.add_parser("bench", help="what things cost, as ratios", allow_abbrev=False)
    add.add_argument(
        "part",
        nargs="?",
        choices=("speed", "growth", "scale", "spread"),
        help="ratios of speed; memory, and how it and time grow; 100,000 cells and rows; "
        "runs on a Ray cluster (default: the first three)",
    )
    add.add_argument("--json", action="store_true", help="as JSON, at the end")
    add = commands.add_parser("experts", help="train or measure the shipped experts", allow_abbrev=False)
    what = add.add_subparsers(dest="what", required=True)
    for name, does in (
        ("train", "train new ones, in an hour a task or less"),
        ("check", "measure them on 1,000 episodes of their own, in a few minutes"),
    ):
        add = what.add_parser(name, help=does, allow_abbrev=False)
        add.add_argument("envs", nargs="*", default=["all"], metavar="ENV")
        add.add_argument(
            "--dir",
            type=_folder,
            metavar="DIR",
            help="default: results/experts to train, the shipped ones to check",
        )
        _add_plugins(add)
        if name == "train":
            add.add_argument("--workers", type=_count, metavar="N", help="processes at a time")
            of_others = "of experts for tasks of others, which are kept in the cache"
            add.add_argument("--budget", choices=BUDGETS, help=f"{of_others}; default full")
            add.add_argument("--seeds", type=seeds, metavar="K|A,B-C", help=f"{of_others}; default 5")
    add = commands.add_parser("list", help="methods and environments", allow_abbrev=False)
    add.add_argument("method", nargs="?", metavar="METHOD", help="list its settings, in the task of --env")
    add.add_argument("--env", metavar="ENV", help="the task in which a method's settings are listed")
    add.add_argument("--budget", choices=BUDGETS, default="full", help="the budget of those; default full")
    _add_plugins(add)
    return top


def _add_bounds(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--action-bounds",
        type=_bounds,
        action="append",
        metavar="LOW,HIGH|scaled",
        help="lowest and highest action in that file, such as =-2,2: one pair, or one for each component, in "
        "order; scaled: they are in [-1, 1] (default: as the file says, or else the task's own)",
    )


def _add_plugins(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--plugin",
        action="append",
        default=[],
        metavar="FILE.py|MODULE",
        help="methods and environments of your own (docs/plugins.md); may be given more than once",
    )


def installed_version() -> str:
    """This program's."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("irl-bench")
    except PackageNotFoundError:
        return "(not installed)"


def _add_how_cells_run(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--workers", type=_count, metavar="N", help="processes at a time (default: the cores)")
    add(
        "--engine",
        default="isolated",
        choices=ENGINES,
        help="cells in worker processes, here or on a Ray cluster (docs/cluster.md), or all inline, "
        "in this one, for a debugger",
    )
    add("--address", metavar="ADDRESS", help="of a Ray cluster, or 'auto'; without it ray starts one here")
    add("--cell-timeout", type=_seconds, metavar="S", help="seconds after which a cell is stopped")
    add(
        "--fast",
        action="store_true",
        help="libraries choose their instructions: a little faster, and other numbers on other processors",
    )
    add(
        "--record",
        default="both",
        choices=RECORDS,
        help="which evaluation episodes of each policy of seed 0: the median, the worst, both, all or "
        "none; what was learned is kept in any case",
    )
    add(
        "--json-progress",
        action="store_true",
        help="standard output is JSON, an object a line, for programs (docs/commands.md); text goes to "
        "standard error",
    )
    add("--retry-failed", action="store_true", help="compute again what failed before")


def _demos(text: str) -> tuple[int, ...]:
    return tuple(sorted({_whole(part, MOST, least=0) for part in text.split(",")}))


def _count(text: str) -> int:
    return _whole(text, MOST)


def seeds(text: str) -> tuple[int, ...]:
    """Return the seeds of a text: a count from 0, or numbers and ranges."""
    if "," not in text and "-" not in text[1:]:
        return tuple(range(_count(text)))
    found: set[int] = set()
    for part in text.split(","):
        ends = [_whole(end, MOST - 1, least=0) for end in part.split("-", 1)]
        if ends[-1] < ends[0]:
            raise argparse.ArgumentTypeError(f"{part[:40]!r} ends before it begins")
        found |= {*range(ends[0], ends[-1] + 1)}
    return tuple(sorted(found))


def _bounds(text: str) -> tuple[float, float]:
    if text == "scaled":
        return -1.0, 1.0
    try:
        low, high = map(float, text.split(","))
    except ValueError as error:
        why = "is not two numbers with a comma between; give the option again for another component"
        raise argparse.ArgumentTypeError(f"{text[:40]!r} {why}") from error
    if not (-LONGEST <= low < high <= LONGEST and high - low >= NARROWEST):
        raise argparse.ArgumentTypeError(f"{text[:40]!r} is not a lower number and a higher one")
    return low, high


def _seed(text: str) -> int:
    return _whole(text, MOST - 1, least=0)


def _seconds(text: str) -> int:
    return _whole(text, LONGEST)


def _folder(text: str) -> Path:
    """With no '..' in it, which would mean another folder once those before it are made."""
    if not text:
        raise argparse.ArgumentTypeError("a folder is needed, not ''")
    path = Path(text)
    return Path(os.path.realpath(path)) if ".." in path.parts else path


def _whole(text: str, most: int, least: int = 1) -> int:
    try:
        number = int(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text[:40]!r} is not a whole number") from error
    if not least <= number <= most:
        raise argparse.ArgumentTypeError(f"must lie between {least} and {most}, not {text[:40]}")
    return number
