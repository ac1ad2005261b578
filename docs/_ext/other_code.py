"""The page of methods beside other code: tables of results/studies, with settings as the code has them."""

from __future__ import annotations

import csv
import dataclasses
import re
from typing import Any, cast

from boards import ROOT, table
from method_pages import told
from plain_docstrings import inline

from harness.registry import METHODS, SPECS, THESIS, VARIANTS, load_method
from methods.settings import settings_for

STUDIES = ROOT / "results/studies"
TASK = "swingup"
HEADING = ("Method", "Beside", "On", "Measure", "Theirs", "Ours", "Runs", "Command", "What deviates")


def rows(name: str) -> list[dict[str, str]]:
    """Return the lines of a study."""
    return list(csv.DictReader((STUDIES / name).read_text(encoding="utf-8").splitlines()))


def page() -> str:
    """Return the page in Markdown, with a row for each method of `irl-bench list`."""
    beside = {row["method"]: row for row in rows("against_others.csv")}
    arms = {*THESIS} - {"shaped_thesis"}
    shown = [name for name in METHODS | VARIANTS if name not in arms]
    lines = [[f"`{name}`", *map(inline, [*beside[name].values()][1:])] for name in shown]
    settings = [
        (row["method"], inline(row["setting"]), row["theirs"], ours(row))
        for row in rows("against_settings.csv")
    ]
    parts = [
        "# Methods beside other code",
        "Methods stand beside the library imitation 1.0.1, by learning or by a part of it, or beside closed "
        "forms and other libraries. No authors' code was run. Where a cell is empty, nothing was compared. "
        "Seeds are tuning seeds, one to three a method. Demonstrations and starts of episodes are the same "
        "on both sides. Ours were tuned on this task, and so were GAIL and AIRL of imitation. "
        "[Studies](../studies/index.md) has files and commands.",
        table(HEADING, lines),
        "## Learning curves",
        "Lines are seeds. A score is 0 for the random policy and 1 for the expert.",
        "![Scores on the way to the last policy, of both programs](../../results/studies/against_others.png)",
        "## Settings of these curves",
        table(("Method", "Setting", "`imitation`", "Here"), settings),
    ]
    return "\n\n".join(parts)


def ours(row: dict[str, str]) -> str:
    """Return our setting, which is a field of the method or of a learner, or the text of the row."""
    named = re.fullmatch(r"(\w+)\.([a-z_]+)", row["ours"])
    if not named:
        return inline(row["ours"])
    method, name = named.groups()
    if method == "PPO":
        return told(getattr(SPECS[TASK].rl, name))
    fitted = cast(Any, load_method(method)(**settings_for(method, TASK, "full")))
    return told({field.name: getattr(fitted, field.name) for field in dataclasses.fields(fitted)}[name])
