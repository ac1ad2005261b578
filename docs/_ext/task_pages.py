"""A page for each task: its picture, what its docstrings say, its spec, its experts and its board."""

from __future__ import annotations

import ast
import csv
import dataclasses
import functools
import inspect
import math
import sys
from collections.abc import Mapping
from typing import Any

import boards
from boards import ROOT, table
from method_pages import groups, text_of
from plain_docstrings import inline, markdown

from envs import EnvSpec, encoders
from envs.encoders import FEATURES
from harness.registry import BUDGETS, KNOWN, all_specs

COUNTS = {1: "One is shipped,", 3: "Three are shipped, each", 5: "Five are shipped, each"}
SHARED = ("envs.mujoco_tasks",)
"""Modules of several tasks, whose docstring is of none of them."""


def pages() -> dict[str, str]:
    """Markdown by file name, `index` among them."""
    found = {spec.name: page(spec) for spec in all_specs()}
    lines = [(f"[`{name}`]({name}.md)", inline(KNOWN.entries["env"][name].summary)) for name in found]
    listed = "\n".join(found)
    found["index"] = (
        "# Tasks\n\nEach page shows a task, what pays there and what ends an episode, what is observed and "
        "done, its experts, its other dynamics and its board.\n\n"
        + table(["Task", "What it is"], lines)
        + f"\n```{{toctree}}\n:hidden:\n\n{listed}\n```\n"
    )
    return found


def page(spec: EnvSpec) -> str:
    module, _, name = KNOWN.entries["env"][spec.name].target.partition(":")
    picture = f"docs/pictures/{spec.name}.png"
    parts = [
        f"# {spec.name}",
        inline(spec.summary) + ".",
        f"![{spec.name}: the expert acting](../../{picture})" if (ROOT / picture).exists() else "",
        "## Dynamics and reward",
        "" if module in SHARED else markdown(inspect.getdoc(sys.modules[module]) or ""),
        markdown(doc_of(module, name)),
        "## What is observed and done",
        quantities(spec),
        "## Numbers",
        numbers(spec),
        "## The expert",
        expert(spec),
        "## Other dynamics",
        variants(spec),
        "## The board",
        board(spec.name),
        f"Code: `{module.replace('.', '/')}.py`.",
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def doc_of(module: str, name: str) -> str:
    """Return the text below the assignment to this name."""
    body = ast.parse(inspect.getsource(sys.modules[module])).body
    for node, after in zip(body, [*body[1:], None], strict=True):
        if (
            isinstance(node, ast.Assign)
            and isinstance(node.targets[0], ast.Name)
            and node.targets[0].id == name
        ):
            return text_of(after)
    raise LookupError(f"{module} assigns no {name}")


def quantities(spec: EnvSpec) -> str:
    every = list(zip(spec.observations, spec.obs_scale, strict=True))
    beside = every[FEATURES:] if spec.encoder else every
    observed = [(f"{FEATURES} features of the image and the one before", "", "1")] if spec.encoder else []
    observed += [(inline(q.name), q.unit, f"{scale:.3g}") for q, scale in beside]
    done = [(inline(q.name), q.unit) for q in spec.actions]
    kind = "One of these choices" if spec.discrete else "Each in [-1, 1]; a unit says what 1 is"
    return (
        (f"{markdown(inspect.getdoc(encoders) or '')}\n\n" if spec.encoder else "")
        + table(["Observation", "Unit", "Typical size"], observed)
        + f"\n{kind}:\n\n"
        + table(["Action", "Unit"], done)
    )


def numbers(spec: EnvSpec) -> str:
    known = [
        ("Steps of an episode, at most", f"{spec.horizon:,}"),
        *([("Seconds of a step", f"{spec.time_step:g}")] if spec.tabular is None else []),
        ("Discount", f"{spec.gamma:g}"),
        ("Reinforcement learning", "exact, by value iteration" if spec.tabular else learner(spec.rl)),
    ]
    if spec.tabular is None:
        known.append(("Its steps", budgets(spec.rl_steps)))
        known.append(("Solves of a learned reward", budgets(spec.solves)))
    known += [
        ("Evaluation episodes", budgets(spec.eval_episodes)),
        ("Demonstrations", budgets(spec.demo_episodes)),
    ]
    return table(["Setting", "Value"], known)


def budgets(numbers: Mapping[str, int]) -> str:
    return ", ".join(f"{numbers[budget]:,} (`{budget}`)" for budget in BUDGETS)


def learner(rl: Any) -> str:
    """Return its name, and the settings that differ from the defaults."""
    changed = [f for f in dataclasses.fields(rl) if getattr(rl, f.name) != f.default]
    said = ", ".join(f"`{f.name}` {told(getattr(rl, f.name))}" for f in changed)
    return f"{type(rl).__name__}" + (f" with {said}" if said else "")


def told(value: object) -> str:
    return (" ".join(map(str, value)) or "none") if isinstance(value, tuple) else f"{value}"


@functools.cache
def held_out() -> dict[str, float]:
    """Mean returns by the name of the expert."""
    text = (ROOT / "results/studies/experts_held_out.csv").read_text(encoding="utf-8")
    rows = csv.DictReader(text.splitlines())
    return {row["expert"]: float(row["mean_return"]) for row in rows if "__" in row["expert"]}


def expert(spec: EnvSpec) -> str:
    if spec.expert_task and spec.expert_task.name in KNOWN.entries["env"]:
        seen = spec.expert_task.name
        return f"That of [`{seen}`]({seen}.md), which sees the state. Its actions are taken here."
    spec = spec.expert_sees
    if (controller := spec.controller) is not None:
        settings = ", ".join(f"`{name}` {told(its)}" for name, its in vars(controller).items())
        return f"{markdown(inspect.getdoc(type(controller)) or '')}\n\nIts settings are {settings}."
    if spec.shipped is None and spec.tabular is None:
        return "None is shipped. A run trains its own."
    if spec.shipped is None:
        return "The best policy, found exactly: the model is known."
    returns = [
        value
        for name, value in held_out().items()
        if name.rpartition("__")[0] == spec.name and name.rpartition("__")[2].isdigit()
    ]
    shipped = spec.shipped
    text = (
        f"{COUNTS[shipped.experts]} trained for {shipped.steps:,} steps"
        + (f" by {learner(shipped.rl)}" if shipped.rl else "")
        + f". Each returns {shipped.bar:g} or more"
        + (
            ""
            if shipped.terminated is None
            else f" and ends at most {shipped.terminated:.0%} of its episodes early"
        )
        + f" on {shipped.episodes:,} episodes that nothing else uses: {min(returns):.1f} to "
        f"{max(returns):.1f} were [measured](../../results/studies/experts_held_out.csv)."
    )
    asked = spec.bar(range(20))
    if not math.isinf(asked) and spec.name != "highway":
        text += f" An expert that a run trains itself must return {asked:g}."
    return text


def variants(spec: EnvSpec) -> str:
    if not spec.variants:
        return "None."
    lines = []
    for name, made in spec.variants.items():
        changed = []
        for key, value in made.items():
            if dataclasses.is_dataclass(value):
                changed += [
                    f"`{f.name}` {told(getattr(value, f.name))} instead of {told(f.default)}"
                    for f in dataclasses.fields(value)
                    if getattr(value, f.name) != f.default
                ]
            else:
                changed.append(f"`{key}` {value}")
        lines.append((f"`{name}`", ", ".join(changed)))
    return (
        table(["Variant", "What differs"], lines)
        + f"\n`run --envs {spec.name} --transfer {next(iter(spec.variants))}` uses what was learned there."
    )


def board(env: str) -> str:
    its = [row for row in boards.rows() if row["env"] == env and row["role"] != "reference"]
    if not its:
        return "It is on no reference board yet."
    pages_of = {name: module for module, names in groups().items() for name in names}
    found: dict[tuple[str, ...], list[tuple[str, str, str]]] = {}
    for row, star, retrained in boards.pairs(its):
        method = row["method"]
        said = f"[`{method}`](../methods/{pages_of[method]}.md)" if method in pages_of else f"`{method}`"
        key = (boards.task_of(row), row["demos"], row["seeds_ok"], boards.link(row["run"], row))
        found.setdefault(key, []).append((said, boards.score(star), boards.score(retrained)))
    text = [
        "Scores at `full`: 0 is a random policy, 1 the expert; in other dynamics 1 is what RL reaches there. "
        "Means over seeds and 90 % intervals; seeds on which RL did not solve R\\* are left out."
    ]
    for (task, shown, seeds, run), lines in found.items():
        text += [
            f"**{inline(task)}**, {shown} demonstrations, {seeds} seeds ({run}):",
            table(["Method", "π\\*", "π_R"], lines),
        ]
    return "\n\n".join(text)
