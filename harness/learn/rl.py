"""Reinforcement learning for every purpose here: the expert, inner loops, and pi_R, by the learner that the
task names (`harness.learn.models`).

One rule says which checkpoint counts, for all: the best mean undiscounted return under the very reward
that the agent learns from, over fresh episodes up to the horizon; of equals the one that does best there with
noise on its actions, and of equals in that too the last. The untrained agent is the first one, and only a
strictly better one replaces it: a reward that cannot tell policies apart teaches nothing. Under one that is
a constant, and 0 by the offset, the solve ends after the warm-up, for the untrained agent would count anyway.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback

from envs import EnvSpec
from envs.learners import DQN, PPO, SAC, Learner
from harness.learn import models
from harness.learn.on_policy import OnPolicy
from harness.learn.seeds import training_seeds
from harness.learn.simulator import Simulator
from harness.learn.training_env import Replay, TrainingEnv
from harness.registry import PROTOCOLS, Library
from methods.base import Array, Episodes, Payment, Policy, Reward, StochasticPolicy, Transitions
from methods.network import Network
from methods.stochastic import EpsilonGreedy, SquashedGaussian

WARM_UP = 1000
"""Random steps before learning; fewer where a solve is shorter than twice that."""
STEPS_PER_CHECK_EPISODE = 75
"""A short solve's checkpoints are checked on fewer episodes: one for so many of its steps."""


@dataclass(frozen=True)
class Solution:
    """What a solve found. curve: (environment steps of this solve, mean return under the learner's
    reward) at each checkpoint; true_curve: the same episodes' true return, which nothing is decided by.
    env_steps: steps that were learned from; check_steps: those of the episodes that checkpoints are judged
    by. checkpoints: the policies of the curve. best: the number of the one that the policy is."""

    policy: Policy
    curve: list[tuple[float, float]]
    true_curve: list[tuple[float, float]]
    env_steps: int = 0
    check_steps: int = 0
    checkpoints: tuple[Policy, ...] = ()
    best: int = 0


class Agent:
    """A learner in one environment, with that one's settings unless others are given. It goes on learning
    with the same networks and the same experience, whatever it was paid by before.

    init, demonstrations, entropy: as of `methods.base.World.agent`. told: called now and then with
    how many steps of the present solve are done.
    env_steps, check_steps: what it took so far, as in `Solution`.
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
        told: Callable[[int], None] = lambda done: None,
    ) -> None:
        if protocol not in PROTOCOLS:
            raise ValueError(f"no protocol named {protocol!r}")
        self.spec = spec
        self._rng = rng
        self._library = library
        self.settings = settings or spec.rl
        # Bouts of learning shorter than an episode would each see one part of it.
        staggered = isinstance(self.settings, PPO)
        self._env = TrainingEnv(spec, protocol, rng, self.settings.copies, staggered)
        self._checks = Simulator(spec)
        self._demonstrations, self._entropy, self._told = demonstrations, entropy, told
        self._init = None if init is None else models.actor_layers(init, spec, self.settings)
        self._model: models.Model | None = None
        self._progress = 0.0
        self._checkpoints: list[tuple[int, Network]] = []
        self._check_seeds: list[int] = []
        self.env_steps = self.check_steps = 0

    def learn(self, steps: int, reward: Reward | Payment | None) -> None:
        """Learns for `steps` environment steps under the reward; None is the environment's own, for the
        expert and the control that learns from the truth.

        Raises ValueError unless `steps` is a multiple of the settings' unit, twice that at least where there
        is a replay buffer, and for None where there are demonstrations; FloatingPointError on rewards that
        are not finite.
        """
        unit = self.settings.unit
        if steps != self.whole(steps):
            least = self.whole(1)
            raise ValueError(f"a solve takes a multiple of {unit} steps, at least {least}, not {steps}")
        if reward is None and self._demonstrations is not None:
            raise ValueError("what the environment paid for demonstrations is not known")
        seed = int(self._rng.integers(1 << 31))
        self._env.reward = reward
        warm_up = 0
        if self._model is None:
            if not isinstance(self.settings, PPO):
                warm_up = min(WARM_UP, steps // 2) // unit * unit
            built = self._build(warm_up, seed)
            if warm_up and not isinstance(built, OnPolicy):
                built.learn(warm_up)
            self._model = built
        else:
            self._model.set_random_seed(seed)
        model = self._model
        models.follow_reward(model, self.settings.noise)
        episodes = max(1, min(self.settings.check_episodes, steps // STEPS_PER_CHECK_EPISODE))
        self._check_seeds = training_seeds(self._rng, episodes)
        self._checkpoints = [(warm_up, self.policy)]
        if self._env.pays_nothing:
            steps = warm_up
        elif isinstance(model, OnPolicy):

            def rate(progress: float) -> float:
                self._progress = progress
                return self._learning_rate

            def done(taken: int) -> None:
                if taken % self.settings.checkpoint_every == 0 or taken == steps:
                    self.keep(taken)

            model.learn(steps, rate, done, self._entropy)
        else:
            keeper = _Keeper(self, warm_up, steps)
            model.learn(steps - warm_up, callback=keeper, reset_num_timesteps=False)
            self.keep(steps)
        self.env_steps += steps

    def whole(self, steps: int) -> int:
        """Return the least number of steps, at least as many, that `learn` takes."""
        unit = self.settings.unit
        least = 1 if isinstance(self.settings, PPO) else 2
        return unit * max(least, -(-steps // unit))

    def best(self, reward: Reward | None) -> Solution:
        """The best checkpoint of what was learned last, under the reward. Raises ValueError where nothing was
        learned yet."""
        if not self._checkpoints:
            raise ValueError("an agent that has not learned yet has no best policy")
        self._env.reward = reward
        steps_before = self.check_steps
        curve, true_curve, equals = [], [], list[int]()
        best_return = -np.inf
        checkpoints = tuple(policy for _, policy in self._checkpoints)
        for i, (score, truth) in enumerate(self.check(checkpoints)):
            done_steps = float(self._checkpoints[i][0])
            curve.append((done_steps, score))
            true_curve.append((done_steps, truth))
            if score > best_return:
                equals, best_return = [i], score
            elif score == best_return > curve[0][1]:
                equals.append(i)
        best = equals[0] if len(equals) == 1 else self._steadiest(equals)
        took = self.check_steps - steps_before
        return Solution(checkpoints[best], curve, true_curve, 0, took, checkpoints, best)

    def _steadiest(self, equals: list[int]) -> int:
        noisy = [disturbed(self._checkpoints[i][1], self.spec, self.settings.noise) for i in equals]
        return max(zip((score for score, _ in self.check(noisy)), equals, strict=True))[1]

    def solve(self, reward: Reward | None, steps: int) -> Solution:
        """`learn` and `best`."""
        before = self.env_steps
        self.learn(steps, reward)
        return replace(self.best(reward), env_steps=self.env_steps - before)

    def replay(self) -> Transitions:
        """The latest steps: of PPO those of its last bout. Raises ValueError where nothing was learned yet,
        and of the PPO of Stable-Baselines3, which keeps none."""
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

    def _build(self, warm_up: int, seed: int) -> models.Model:
        model = models.build(
            self.settings,
            self._library,
            self._env,
            self._demonstrations,
            warm_up,
            seed,
            lambda: self._learning_rate,
        )
        if self._init is not None:
            models.begin(model, self._init)
        return model

    @property
    def _learning_rate(self) -> float:
        s = self.settings
        return s.learning_rate + (s.final_learning_rate - s.learning_rate) * self._progress

    def keep(self, done_steps: int) -> None:
        """Makes a checkpoint of the policy after so many steps of what is being learned."""
        self._checkpoints.append((done_steps, self.policy))
        self._told(done_steps)

    def advance(self, progress: float) -> None:
        """Says what share of the present solve is done; the learning rate follows."""
        self._progress = progress
        models.follow_learning_rate(self._built, self._learning_rate)

    @property
    def policy(self) -> Network:
        """What it would do now; the mean action where it learns by soft actor-critic. Raises ValueError where
        nothing was learned yet."""
        if isinstance(self.settings, SAC):
            return SquashedGaussian(models.actor(self._built, self.spec)).mean
        return replace(models.actor(self._built, self.spec), tanh=not self.spec.discrete)

    @property
    def behaviour(self) -> StochasticPolicy:
        """What it explores with now. Raises ValueError where nothing was learned yet, and where it learns by
        DDPG, TD3 or the PPO of Stable-Baselines3."""
        if isinstance(self._built, OnPolicy):
            return self._built.behaviour
        if isinstance(self.settings, DQN):
            return EpsilonGreedy(self.policy, self.settings.noise)
        if not isinstance(self.settings, SAC):
            raise ValueError(f"{type(self.settings).__name__} has no stochastic policy")
        return SquashedGaussian(models.actor(self._built, self.spec))

    def check(self, policies: Sequence[Policy]) -> list[tuple[float, float]]:
        """Of each, mean undiscounted return under the reward that the agent learns from, and the true one."""
        found = []
        for episodes in self._checks.run_each(policies, self._check_seeds):
            total = sum(float(self._env.raw_rewards(e.transitions(), e.rewards).sum()) for e in episodes)
            truth = sum(float(e.rewards.sum()) for e in episodes)
            self.check_steps += sum(len(e.act) for e in episodes)
            found.append((total / len(episodes), truth / len(episodes)))
        return found


def disturbed(policy: Policy, spec: EnvSpec, noise: float, rng: np.random.Generator | None = None) -> Policy:
    """The policy with white noise of this standard deviation on its actions; by default the same noise for
    every policy."""
    rng = rng or np.random.default_rng(0)

    def act(obs: Array) -> Array:
        chosen = spec.executed(policy(obs))
        return np.clip(chosen + noise * rng.standard_normal(chosen.shape), -1, 1)

    return act


class _Keeper(BaseCallback):
    """Keeps checkpoints, and lets the learning rate follow."""

    def __init__(self, agent: Agent, start: int, steps: int) -> None:
        super().__init__()
        self.agent, self.done_steps, self.steps = agent, start, steps

    def _on_step(self) -> bool:
        settings = self.agent.settings
        self.done_steps += settings.copies
        self.agent.advance(self.done_steps / self.steps)
        if self.done_steps % settings.checkpoint_every == 0 and self.done_steps < self.steps:
            self.agent.keep(self.done_steps)
        return True
