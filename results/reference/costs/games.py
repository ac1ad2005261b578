"""What the benchmark's own GAIL and AIRL cost until their policy scores 0.95 of the expert, by the rule of
adversarial.py: the policy is evaluated after each of the agent's turns, which is not counted.

From the root; prints one line as adversarial.py does, whose last column says how many demonstrations there
were (swingup_5.csv has both, with the library's name before it):

    python results/reference/costs/games.py swingup gail 0 5
"""

from __future__ import annotations

import sys
import time
from contextlib import suppress
from typing import Any

from harness.learn.seeds import rng_for
from harness.learn.world import TaskWorld, WorldAgent, without_rewards
from judging import BUDGET, ENOUGH, Judge

from harness.registry import load_method
from methods.base import Payment, Reward
from methods.settings import settings_for


class Reached(Exception):
    """The policy is good enough."""


class Watched(TaskWorld):
    """A world that judges its agent after each turn and has it stop when it is good enough."""

    def __init__(self, judge: Judge) -> None:
        super().__init__(judge.spec, "absorbing", "sbx")
        self.judge, self.unpaid, self.score = judge, 0.0, float("nan")

    def agent(self, *args: Any, **options: Any) -> WorldAgent:
        agent = super().agent(*args, **options)
        learn = agent.learn

        def watched(steps: int, reward: Reward | Payment) -> None:
            learn(steps, reward)
            started = time.perf_counter()
            self.score = self.judge.score(agent.policy)
            self.unpaid += time.perf_counter() - started
            print(f"{self.env_steps} steps: {self.score:.3f}", file=sys.stderr)
            if self.score >= ENOUGH:
                raise Reached

        agent.learn = watched  # type: ignore[method-assign]
        return agent


if __name__ == "__main__":
    env, method, seed, count = sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
    judge = Judge(env, seed)
    world, demos = Watched(judge), without_rewards(judge.demonstrations()[:count])
    started = time.perf_counter()
    game = load_method(method)(**settings_for(method, env, BUDGET))
    with suppress(Reached):
        game.fit(demos, world, rng_for(seed, env, method, "fit"))
    seconds = time.perf_counter() - started - world.unpaid
    told = f"{world.score >= ENOUGH},{seconds:.0f},{world.env_steps},{world.score:.3f}"
    print(f"{env},{method},absorbing,{seed},{told},{count} demonstrations")
