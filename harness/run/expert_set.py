"""The experts that are shipped: trained once, chosen on episodes that nothing is scored on, and fixed.

<env>__<k>.safetensors          expert k: the arrays of a `Network`, and how it was made
<env>__<k>__medium.safetensors  the checkpoint of its training with about half its return
candidates.csv                  every agent that was trained for them, those that missed the bar included
SHA256SUMS                      checksums, as of sha256sum

`harness.expert_training` makes them.
"""

from __future__ import annotations

from pathlib import Path

from harness.registry import BadInput
from harness.registry.keys import EXPERTS, ROOT, expert_files
from harness.run.cache import Kept, load
from harness.run.files import read, sha256
from harness.run.sums import SUMS, readable
from methods.network import Network

KINDS = (False, True)
"""Of experts, whether they are medium ones."""


def folder() -> Path:
    """Where they are."""
    return next((ROOT / name for name in EXPERTS if (ROOT / name).is_dir()), ROOT / EXPERTS[0])


def shipped_policies(env: str) -> list[Network]:
    """A task's experts and medium ones; none where it has none."""
    count = len(expert_files(env)) // len(KINDS)
    return [Network.from_arrays(shipped(env, i, medium)[1].arrays) for medium in KINDS for i in range(count)]


def shipped(env: str, seed: int, medium: bool = False) -> tuple[int, Kept]:
    """The number of the expert that run seed `seed` uses, and what its file holds. Raises BadInput where the
    task has none, or it is damaged."""
    names = [name for name in expert_files(env) if name.endswith("__medium.safetensors") == medium]
    if not names:
        raise BadInput(f"no experts of {env} are installed; see `experts train`, or run --experts trained")
    number = seed % len(names)
    path = ROOT / names[number]
    found = load(path)
    listed = readable(read(path.parent / SUMS))
    if found is None or listed.get(path.name) != sha256(path):
        raise BadInput(f"{path} is damaged")
    return number, found
