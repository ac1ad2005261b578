"""The arms of `reproduce`'s study: the thesis's model on more or fewer trajectories, with and without weight
regularisation, which section 5.3 suspects; and behaviour cloning on as many. Their names stand for methods in
cells."""

from __future__ import annotations

from typing import Any, NamedTuple

TRAJECTORIES = (1, 5, 20, 100)
DECAYS = (0.0, 1e-3)
"""Weights of the sum of squared parameters in the loss."""


class Arm(NamedTuple):
    """A method on its own number of demonstrations and with hyper-parameters besides its budget's."""

    method: str
    demonstrations: int | None
    """As many as the budget says where it is None."""
    settings: dict[str, Any]


def name_of(trajectories: int, decay: float) -> str:
    """The method's name in an arm's cells."""
    return f"shaped_{trajectories}_trajectories_decay_{decay:g}"


CLONES = {f"bc_{n}_trajectories": Arm("bc", n, {}) for n in TRAJECTORIES}
ARMS = {name_of(n, d): Arm("shaped", n, {"weight_decay": d}) for n in TRAJECTORIES for d in DECAYS} | CLONES
THESIS = name_of(100, 0.0)
"""What the thesis evaluates."""
