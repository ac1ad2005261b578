"""Values of options, from the words of the command line. Each raises ArgumentTypeError for another word."""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
from typing import Any

from harness.registry import configured

MOST = 1000
"""Largest count that --seeds, --solves and --workers take; seeds lie below it."""
NARROWEST = 1e-9
"""Smallest width that --action-bounds takes."""
LONGEST = 10**6
"""Largest number of seconds that --cell-timeout takes."""


def demos(text: str) -> tuple[int, ...]:
    return tuple(sorted({whole(part, MOST, least=0) for part in text.split(",")}))


def count(text: str) -> int:
    return whole(text, MOST)


def seeds(text: str) -> tuple[int, ...]:
    """Return the seeds of a text: a count from 0, or numbers and ranges."""
    if "," not in text and "-" not in text[1:]:
        return tuple(range(count(text)))
    found: set[int] = set()
    for part in text.split(","):
        ends = [whole(end, MOST - 1, least=0) for end in part.split("-", 1)]
        if ends[-1] < ends[0]:
            raise argparse.ArgumentTypeError(f"{part[:40]!r} ends before it begins")
        found |= {*range(ends[0], ends[-1] + 1)}
    return tuple(sorted(found))


def bounds(text: str) -> tuple[float, float]:
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


def named_value(text: str) -> tuple[str, Any]:
    """Return the name and the value of 'NAME=VALUE'. The value is JSON, or else the text itself."""
    name, equals, value = text.partition("=")
    if not name.isidentifier() or not equals:
        raise argparse.ArgumentTypeError(f"{text[:40]!r} is not NAME=VALUE")
    try:
        return name, json.loads(value)
    except ValueError:
        return name, value


def names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


def seed(text: str) -> int:
    return whole(text, MOST - 1, least=0)


def seconds(text: str) -> int:
    return whole(text, LONGEST)


def folder(text: str) -> Path:
    """Return the folder with no '..' in it, which would mean another folder once those before it are made."""
    if not text or "\0" in text:
        raise argparse.ArgumentTypeError(f"a folder is needed, not {text!r:.40}")
    path = Path(text)
    return Path(os.path.realpath(path)) if ".." in path.parts else path


def whole(text: str, most: int, least: int = 1) -> int:
    try:
        number = int(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text[:40]!r} is not a whole number") from error
    if not least <= number <= most:
        raise argparse.ArgumentTypeError(f"must lie between {least} and {most}, not {text[:40]}")
    return number


def installed_version() -> str:
    """Return the version of this program."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("irl-bench")
    except PackageNotFoundError:
        return "(not installed)"


class Settings(argparse.Action):
    """Settings of methods, collected by method and field."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option: object = None,
    ) -> None:
        name, is_set, value = values.partition("=")
        method, _, field = name.rpartition(".")
        if not (is_set and method and field):
            parser.error(f"{option} is given as METHOD.FIELD=VALUE, not {values[:80]!r}")
        settings = {key: dict(own) for key, own in getattr(namespace, self.dest).items()}
        if field in settings.setdefault(method, {}):
            parser.error(
                f"{option} {name} is given twice; for a row of each value: "
                f"--methods '{method}({field}=A),{method}({field}=B)'"
            )
        settings[method][field] = configured.value_in(value)
        setattr(namespace, self.dest, settings)


class Named(argparse.Action):
    """Values by name, each given once."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option: object = None,
    ) -> None:
        there = getattr(namespace, self.dest)
        if (name := values[0]) in there:
            parser.error(f"{option} {name} is given twice")
        setattr(namespace, self.dest, there | dict([values]))
