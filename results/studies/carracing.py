"""Fit methods on carracing from 20 demonstrations, and score pi* at both starts, on tuning seeds.

python results/studies/carracing.py FILE [METHOD ...]: lines appended to a CSV file, by default of the expert,
random actions and all methods, for seeds 100 to 102. `steps`: environment steps of the fit, of four frames
each. `seconds`: processor time of fit and scores, in one process one after the other. `laps`: share of
episodes in which the lap was completed. Lines of `source` Reddy have what Reddy et al. 2020 published.
"""

import csv
import sys
import time

import numpy as np

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

ENV, SEEDS, DEMOS, EPISODES = "carracing", range(100, 103), 20, 5
SQIL_STEPS, SOLVE_STEPS = 8000, 10_240
"""Steps of SQIL, and of a solve from scratch, from which GAIL's follow."""
CONDITIONS = Conditions("quick", "absorbing", "sbx")
METHODS = {"bc": BehaviourCloning(), "sqil": SQIL(rl_steps=SQIL_STEPS), "gail": GAIL()}
PUBLISHED = {"expert": (704, 480), "bc": (698, -45), "sqil": (704, 375)}
"""Mean returns as trained and turned, by Reddy et al. 2020."""


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
    for start, spec in (("as trained", seen), ("turned", seen.variant("turned"))):
        scored = evaluate(spec, policy, evaluation_seeds(seed, EPISODES))
        laps = scored.endings.get("lap complete", 0) / EPISODES
        facts = [f"{scored.returns.mean():.1f}", f"{scored.returns.std():.1f}", laps]
        seconds = f"{time.process_time() - begun:.0f}"
        result.append(["here", name, seed, start, DEMOS, steps, EPISODES, *facts, seconds])
    return result


path, *names = sys.argv[1:]
with open(path, "a", newline="", encoding="utf-8") as file:
    writer = csv.writer(file)
    if not file.tell():
        columns = ("source", "method", "seed", "start", "demos", "steps", "episodes", "return", "std", "laps")
        writer.writerow((*columns, "seconds"))
        for method, values in PUBLISHED.items():
            for beginning, value in zip(("as trained", "turned"), values, strict=True):
                writer.writerow(["Reddy", method, "", beginning, "", "", "", value, "", "", ""])
    for number in SEEDS:
        for method in names or ("expert", "random", *METHODS):
            writer.writerows(lines(method, number))
            file.flush()
