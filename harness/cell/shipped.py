"""Experts that are shipped: trained once, chosen on episodes that nothing is scored on, and fixed.

`ENV.safetensors` holds a task's experts in arrays 'expert0/weight0', ... It also holds checkpoints of their
trainings with about half their returns, 'medium0/weight0'. Its metadata has the commit, seed and settings
that made each. Beside it lie candidates.csv, with every agent that was trained for them, and SHA256SUMS.

`harness.benchmarks.expert_files` makes them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from harness.registry import BadInput
from harness.registry.keys import expert_files
from harness.rl.stored import compact
from harness.store.cache import Kept, as_bytes, from_bytes
from methods.network import Network


@dataclass(frozen=True)
class ShippedExpert:
    """An expert, the checkpoint of its training with about half its return, and how both were made.

    facts: a line of candidates.csv by name, settings, curve, origin, and checkpoints.
    """

    expert: Network
    medium: Network
    facts: Mapping[str, Any]


def shipped_experts(env: str) -> list[ShippedExpert]:
    """Return a task's experts, none where it has none. Raises BadInput where they are damaged."""
    for name, data in expert_files(env).items():
        try:
            return from_file(data, env)
        except ValueError as error:
            raise BadInput(f"{name} is damaged: {error}") from error
    return []


def shipped_policies(env: str) -> list[Network]:
    """Return a task's experts, and then their medium checkpoints; none where it has none."""
    experts = shipped_experts(env)
    return [one.expert for one in experts] + [one.medium for one in experts]


def to_file(env: str, experts: Sequence[ShippedExpert]) -> bytes:
    """Return the file of a task's experts."""
    arrays = {
        f"{kind}{number}/{name}": compact(array)
        for number, one in enumerate(experts)
        for kind, network in (("expert", one.expert), ("medium", one.medium))
        for name, array in network.arrays().items()
    }
    return as_bytes(Kept(arrays, {"env": env, "experts": [dict(one.facts) for one in experts]}))


def from_file(data: bytes, env: str) -> list[ShippedExpert]:
    """Return the experts in a file. Raises ValueError for any other, and for another task's."""
    content = from_bytes(data)

    def network(prefix: str) -> Network:
        arrays = content.arrays.items()
        return Network.from_arrays({n.removeprefix(prefix): a for n, a in arrays if n.startswith(prefix)})

    try:
        if content.facts["env"] != env:
            raise ValueError(f"it holds experts of {content.facts['env']!r:.80}")
        return [
            ShippedExpert(network(f"expert{number}/"), network(f"medium{number}/"), facts)
            for number, facts in enumerate(content.facts["experts"])
        ]
    except (KeyError, TypeError) as error:
        raise ValueError(f"it holds no experts: {error}") from error
