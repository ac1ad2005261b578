"""A check of a contract, and how it says what was expected and what came."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from harness.run.environment import hint
from methods.base import Unsuitable

READ = "docs/plugins.md"
"""Says what is expected, where a message names nothing else."""


class ContractError(AssertionError):
    """What was expected of a method or a task, and what came."""


@dataclass(frozen=True)
class Check:
    """What must hold, and what finds out."""

    title: str
    run: Callable[[], None]
    """Raises ContractError where it does not hold."""

    def outcome(self) -> tuple[str, str]:
        """'ok', 'skipped' where the method says that it is not made for that, or 'FAILED', and why. Whatever
        the check raises is a failure."""
        try:
            self.run()
        except Unsuitable as error:
            return "skipped", " ".join(str(error).split())
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # SystemExit, too: what a method raises ends no check
            kind = "" if isinstance(error, ContractError) else f"{type(error).__name__}: "
            why = f"{kind}{' '.join(str(error).split())}"[:500] + hint(error)
            return "FAILED", why if "docs/" in why else f"{why} ({READ})"
        return "ok", ""


def expect(holds: object, message: str) -> None:
    """Raises ContractError with the message unless it holds."""
    if not holds:
        raise ContractError(message)
