"""Numbers as text for people."""

from __future__ import annotations

import math
import re

LARGE = 1e9
"""The least number that is written with a power of ten."""


def as_text(value: float, spec: str) -> str:
    """Return the number in the format `spec`, a large one with four digits and a power of ten, or 'n/a'."""
    if not math.isfinite(value):
        return "n/a"
    return format(value, re.sub(r"(\.\d+)?[fg]$", ".4g", spec) if abs(value) >= LARGE else spec)
