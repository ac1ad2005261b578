"""What a run was asked to compute, as its directory remembers it."""

from __future__ import annotations

import dataclasses
import json
import os
import re
from pathlib import Path
from typing import Any

from harness.judge.results import ALL_SHOWN, FORMATS, MOST_SEEDS, Conditions, Request
from harness.registry import KNOWN, BadInput
from harness.registry.gymnasium_tasks import task_or_name
from harness.run.codec import checked, checksum, printable
from harness.run.files import read, unfinished, write_atomic

NO_NUMBERS = "It reads and writes what was asked for, of which keys are."

LOCK = ".lock"
LOCK_MARK = "irl-bench "
"""What a lock says before the number of the process that has it."""
REQUEST = "run.json"
BASELINE = "baseline"
FOLDERS = {
    **{"cells": "json", BASELINE: "json", "recordings": "rrd", "artifacts": "safetensors"},
    "figures": "png",
}
"""Of a run's directory, and how the names of files end that a run writes there."""
STUDY = "study.json"
"""Marks the directory of a study, which holds runs (`harness.reproduce`)."""
MOST_NAMED = 5
"""Runs that a line names."""
EARLIER_RECORD = "first"
"""What runs of earlier versions were told to record; they may go on with whatever is recorded now."""
LATER = ("demonstrations", "learner", "solves")
"""Conditions that earlier versions lack. run.json names them where they are not the default."""
KEYS = tuple(field.name for field in dataclasses.fields(Conditions))


def write_request(path: Path, request: Request) -> None:
    """Stores it in the directory `path`."""
    write_atomic(path / REQUEST, as_text(request))


def as_text(request: Request) -> str:
    """What run.json holds."""
    data = {"format": FORMATS[-1], **dataclasses.asdict(request)}
    data |= data.pop("conditions")
    for field in dataclasses.fields(Conditions):
        if field.name in LATER and data[field.name] == field.default:
            del data[field.name]
    if (request.shown, request.variants, request.conditions.retrain) == ((ALL_SHOWN,), (), True):
        data["format"] = FORMATS[0]
        for name in ("shown", "variants", "retrain"):
            del data[name]
    if data["seeds"] == tuple(range(len(data["seeds"]))):
        data["seeds"] = len(data["seeds"])
    return json.dumps({"sha256": checksum(data), **data}, indent=2) + "\n"


def existing(path: Path) -> Request:
    """Raises BadInput where `path` holds no run."""
    try:
        request = stored_request(path)
    except BadInput as error:
        if runs := sorted(str(file.parent) for file in path.glob(f"*/{REQUEST}")):
            more = f" and {len(runs) - MOST_NAMED} more" if len(runs) > MOST_NAMED else ""
            is_study = "a study (its tables: study.md)" if (path / STUDY).exists() else "no run"
            told = f"{path} holds {is_study}; runs in it are {', '.join(runs[:MOST_NAMED])}{more}: name one"
            raise BadInput(told) from error
        raise
    if request is None:
        raise BadInput(f"{path} holds no run (no run.json)")
    return request


def merged(path: Path, request: Request) -> Request:
    """The request of `path` grown by this one. Raises BadInput where they cannot be one run."""
    old = stored_request(path)
    grown = request if old is None else _grown(path, old, request)
    try:
        found = checked(json.loads(json.dumps(dataclasses.asdict(grown))), Request)
    except ValueError as error:
        raise BadInput(f"{path} cannot hold so much: {error}") from error
    if old is not None:
        _check_known(path, old)
    return found


def _check_known(path: Path, old: Request) -> None:
    """Raises BadInput where the run in `path` has methods or environments that are not known here."""
    known = {*KNOWN.entries["method"], *KNOWN.entries["env"]}
    if strangers := [name for name in (*old.methods, *old.envs) if task_or_name(name) not in known]:
        raise BadInput(
            f"{path} holds cells of {strangers[0]}, which is of a plug-in: name that too with --plugin, "
            "or give another --out",
            page="plugins",
        )


def _grown(path: Path, old: Request, request: Request) -> Request:
    """The request `old`, stored in `path`, and this one. Raises BadInput where their conditions differ."""
    for name in KEYS:
        there, asked = (its.conditions.in_words(name) for its in (old, request))
        if there != asked and (name, there) != ("record", EARLIER_RECORD):
            said = f"{name} {there}, not {asked}"
            raise BadInput(f"{path} holds a run with {said}; give another --out", "commands")
    return Request(
        methods=_union(KNOWN.entries["method"], old.methods, request.methods),
        envs=_union(KNOWN.entries["env"], old.envs, request.envs),
        seeds=tuple(sorted({*old.seeds, *request.seeds})),
        conditions=dataclasses.replace(old.conditions, record=request.conditions.record),
        shown=tuple(sorted({*old.shown, *request.shown})),
        variants=tuple(sorted({*old.variants, *request.variants})),
    )


def _seeds(stored: Any) -> Any:
    """Which they are, where it is said how many from 0."""
    few = type(stored) is int and 0 < stored <= MOST_SEEDS
    return list(range(stored)) if few else stored


def _union(order: dict[str, Any], *lists: tuple[str, ...]) -> tuple[str, ...]:
    names = {name for names in lists for name in names}
    return tuple(name for name in order if name in names) + tuple(sorted(names - order.keys()))


def is_begun(path: Path, first: str) -> bool:
    """Whether the directory holds what a run that was killed before its first file was whole leaves there,
    and nothing else."""
    there = {file.name for file in path.iterdir()} - {
        file.name for file in unfinished(path, re.escape(first))
    }
    ours = rf"({LOCK_MARK}\d{{0,20}})?".encode()
    return there == {LOCK} and re.fullmatch(ours, read(path / LOCK)) is not None


def stored_request(path: Path) -> Request | None:
    """The request stored in `path`; None where nothing is there yet. Raises BadInput for all else."""
    file = path / REQUEST
    try:
        if not list(path.iterdir()) or is_begun(path, REQUEST):
            return None
        text = read(file)
        for folder in FOLDERS:
            if (path / folder).is_symlink() or ((path / folder).exists() and not (path / folder).is_dir()):
                raise BadInput(f"cannot use {path}: its {folder} is no folder of its own")
    except FileNotFoundError as error:
        if not os.path.lexists(path):
            return None
        raise BadInput(f"{path} is not empty and holds no run (no run.json)") from error
    except OSError as error:
        raise BadInput(f"cannot use {path}: {error.strerror}") from error
    except ValueError as error:
        raise BadInput(f"cannot use {str(path)!r}: {error}") from error
    try:
        data = json.loads(text)
        version = data["format"]
        if version in FORMATS:
            if data.pop("sha256") != checksum(data):
                raise ValueError
            conditions = {key: data.pop(key) for key in KEYS if key in data}
            request = checked({**data, "conditions": conditions, "seeds": _seeds(data["seeds"])}, Request)
            if list(request.seeds) != sorted({*request.seeds}):
                raise ValueError
            return request
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise BadInput(f"{file} is damaged") from error
    known = " and ".join(map(str, FORMATS))
    raise BadInput(f"{path} has format {printable(repr(version))[:40]}; this version reads {known}")
