"""How the tests run, and a task so small that reinforcement learning takes a second, in two kinds."""

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

HORIZON = 10


def pytest_configure(config: pytest.Config) -> None:
    """What JAX compiles, much of the time of many tests, is compiled once for all, and no test's cache is the
    user's. Ctrl-C reaches what
    tests start, also where a shell started them in the background and so deaf to it."""
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(config.cache.mkdir("jax")))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
    os.environ.setdefault("IRL_BENCH_CACHE", str(config.cache.mkdir("irl-bench")))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest test first: started last, it would run alone at the end."""
    items.sort(key=lambda item: "test_smoke" not in item.nodeid)


class Target(gym.Env):
    """The observation (1,) is where to be, uniform in [-0.8, 0.8] at every step; the action (1,) goes there.

    Reward: 1 - |observation - action|. Terminates where that distance is more than `reach`.
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
    env_id = f"irl_bench_tests/{name}-v0"
    gym.register(
        env_id,
        entry_point=functools.partial(Target, reach),
        max_episode_steps=HORIZON,
        disable_env_checker=True,
    )
    return EnvSpec(
        name=name,
        summary="go where the observation says",
        env_id=env_id,
        obs_size=1,
        act_size=1,
        obs_scale=(0.5,),
        horizon=HORIZON,
        gamma=0.9,
        time_step=0.1,
        bar=lambda seeds: 9.0,
        max_terminated=dict.fromkeys(BUDGETS, 1.0),
        rl_steps=dict.fromkeys(BUDGETS, 1500),
        eval_episodes=dict.fromkeys(BUDGETS, 5),
        demo_episodes=dict.fromkeys(BUDGETS, 5),
        phi=lambda obs, act: 1 - (obs - act) ** 2 / 4,
        draw=lambda env: {},
        why_ended=lambda env: "missed",
    )


@pytest.fixture(scope="session")
def steady() -> EnvSpec:
    """The task that never terminates."""
    return target_spec("Steady", math.inf)


@pytest.fixture(scope="session")
def fragile() -> EnvSpec:
    """The task that terminates on a miss of more than 0.5."""
    return target_spec("Fragile", 0.5)


@pytest.fixture(autouse=True)
def _forget_plugins() -> Iterator[None]:
    """Forgets which plug-ins a test imported, after which nothing else is computed in their process."""
    before = {*sys.modules}
    yield
    if known := sys.modules.get("harness.registry.known"):
        for name in {one.module.__name__ for one in known.KNOWN.loaded if one.is_plugin} - before:
            sys.modules.pop(name, None)
        known.KNOWN.loaded.clear()


@pytest.fixture
def fused_adam() -> Iterator[None]:
    """Fails a step of torch's default Adam, which not all processors round alike."""
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
    """To tell at the end of the test run how much of what was tried."""

    def tell(what: str, counts: Counter[str]) -> None:
        parts = ", ".join(f"{count} {name}" for name, count in sorted(counts.items()))
        record_property("tried", f"{counts.total()} {what}: {parts}")

    return tell


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    for report in terminalreporter.getreports("passed"):
        for name, value in report.user_properties:
            if name == "tried" and report.when == "call":
                terminalreporter.write_line(f"tried {value}")
