"""Installed packages that numbers can come from, with their versions."""

from __future__ import annotations

import functools
import importlib.metadata
import sys
from collections.abc import Iterable
from typing import NamedTuple

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from harness.registry.names import BadInput

NO_NUMBERS = "Its results are the keys themselves."
PROGRAM = "irl-bench"
PACKAGES = (
    *("torch", "numpy", "scipy", "jax", "jaxlib", "flax", "optax", "stable-baselines3", "sbx-rl"),
    *("gymnasium", "mujoco", "highway-env", "cvxpy", "clarabel"),
)
"""Packages whose versions a result names. Keys are of more of them."""
LEFT_OUT = {
    **dict.fromkeys(("irl-bench",), "keys are of its source"),
    **dict.fromkeys(("matplotlib", "jinja2", "markupsafe", "rich", "rerun-sdk"), "they show results"),
    **dict.fromkeys(("pillow", "imageio", "pygame-ce", "pygame", "glfw", "pyopengl"), "they draw"),
    **dict.fromkeys(("filelock", "pebble", "psutil", "tqdm"), "they start, lock or count"),
    **dict.fromkeys(("pandas",), "it makes tables of stored rows"),
    **dict.fromkeys(("pyarrow",), "it reads files of demonstrations, whose content is in the keys"),
}
"""Packages that change no number, and why. Packages that only they require are left out, too."""

BUILT = {"box2d": (3, 14)}
"""Extras that are compiled when they are installed, and the Python since which they are."""


class Facts(NamedTuple):
    """A distribution's metadata; empty where it is not installed."""

    version: str = ""
    requirements: tuple[str, ...] = ()
    extras: tuple[str, ...] = ()


@functools.cache
def facts(name: str) -> Facts:
    """Return a distribution's metadata, as it was when this process first asked."""
    try:
        distribution = importlib.metadata.distribution(name)
    except importlib.metadata.PackageNotFoundError:
        return Facts()
    stated = distribution.metadata
    (version,) = stated.get_all("Version") or ("",)
    return Facts(version, tuple(distribution.requires or ()), tuple(stated.get_all("Provides-Extra") or ()))


def version_of(name: str) -> str:
    """Return the version of a distribution, '' where it is not installed or has none."""
    return facts(name).version


def required(*roots: str, extras: bool = False) -> dict[str, str]:
    """Return the versions of these distributions, by default this program's, and of all that they require.

    `LEFT_OUT` is left out. extras: whether those of the roots count. A distribution that is not installed has
    version ''.
    """
    return {name: version_of(name) for name in _required(roots or (PROGRAM,), extras)}


def versions(names: Iterable[str]) -> list[str]:
    """Return the versions of installed packages. Raises BadInput for one that is missing or incomplete."""
    stated = {name: version_of(name) for name in names}
    for name, version in stated.items():
        if not version:
            raise BadInput(f"the package {name} is not installed, or only in part; install it again")
    return [*stated.values()]


def versions_of_module(top: str, extras: bool = False) -> dict[str, str]:
    """Return the versions of the distributions that a module may be of, and of all that they require."""
    # Most distributions are called as their module is, and to ask all of them takes a second.
    names = [top] if version_of(top) else sorted(set(distributions().get(top, [])))
    return required(*names, extras=extras) if names else {}


@functools.cache
def distributions() -> dict[str, list[str]]:
    """Return the names of distributions by module. This takes a second, once."""
    return dict(importlib.metadata.packages_distributions())


@functools.cache
def _required(roots: tuple[str, ...], extras: bool) -> tuple[str, ...]:
    names, waiting = set[str](), [*roots]
    while waiting:
        if (name := canonicalize_name(waiting.pop())) in names:
            continue
        names.add(name)
        optional = facts(name).extras if extras and name in map(canonicalize_name, roots) else ()
        for one in map(Requirement, facts(name).requirements):
            holds = one.marker is None or any(one.marker.evaluate({"extra": e}) for e in ("", *optional))
            if holds and canonicalize_name(one.name) not in LEFT_OUT:
                waiting.append(one.name)
    return tuple(sorted(names - {PROGRAM}))


def to_install(extra: str) -> str:
    """Return how to install an extra."""
    is_built = sys.version_info >= BUILT.get(extra, (4,))
    return f"pip install 'irl-bench[{extra}]'" + is_built * ", which needs swig and a C++ compiler"
