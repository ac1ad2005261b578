"""The phase of a job that runs: data until it is shown."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from harness.judge.numbers import as_text

NO_NUMBERS = "It words how far a cell is, for people."

IN_WORDS = {
    "demonstrate": "reading demonstrations",
    "retrain": "RL",
    "score": "scoring",
    "measure": "measuring the reward",
    "record": "recording",
}


@dataclass(frozen=True)
class Phase:
    """A stage of a job, and its progress. `stage` is '' where that is unknown, as on a cluster.

    `step`, `of`: environment steps so far, and of the whole stage; None where unknown.
    `returns`: mean true returns of the policies that were scored by now. `values`: new points of curves.
    """

    stage: str = ""
    step: int | None = None
    of: int | None = None
    returns: Mapping[str, float] = field(default_factory=dict)
    values: Mapping[str, float] = field(default_factory=dict)

    def __str__(self) -> str:
        """Return words for people, such as 'RL step 12k of 40k'."""
        counts = [("step", self.step), ("of", self.of)]
        words = [f"{word} {short(count)}" for word, count in counts if count is not None]
        text = " ".join([IN_WORDS.get(self.stage, self.stage), *words])
        return f"{text}; {returned(self.returns)}" if self.returns else text


def returned(returns: Mapping[str, float]) -> str:
    """Return mean returns of policies in words."""
    return ", ".join(
        f"{name} {as_text(value, '.1f' if abs(value) >= 10 else '.2f')}" for name, value in returns.items()
    )


def short(count: int) -> str:
    """Return a number of steps in few letters, such as 800, 12k or 1.2M."""
    if count < 1000:
        return str(count)
    return f"{count / 1000:.3g}k" if count < 999_500 else f"{count / 1e6:.3g}M"
