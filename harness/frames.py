"""Runs from Python, and what they found as pandas frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from harness import commands
from harness.arguments import parser
from harness.registry import BadInput

DEFAULT = Path("results/latest")


@dataclass(frozen=True)
class Frames:
    """scores: a row for each policy of each cell, with the columns of `harness.judge.results.Row`.
    leaderboard: those over seeds, as in leaderboard.csv."""

    scores: pd.DataFrame
    leaderboard: pd.DataFrame


def run(
    methods: Sequence[str],
    envs: Sequence[str],
    seeds: int | Sequence[int] = 1,
    budget: str = "quick",
    out: Path | str = DEFAULT,
    plugins: Sequence[str] = (),
    options: Sequence[str] = (),
) -> Frames:
    """Computes what is asked for and not there yet, as `irl-bench run` does; all that is in `out` then.

    seeds: how many, from 0, or which. plugins: files or modules, as of `--plugin`. options: more of
    `irl-bench run`'s, such as ["--demos", "5"]. A cell that fails is a row that says why.
    Raises `harness.registry.BadInput` for what cannot be done.
    """
    for name, given in {"methods": methods, "envs": envs, "plugins": plugins, "options": options}.items():
        if isinstance(given, str):
            raise BadInput(f"{name} must be a list, such as [{given!r}]")
    if {"--plan", "--out"} & {*options}:
        raise BadInput("options cannot hold --plan, which computes nothing, nor --out")
    which = str(seeds) if isinstance(seeds, int) else ",".join(f"{seed}-{seed}" for seed in seeds)
    words = ["run", "--methods", ",".join(methods), "--envs", ",".join(envs), "--seeds", which]
    words += ["--budget", budget, "--out", str(out), *options]
    for plugin in plugins:
        words += ["--plugin", plugin]
    commands.run(parser().parse_args(words))
    return load(out)


def load(directory: Path | str) -> Frames:
    """What a run's directory holds. Raises BadInput where that is no finished run."""
    folder = Path(directory)
    try:
        return Frames(pd.read_csv(folder / "scores.csv"), pd.read_csv(folder / "leaderboard.csv"))
    except (OSError, ValueError) as error:
        raise BadInput(f"{folder} holds no finished run: {error}") from error
