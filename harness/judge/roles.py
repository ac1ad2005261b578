"""The role of each method and control on a leaderboard."""

from __future__ import annotations

from harness.records import LOWER_CONTROLS, REFERENCE
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
"""Protocols under which an end pays nothing. There control_plus1 means "stay alive", and control_survival
pays 0 everywhere; under the others it is the reverse (docs/termination.md)."""
UNINFORMED = (LOWER, SURVIVAL, "shuffled control")
"""Roles of controls without information about the task."""


def role_of(method: str, protocol: str) -> str:
    """Return the role under a protocol; 'method' for those that are compared with each other."""
    swapped = {"control_plus1": SURVIVAL, "control_survival": LOWER} if protocol in WITHOUT_OFFSET else {}
    return swapped.get(method) or _ROLES.get(method, "method")


def is_rival(method: str) -> bool:
    """Return whether the method competes with others, unlike controls and the reference."""
    return method not in _ROLES
