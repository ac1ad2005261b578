"""A check of a contract, and its outcome in words."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from harness.process.environment import hint
from methods.base import Unsuitable

READ = "docs/plugins.md"
"""The page to read, where a message names no other."""


class ContractError(AssertionError):
    """A difference between what is expected of a method or a task, and what came."""


@dataclass(frozen=True)
class Check:
    """A condition that must hold. run: raises whatever it likes where it does not."""

    title: str
    run: Callable[[], object]

    def outcome(self) -> tuple[str, str]:
        """Return 'ok', 'skipped' where the method says that it is not made for that, or 'FAILED', and why."""
        try:
            self.run()
        except Unsuitable as error:
            return "skipped", " ".join(str(error).split())
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # A method may raise SystemExit, too.
            kind = "" if isinstance(error, ContractError) else f"{type(error).__name__}: "
            why = f"{kind}{' '.join(str(error).split())}"[:500] + hint(error)
            return "FAILED", why if "docs/" in why else f"{why} ({READ})"
        return "ok", ""


def expect(holds: object, message: str) -> None:
    """Raise ContractError with the message unless it holds."""
    if not holds:
        raise ContractError(message)
