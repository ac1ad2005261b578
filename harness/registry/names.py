"""Names that users choose among, and the choice."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Mapping, Sequence
from types import MappingProxyType
from typing import Literal

NO_NUMBERS = {"choose": "It reads what users type."}

Library = Literal["sbx", "sb3"]
LearnerName = Literal["own", "ddpg"]
Experts = Literal["shipped", "trained", "none"]
Record = Literal["none", "median", "worst", "both", "all", "first"]
Demonstrator = Literal["expert", "medium", "noisy", "ranked"]
LastObservation = Literal["repeat", "drop"]
Sampler = Literal["tpe", "random"]
EngineName = Literal["isolated", "inline", "ray"]

BUDGETS = ("smoke", "quick", "full")
LIBRARIES: tuple[Library, ...] = ("sbx", "sb3")
LEARNERS: tuple[LearnerName, ...] = ("own", "ddpg")
"""Learners of a run: each task's own, or DDPG, the thesis's."""
ENCODERS = ("small", "nature")
"""Encoders of images (`envs.encoders.LAYERS`)."""
EXPERTS: tuple[Experts, ...] = ("shipped", "trained", "none")
LOGS = ("tensorboard", "wandb")
"""Programs that show curves of running cells."""
SAMPLERS: tuple[Sampler, ...] = ("tpe", "random")
"""Samplers of hyper-parameters in a search."""
ENGINES: tuple[EngineName, ...] = ("isolated", "inline", "ray")
RECORDS: tuple[Record, ...] = ("none", "median", "worst", "both", "all")
DEMONSTRATORS: tuple[Demonstrator, ...] = ("expert", "medium", "noisy", "ranked")
LAST_OBSERVATIONS: tuple[LastObservation, ...] = ("repeat", "drop")
"""Treatments of files without an episode's last observation (`harness.demonstrations.recording.Reading`)."""
PROTOCOLS = ("absorbing", "native", "state", "offset")
"""Treatments of an episode's end (`harness.rl.solving`). The last two are parts of the first."""


class BadInput(Exception):
    """A request that cannot be done. Its text is the one line that the user reads.

    page: the page of docs/ that helps, without its ending. The line ends with it.
    """

    def __init__(self, text: str, page: str = "") -> None:
        super().__init__(f"{text} (docs/{page}.md)" if page else text)


class Unfinished(Exception):
    """An end of a run before it was done. Its text is one line, and what is finished is kept."""

    def __init__(self, why: str) -> None:
        super().__init__(f"{why}; what is finished is kept, and the same command goes on")


SETTING = "+"
"""The character before each setting in the name of a method that has some."""


def base(method: str) -> str:
    """Return the name of a method without its settings."""
    return method.partition(SETTING)[0]


def plain(text: str) -> str:
    """Return the text with every character escaped that cannot be printed."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def choose(
    kind: str,
    text: str,
    known: Collection[str],
    variants: Collection[str] = (),
    groups: Mapping[str, Sequence[str]] = MappingProxyType({}),
) -> tuple[str, ...]:
    """Return the names in a text with commas between, in the order of `known` and `variants`.

    'all' stands for every name of `known`, and a group's name for its members.
    Raises BadInput for an empty name and, with the closest matches, for unknown ones.
    """
    names = [name.strip() for name in text.split(",")]
    choices = (*known, *variants)
    groups = {"all": (*known,), **groups}
    if not all(names):
        raise BadInput(f"no {kind} named: give 'all' or some of {', '.join(choices)}")
    if unknown := [name for name in names if name not in groups and name not in choices]:
        alike = [name.lower().replace("-", "_") for name in unknown]
        near = [difflib.get_close_matches(name, [*choices, *groups], 1) for name in alike]
        meant = ", ".join(repr(names[0]) for names in near if names)
        advice = f"did you mean {meant}?" if all(near) else f"there are {', '.join(choices)}"
        raise BadInput(f"no {kind} named {', '.join(map(repr, unknown))}; {advice}")
    chosen = {one for name in names for one in groups.get(name, (name,))}
    return tuple(name for name in choices if name in chosen)
