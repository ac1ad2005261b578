"""Where randomness comes from: generators scoped by name, and episode seeds in blocks that never meet."""

from __future__ import annotations

import zlib

import numpy as np

EVALUATION = 10_000
"""Evaluation episodes: seed k uses 1,000 seeds from here + 1,000 k. No hyper-parameter is tuned on these; the
rule by which checkpoints are chosen was changed after scores of seed 0 had been seen."""
DEMONSTRATION = 1 << 20
"""Demonstration episodes: seed k uses 1,000 seeds from here + 1,000 k."""
JUDGING = 1 << 21
"""Episodes by which one of several solves is chosen: seed k uses 1,000 seeds from here + 1,000 k."""
TUNING = 1 << 22
"""Episodes that shipped experts are chosen by."""
HELD_OUT = (1 << 23) + 1000
"""Episodes that shipped experts are measured on, and nothing else is. (The thousand before these had been
seen when the rule by which experts are chosen was made stricter.)"""
TRAINING = 1 << 24
"""Every other episode's seed is drawn from here to 2^31."""


def rng_for(seed: int, *names: str) -> np.random.Generator:
    """The generator of one purpose, such as `rng_for(seed, env, "demos")`; independent for other names."""
    return np.random.default_rng([seed, *(zlib.crc32(name.encode()) for name in names)])


def evaluation_seeds(seed: int, episodes: int) -> range:
    """Episode seeds that score policies under run seed `seed`."""
    return range(EVALUATION + 1000 * seed, EVALUATION + 1000 * seed + episodes)


def demonstration_seeds(seed: int, episodes: int) -> range:
    """Episode seeds of the demonstrations of run seed `seed`."""
    return range(DEMONSTRATION + 1000 * seed, DEMONSTRATION + 1000 * seed + episodes)


def judging_seeds(seed: int, episodes: int) -> range:
    """Return the episode seeds by which run seed `seed` chooses one of several solves."""
    return range(JUDGING + 1000 * seed, JUDGING + 1000 * seed + episodes)


def tuning_seeds(episodes: int) -> range:
    """Episode seeds that shipped experts are chosen by."""
    return range(TUNING, TUNING + episodes)


def held_out_seeds(episodes: int) -> range:
    """Episode seeds that shipped experts are measured on, and nothing else is."""
    return range(HELD_OUT, HELD_OUT + episodes)


def training_seeds(rng: np.random.Generator, episodes: int) -> list[int]:
    """Seeds of training episodes; never those of evaluation or demonstrations."""
    return [int(s) for s in rng.integers(TRAINING, 1 << 31, episodes)]
