"""What a job says that it does (`harness.cell`), taken apart for who shows it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

from harness.judge.numbers import as_text

NO_NUMBERS = "It reads and words what people are told of a cell's progress."

IN_WORDS = {
    "demonstrate": "reading demonstrations",
    "retrain": "RL",
    "score": "scoring",
    "measure": "measuring the reward",
    "record": "recording",
}
STEPS = re.compile(r"(.*), (?:step ([\d,]{1,20}) of ([\d,]{1,20})|([\d,]{1,20}) steps so far)")
RETURNS = re.compile(r"(\w+) (-?\d{1,20}(?:\.\d+|(?:\.\d+)?e[+-]\d{1,3}))")


@dataclass(frozen=True)
class Phase:
    """A stage of a job; '' where it has told none, as on a cluster.

    step, of: environment steps so far, and how many there will be; None where that is not told. returns: the
    mean true return of each of the cell's policies that was scored by now.
    """

    name: str = ""
    step: int | None = None
    of: int | None = None
    returns: Mapping[str, float] = field(default_factory=dict)

    def __str__(self) -> str:
        """For people, such as 'RL step 12k of 40k'."""
        words = [IN_WORDS.get(self.name, self.name)]
        if self.step is not None:
            words.append(f"step {short(self.step)}")
        if self.of is not None:
            words.append(f"of {short(self.of)}")
        return "; ".join([" ".join(words), *filter(None, [returned(self.returns)])])


def phase_of(said: str) -> Phase:
    """What a job said of itself; where it is in no known form, that as the phase's name."""
    stage, _, scores = said.partition("; ")
    found = STEPS.fullmatch(stage)
    name, step, of, so_far = found.groups() if found else (stage, None, None, None)
    returns = {policy: float(value) for policy, value in RETURNS.findall(scores)}
    return Phase(name, _count(step or so_far), _count(of), returns)


def returned(returns: Mapping[str, float]) -> str:
    """Mean returns of policies, as `phase_of` reads them."""
    return ", ".join(
        f"{name} {as_text(value, '.1f' if abs(value) >= 10 else '.2f')}" for name, value in returns.items()
    )


def short(count: int) -> str:
    """A number of steps, such as 800, 12k or 1.2M."""
    if count < 1000:
        return str(count)
    return f"{count / 1000:.3g}k" if count < 999_500 else f"{count / 1e6:.3g}M"


def _count(text: str | None) -> int | None:
    return int(text.replace(",", "")) if text else None
