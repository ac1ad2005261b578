"""Set methods beside other code on one task, with the same demonstrations and starts of episodes.

python results/studies/against_others.py demos TASK SEED DEMOS FOLDER: write what `against_imitation.py`
reads.
python results/studies/against_others.py curve METHOD TASK SEED DEMOS FILE: fit our method, and append a line
to a CSV file for each policy on the way. Columns are those of against_others_curves.csv. `at`: environment
steps that RL learned from, actions that the expert gave, or demonstrations.
score: 0 is the random policy, 1 the expert,
on 50 evaluation episodes of the tuning seed.
python results/studies/against_others.py picture: draw against_others_curves.csv as against_others.png.
"""

import csv
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from harness.cell.experts import source_for
from harness.judge.evaluation import evaluate
from harness.records import Conditions, Shown
from harness.registry import METHODS, SPECS, VARIANTS, load_method
from harness.rl.seeds import evaluation_seeds, rng_for
from harness.rl.world import TaskWorld, WorldAgent
from methods.base import Episodes, Payment, Policy, Reward, Rng
from methods.network import Network
from methods.settings import settings_for

HERE = Path(__file__).parent
CONDITIONS = Conditions("full", "absorbing", "sbx")
EPISODES = 50
UNITS = {"bc": "demonstrations", "dagger": "expert's actions"}


class Task:
    """A task and a tuning seed, with what scores 0 and 1."""

    def __init__(self, name: str, seed: int, demos: int) -> None:
        self.name, self.seed, self.spec = name, seed, SPECS[name]
        source = source_for(name, seed, CONDITIONS)
        self.expert, self.seeds = source.expert.policy, evaluation_seeds(seed, EPISODES)
        self.demos = source.demonstrations(Shown(demos=demos))
        random = np.random.default_rng(seed)
        uniform: Policy = lambda obs: self.spec.random_actions(len(obs), random)  # noqa: E731
        self.least, self.most = self.mean(uniform), self.mean(self.expert)

    def mean(self, policy: Policy) -> float:
        return float(evaluate(self.spec, policy, self.seeds).returns.mean())

    def score(self, policy: Policy) -> float:
        return (self.mean(policy) - self.least) / (self.most - self.least)


class Watched(TaskWorld):
    """A world that scores policies on the way: an agent's checkpoints, and clones that the expert answers."""

    def __init__(self, task: Task) -> None:
        steps = task.spec.rl_steps["full"]
        super().__init__(task.spec, "absorbing", "sbx", task.expert, solve_steps=steps)
        self.task, self.seen = task, list[tuple[int, float]]()

    def rollout(self, policy: Policy, episodes: int, rng: Rng) -> Episodes:
        if isinstance(policy, Network):
            self.seen.append((self.answers, self.task.score(policy)))
        return super().rollout(policy, episodes, rng)

    def agent(self, rng: Rng, **options: Any) -> WorldAgent:
        agent = super().agent(rng, **options)
        learn = agent.learn

        def watched(steps: int, reward: Reward | Payment) -> None:
            before = self.env_steps
            learn(steps, reward)
            solver: Any = agent._solver
            self.seen += [(before + at, self.task.score(one)) for at, one in solver._checkpoints[1:]]

        agent.learn = watched  # type: ignore[method-assign]
        return agent


def curve(method: str, task: Task) -> list[tuple[int, float]]:
    """Return what policies on the way score, the last one being pi*."""
    world, fitted = Watched(task), load_method(method)(**settings_for(method, task.name, "full"))
    learned = fitted.fit(task.demos, world, rng_for(task.seed, task.name, method, "fit"))
    last = {"bc": len(task.demos), "dagger": world.answers}.get(method, world.env_steps)
    return [*world.seen, (last, task.score(learned.policy))]


def exported(task: Task) -> dict[str, Any]:
    """Return demonstrations, starts and returns as arrays."""
    expert: Any = task.expert
    numbers = {"seeds": [*task.seeds], "least": task.least, "most": task.most}
    obs, act = (np.concatenate(parts) for parts in (task.demos.obs, task.demos.act))
    shown = {"obs": obs, "act": act, "lengths": task.demos.lengths, "terminated": task.demos.terminated}
    return numbers | shown | {f"expert_{name}": array for name, array in expert.arrays().items()}


def picture() -> None:
    """Draw the curves of methods that learn by RL, one axes a method, one line a seed."""
    curves = pd.read_csv(HERE / "against_others_curves.csv")
    curves = curves[curves.unit == "environment steps"]
    methods = [*dict.fromkeys(curves[curves.code == "imitation"].method)]
    figure = Figure(figsize=(3.2 * len(methods), 2.8), layout="constrained")
    for axes, method in zip(
        figure.subplots(1, len(methods), sharey=True, squeeze=False)[0], methods, strict=True
    ):
        for (code, _), line in curves[curves.method == method].groupby(["code", "seed"]):
            colour = "tab:orange" if code == "imitation" else "tab:blue"
            axes.plot(line["at"], line.score, color=colour, label=code)
        labels = dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True))
        axes.legend(labels.values(), labels.keys(), fontsize=7)
        axes.set(title=method, xlabel="environment steps", ylim=(-0.2, 1.1))
    figure.savefig(HERE / "against_others.png", dpi=110)


if __name__ == "__main__":
    job, *asked = sys.argv[1:]
    if job == "picture":
        picture()
    elif job == "demos":
        name, seed, demos, folder = asked
        np.savez(Path(folder) / f"{name}_{seed}_{demos}.npz", **exported(Task(name, int(seed), int(demos))))
    elif job == "curve":
        method, name, seed, demos, path = asked
        assert method in METHODS | VARIANTS
        points = curve(method, Task(name, int(seed), int(demos)))
        unit = UNITS.get(method, "environment steps")
        with open(path, "a", newline="", encoding="utf-8") as file:
            write = csv.writer(file, lineterminator="\n").writerow
            for at, score in points:
                write(["irl-bench", method, name, demos, seed, unit, at, f"{score:.3f}"])
