"""Reinforcement learning for the expert, inner loops and pi_R, by the task's learner
(`harness.rl.models`).

One rule chooses the checkpoint: the best mean undiscounted return under the reward that the agent learns
from, over fresh episodes up to the horizon. Ties go to the checkpoint that scores best with noise on its
actions, then to the latest. Only a strictly better checkpoint replaces the untrained agent, so that a reward
which does not distinguish policies teaches nothing. Under a constant reward that is 0 by the offset, the
solve ends after the warm-up, because the untrained agent would be chosen anyway.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from envs import EnvSpec
from envs.learners import DQN, PPO, SAC, Learner
from harness.registry import PROTOCOLS, Library
from harness.rl import models
from harness.rl.budget import check_episodes, warm_up
from harness.rl.on_policy import OnPolicy
from harness.rl.seeds import training_seeds
from harness.rl.simulator import Simulator
from harness.rl.training_env import Replay, TrainingEnv
from methods.base import Array, Episodes, Payment, Policy, Reward, StochasticPolicy, Transitions
from methods.network import Network
from methods.stochastic import EpsilonGreedy, SquashedGaussian

Told = Callable[[int, Mapping[str, float]], None]
"""A function of the environment steps so far, and new points of curves by name."""
PAY = "mean pay of a step"
OWN, TRUE = "return of a checkpoint under its reward", "true return of a checkpoint"
"""Curves of a solve."""


@dataclass(frozen=True)
class Solution:
    """The result of a solve.

    `curve`: (environment steps of this solve, mean return under the learner's reward) at each checkpoint.
    `true_curve`: the same with the true return, which decides nothing.
    `env_steps`: steps that were learned from. `check_steps`: steps of the episodes that check checkpoints.
    `checkpoints`: the policies of the curve. `best`: the number of the chosen one, which is `policy`.
    """

    policy: Policy
    curve: list[tuple[float, float]]
    true_curve: list[tuple[float, float]]
    env_steps: int = 0
    check_steps: int = 0
    checkpoints: tuple[Policy, ...] = ()
    best: int = 0


class Agent:
    """A learner in one environment. It goes on with the same networks and experience under each new reward.

    `settings`: by default the task's. `init`, `demonstrations`, `entropy`: as for `methods.base.World.agent`.
    `told`: called at each checkpoint with the steps of the present solve so far, and the mean pay of a step
    since the last one. In `solve` it receives the checkpoint's mean returns, too.
    `env_steps`, `check_steps`: its totals, as in `Solution`.
    Raises ValueError for an unknown protocol, and for an `init` that its actor cannot be.
    """

    def __init__(
        self,
        spec: EnvSpec,
        protocol: str,
        rng: np.random.Generator,
        library: Library,
        settings: Learner | None = None,
        *,
        init: Policy | StochasticPolicy | None = None,
        demonstrations: Episodes | None = None,
        entropy: float = 0.0,
        told: Told = lambda done, values: None,
    ) -> None:
        if protocol not in PROTOCOLS:
            raise ValueError(f"no protocol named {protocol!r}")
        self.spec, self.settings = spec, settings or spec.rl
        self.env_steps = self.check_steps = 0
        self._rng, self._library = rng, library
        # A bout of PPO is shorter than an episode, and would otherwise be one part of it in all copies.
        staggered = isinstance(self.settings, PPO)
        self._env = TrainingEnv(spec, protocol, rng, self.settings.copies, staggered)
        self._checks = Simulator(spec)
        self._demonstrations, self._entropy, self._told = demonstrations, entropy, told
        self._init = None if init is None else models.actor_layers(init, spec, self.settings)
        self._model: models.Model | None = None
        self._progress = 0.0
        self._checkpoints: list[tuple[int, Network]] = []
        self._check_seeds: list[int] = []
        self._scores: list[tuple[float, float]] | None = None
        """Returns of the checkpoints in a solve, None where `best` scores them."""

    def whole(self, steps: int) -> int:
        """Return the least number of steps, at least `steps`, that `learn` takes."""
        unit, least = self.settings.unit, 1 if isinstance(self.settings, PPO) else 2
        return unit * max(least, -(-steps // unit))

    def learn(self, steps: int, reward: Reward | Payment | None) -> None:
        """Learn for `steps` environment steps under the reward; None is the environment's own.

        Raises ValueError unless `steps` is a multiple of the settings' unit, and at least two units for a
        learner with a replay buffer. Raises it for None with demonstrations, and FloatingPointError on
        rewards that are not finite.
        """
        if steps != self.whole(steps):
            unit, least = self.settings.unit, self.whole(1)
            raise ValueError(f"a solve takes a multiple of {unit} steps, at least {least}, not {steps}")
        if reward is None and self._demonstrations is not None:
            raise ValueError("what the environment paid for demonstrations is not known")
        seed = int(self._rng.integers(1 << 31))
        self._env.reward = reward
        start = 0
        if self._model is None:
            start = self._begin(steps, seed)
        else:
            self._model.set_random_seed(seed)
        models.follow_reward(self._built, self.settings.noise)
        self._check_seeds = training_seeds(self._rng, check_episodes(self.settings, steps))
        self._checkpoints = []
        self._keep(start, {})
        if self._env.pays_nothing:
            steps = start
        else:
            self._go_on(start, steps)
        self.env_steps += steps

    def _begin(self, steps: int, seed: int) -> int:
        """Build the model and let it take random steps. Return how many those are."""
        random_steps = warm_up(self.settings, steps)
        model = models.build(
            *(self.settings, self._library, self._env, self._demonstrations, random_steps, seed),
            learning_rate=lambda: self._learning_rate,
        )
        if self._init is not None:
            models.begin(model, self._init)
        if random_steps and not isinstance(model, OnPolicy):
            model.learn(random_steps)
        self._model = model
        return random_steps

    def _go_on(self, start: int, steps: int) -> None:
        """Learn from step `start` of a solve to its end, and keep checkpoints."""
        model, s, done = self._built, self.settings, start

        def keep(done: int) -> None:
            if done % s.checkpoint_every == 0 or done == steps:
                self._keep(done, {PAY: self._env.mean_pay()})

        def after_step(*_: object) -> bool:
            nonlocal done
            done += s.copies
            self._advance(done / steps)
            if done < steps:
                keep(done)
            return True

        if isinstance(model, OnPolicy):
            model.learn(steps, self._advance, keep, self._entropy)
        else:
            model.learn(steps - start, callback=after_step, reset_num_timesteps=False)
            keep(steps)  # after the last gradient steps

    def _keep(self, done: int, values: Mapping[str, float]) -> None:
        """Keep the present policy as a checkpoint, and tell what is known of it."""
        policy = self.policy
        self._checkpoints.append((done, policy))
        if self._scores is not None:
            self._scores += self.check([policy])
            values = {**values, **dict(zip((OWN, TRUE), self._scores[-1], strict=True))}
        if values:
            self._told(done, values)

    def best(self, reward: Reward | None) -> Solution:
        """Return the last solve's best checkpoint under the reward. Raises ValueError where nothing was
        learned yet."""
        if not self._checkpoints:
            raise ValueError("an agent that has not learned yet has no best policy")
        self._env.reward = reward
        before = self.check_steps
        solution = self._chosen(self.check([policy for _, policy in self._checkpoints]))
        return replace(solution, check_steps=self.check_steps - before)

    def _chosen(self, returns: Sequence[tuple[float, float]]) -> Solution:
        """Return the best checkpoint. `returns`: those of `check` for each."""
        steps, checkpoints = zip(*self._checkpoints, strict=True)
        scores, truths = zip(*returns, strict=True)
        most = max(scores)
        equals = [i for i, score in enumerate(scores) if score == most]
        best = equals[0]
        if best != 0 and len(equals) > 1:
            noisy = [disturbed(checkpoints[i], self.spec, self.settings.noise) for i in equals]
            best = max(zip((score for score, _ in self.check(noisy)), equals, strict=True))[1]
        done = [*map(float, steps)]
        curve, true_curve = [*zip(done, scores, strict=True)], [*zip(done, truths, strict=True)]
        return Solution(checkpoints[best], curve, true_curve, checkpoints=checkpoints, best=best)

    def solve(self, reward: Reward | None, steps: int) -> Solution:
        """Do as `learn` and `best`, but score each checkpoint before learning goes on."""
        taken, checked, self._scores = self.env_steps, self.check_steps, []
        self.learn(steps, reward)
        solution = self._chosen(self._scores)
        self._scores = None
        taken, checked = self.env_steps - taken, self.check_steps - checked
        return replace(solution, env_steps=taken, check_steps=checked)

    def replay(self) -> Transitions:
        """Return the steps that it remembers; PPO remembers its last bout. Raises ValueError where nothing
        was learned yet, and for the PPO of Stable-Baselines3, which keeps none."""
        if isinstance(self._built, OnPolicy):
            latest = self._built.latest
            return latest.absorbed() if self._env.absorbs else latest
        return self._replay.steps()

    @property
    def _replay(self) -> Replay:
        return models.replay(self._built)

    @property
    def _built(self) -> models.Model:
        if self._model is None:
            raise ValueError("an agent that has not learned yet has seen nothing and has no policy")
        return self._model

    @property
    def _learning_rate(self) -> float:
        s = self.settings
        return s.learning_rate + (s.final_learning_rate - s.learning_rate) * self._progress

    def _advance(self, progress: float) -> float:
        """Set the learning rate after this share of the solve, and return it."""
        self._progress = progress
        models.follow_learning_rate(self._built, self._learning_rate)
        return self._learning_rate

    @property
    def policy(self) -> Network:
        """The present policy; the mean action in soft actor-critic. Raises ValueError where nothing was
        learned yet."""
        actor = models.actor(self._built, self.spec)
        if isinstance(self.settings, SAC):
            return SquashedGaussian(actor).mean
        return replace(actor, tanh=not self.spec.discrete)

    @property
    def behaviour(self) -> StochasticPolicy:
        """The policy that it explores with now. Raises ValueError where nothing was learned yet, and for
        DDPG, TD3 and the PPO of Stable-Baselines3."""
        if isinstance(self._built, OnPolicy):
            return self._built.behaviour
        if isinstance(self.settings, DQN):
            return EpsilonGreedy(self.policy, self.settings.noise)
        if isinstance(self.settings, SAC):
            return SquashedGaussian(models.actor(self._built, self.spec))
        raise ValueError(f"{type(self.settings).__name__} has no stochastic policy")

    def check(self, policies: Sequence[Policy]) -> list[tuple[float, float]]:
        """Return each policy's mean undiscounted return under the reward that it learns from, and the true
        one."""
        returns = []
        for episodes in self._checks.run_each(policies, self._check_seeds):
            total = sum(float(self._env.raw_rewards(e.transitions(), e.rewards).sum()) for e in episodes)
            truth = sum(float(e.rewards.sum()) for e in episodes)
            self.check_steps += sum(len(e.act) for e in episodes)
            returns.append((total / len(episodes), truth / len(episodes)))
        return returns


def disturbed(policy: Policy, spec: EnvSpec, noise: float, rng: np.random.Generator | None = None) -> Policy:
    """Return the policy with white noise of this standard deviation on its actions. By default the noise is
    the same for every policy."""
    rng = rng or np.random.default_rng(0)

    def act(obs: Array) -> Array:
        chosen = spec.executed(policy(obs))
        return np.clip(chosen + noise * rng.standard_normal(chosen.shape), -1, 1)

    return act
