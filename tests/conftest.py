"""How tests run, and a task so small that reinforcement learning takes a second, in two kinds."""

from __future__ import annotations

import functools
import math
import os
import signal
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from harness.process.environment import FIXED

os.environ.update(FIXED)  # before numpy, which decides how many threads it has as it is imported

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from envs import BUDGETS, EnvSpec
from envs.spec import register

HORIZON = 10


def pytest_configure(config: pytest.Config) -> None:
    """Let JAX compile once for all tests, in a cache that is not the user's, and Ctrl-C reach what tests
    start, also in the background of a shell."""
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(config.cache.mkdir("jax")))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
    os.environ.setdefault("IRL_BENCH_CACHE", str(config.cache.mkdir("irl-bench")))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the longest test first. Started last, it would run alone at the end."""
    items.sort(key=lambda item: "test_smoke" not in item.nodeid)


class Target(gym.Env):
    """The observation (1,) is where to be, uniform in [-0.8, 0.8] at every step. The action (1,) goes there.

    Each step pays 1 - |observation - action|. The task terminates where that distance is more than `reach`.
    """

    def __init__(self, reach: float) -> None:
        self.observation_space = spaces.Box(-1.0, 1.0, (1,), np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)
        self.reach = reach
        self.where = 0.0

    def _move(self) -> np.ndarray:
        obs = self.np_random.uniform(-0.8, 0.8, 1).astype(np.float32)
        self.where = float(obs[0])
        return obs

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[np.ndarray, dict]:
        super().reset(seed=seed)
        return self._move(), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        miss = abs(self.where - float(action[0]))
        return self._move(), 1 - miss, miss > self.reach, False, {"reward": 1 - miss}


def target_spec(name: str, reach: float) -> EnvSpec:
    spec = EnvSpec(
        name=name,
        env_id=f"irl_bench_tests/{name}-v0",
        obs_size=1,
        act_size=1,
        obs_scale=(0.5,),
        horizon=HORIZON,
        gamma=0.9,
        time_step=0.1,
        bar=lambda seeds: 9.0,
        rl_steps=dict.fromkeys(BUDGETS, 1500),
        eval_episodes=dict.fromkeys(BUDGETS, 5),
        demo_episodes=dict.fromkeys(BUDGETS, 5),
        phi=lambda obs, act: 1 - (obs - act) ** 2 / 4,
        why_ended=lambda env: "missed",
    )
    register(spec, functools.partial(Target, reach))  # type: ignore[arg-type]
    return spec


@pytest.fixture(scope="session")
def steady() -> EnvSpec:
    """Return the task that never terminates."""
    return target_spec("Steady", math.inf)


@pytest.fixture(scope="session")
def fragile() -> EnvSpec:
    """Return the task that terminates on a miss of more than 0.5."""
    return target_spec("Fragile", 0.5)


@pytest.fixture(autouse=True)
def _forget_plugins() -> Iterator[None]:
    """Forget the plug-ins that a test imported, after which its process computes nothing else."""
    before = {*sys.modules}
    yield
    if known := sys.modules.get("harness.registry.known"):
        for name in {one.module.__name__ for one in known.KNOWN.loaded if one.is_plugin} - before:
            sys.modules.pop(name, None)
        known.KNOWN.loaded.clear()


@pytest.fixture
def fused_adam() -> Iterator[None]:
    """Fail a step of torch's default Adam, which not all processors round alike."""
    # Not before `pytest_configure`, which says how many threads torch may have.
    import torch
    from torch.optim.optimizer import register_optimizer_step_pre_hook

    def check(optimizer: torch.optim.Optimizer, *_: object) -> None:
        assert not isinstance(optimizer, torch.optim.Adam) or optimizer.defaults["fused"]

    handle = register_optimizer_step_pre_hook(check)
    yield
    handle.remove()


@pytest.fixture
def tried(record_property: Callable[[str, object], None]) -> Callable[[str, Counter[str]], None]:
    """Return a function that notes how much was tried, for the end of the test run."""

    def tell(what: str, counts: Counter[str]) -> None:
        parts = ", ".join(f"{count} {name}" for name, count in sorted(counts.items()))
        record_property("tried", f"{counts.total()} {what}: {parts}")

    return tell


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    for report in terminalreporter.getreports("passed"):
        for name, value in report.user_properties:
            if name == "tried" and report.when == "call":
                terminalreporter.write_line(f"tried {value}")
