"""What each method and control is on a leaderboard for."""

from __future__ import annotations

from harness.judge.results import LOWER_CONTROLS, REFERENCE
from harness.registry import ASKING

LOWER, SURVIVAL, ASKS = "lower control", "survival control", "asks the expert"
_ROLES = {
    REFERENCE: "reference",
    "control_true": "upper control",
    "control_survival": SURVIVAL,
    "control_shuffled": "shuffled control",
    "control_clone": "clone control",
    **dict.fromkeys(LOWER_CONTROLS, LOWER),
    **dict.fromkeys(ASKING, ASKS),
}
WITHOUT_OFFSET = ("native", "state")
"""Protocols under which an end pays nothing: a constant +1 then says "stay alive", as control_survival does
under the others, and that pays 0 everywhere, as +1 does there (docs/termination.md)."""
UNINFORMED = (LOWER, SURVIVAL, "shuffled control")
"""Roles of controls that know nothing of how to do the task."""


def role_of(method: str, protocol: str) -> str:
    """What it is there for, 'method' where it is compared with the others."""
    if protocol in WITHOUT_OFFSET:
        swapped = {"control_plus1": SURVIVAL, "control_survival": LOWER}
        return swapped.get(method) or _ROLES.get(method, "method")
    return _ROLES.get(method, "method")


def is_rival(method: str) -> bool:
    """Whether it is compared with the other methods, or is there for comparison."""
    return method not in _ROLES
