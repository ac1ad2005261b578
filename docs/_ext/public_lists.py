"""The lists of docs/public_names.md, docs/settings.md and docs/demonstrations.md, made of the code."""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Mapping
from typing import Any, cast

from boards import table
from method_pages import field_docs, told, told_all
from plain_docstrings import inline, paragraphs

import harness.records
import irl_bench
from harness.demonstrations.forms import LISTED
from harness.judge.leaderboard import Entry
from harness.records import Row
from harness.registry import ENVS, METHODS, VARIANTS, load_method
from methods.settings import settings_for

PLAIN = {
    "env": "Task.",
    "method": "Method or control, or `reference` for the expert and the random policy.",
    "seed": "Run seed.",
    "role": "Kind of line: a method, a kind of control, or the reference.",
    "policy": "`pi_star`, `pi_R`, `expert`, `demonstrations` or `random`.",
    "protocol": "Treatment of an episode's end.",
    "dynamics": "The task's own (`nominal`), or a variant.",
    "demos": "Demonstrations that are shown; 0: the budget's number.",
    "every": "Distance between shown steps.",
    "demonstrator": "`expert`, `medium`, `noisy` or `ranked`.",
    "status": "`ok`, `skipped` or `failed`.",
    "episodes": "Evaluation episodes.",
    "seeds": "Seeds of the line.",
    "seeds_ok": "Seeds whose status is ok.",
    "rl_solves": "RL solves of making this policy.",
    "discounted_mean": "Mean return, discounted by the task's gamma.",
}
"""Meanings of columns whose fields have no docstring."""
ENDINGS = {
    "std": "Standard deviation, beside `{0}_mean`.",
    "low": "Lower end of the interval of `{0}_mean`.",
    "high": "Upper end of the interval of `{0}_mean`.",
    "mean": "Mean {0}.",
}
"""Meanings of endings of such names, by the name before them."""


def names() -> str:
    """Return a table of the public names, with the first sentence of each."""
    lines = []
    for name in sorted(irl_bench.__all__, key=str.lower):
        first = " ".join((paragraphs(inspect.getdoc(getattr(irl_bench, name)) or "") or [""])[0].split())
        lines.append((f"`{name}`", inline(re.split(r"(?<=\.)(?<!al\.) ", first)[0])))
    return table(["Name", "Meaning"], lines)


def scores() -> str:
    """Return a table of the columns of scores.csv."""
    return columns(Row)


def leaderboard() -> str:
    """Return a table of the columns of leaderboard.csv."""
    return columns(Entry)


def columns(cls: type) -> str:
    docs, fields = field_docs(cls), dataclasses.fields(cast(Any, cls))
    lines = [(f"`{field.name}`", inline(meaning(field.name, docs[field.name]))) for field in fields]
    return table(["Column", "Meaning"], lines)


def meaning(column: str, doc: str) -> str:
    """Return a field's docstring, or else the common meaning of a column of its name."""
    quantity, _, ending = column.rpartition("_")
    if column in PLAIN and (not doc or doc.startswith("As in")):
        return PLAIN[column]
    if not doc and ending in ENDINGS:
        return ENDINGS[ending].format(quantity)
    return doc or "Mean over seeds of this column of scores.csv."


def files() -> str:
    """Return a table of the files of a run's directory."""
    lines = re.findall(r"^DIR/(\S.*?)\s{2,}(.+)$", harness.records.__doc__ or "", re.MULTILINE)
    return table(["File", "Content"], [(f"`{name}`", inline(text)) for name, text in lines])


def forms() -> str:
    """Return a table of the forms of files of demonstrations."""
    return table(
        ["Form", "Recognised by", "Endings", "Bounds of its actions"], [tuple(one) for one in LISTED]
    )


def hyper_parameters() -> str:
    """Return a table of the methods' hyper-parameters at `full`, and what differs by task."""
    lines = []
    for method in (*METHODS, *VARIANTS):
        values = {env: dict(settings_for(method, env, "full")) for env in ENVS}
        fields = {f.name: f.default for f in dataclasses.fields(cast(Any, load_method(method)))}
        usual = fields | common(values)
        others: dict[str, list[str]] = {}
        for env, settings in values.items():
            if differs := told_all({k: v for k, v in settings.items() if usual[k] != v}):
                others.setdefault(differs, []).append(f"`{env}`")
        elsewhere = "; ".join(f"{', '.join(envs)}: {differs}" for differs, envs in others.items())
        lines.append((f"`{method}`", ", ".join(f"{k} {told(v)}" for k, v in usual.items()), elsewhere))
    return table(["Method", "Hyper-parameters at `full`", "Otherwise"], lines)


def common(values: Mapping[str, Mapping[str, object]]) -> dict[str, object]:
    """Return the settings that all tasks share."""
    first, *others = values.values()
    return {name: value for name, value in first.items() if all(its.get(name) == value for its in others)}
