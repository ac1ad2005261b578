"""The contract that methods and tasks are tested by, this program's own and those of plug-ins."""

from __future__ import annotations

from envs import EnvSpec
from harness.registry.contract import methods, tasks
from harness.registry.contract.check import Check, ContractError
from methods.base import Method

__all__ = ["ContractError", "check_env", "check_method", "methods", "tasks"]


def check_method(method: Method) -> None:
    """Raise ContractError, which names the broken rule, if a method breaks the contract."""
    _run(methods.checks(method))


def check_env(spec: EnvSpec) -> None:
    """Raise ContractError, which names the broken rule, if a task breaks the contract."""
    _run(tasks.checks(spec))


def _run(checks: list[Check]) -> None:
    for check in checks:
        outcome, why = check.outcome()
        if outcome == "FAILED":
            raise ContractError(f"{check.title}: {why}")
