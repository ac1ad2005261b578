"""The settings that a cell is computed with, for people: of its method, its learner and its budget."""

from __future__ import annotations

import dataclasses
from typing import Any

from harness.records import CONTROL_METHODS, CONTROLS, REFERENCE, Conditions
from harness.registry import plugins
from harness.registry.bounds import LONGEST_TEXT, Setting, Settings, usable
from harness.registry.tasks import task_for
from harness.store.codec import printable

NO_NUMBERS = "It tells people what keys are of already."

LIMITS = ("rl_steps", "solves", "eval_episodes", "demo_episodes")
"""The fields of a task that are tables by budget."""


def settings_of(method: str, env: str, conditions: Conditions) -> Settings:
    """Return the hyper-parameters that a method gets in an environment, those of the learner that solves
    rewards there, and what the budget allows. The reference, and controls without a fit, have no first."""
    spec, settings = task_for(env, conditions), Settings()
    name = CONTROL_METHODS.get(method, method)
    if name not in (REFERENCE, *CONTROLS):
        settings["method"] = _fields(plugins.method_for(name, env, conditions.budget))
    settings["learner"] = {"name": "exact"}
    if spec.tabular is None:
        settings["learner"] = {"name": type(spec.rl).__name__, **_fields(spec.rl)}
    limits = {limit: getattr(spec, limit)[conditions.budget] for limit in LIMITS}
    settings["budget"] = {"name": conditions.budget, **limits}
    if conditions.solves:
        settings["budget"]["solves"] = conditions.solves
    return settings


def _fields(values: Any) -> dict[str, Setting]:
    """Return the fields of a dataclass as JSON holds them."""
    fields = {field.name: getattr(values, field.name) for field in dataclasses.fields(values)}
    return {
        name: [_scalar(item) for item in value[:100]] if isinstance(value, tuple | list) else _scalar(value)
        for name, value in fields.items()
    }


def _scalar(value: object) -> bool | int | float | str:
    if isinstance(value, bool | int) or (isinstance(value, float) and usable(value)):
        return value
    return printable("none" if value is None else str(value))[:LONGEST_TEXT]
