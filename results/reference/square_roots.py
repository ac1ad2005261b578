"""Square roots by torch, which has MKL take them, and what a fit by L-BFGS makes of them: its line search
takes some. Held to the instructions that all processors have, MKL rounds them as the processor's own
approximate root has it. Prints the numbers of a line of square_roots.csv, beside this file. From the root, on
a processor as it is, and as if it were a Haswell:

    python results/reference/square_roots.py
    qemu-x86_64 -cpu Haswell python results/reference/square_roots.py
"""

from __future__ import annotations

import hashlib
import os

from harness.run.environment import FIXED, SAME_INSTRUCTIONS

os.environ.update(FIXED | SAME_INSTRUCTIONS)  # which libraries read when they are imported

import numpy as np
import torch

from methods.bc import BehaviourCloning

BY_TORCH = torch.Tensor.sqrt
taken = list[torch.Tensor]()


def by_torch(x: torch.Tensor) -> torch.Tensor:
    taken.append(x)
    return BY_TORCH(x)


def rounded(x: torch.Tensor) -> torch.Tensor:
    """As IEEE 754 has it."""
    return torch.as_tensor(np.sqrt(x.numpy()))


def fit() -> str:
    """The weights of a clone after 400 iterations of L-BFGS, as a digest."""
    rng = np.random.default_rng(0)
    obs = rng.normal(size=(400, 3))
    act = np.tanh(obs.sum(axis=1, keepdims=True)) + 0.1 * rng.normal(size=(400, 1))
    method = BehaviourCloning(steps=100, iterations=400)
    policy, _ = method.clone(obs, act.clip(-0.9, 0.9), np.random.default_rng(1))
    return hashlib.sha256(b"".join(weight.tobytes() for weight in policy.weights)).hexdigest()[:8]


some = torch.as_tensor(np.random.default_rng(0).normal(size=16_384).astype(np.float32)).abs()
others = int((BY_TORCH(some) != rounded(some)).sum())
digests = []
for root in (by_torch, rounded):
    torch.Tensor.sqrt = root  # type: ignore[method-assign, assignment]
    digests.append(fit())
print(others, len(taken), *digests, sep=",")
