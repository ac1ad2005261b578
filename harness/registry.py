"""Names: which methods and environments there are, known without importing any of them."""

from __future__ import annotations

import difflib
import importlib
from collections.abc import Collection
from typing import TYPE_CHECKING, NamedTuple, cast

if TYPE_CHECKING:
    from harness.results import Experts, Library, Record
    from methods.base import Method

BUDGETS = ("smoke", "quick", "full")
LIBRARIES: tuple[Library, ...] = ("sbx", "sb3")
EXPERTS: tuple[Experts, ...] = ("shipped", "trained")
RECORDS: tuple[Record, ...] = ("first", "none")
PROTOCOLS = ("absorbing", "native", "state", "offset")
"""What becomes of an episode's end (`harness.rl`); the last two are parts of the first."""


class BadInput(Exception):
    """What the user asked for cannot be done; its text is the one line they are told."""


class Entry(NamedTuple):
    """Where a method is ('module:Class') and what it is, in one line."""

    target: str
    summary: str


METHODS = {
    "shaped": Entry("methods.shaped:Shaped", "the thesis's shaped-reward model, learned from expert pairs"),
    "shaped_ml": Entry(
        "methods.shaped_ml:ShapedML", "shaped, with L fitted by likelihood and an inverse LQR in the world"
    ),
    "maxmargin": Entry(
        "methods.maxmargin:MaxMargin", "max-margin apprenticeship learning (Abbeel & Ng 2004)"
    ),
    "maxent": Entry("methods.maxent:MaxEnt", "maximum-entropy deep IRL (Wulfmeier et al. 2015)"),
    "bc": Entry("methods.bc:BehaviourCloning", "behaviour cloning; learns no reward"),
}
VARIANTS = {
    "maxent_linear": Entry(
        "methods.maxent_linear:MaxEntLinear", "maximum-entropy IRL with a linear reward (Ziebart et al. 2008)"
    ),
    "maxmargin_projection": Entry(
        "methods.maxmargin:MaxMargin", "maxmargin by the paper's projection method instead"
    ),
}
"""Methods that run when they are named, but are not part of 'all'."""
ENVS = {
    "cartpole": "continuous cart-pole: keep the pole upright for 500 steps (RLLab's reward)",
    "pendulum": "MuJoCo InvertedPendulum-v5: balance the pole for 1000 steps",
    "highway": "highway-env, three lanes, steering and acceleration: drive fast without crashing for 30 s",
    "cartpole_discrete": "Gymnasium's CartPole-v1, two actions: keep the pole upright for 500 steps",
    "gridworld": "objectworld, 12 by 12 cells: find what pays, avoid what costs; the model is known",
}


def choose(kind: str, text: str, known: Collection[str], variants: Collection[str] = ()) -> tuple[str, ...]:
    """The names in a comma-separated `text`, 'all' being every known one but no variant, without repeats, in
    the order of `known` and then `variants`.

    Raises BadInput, with the closest match, for an unknown name; and for an empty one.
    """
    names = [name.strip() for name in text.split(",")]
    choices = (*known, *variants)
    if not all(names):
        raise BadInput(f"no {kind} named: give 'all' or some of {', '.join(choices)}")
    for name in names:
        if name != "all" and name not in choices:
            near = difflib.get_close_matches(name, choices, n=1, cutoff=0.5)
            hint = f"did you mean {near[0]!r}?" if near else f"there are {', '.join(choices)}"
            raise BadInput(f"no {kind} named {name!r}; {hint}")
    return tuple(name for name in choices if name in names or ("all" in names and name in known))


def load_method(name: str) -> type[Method]:
    """The method's dataclass, imported now. Raises BadInput for an unknown name."""
    entries = METHODS | VARIANTS
    if name not in entries:
        choose("method", name, METHODS, VARIANTS)
        raise BadInput(f"{name!r} is not one method")
    module, _, attribute = entries[name].target.partition(":")
    return cast("type[Method]", getattr(importlib.import_module(module), attribute))
