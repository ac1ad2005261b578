"""The lists of docs/commands.md: options of every command, of the parser itself, and events for programs."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Literal, get_args, get_origin

import msgspec
from boards import table
from plain_docstrings import inline

from harness.cli.arguments import parser
from harness.schedule.events import AnyEvent


def options() -> str:
    """Return a section for each command: what it does, its usage, its arguments, and its examples."""
    parts = []
    for command, does in commands(parser(), ""):
        usage = command.format_usage().removeprefix("usage: ").replace("\n       ", "\n").strip()
        examples = command.format_help().partition("\nexamples:\n")[2].rstrip()
        lines = [line(command, action) for action in command._actions if action.dest != "help"]
        parts += [f"### {command.prog}", f"{does[:1].upper()}{does[1:]}.", f"```\n{usage}\n```"]
        parts += ["\n".join(filter(None, lines)), f"```\n{examples}\n```"]
    return "\n\n".join(parts)


def commands(above: argparse.ArgumentParser, does: str) -> Iterator[tuple[argparse.ArgumentParser, str]]:
    """Yield every command that has no commands below it, with what it does."""
    (below,) = [a for a in above._actions if isinstance(a, argparse._SubParsersAction)] or [None]
    if below is None:
        yield above, does
        return
    helps = {choice.dest: choice.help or "" for choice in below._choices_actions}
    for name, command in below.choices.items():
        yield from commands(command, helps[name])


def line(command: argparse.ArgumentParser, action: argparse.Action) -> str:
    """Return an argument as an item of a list, or '' where the usage says all of it."""
    text = command._get_formatter()._expand_help(action) if action.help else ""
    if action.default and action.default != argparse.SUPPRESS and "default" not in text and action.nargs != 0:
        text += f"{'; ' * bool(text)}default {shown(action.default)}"
    value = "|".join(map(str, action.choices or ())) or action.metavar or action.dest.upper()
    name = " ".join([*action.option_strings, *([] if action.nargs == 0 else [str(value)])])
    return text and f"- `{name}`: {inline(text)}"


def shown(value: object) -> str:
    """Return a default as it is typed."""
    return ",".join(map(str, value)) if isinstance(value, (list, tuple)) else str(value)


def events() -> str:
    """Return a table of the events of --json-progress, by their types."""
    lines = []
    for kind in get_args(AnyEvent):
        fields = [f"`{f.encode_name}` ({type_of(f.type)})" for f in msgspec.structs.fields(kind)]
        doc = kind.__dict__.get("__doc__") or f"A job has {kind.__struct_config__.tag}."
        lines.append((f"`{kind.__struct_config__.tag}`", ", ".join(fields), inline(doc)))
    return table(["Event", "Fields", "Meaning"], lines)


def type_of(kind: object) -> str:
    """Return a type in words."""
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        return "object: " + ", ".join(f"`{f.encode_name}`" for f in msgspec.structs.fields(kind))
    if get_origin(kind) is Literal:
        return inline(" or ".join(map(str, get_args(kind))))
    text = str(kind) if get_args(kind) else getattr(kind, "__name__", str(kind))
    return inline(text.replace("None", "null"))
