"""Fit methods on carracing from 20 demonstrations, and score pi* at both starts, on tuning seeds.

python results/studies/carracing.py FILE METHOD,METHOD [SEED ...]: lines for each method and seed, by default
100 to 102, appended to a CSV file. METHOD is expert, random, bc, sqil or gail. `steps`: environment steps
of the fit, of four frames each. `seconds`: processor time of fit and scores, in one process one after the
other. `laps`: share of episodes in which the lap was completed. `start`: 'in large pictures' is `bc` as
trained, whose pictures are made of Gymnasium's own, 96 by 96 pixels without the zoom of the first second.
Lines of `source` Reddy have what Reddy et al. 2020 published.
"""

import csv
import sys
import time
from dataclasses import replace
from typing import Any

import numpy as np
from gymnasium.envs.box2d.car_racing import CarRacing

import envs.racing.carracing as carracing
from envs.images import Images, SeenBatch
from envs.racing.picture import SIDE, View
from harness.cell.experts import source_for
from harness.judge.evaluation import evaluate
from harness.records import Conditions, Shown
from harness.registry import SPECS
from harness.rl.seeds import evaluation_seeds, rng_for
from harness.rl.world import TaskWorld
from methods.base import Policy
from methods.bc import BehaviourCloning
from methods.gail import GAIL
from methods.sqil import SQIL

ENV, DEMOS, EPISODES = "carracing", 20, 5
SQIL_STEPS, SOLVE_STEPS = 8000, 10_240
"""Steps of SQIL, and of a solve from scratch, from which GAIL's follow."""
CONDITIONS = Conditions("quick", "absorbing", "sbx")
METHODS = {"bc": BehaviourCloning(), "sqil": SQIL(rl_steps=SQIL_STEPS), "gail": GAIL()}
PUBLISHED = {"expert": (704, 480), "bc": (698, -45), "sqil": (704, 375)}
"""Mean returns as trained and turned, by Reddy et al. 2020."""


class Large(View):
    """Copies whose pictures are made of Gymnasium's own."""

    def _image(self, place: int) -> Images:
        car = self._racing[place].car
        now, car.t = car.t, max(car.t, 1.0)
        green = CarRacing._render(car, "state_pixels")[:84, :, 1]
        car.t = now
        return green.repeat(4, axis=0).reshape(SIDE, 7, SIDE, 2).mean(axis=(1, 3)).astype(np.uint8)[..., None]


def large(count: int, **_: Any) -> SeenBatch:
    """Return copies whose features are by the task's own encoder, of Gymnasium's pictures."""
    batch = SeenBatch(count, carracing.view, "small")
    batch.view = Large(count)
    return batch


def fitted(name: str, seed: int) -> tuple[Policy, int]:
    """Return a policy, and the environment steps that it took."""
    spec, source = SPECS[ENV], source_for(ENV, seed, CONDITIONS)
    if name == "random":
        rng = np.random.default_rng(seed)
        return lambda obs: spec.random_actions(len(obs), rng), 0
    if name == "expert":
        return source.expert.policy, 0
    world = TaskWorld(spec, CONDITIONS.protocol, CONDITIONS.rl, solve_steps=SOLVE_STEPS)
    demos = source.demonstrations(Shown(demos=DEMOS))
    policy = METHODS[name].fit(demos, world, rng_for(seed, ENV, name, "fit")).policy
    return policy, world.env_steps


def lines(name: str, seed: int) -> list[list[object]]:
    """Return a line for each start."""
    begun = time.process_time()
    policy, steps = fitted(name, seed)
    seen = SPECS[ENV].expert_sees if name == "expert" else SPECS[ENV]
    result = list[list[object]]()
    starts = {"as trained": seen, "turned": seen.variant("turned")}
    if name == "bc":
        starts["in large pictures"] = replace(seen, batch=large)
    for start, spec in starts.items():
        scored = evaluate(spec, policy, evaluation_seeds(seed, EPISODES))
        laps = scored.endings.get("lap complete", 0) / EPISODES
        facts = [f"{scored.returns.mean():.1f}", f"{scored.returns.std():.1f}", laps]
        seconds = f"{time.process_time() - begun:.0f}"
        result.append(["here", name, seed, start, DEMOS, steps, EPISODES, *facts, seconds])
    return result


path, names, *seeds = sys.argv[1:]
with open(path, "a", newline="", encoding="utf-8") as file:
    writer = csv.writer(file)
    if not file.tell():
        columns = ("source", "method", "seed", "start", "demos", "steps", "episodes", "return", "std", "laps")
        writer.writerow((*columns, "seconds"))
        for method, values in PUBLISHED.items():
            for beginning, value in zip(("as trained", "turned"), values, strict=True):
                writer.writerow(["Reddy", method, "", beginning, "", "", "", value, "", "", ""])
    for method in names.split(","):
        for number in map(int, seeds or (100, 101, 102)):
            writer.writerows(lines(method, number))
            file.flush()
