"""Inputs that all cells of a task and run seed share, made once and handed to them as bytes: the expert,
demonstrations, and episodes by which rewards are compared."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from harness.cell.experts import Expert, Source, from_kept, source_for, to_kept
from harness.cell.sharing import name_of
from harness.cell.shipped import shipped_policies
from harness.demonstrations.arrays import from_arrays, to_arrays
from harness.judge.advantage import Ranked, Replays, ranked, replay
from harness.records import LEARNED, RESULT, CellResult, Conditions, Shown
from harness.registry.keys import experts_version
from harness.rl.seeds import evaluation_seeds, rng_for
from harness.store.artifacts import learned_in
from harness.store.cache import Kept, as_bytes, from_bytes
from harness.store.codec import decode
from methods.base import Episodes, Policy

REPLAYS = {"smoke": 20, "quick": 200, "full": 500}
"""States and actions by which a reward is compared with the true one, for each budget."""
RANKED = {"smoke": 1, "quick": 5, "full": 10}
"""Episodes of each policy that a reward must rank, for each budget."""
EXPERT, REPLAYED, RANKING = "expert", "replays", "ranking"
"""Names of what is handed to cells, beside those of demonstrations."""


def prepare(env: str, seed: int, shown: Iterable[Shown], conditions: Conditions) -> dict[str, bytes]:
    """Return what `Shared` reads, with these demonstrations; made now, or from the cache."""
    source, budget = source_for(env, seed, conditions), conditions.budget
    spec = source.spec
    inputs = {EXPERT: to_kept(source.expert)}
    inputs |= {name_of(one): Kept(to_arrays(source.demonstrations(one)), {}) for one in shown}

    def add(name: str, count: int, play: Callable[[range, np.random.Generator], Replays | Ranked]) -> None:
        """Add what is played on that many evaluation episodes, by the cache where that knows it."""
        seeds, rng = evaluation_seeds(seed, count), rng_for(seed, env, name)
        asked = [experts_version(env), count]
        inputs[name] = source.kept(name, asked, lambda: Kept(play(seeds, rng).arrays(), {}))

    if conditions.retrain and not spec.tabular:
        add(REPLAYED, REPLAYS[budget], lambda seeds, rng: replay(spec, source.expert.policy, seeds, rng))
    if conditions.retrain and (policies := _ranked_by(source)):
        add(RANKING, RANKED[budget], lambda seeds, rng: ranked(spec, policies, seeds, rng))
    return {name: as_bytes(content) for name, content in inputs.items()}


def _ranked_by(source: Source) -> Sequence[Policy]:
    """Return the policies by whose ranking rewards are compared; none where there are none."""
    if source.expert.returns:
        return ()
    return [source.expert.policy] if source.spec.tabular else shipped_policies(source.spec.expert_sees.name)


@dataclass(frozen=True)
class Shared:
    """Inputs by name, from `prepare`, and what the cell before learned. Raises KeyError for a missing one."""

    inputs: Mapping[str, bytes]

    @cached_property
    def expert(self) -> Expert:
        """The run seed's expert."""
        return from_kept(from_bytes(self.inputs[EXPERT]))

    def demonstrations(self, shown: Shown) -> Episodes:
        """Return what is shown to every method."""
        return from_arrays(from_bytes(self.inputs[name_of(shown)]).arrays)

    @cached_property
    def learned(self) -> dict[str, Any]:
        """Policies and rewards by name; empty where nothing was handed over."""
        data = self.inputs.get(LEARNED)
        return learned_in(data) if data else {}

    @property
    def before(self) -> CellResult:
        """The result of the cell that `learned` is of."""
        return decode(self.inputs[RESULT])

    @property
    def replays(self) -> Replays:
        """States and actions, equal for every reward."""
        return Replays(**from_bytes(self.inputs[REPLAYED]).arrays)

    @property
    def ranked(self) -> Ranked | None:
        """Policies, equal for every reward; None where the task has none."""
        data = self.inputs.get(RANKING)
        return Ranked(**from_bytes(data).arrays) if data else None
