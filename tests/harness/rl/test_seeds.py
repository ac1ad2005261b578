"""Randomness is scoped by name, and episodes for one purpose are never those of another."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from harness.rl.seeds import (
    demonstration_seeds,
    evaluation_seeds,
    held_out_seeds,
    judging_seeds,
    rng_for,
    training_seeds,
    tuning_seeds,
)

RUNS = st.integers(0, 999)
EPISODES = st.integers(1, 1000)
PINNED = (1402831085389609345, 17900941403114240991, 6272127928090603391)


@given(RUNS, EPISODES, RUNS, EPISODES, st.integers(0, 2**31))
def test_evaluation_demonstration_and_training_never_meet(
    run: int, episodes: int, other_run: int, other_episodes: int, seed: int
) -> None:
    evaluation = evaluation_seeds(run, episodes)
    demonstration = demonstration_seeds(other_run, other_episodes)
    training = training_seeds(np.random.default_rng(seed), 100)
    assert len(evaluation) == episodes
    assert len(demonstration) == other_episodes
    assert len(training) == 100
    judging = judging_seeds(run, other_episodes)
    apart = (evaluation, demonstration, judging, training, tuning_seeds(episodes), held_out_seeds(episodes))
    for one, other in combinations(map(set, apart), 2):
        assert not one & other
    assert 0 <= min(evaluation) <= max(training) < 2**31


@given(RUNS, RUNS, EPISODES)
def test_runs_share_no_episodes(run: int, other: int, episodes: int) -> None:
    for seeds in (evaluation_seeds, demonstration_seeds, judging_seeds):
        assert bool(set(seeds(run, episodes)) & set(seeds(other, episodes))) is (run == other)


def draw(rng: np.random.Generator) -> tuple[int, ...]:
    return tuple(rng.bit_generator.random_raw(3).tolist())


def test_generators_differ_by_seed_and_by_every_name_and_their_order() -> None:
    scopes = [(0,), (1,), (0, "a"), (0, "b"), (0, "a", "b"), (0, "b", "a"), (0, "ab"), (1, "a", "b")]
    assert len({draw(rng_for(*scope)) for scope in scopes}) == len(scopes)


def test_a_generator_is_the_same_for_ever() -> None:
    assert draw(rng_for(3, "cartpole", "demos")) == PINNED
