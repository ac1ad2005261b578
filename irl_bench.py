"""The public interface of this benchmark.

import irl_bench

frames = irl_bench.run(methods=["bc", "gail"], envs=["swingup"], seeds=3, budget="smoke")
scores = irl_bench.load("results/reference/board/swingup_5").scores
"""

from __future__ import annotations

import importlib
import os
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    pass

_FROM = {
    "envs": ("EnvSpec", "from_gymnasium"),
    "envs.learners": ("DDPG", "DQN", "PPO", "SAC", "TD3"),
    "envs.spec": ("Quantity", "Shape"),
    "harness.exported": (*("Exported", "ExportedPolicy", "LearnedReward", "export", "load_learned", "make"),),
    "harness.frames": ("Frames", "add_plugins", "load", "run"),
    "harness.testing": ("ContractError", "check_env", "check_method"),
    "methods.base": (
        *("Episodes", "Learned", "Method", "Policy", "Reward", "Transitions", "Unsuitable", "World"),
    ),
    "methods.network": ("Network",),
    "methods.rewards": ("LinearReward", "MeanReward", "NetworkReward", "StateReward"),
}
WHERE = {name: module for module, names in _FROM.items() for name in names}
"""Home module of each public name."""

__all__ = list(WHERE)


def _begin() -> None:
    """Import this program's packages before others of their names, such as those beside a script."""
    here = os.path.dirname(os.path.realpath(__file__))
    sys.path.insert(0, here)
    try:
        from harness.run import ours
    except ImportError as error:
        file = getattr(sys.modules.get("harness"), "__file__", None)
        raise ImportError(f"{file} hides this program's package 'harness': rename it") from error
    finally:
        sys.path.remove(here)
    ours.first()


_begin()


def start() -> int:
    """Run the command line, and return its exit code."""
    from harness.__main__ import start

    return start()


def __getattr__(name: str) -> object:
    """Import a public name on first use, because torch takes a second."""
    if name not in WHERE:
        raise AttributeError(f"module 'irl_bench' has no attribute {name!r}; it has {', '.join(__all__)}")
    return getattr(importlib.import_module(WHERE[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
