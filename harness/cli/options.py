"""Options of `run`, and those that it shares with other commands."""

from __future__ import annotations

import argparse
from pathlib import Path

from harness.cli import values
from harness.registry import (
    BUDGETS,
    BUILT_IN,
    DEMONSTRATORS,
    ENCODERS,
    ENGINES,
    EXPERTS,
    GROUPS,
    LAST_OBSERVATIONS,
    LEARNERS,
    LIBRARIES,
    LOGS,
    METHOD_GROUPS,
    METHODS,
    PROTOCOLS,
    RECORDS,
    VARIANTS,
)
from harness.registry.names import SAMPLERS


def add_run(add: argparse.ArgumentParser) -> None:
    """Add the options of `run`."""
    add.add_argument(
        "--methods",
        default="all",
        metavar="all|A,B",
        help=", ".join([*METHODS, *VARIANTS, *METHOD_GROUPS])
        + "; plugins: those of plug-ins, which 'all' does not include; 'gail(layers=(128, 128))': with "
        "hyper-parameters of your own (list METHOD --env ENV)",
    )
    add.add_argument(
        "--set",
        action=values.Settings,
        default={},
        metavar="METHOD.FIELD=VALUE",
        help="a hyper-parameter in all rows of a method; may be given more than once",
    )
    add.add_argument(
        "--envs",
        default="all",
        metavar="all|A,B",
        help=", ".join([*BUILT_IN["env"], *GROUPS])
        + "; gym:ID, a task of Gymnasium; plugins: those of plug-ins",
    )
    add_plugins(add)
    add_given(add)
    add.add_argument(
        "--seeds",
        type=values.seeds,
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
        type=values.count,
        metavar="K",
        default=0,
        help="RL solves of each learned reward, of which the one that earns most counts (default: by budget "
        "and task); controls and variants take one",
    )
    add.add_argument(
        "--encoder",
        default="",
        metavar="|".join([*ENCODERS, "MODULE:CLASS"]),
        help="what makes vectors of images, in tasks that have some",
    )
    add.add_argument("--experts", default="shipped", choices=EXPERTS, help="or trained now, one a seed")
    add.add_argument(
        "--demos",
        type=values.demos,
        metavar="N[,N]",
        default=(0,),
        help="demonstrations, each number in turn; 0 (default): as many as the budget says",
    )
    add.add_argument(
        "--subsample",
        type=values.count,
        metavar="K",
        default=1,
        help="show every K-th step of them (default: all)",
    )
    add.add_argument(
        "--demos-from",
        type=values.folder,
        action="append",
        metavar="PATH",
        help="demonstrations of a file instead of the experts' (docs/demonstrations.md); given again, "
        "those of all files",
    )
    add_reading(add)
    add.add_argument(
        "--preferences",
        type=values.folder,
        metavar="FILE.csv",
        help="preferences between demonstrations of a file, for trex: columns first, second and better, "
        "numbers of episodes from 0 (default: by the file's rewards)",
    )
    add.add_argument(
        "--demonstrator",
        default="expert",
        choices=DEMONSTRATORS,
        help="who is shown: the expert, a worse one, the expert with noise on its actions, or a third each, "
        "ranked by return for trex",
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
        type=values.folder,
        metavar="DIR",
        help="a run, or a folder of runs, to be shown beside: what it has is not computed again",
    )
    add.add_argument("--out", default=Path("results/latest"), type=values.folder, metavar="DIR")
    add.add_argument("--plan", action="store_true", help="say what it would take; compute and write nothing")
    add_how_cells_run(add)


def add_tune(add: argparse.ArgumentParser) -> None:
    """Add the options of `tune`."""
    add.add_argument("--methods", required=True, metavar="A,B", help="each gets as many trials")
    add.add_argument("--envs", required=True, metavar="A,B", help="a trial's score is a mean over them")
    add_plugins(add)
    add.add_argument("--trials", type=values.count, required=True, metavar="N", help="of each method")
    add.add_argument(
        "--storage",
        type=values.folder,
        required=True,
        metavar="FILE",
        help="of Optuna; new, or of a search that goes on",
    )
    add.add_argument("--sampler", choices=SAMPLERS, default="tpe", help="what proposes settings")
    add.add_argument(
        "--seeds",
        type=values.seeds,
        metavar="A,B-C",
        default=(100, 101),
        help="tuning seeds, from 100 to 199, each with an expert that is trained for it (default 100-101)",
    )
    add.add_argument("--budget", default="quick", choices=BUDGETS)
    add.add_argument("--demos", type=values.demos, metavar="N[,N]", default=(0,), help="as of `run`")
    add.add_argument("--no-retrain", action="store_true", help="search by pi* alone, not pi_R too")
    add_how_cells_run(add, runs=False)


def add_reading(parser: argparse.ArgumentParser) -> None:
    """Add the options for what a file of demonstrations does not say."""
    parser.add_argument(
        "--action-bounds",
        type=values.bounds,
        action="append",
        metavar="LOW,HIGH|scaled",
        help="lowest and highest action in that file, such as =-2,2: one pair, or one for each component, in "
        "order; scaled: they are in [-1, 1] (default: as the file says, or else the task's own)",
    )
    parser.add_argument(
        "--last-observation",
        choices=LAST_OBSERVATIONS,
        help="where a file has as many observations as actions: repeat the last one of each episode, or drop "
        "its last action, and count it as cut",
    )
    parser.add_argument(
        "--obs-keys",
        type=values.names,
        default=(),
        metavar="A,B",
        help="names of the file's observations, in the task's order",
    )


def add_plugins(parser: argparse.ArgumentParser) -> None:
    """Add the option that names plug-ins."""
    parser.add_argument(
        "--plugin",
        action="append",
        default=[],
        metavar="FILE.py|MODULE",
        help="methods and environments of your own (docs/plugins.md); may be given more than once",
    )


def add_given(parser: argparse.ArgumentParser) -> None:
    """Add the options for arguments of tasks, and for variables of plug-ins."""
    parser.add_argument(
        "--env-kwargs",
        type=values.named_value,
        action=values.Named,
        default={},
        metavar="KEY=VALUE",
        help="an argument of every task gym:ID, as JSON or as text, such as max_episode_steps=200; may be "
        "given more than once",
    )
    parser.add_argument(
        "--env-var",
        action="append",
        default=[],
        metavar="NAME",
        help="a variable of the environment that a plug-in reads, stored with its value; may be given more "
        "than once",
    )


def add_how_cells_run(parser: argparse.ArgumentParser, runs: bool = True) -> None:
    """Add the options of all commands that compute cells. `runs`: those of runs that people look at, too."""
    add = parser.add_argument
    add("--workers", type=values.count, metavar="N", help="processes at a time (default: the cores)")
    add(
        "--engine",
        default="isolated",
        choices=ENGINES,
        help="cells in worker processes, here or on a Ray cluster (docs/cluster.md), or all inline, "
        "in this one, for a debugger",
    )
    add("--address", metavar="ADDRESS", help="of a Ray cluster, or 'auto'; without it ray starts one here")
    add("--cell-timeout", type=values.seconds, metavar="S", help="seconds after which a cell is stopped")
    add(
        "--fast",
        action="store_true",
        help="libraries choose their instructions: a little faster, and other numbers on other processors",
    )
    if not runs:
        return
    add(
        "--log",
        action="append",
        default=[],
        choices=LOGS,
        help="write curves while cells run, too; may be given for each",
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
