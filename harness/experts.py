"""Experts: RL on the true reward, trained once for each environment and budget, kept in a cache; exact
where the model is known."""

from __future__ import annotations

import dataclasses
import hashlib
import importlib.metadata
import json
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import safetensors.numpy
from safetensors import safe_open

from envs import SPECS, EnvSpec
from harness import rl
from harness.files import write_atomic
from harness.results import Library
from harness.seeds import rng_for
from harness.world import solver_for
from methods.base import Policy
from methods.network import Network

CACHE_VARIABLE = "IRL_BENCH_CACHE"
DEFAULT_CACHE = Path("results") / "cache"
SOURCES = ("envs", "harness/rl.py", "harness/seeds.py", "harness/simulator.py", "methods/network.py")
"""What can change an expert, besides the packages below."""
PACKAGES = (
    *("torch", "numpy", "jax", "flax", "optax", "stable-baselines3", "sbx-rl"),
    *("gymnasium", "mujoco", "highway-env"),
)


@dataclass(frozen=True)
class Expert:
    """A trained expert and what it took. curve: (environment steps, mean true return) at checkpoints."""

    policy: Policy
    curve: list[tuple[float, float]]
    seconds: float
    env_steps: int
    rl_steps: int


def expert_for(env: str, budget: str, library: Library) -> Expert:
    """The expert from the cache, or trained and cached now, which may take minutes."""
    spec = SPECS[env]
    path = _cache_file(spec, budget, library)
    if (expert := _load(path)) is not None:
        return expert
    started = time.perf_counter()
    solver = solver_for(spec, "absorbing", rng_for(0, env, "expert"), library)
    solution = solver.solve(None, spec.rl_steps[budget])
    facts: dict[str, Any] = {
        "curve": solution.curve,
        "seconds": time.perf_counter() - started,
        "env_steps": solution.env_steps,
        "rl_steps": solution.rl_steps,
    }
    # An exact solution is found faster than it is read.
    if isinstance(solution.policy, Network):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(path, safetensors.numpy.save(solution.policy.arrays(), {"facts": json.dumps(facts)}))
    return Expert(solution.policy, **facts)


def _load(path: Path) -> Expert | None:
    """None where there is no such file or it cannot be read as an expert."""
    try:
        with safe_open(path, framework="numpy") as file:
            facts = json.loads(file.metadata()["facts"])
            arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        facts["curve"] = [(x, y) for x, y in facts["curve"]]
        return Expert(Network.from_arrays(arrays), **facts)
    except (OSError, safetensors.SafetensorError, KeyError, TypeError, ValueError):
        return None


def _cache_file(spec: EnvSpec, budget: str, library: Library) -> Path:
    settings = rl.SETTINGS.get(spec.name, rl.Settings())
    ingredients = [library, spec.name, spec.rl_steps[budget], dataclasses.asdict(settings)]
    text = json.dumps([*ingredients, *_sources(), *_versions()])
    key = hashlib.sha256(text.encode()).hexdigest()[:16]
    cache = Path(os.environ.get(CACHE_VARIABLE, DEFAULT_CACHE))
    return cache / f"expert__{spec.name}__{budget}__{key}.safetensors"


def _versions() -> list[str]:
    return [importlib.metadata.version(package) for package in PACKAGES]


def _sources() -> list[str]:
    root = Path(__file__).parent.parent
    files = [f for s in SOURCES for f in (sorted((root / s).glob("*.py")) if s == "envs" else [root / s])]
    return [hashlib.sha256(file.read_bytes()).hexdigest() for file in files]
