"""What cells share where all that is known of an expert are demonstrations of a file. What those return
scores 1. Where rewards are compared, in states that the expert visits, a clone stands in for it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from harness.judge.advantage import replay
from harness.judge.results import ALL_SHOWN, Cell, Conditions, Row, name_of
from harness.learn.seeds import evaluation_seeds, rng_for
from harness.learn.stored import to_arrays
from harness.registry import SPECS
from harness.run import given
from harness.run.experts import EXPERT, REPLAYED, REPLAYS, Expert, Shared
from harness.run.stages import Task, learned_by
from harness.store.cache import Kept, as_bytes


def prepare(env: str, seed: int, conditions: Conditions) -> dict[str, bytes]:
    """What `Shared` reads, but for demonstrations."""
    said = conditions.demonstrations
    shared = Shared({name_of(ALL_SHOWN): as_bytes(given.shown(said, env, seed, ALL_SHOWN))})
    task = Task(Cell(env, "bc", seed), conditions, shared)
    clone = learned_by(task, "bc", shared.demonstrations(ALL_SHOWN), task.world()).policy
    arrays, policy = to_arrays(clone, "policy")
    facts = vars(Expert(given.source_of(said), clone, [], 0.0, 0, 0))
    found = {EXPERT: Kept(arrays, {**facts, "policy": policy})}
    if conditions.retrain and not task.spec.tabular:
        seeds = evaluation_seeds(seed, REPLAYS[conditions.budget])
        found[REPLAYED] = Kept(replay(task.spec, clone, seeds, rng_for(seed, env, "replays")).arrays(), {})
    return {name: as_bytes(what) for name, what in found.items()}


def in_its_place(row: Row, conditions: Conditions) -> Row:
    """The row of the expert, with what the demonstrations return, by the file's rewards, and how long they
    last."""
    paid = given.rewards(conditions.demonstrations)
    gamma = SPECS[row.env].gamma
    measures = {
        "return": [rewards.sum() for rewards in paid],
        "discounted": [rewards @ gamma ** np.arange(len(rewards)) for rewards in paid],
        "length": [*map(len, paid)],
    }
    columns: dict[str, Any] = {"status": "ok", "episodes": len(paid)}
    for name, values in measures.items():
        columns |= {f"{name}_mean": float(np.mean(values)), f"{name}_std": float(np.std(values))}
    return replace(row, **columns)
