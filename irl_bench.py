"""Names for plug-ins, notebooks and other programs.

import irl_bench

request = irl_bench.RunRequest(methods=["bc", "gail"], envs=["swingup"], seeds=3, budget="smoke")
results = irl_bench.run(request, store="results/mine")
results.leaderboard[["method", "policy", "score_mean"]]
scores = irl_bench.load("results/reference/board/swingup_5").scores
"""

from __future__ import annotations

import importlib
import os
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from envs import EnvSpec, from_gymnasium
    from envs.learners import DDPG, DQN, PPO, SAC, TD3
    from envs.spec import Quantity, Shape
    from harness.api.exported import Exported, ExportedPolicy, LearnedReward, export, load_learned, make
    from harness.api.preparing import Engine
    from harness.api.request import RunRequest
    from harness.api.results import Results, load
    from harness.api.running import add_plugins, run
    from harness.registry.contract import ContractError, check_env, check_method
    from methods.base import Agent, Episodes, Learned, Method, Policy, Reward, Transitions, Unsuitable, World
    from methods.network import Network
    from methods.rewards import LinearReward, MeanReward, NetworkReward, StateReward

_FROM = {
    "envs": ("EnvSpec", "from_gymnasium"),
    "envs.learners": ("DDPG", "DQN", "PPO", "SAC", "TD3"),
    "envs.spec": ("Quantity", "Shape"),
    "harness.api.exported": (
        *("Exported", "ExportedPolicy", "LearnedReward", "export", "load_learned", "make"),
    ),
    "harness.api.preparing": ("Engine",),
    "harness.api.request": ("RunRequest",),
    "harness.api.results": ("Results", "load"),
    "harness.api.running": ("add_plugins", "run"),
    "harness.registry.contract": ("ContractError", "check_env", "check_method"),
    "methods.base": (
        *("Agent", "Episodes", "Learned", "Method", "Policy", "Reward", "Transitions", "Unsuitable", "World"),
    ),
    "methods.network": ("Network",),
    "methods.rewards": ("LinearReward", "MeanReward", "NetworkReward", "StateReward"),
}
WHERE = {name: module for module, names in _FROM.items() for name in names}
"""The module that each name comes from."""

__all__ = [
    "DDPG",
    "DQN",
    "PPO",
    "SAC",
    "TD3",
    "Agent",
    "ContractError",
    "Engine",
    "EnvSpec",
    "Episodes",
    "Exported",
    "ExportedPolicy",
    "Learned",
    "LearnedReward",
    "LinearReward",
    "MeanReward",
    "Method",
    "Network",
    "NetworkReward",
    "Policy",
    "Quantity",
    "Results",
    "Reward",
    "RunRequest",
    "Shape",
    "StateReward",
    "Transitions",
    "Unsuitable",
    "World",
    "add_plugins",
    "check_env",
    "check_method",
    "export",
    "from_gymnasium",
    "load",
    "load_learned",
    "make",
    "run",
]


def _begin() -> None:
    """Make this program's packages be found before others of their names, such as those beside a script."""
    here = os.path.dirname(os.path.realpath(__file__))
    sys.path.insert(0, here)
    try:
        from harness.registry import ours
    except ImportError as error:
        if sys.platform == "win32":
            raise
        file = getattr(sys.modules.get("harness"), "__file__", None)
        raise ImportError(f"{file} hides this program's package 'harness': rename it") from error
    finally:
        sys.path.remove(here)
    with ours.meanwhile():  # from now on the rest is found, too
        pass


def _register_tasks() -> None:
    """Register every task with Gymnasium, as irl_bench/Swingup-v0. The command answers sooner without."""
    if not os.path.basename(sys.argv[0] if sys.argv else "").startswith("irl-bench"):
        from harness.registry.gymnasium_tasks import register_tasks

        register_tasks()


_begin()
_register_tasks()


def start() -> int:
    """Do what the command line asks for, and return the exit code. For a process of its own."""
    from harness.__main__ import start

    return start()


def __getattr__(name: str) -> object:
    """Import a name when it is first asked for. Torch alone takes a second."""
    if name not in WHERE:
        raise AttributeError(f"module 'irl_bench' has no attribute {name!r}; it has {', '.join(__all__)}")
    from harness.registry import ours

    with ours.meanwhile():
        return getattr(importlib.import_module(WHERE[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
