"""Fit the thesis's own model, the arms that lead from it to `shaped`, and `shaped`, and solve their rewards.

    python results/studies/thesis_arms.py FILE [--envs ENV,...] [--arms ARM,...] [--seeds 100-109]
    python results/studies/thesis_arms.py FILE --epochs

A line for each cell is added to a CSV file as the cell ends. Lines that are there are not computed again.
--epochs has other numbers of epochs, and the epsilon of Keras 2.2 and later, on cart-pole. Budget quick: 100
demonstrations. One solve of each reward, and the seed's first 20 evaluation episodes.

Columns: arm (without `shaped_thesis_`), env and seed. eig_shown, eig_away: mean eigenvalue of L L^T at the
demonstrations, and in the random policy's evaluation episodes. star, pi_R: mean true returns, pi_R
learned by the task's learner under `absorbing` with the default of what an end pays. zero: the same where an
end pays 0. ddpg: by DDPG under `native`, of `thesis` alone. variant: the same as pi_R, in the
task's variant (`VARIANTS`). Each solve's `solved_` column is 1 if RL solved R*. The arms `random`, `expert`
and `true` are references: their returns are in pi_R and variant, where `true` is RL on the true reward.
"""

import argparse
import csv
import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from harness.cell.experts import source_for
from harness.judge.evaluation import is_solved, totals
from harness.records import ALL_SHOWN, Conditions
from harness.registry import SPECS
from harness.rl.seeds import evaluation_seeds, rng_for
from harness.rl.simulator import Simulator, Trajectory
from harness.rl.world import TaskWorld, solver_for
from methods.base import Policy
from methods.rewards import default_absorbing
from methods.settings import THESIS_ARMS
from methods.shaped import ShapedReward
from methods.shaped_thesis import ShapedThesis

CONDITIONS = Conditions("quick", "absorbing", "sbx")
EPISODES = 20
VARIANTS = {"cartpole": "long_pole", "swingup": "heavy", "highway": "dense", "pendulum": "long_pole"}
REFERENCES = ("random", "expert", "true")
WITHOUT = ("batch", "end")
ARMS: dict[str, Mapping[str, Any]] = {
    "thesis": {},
    "shaped": {
        name: on for arm, own in THESIS_ARMS.items() if arm not in WITHOUT for name, on in own.items()
    },
    **{arm: own for arm, own in THESIS_ARMS.items() if arm != "end"},
}
"""Settings of each arm but what an end pays, which needs no other fit."""
EPOCHS = {"epochs_1": {"epochs": 1}, "epochs_100": {"epochs": 100}, "epsilon_1e-7": {"epsilon": 1e-7}}
SOLVES = ("pi_R", "variant", "zero", "ddpg")
COLUMNS = ("arm", "env", "seed", "eig_shown", "eig_away", "star")
COLUMNS += tuple(name for solve in SOLVES for name in (solve, f"solved_{solve}"))


class Seed:
    """A task's expert, demonstrations and evaluation for one seed."""

    def __init__(self, env: str, seed: int) -> None:
        self.env, self.seed, self.spec = env, seed, SPECS[env]
        self.source = source_for(env, seed, CONDITIONS)
        self.seeds = evaluation_seeds(seed, EPISODES)
        self.places = {"task": self.spec, "variant": self.spec.variant(VARIANTS[env])}
        self.by_chance = {where: self.played(self.random(), where) for where in self.places}

    def random(self) -> Policy:
        rng = rng_for(self.seed, self.env, "reference", "random policy")
        return lambda obs: self.spec.random_actions(len(obs), rng)

    def played(self, policy: Policy, where: str) -> list[Trajectory]:
        """Return the evaluation episodes of a policy."""
        return Simulator(self.places[where]).run(policy, self.seeds)

    def solve(self, where: str, reward: ShapedReward | None, by_ddpg: bool = False) -> Policy:
        """Return the policy that RL learns. All rewards get the same random numbers."""
        place, protocol = self.places[where], "native" if by_ddpg else "absorbing"
        place = place.by_ddpg() if by_ddpg else place
        rng = rng_for(self.seed, self.env, "shaped", "pi_R 0")
        return solver_for(place, protocol, rng, "sbx").solve(reward, place.rl_steps[CONDITIONS.budget]).policy

    def reference(self, arm: str) -> dict[str, float]:
        """Return the returns of a reference in the task and in its variant."""
        returns = {}
        for name, where in (("pi_R", "task"), ("variant", "variant")):
            if arm == "random":
                episodes = self.by_chance[where]
            else:
                policy = self.solve(where, None) if arm == "true" else self.source.expert.policy
                episodes = self.played(policy, where)
            returns[name] = true_return(episodes)
        return returns

    def cell(self, arm: str) -> dict[str, float]:
        """Return the numbers of an arm."""
        world, demos = TaskWorld(self.spec, "absorbing", "sbx"), self.source.demonstrations(ALL_SHOWN)
        rng = rng_for(self.seed, self.env, "shaped", "fit")
        learned = ShapedThesis(**(ARMS | EPOCHS)[arm]).fit(demos, world, rng)
        zero = learned.reward
        assert isinstance(zero, ShapedReward)
        paid = replace(zero, absorbing=default_absorbing(zero, demos, world.random_actions, rng))
        away = np.concatenate([episode.obs[:-1] for episode in self.by_chance["task"]])
        star = {where: self.played(learned.policy, where) for where in self.places}
        numbers = {
            "eig_shown": zero.size_of_l(demos.pairs()[0])["eigenvalues of LLᵀ, mean"],
            "eig_away": zero.size_of_l(away)["eigenvalues of LLᵀ, mean"],
            "star": true_return(star["task"]),
        }
        solves = {"pi_R": ("task", paid), "variant": ("variant", paid), "zero": ("task", zero)}
        if arm == "thesis":
            solves["ddpg"] = ("task", zero)
        for name, (where, reward) in solves.items():
            found = self.played(self.solve(where, reward, name == "ddpg"), where)
            numbers[name] = true_return(found)
            own = [own_return(reward, episodes) for episodes in (found, star[where], self.by_chance[where])]
            numbers[f"solved_{name}"] = is_solved(*own)
        return numbers


def true_return(episodes: list[Trajectory]) -> float:
    return float(np.mean([episode.rewards.sum() for episode in episodes]))


def own_return(reward: ShapedReward, episodes: list[Trajectory]) -> float:
    return float(totals(reward, [(episode.obs, episode.act) for episode in episodes]).mean())


def seeds_of(text: str) -> range:
    first, _, last = text.partition("-")
    return range(int(first), int(last or first) + 1)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("file", type=Path)
    parser.add_argument("--envs", default=",".join(VARIANTS))
    parser.add_argument("--arms", default=",".join((*REFERENCES, *ARMS)))
    parser.add_argument("--seeds", type=seeds_of, default="100-109")
    parser.add_argument("--epochs", action="store_true")
    asked = parser.parse_args()
    if asked.epochs:
        asked.envs, asked.seeds = "cartpole", seeds_of("100-104")
        asked.arms = ",".join((*REFERENCES, "thesis", *EPOCHS))
    if not asked.file.exists():
        asked.file.write_text(",".join(COLUMNS) + "\n", encoding="utf-8")
    lines = csv.DictReader(asked.file.read_text(encoding="utf-8").splitlines())
    known = {(line["arm"], line["env"], int(line["seed"])) for line in lines}
    for seed in asked.seeds:
        for env in asked.envs.split(","):
            place = Seed(env, seed)
            for arm in asked.arms.split(","):
                if (arm, env, seed) in known or (arm == "batch" and place.spec.act_size > 1):
                    continue
                started = time.process_time()
                numbers = place.reference(arm) if arm in REFERENCES else place.cell(arm)
                line = {name: f"{value:.5g}" for name, value in numbers.items()}
                with asked.file.open("a", newline="", encoding="utf-8") as file:
                    writer = csv.DictWriter(file, COLUMNS, restval="", lineterminator="\n")
                    writer.writerow(line | {"arm": arm, "env": env, "seed": seed})
                print(arm, env, seed, f"{time.process_time() - started:.1f} s", file=sys.stderr, flush=True)
