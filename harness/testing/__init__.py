"""The contract that methods and tasks are tested by, this program's own and those of plug-ins."""

from __future__ import annotations

from envs import EnvSpec
from harness.testing import envs, methods
from harness.testing.contract import Check, ContractError
from methods.base import Method

__all__ = ["ContractError", "check_env", "check_method"]


def check_method(method: Method) -> None:
    """Raises ContractError where it breaks the contract of methods, with what was expected and what came."""
    _run(methods.checks(method))


def check_env(spec: EnvSpec) -> None:
    """Raises ContractError where it breaks the contract of tasks, with what was expected and what came."""
    _run(envs.checks(spec))


def _run(checks: list[Check]) -> None:
    for check in checks:
        outcome, why = check.outcome()
        if outcome == "FAILED":
            raise ContractError(f"{check.title}: {why}")
