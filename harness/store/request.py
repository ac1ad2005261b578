"""The request of a run's directory, how it grows by another one, and the command line that asks for it."""

from __future__ import annotations

import dataclasses
import json
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta

from harness.records import ALL_SHOWN, CONTROLS, NOMINAL, REFERENCE, UNSHOWN, Cell, Conditions, Shown
from harness.registry import KNOWN, BadInput, base
from harness.registry.bounds import MOST_SEEDS, Name, Names, Seed
from harness.registry.built_in import BUILT_IN
from harness.registry.gymnasium_tasks import task_or_name
from harness.registry.known import GYMNASIUM_NAME
from harness.store.codec import encode, parsed

NO_NUMBERS = "It merges what was asked for, of which keys are."


@dataclass(frozen=True)
class Request:
    """The request of a run."""

    methods: Names
    envs: Names
    seeds: Annotated[tuple[Seed, ...], Meta(min_length=1, max_length=MOST_SEEDS)]
    """Seeds in ascending order."""
    conditions: Conditions
    shown: Annotated[tuple[Shown, ...], Meta(min_length=1, max_length=100)] = (ALL_SHOWN,)
    """Demonstrations that each method sees, one after the other."""
    variants: Annotated[tuple[Name, ...], Meta(max_length=1000)] = ()
    """Variants, 'ENV.VARIANT', in which what was learned is used."""
    controls: bool = True
    """True where controls are computed beside pi_R."""

    @property
    def _methods(self) -> tuple[str, ...]:
        controls = CONTROLS if self.controls and self.conditions.retrain else ()
        return (REFERENCE, *controls, *self.methods)

    def _shown_to(self, method: str) -> tuple[Shown, ...]:
        return (ALL_SHOWN,) if method in UNSHOWN else self.shown

    @property
    def cells(self) -> list[Cell]:
        """Every cell, those of the reference and the controls included."""
        variants = [variant.partition(".") for variant in self.variants]
        return [
            Cell(env, method, seed, shown, dynamics)
            for env in self.envs
            for dynamics in (NOMINAL, *(variant for its, _, variant in variants if its == env))
            for method in self._methods
            for shown in self._shown_to(method)
            for seed in self.seeds
        ]

    def asks_for(self, cell: Cell) -> bool:
        """Return whether the cell is one of `cells`."""
        return (
            cell.method in self._methods
            and cell.env in self.envs
            and cell.seed in self.seeds
            and cell.shown in self._shown_to(cell.method)
            and (cell.dynamics == NOMINAL or cell.task in self.variants)
        )


def request_in(text: bytes | str) -> Request:
    """Return the request that `encode` wrote. Raises ValueError for anything else."""
    request = parsed(text, Request)
    if list(request.seeds) != sorted({*request.seeds}):
        raise ValueError("its seeds are not in order")
    return request


def grown(path: Path, old: Request | None, asked: Request) -> Request:
    """Return the request `old` of the directory `path`, where it has one, grown by `asked`.

    Raises BadInput where they cannot be one run, it would be larger than a directory can hold, or methods or
    environments of the old one are not known here.
    """
    union = asked if old is None else _union(path, old, asked)
    try:
        request_in(encode(union))
    except ValueError as error:
        raise BadInput(f"{path} cannot hold so much: {error}") from error
    names = (*old.methods, *old.envs) if old else ()
    for name in names:
        KNOWN.configure(name)
    known = {*KNOWN.entries["method"], *KNOWN.entries["env"]}
    if strangers := [name for name in names if task_or_name(name) not in known]:
        raise BadInput(
            f"{path} holds cells of {strangers[0]}, which is of a plug-in: name that too with --plugin, "
            "or give another --out",
            page="plugins",
        )
    return union


def _union(path: Path, old: Request, asked: Request) -> Request:
    """Return both requests as one. Raises BadInput where their conditions differ."""
    for field in dataclasses.fields(Conditions):
        there, here = (request.conditions.in_words(field.name) for request in (old, asked))
        if there != here:
            differs = f"{field.name} {there}, not {here}"
            raise BadInput(f"{path} holds a run with {differs}; give another --out", "commands")
    return Request(
        methods=_in_order(KNOWN.entries["method"], old.methods + asked.methods),
        envs=_in_order(KNOWN.entries["env"], old.envs + asked.envs),
        seeds=tuple(sorted({*old.seeds, *asked.seeds})),
        conditions=old.conditions,
        shown=tuple(sorted({*old.shown, *asked.shown})),
        variants=tuple(sorted({*old.variants, *asked.variants})),
        controls=old.controls or asked.controls,
    )


def _in_order(known: dict[str, Any], names: tuple[str, ...]) -> tuple[str, ...]:
    """Return each name once, the known ones first and in their order."""
    return tuple(name for name in known if name in names) + tuple(sorted({*names} - known.keys()))


def as_seeds(seeds: Sequence[int]) -> str:
    """Return seeds as `--seeds` takes them: their number, where they count from 0, else ranges, '0,3,5-9'."""
    if list(seeds) == list(range(len(seeds))):
        return str(len(seeds))
    starts = [s for s in seeds if s - 1 not in seeds]
    ends = [s for s in seeds if s + 1 not in seeds]
    ranges = [f"{a}-{b}" if a < b or len(seeds) == 1 else str(a) for a, b in zip(starts, ends, strict=True)]
    return ",".join(ranges)


def command_of(request: Request, beside: bool = False) -> str:
    """Return the command line of a request, or several, joined by '&&'. `beside`: True for a run beside a
    baseline."""
    c = request.conditions
    known = {*BUILT_IN["method"], *BUILT_IN["env"]}
    others = [name for name in (*map(base, request.methods), *request.envs) if name not in known]
    plugged = any(not name.startswith(GYMNASIUM_NAME) for name in others)
    dynamics = dict.fromkeys(variant.partition(".")[2] for variant in request.variants)
    words = ["irl-bench run", "--methods", ",".join(request.methods), "--envs", ",".join(request.envs)]
    words += ["--plugin", "FILE"] if plugged else []
    words += ["--seeds", as_seeds(request.seeds), "--budget", c.budget, "--protocol", c.protocol]
    words += ["--rl", c.rl]
    words += ["--learner", c.learner] if c.learner != "own" else []
    words += ["--solves", str(c.solves)] if c.solves else []
    words += ["--encoder", c.encoder] if c.encoder else []
    for name, value in json.loads(c.env_kwargs or "{}").items():
        words += ["--env-kwargs", shlex.quote(f"{name}={json.dumps(value)}")]
    for name in json.loads(c.env_vars or "{}"):
        words += ["--env-var", name]
    words += ["--experts", c.experts, "--record", c.record]
    words += ["--transfer", ",".join(dynamics)] if dynamics else []
    words += ["--demos-from", "FILE"] if c.demonstrations else []
    words += ["--baseline", "DIR"] if beside else []
    words += [] if c.retrain else ["--no-retrain"]
    words += [] if c.deterministic else ["--fast"]
    many: dict[tuple[int, str], list[int]] = {}
    for shown in request.shown:
        many.setdefault((shown.every, shown.demonstrator), []).append(shown.demos)
    commands = []
    for (every, demonstrator), demos in many.items():
        more = ["--demos", ",".join(map(str, demos))] if demos != [0] else []
        more += ["--subsample", str(every)] if every > 1 else []
        more += ["--demonstrator", demonstrator] if demonstrator != "expert" else []
        commands.append(" ".join([*words, *more]))
    return " && ".join(commands)
