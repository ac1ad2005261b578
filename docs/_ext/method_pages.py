"""A page for each method: its docstring, its hyper-parameters, and what it scored and took."""

from __future__ import annotations

import ast
import dataclasses
import functools
import inspect
import sys
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any, cast

import boards
from boards import table
from plain_docstrings import bullets, inline, markdown, paragraphs

from harness.registry import ENVS, METHODS, VARIANTS, load_method
from methods.settings import settings_for

NAMES = METHODS | VARIANTS
DEVIATES = "Deviates from"


@functools.cache
def groups() -> dict[str, list[str]]:
    """Names of methods by the module's they share."""
    found: dict[str, list[str]] = {}
    for name, entry in NAMES.items():
        found.setdefault(entry.target.partition(":")[0].rpartition(".")[2], []).append(name)
    return found


def pages() -> dict[str, str]:
    """Markdown by file name, `index` among them."""
    found = {name: page(name, its) for name, its in groups().items()}
    lines = [
        (f"[`{name}`]({module}.md)", inline(NAMES[name].summary), "yes" if name in METHODS else "when named")
        for module, its in groups().items()
        for name in its
    ]
    listed = "\n".join(groups())
    found["index"] = (
        "# Methods\n\nEach page says what a method does, where it deviates from its paper, its "
        "hyper-parameters, what it scores on the reference boards and what that took.\n\n"
        + table(["Method", "What it is", "Part of `all`"], lines)
        + f"\n```{{toctree}}\n:hidden:\n\n{listed}\n```\n"
    )
    return found


def page(module: str, names: Sequence[str]) -> str:
    method = cast(Any, load_method(names[0]))
    doc = inspect.getdoc(sys.modules[method.__module__]) or ""
    idea = [p for p in paragraphs(doc) if not p.startswith(DEVIATES)]
    deviates = [p.partition(": ") for p in paragraphs(doc) if p.startswith(DEVIATES)]
    known = [(f"`{name}`", inline(NAMES[name].summary)) for name in names]
    named = [f"`{name}`" for name in names if name in VARIANTS]
    parts = [
        f"# {module}",
        table(["Name", "What it is"], known),
        f"{', '.join(named)} {'runs' if len(named) == 1 else 'run'} when named, and not with `all`."
        if named
        else "",
        "## Idea",
        markdown("\n\n".join(idea)),
        *(text for first, _, rest in deviates for text in (f"## {first}", bullets(rest))),
        "## Hyper-parameters",
        hyper_parameters(method, names),
        "## Results",
        results(names),
        "## What it costs",
        costs(names),
        f"Code: `{method.__module__.replace('.', '/')}.py`.",
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def hyper_parameters(method: Any, names: Sequence[str]) -> str:
    fields = {f.name: f.default for f in dataclasses.fields(method)}
    said = field_docs(method)
    lines = [(f"`{name}`", told(value), inline(said[name])) for name, value in fields.items()]
    others: dict[tuple[str, str], list[str]] = {}
    for name in names:
        values = {env: dict(settings_for(name, env, "full")) for env in ENVS}
        usual = fields | {
            key: value
            for key, value in values["cartpole_discrete"].items()
            if all(its.get(key) == value for its in values.values())
        }
        where: dict[str, list[str]] = {}
        for env, its in values.items():
            if differs := told_all({key: value for key, value in its.items() if usual[key] != value}):
                where.setdefault(differs, []).append(f"`{env}`")
        if everywhere := told_all({key: value for key, value in usual.items() if fields[key] != value}):
            others.setdefault(("all", everywhere), []).append(f"`{name}`")
        for differs, envs in where.items():
            others.setdefault((", ".join(envs), differs), []).append(f"`{name}`")
    text = table(["Name", "Default", "What it is"], lines)
    if others:
        changed = [(", ".join(who), tasks, setting) for (tasks, setting), who in others.items()]
        text += "\nOtherwise at the budget `full`:\n\n" + table(["Method", "Task", "Setting"], changed)
    return text + "\nHow they were found: [tuning](../tuning.md).\n"


def field_docs(cls: type) -> dict[str, str]:
    """Return the docstring of each field, including fields of base classes."""
    found: dict[str, str] = {}
    for one in reversed(cls.__mro__[:-1]):
        (tree,) = ast.parse(textwrap.dedent(inspect.getsource(one))).body
        assert isinstance(tree, ast.ClassDef)
        for field, after in zip(tree.body, [*tree.body[1:], None], strict=True):
            if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name):
                found[field.target.id] = text_of(after)
    return found


def text_of(node: ast.stmt | None) -> str:
    """Return the text of a statement that is a text; '' for others."""
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
        return inspect.cleandoc(str(node.value.value))
    return ""


def told(value: object) -> str:
    return " ".join(map(str, value)) if isinstance(value, tuple) else f"{value}"


def told_all(settings: Mapping[str, object]) -> str:
    return ", ".join(f"`{name}` {told(value)}" for name, value in settings.items())


def results(names: Sequence[str]) -> str:
    its = [row for row in boards.rows() if row["method"] in names]
    if not its:
        return "It is on no reference board yet."
    text = [
        "Scores at the budget `full`: 0 is a random policy, 1 the expert. Means over seeds and "
        "90 % intervals. Seeds on which RL did not solve R\\* are left out; then their mean is in brackets. "
        "What they show: [findings](../findings.md)."
    ]
    for title, chosen in (
        ("", [row for row in its if row["dynamics"] == "nominal"]),
        (
            "In changed dynamics π\\* is carried over and π_R trained anew on R\\*; 1 is what RL reaches "
            "there on the true reward.",
            [row for row in its if row["dynamics"] != "nominal"],
        ),
    ):
        if chosen:
            lines = [
                (
                    *(boards.link(f"`{boards.task_of(row)}`", row), row["demos"], row["seeds_ok"]),
                    *(f"`{row['method']}`", boards.score(star), boards.score(retrained)),
                )
                for row, star, retrained in boards.pairs(chosen)
            ]
            heading = ["Task", "Demos", "Seeds", "Method", "π\\*", "π_R"]
            text += [title, table_of_methods(heading, lines)]
    return "\n\n".join(part for part in text if part)


def costs(names: Sequence[str]) -> str:
    its = [
        row
        for row in boards.rows()
        if row["method"] in names and row["policy"] == "pi_star" and row["dynamics"] == "nominal"
    ]
    if not its:
        return "Not measured on a reference board yet."
    lines = [
        (
            *(f"`{row['env']}`", row["demos"], f"`{row['method']}`"),
            *(boards.amount(row[name]) for name in ("fit_seconds", "env_steps", "check_steps", "rl_solves")),
        )
        for row in its
    ]
    heading = [
        "Task",
        "Demonstrations",
        "Method",
        "Fit, s",
        "Environment steps",
        "Steps of checks",
        "RL solves",
    ]
    return (
        "Until π\\* is there, means over seeds. Steps are of rollouts and those that RL learned from; checks "
        "are the episodes by which RL's checkpoints were judged. Seconds are of one core beside other work, "
        "on whatever machine computed the run: rough.\n\n" + table_of_methods(heading, lines)
    )


def table_of_methods(heading: Sequence[str], lines: Sequence[Sequence[object]]) -> str:
    """The table, which names methods only where they differ."""
    place = heading.index("Method")
    kept = [i for i in range(len(heading)) if i != place or len({line[place] for line in lines}) > 1]
    return table([heading[i] for i in kept], [[line[i] for i in kept] for line in lines])
