"""Sources of randomness: generators scoped by name, and episode seeds in ranges that never meet."""

from __future__ import annotations

import zlib

import numpy as np

EVALUATION = 10_000
"""First seed of evaluation. No hyper-parameter is tuned on these episodes; the rule that chooses checkpoints
was changed after scores of seed 0 had been seen."""
DEMONSTRATION = 1 << 20
JUDGING = 1 << 21
TUNING = 1 << 22
HELD_OUT = (1 << 23) + 1000
"""First seed of the episodes that measure shipped experts. The thousand before had been seen when the rule
that chooses experts was made stricter."""
TRAINING = 1 << 24
"""First seed of all other episodes, whose seeds are drawn from here to 2^31."""
EACH = 1000
"""Seeds of one run, for each purpose."""


def rng_for(seed: int, *names: str) -> np.random.Generator:
    """Return the generator of one purpose, such as `rng_for(seed, env, "demos")`. Other names make
    independent ones."""
    return np.random.default_rng([seed, *(zlib.crc32(name.encode()) for name in names)])


def evaluation_seeds(seed: int, episodes: int) -> range:
    """Return the episode seeds that score policies under run seed `seed`."""
    return _range(EVALUATION + EACH * seed, episodes)


def demonstration_seeds(seed: int, episodes: int) -> range:
    """Return the episode seeds of the demonstrations of run seed `seed`."""
    return _range(DEMONSTRATION + EACH * seed, episodes)


def judging_seeds(seed: int, episodes: int) -> range:
    """Return the episode seeds by which run seed `seed` chooses one of several solves."""
    return _range(JUDGING + EACH * seed, episodes)


def tuning_seeds(episodes: int) -> range:
    """Return the episode seeds that shipped experts are chosen by."""
    return _range(TUNING, episodes)


def held_out_seeds(episodes: int) -> range:
    """Return the episode seeds that only measure shipped experts."""
    return _range(HELD_OUT, episodes)


def training_seeds(rng: np.random.Generator, episodes: int) -> list[int]:
    """Draw seeds of training episodes, which are never those of another purpose."""
    return [*map(int, rng.integers(TRAINING, 1 << 31, episodes))]


def _range(first: int, episodes: int) -> range:
    return range(first, first + episodes)
