"""Versions of methods for tasks whose model is known, and exact solutions of such tasks (`model`).

A method's `fit` hands over to its version here in one line: `tabular(TabularMaxEnt, self).fit(...)`. Methods
without a version, such as `bc`, do the same in all tasks.
"""

from dataclasses import fields
from typing import Any, TypeVar, cast

Version = TypeVar("Version")


def tabular(version: type[Version], method: object) -> Version:
    """Return a method's tabular version, with the values of the hyper-parameters that both have."""
    return version(**{field.name: getattr(method, field.name) for field in fields(cast(Any, version))})
