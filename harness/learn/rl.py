"""Reinforcement learning for every purpose here: the expert, inner loops, and pi_R. The only file that
knows the RL library: DDPG (Lillicrap et al. 2015) with n-step returns, of SBX, which is Stable-Baselines3
in JAX, or of Stable-Baselines3 itself; where actions are discrete its DQN (Mnih et al. 2013; thesis,
figure 3.2).

Protocol `absorbing` has two parts (Kostrikov et al. 2019, Discriminator-Actor-Critic). The state:
observations carry an absorbing indicator; what would terminate goes to the absorbing state instead, which
pays 0, stays there a few steps, and is truncated and bootstrapped like a time limit. The offset: the agent
learns on reward - reward.absorbing, so that a constant reward is 0 everywhere. Protocols `state` and `offset`
have one part alone, to tell what each does. Protocol `native` has neither: episodes end, and the agent learns
on the reward as it is.

After a random warm-up the rewards are scaled to a fixed mean size, and where there is an absorbing state
centred by one constant, its own reward included. Neither changes which policy is better.

One rule says which checkpoint counts, for all: the best mean undiscounted return under the very reward
that the agent learns from, over fresh episodes up to the horizon; of equals the one that does best there with
noise on its actions, and of equals in that too the last. The untrained agent is the first one, and only a
strictly better one replaces it: a reward that cannot tell policies apart teaches nothing. Under one that is
a constant, and 0 by the offset, the solve ends after the warm-up, for the untrained agent would count anyway.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import optax
import sbx
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3 import DDPG, DQN
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.noise import OrnsteinUhlenbeckActionNoise
from stable_baselines3.common.vec_env import VecEnv

from envs import EnvSpec
from harness.learn.seeds import training_seeds
from harness.learn.settings import Settings, rl_settings_for
from harness.learn.simulator import Simulator, copies_of
from harness.registry import PROTOCOLS, Library
from methods.base import Array, Policy, Reward
from methods.network import ADAM, Network
from methods.rewards import Constant

ABSORBING_STEPS = 5
"""Steps in the absorbing state before the episode is truncated."""
NOT_ABSORBED = -1
WARM_UP = 1000
"""Random steps before learning; fewer where a solve is shorter than twice that."""
STEPS_PER_CHECK_EPISODE = 75
"""A short solve's checkpoints are checked on fewer episodes: one for so many of its steps."""
REWARD_SIZE = 0.1
"""Mean absolute reward after scaling."""
FIRST_ACTIONS = 0.01
"""Size of an untrained actor's last weights, of what SBX draws."""
BUFFER = 100_000
"""Transitions that a learner can hold, over all its solves."""
_FUNCTIONS: dict[tuple[Settings, int], list[tuple[Any, Any]]] = {}
"""Networks' and optimizers' functions, of the first agent with these settings and size of actions. What JAX
compiles for a function it keeps; each agent's own would be compiled, and kept, again."""


@dataclass(frozen=True)
class Solution:
    """What a solve found. curve: (environment steps of this solve, mean return under the learner's
    reward) at each checkpoint; true_curve: the same episodes' true return, which nothing is decided by.
    env_steps: steps that were learned from; check_steps: those of the episodes that checkpoints are judged
    by. checkpoints: the policies of the curve."""

    policy: Policy
    curve: list[tuple[float, float]]
    true_curve: list[tuple[float, float]]
    env_steps: int = 0
    check_steps: int = 0
    checkpoints: tuple[Policy, ...] = ()


class Learner:
    """DDPG or DQN in one environment, with that one's settings unless others are given. Solving again goes on
    with the same networks and the same experience, relabelled by the new reward."""

    def __init__(
        self,
        spec: EnvSpec,
        protocol: str,
        rng: np.random.Generator,
        library: Library,
        settings: Settings | None = None,
    ) -> None:
        if protocol not in PROTOCOLS:
            raise ValueError(f"no protocol named {protocol!r}")
        self.spec = spec
        self._rng = rng
        self._library = library
        self.settings = settings or rl_settings_for(spec.name)
        self._env = _TrainingEnv(spec, protocol, rng, self.settings.copies)
        self._checks = Simulator(spec)
        self._model: sbx.DDPG | DDPG | DQN | None = None
        self._progress = 0.0

    def solve(self, reward: Reward | None, steps: int) -> Solution:
        """Learn for `steps` environment steps under the reward; None is the environment's own, for the
        expert and the control that learns from the truth.

        Raises ValueError unless `steps` is a multiple of the settings' copies, twice that at least;
        FloatingPointError on rewards that are not finite.
        """
        copies = self.settings.copies
        if steps < 2 * copies or steps % copies:
            raise ValueError(
                f"a solve takes a multiple of {copies} steps, at least {2 * copies}, not {steps}"
            )
        seed = int(self._rng.integers(1 << 31))
        self._env.reward = reward
        warm_up = 0
        if self._model is None:
            warm_up = min(WARM_UP, steps // 2) // copies * copies
            self._model = self._build(warm_up, seed)
            self._model.set_logger(Logger(None, []))  # its own would leave a folder behind
            self._model.learn(warm_up)
        else:
            self._model.set_random_seed(seed)
        buffer = self._model.replay_buffer
        assert buffer is not None
        seen = self._env.normalise()
        buffer.rewards[: len(seen)] = seen
        episodes = max(1, min(self.settings.check_episodes, steps // STEPS_PER_CHECK_EPISODE))
        keeper = _Keeper(self, training_seeds(self._rng, episodes), warm_up, steps)
        if self._env.pays_nothing:
            steps = warm_up
        else:
            self._model.learn(steps - warm_up, callback=keeper, reset_num_timesteps=False)
        best = keeper.best()
        curves = keeper.curve, keeper.true_curve
        return Solution(best, *curves, steps, keeper.check_steps, tuple(keeper.checkpoints))

    def _build(self, warm_up: int, seed: int) -> sbx.DDPG | DDPG | DQN:
        s, size = self.settings, self.spec.act_size
        common: dict[str, Any] = {
            "policy": "MlpPolicy",
            "env": self._env,
            "learning_rate": s.learning_rate,
            "buffer_size": BUFFER,
            "learning_starts": warm_up,
            "batch_size": s.batch,
            "tau": s.tau,
            "gamma": self.spec.gamma,
            "n_steps": s.n_steps,
            "train_freq": 1,
            "gradient_steps": s.gradient_steps,
            "seed": seed,
            "device": "cpu",
        }
        network: dict[str, Any] = {"net_arch": list(s.net)}
        if self.spec.discrete:
            # It moves its target network with every bout of learning, not with every gradient step.
            return DQN(
                **(common | {"tau": 1 - (1 - s.tau) ** s.gradient_steps}),
                target_update_interval=s.copies,
                exploration_initial_eps=s.noise,
                exploration_final_eps=s.noise,
                policy_kwargs=network | {"optimizer_kwargs": ADAM},
            )
        network["n_critics"] = s.critics
        common["action_noise"] = OrnsteinUhlenbeckActionNoise(np.zeros(size), np.full(size, s.noise))
        if self._library == "sb3":
            # Of SB3's own progress a warm start would begin in the middle.
            common["learning_rate"] = lambda _: self._learning_rate
            return DDPG(**common, policy_kwargs=network | {"optimizer_kwargs": ADAM})
        network["optimizer_class"] = optax.inject_hyperparams(optax.adam)
        model = sbx.DDPG(**common, qf_learning_rate=s.learning_rate, policy_kwargs=network)
        states = (model.policy.actor_state, model.policy.qf_state)
        functions = _FUNCTIONS.setdefault((s, size), [(state.apply_fn, state.tx) for state in states])
        actor, critics = (
            state.replace(apply_fn=apply, tx=optimizer)
            for state, (apply, optimizer) in zip(states, functions, strict=True)
        )
        # First actions near zero, as in the paper: with SBX's initial weights an untrained agent may balance.
        last = f"Dense_{len(s.net)}"
        params = {**actor.params["params"]}
        params[last] = {**params[last], "kernel": FIRST_ACTIONS * params[last]["kernel"]}
        start = {"params": params}
        model.policy.actor_state = actor.replace(params=start, target_params=start)
        model.policy.qf_state = critics
        return model

    @property
    def _learning_rate(self) -> float:
        s = self.settings
        return s.learning_rate + (s.final_learning_rate - s.learning_rate) * self._progress

    def advance(self, progress: float) -> None:
        """Says what share of the present solve is done; the learning rate follows."""
        self._progress = progress
        if isinstance(self._model, sbx.DDPG):
            for state in (self._model.policy.actor_state, self._model.policy.qf_state):
                state.opt_state.hyperparams["learning_rate"] = np.float32(self._learning_rate)

    def actor(self) -> Network:
        """The current policy on the environment's own observations (the absorbing indicator is 0)."""
        size = self.spec.obs_size
        zeros, scale = np.zeros(size), np.array(self.spec.obs_scale)
        if isinstance(self._model, sbx.DDPG):
            net = Network.from_flax(self._model.policy.actor_state.params["params"], zeros, scale, tanh=True)
        elif isinstance(self._model, DDPG):
            net = Network.from_torch(self._model.actor.mu, zeros, scale, tanh=True)
        else:
            assert self._model is not None
            net = Network.from_torch(self._model.q_net.q_net, zeros, scale)
        return replace(net, weights=(net.weights[0][:size], *net.weights[1:]))

    def check(self, policy: Policy, seeds: list[int]) -> tuple[float, float, int]:
        """Mean undiscounted return under the reward that the agent learns from, the true one, and the steps
        it took."""
        episodes = self._checks.run(policy, seeds)
        total = sum(
            float(self._env.raw_rewards(e.obs[:-1], e.act, e.obs[1:], e.rewards).sum()) for e in episodes
        )
        truth = sum(float(e.rewards.sum()) for e in episodes)
        return total / len(seeds), truth / len(seeds), sum(len(e.act) for e in episodes)


def disturbed(policy: Policy, spec: EnvSpec, noise: float) -> Policy:
    """The policy with white noise of this standard deviation on its actions, the same for every policy."""
    rng = np.random.default_rng(0)

    def act(obs: Array) -> Array:
        chosen = spec.executed(policy(obs))
        return np.clip(chosen + noise * rng.standard_normal(chosen.shape), -1, 1)

    return act


class _Keeper(BaseCallback):
    """Keeps the best checkpoints, all of the same return."""

    def __init__(self, learner: Learner, seeds: list[int], start: int, steps: int) -> None:
        super().__init__()
        self.learner, self.seeds, self.done_steps, self.steps = learner, seeds, start, steps
        self.curve: list[tuple[float, float]] = []
        self.true_curve: list[tuple[float, float]] = []
        self.check_steps = 0
        self.checkpoints: list[Network] = []
        self.equals: list[Network] = []
        self.best_return = -np.inf
        self._check()

    def _on_step(self) -> bool:
        self.done_steps += self.learner.settings.copies
        self.learner.advance(self.done_steps / self.steps)
        if self.done_steps % self.learner.settings.checkpoint_every == 0 or self.done_steps == self.steps:
            self._check()
        return True

    def _check(self) -> None:
        policy = self.learner.actor()
        score, truth, steps = self.learner.check(policy, self.seeds)
        self.check_steps += steps
        self.checkpoints.append(policy)
        self.curve.append((float(self.done_steps), score))
        self.true_curve.append((float(self.done_steps), truth))
        untrained = self.curve[0][1]
        if score > self.best_return:
            self.equals, self.best_return = [policy], score
        elif score == self.best_return > untrained:
            self.equals.append(policy)

    def best(self) -> Network:
        if len(self.equals) == 1:
            return self.equals[0]
        steadiness = []
        for policy in self.equals:
            noisy = disturbed(policy, self.learner.spec, self.learner.settings.noise)
            score, _, steps = self.learner.check(noisy, self.seeds)
            self.check_steps += steps
            steadiness.append(score)
        return self.equals[max(range(len(steadiness)), key=lambda i: (steadiness[i], i))]


class _TrainingEnv(VecEnv):
    """Copies of the environment as the agent sees them, and all steps taken, to be relabelled."""

    def __init__(self, spec: EnvSpec, protocol: str, rng: np.random.Generator, copies: int) -> None:
        actions: spaces.Space[Any] = (
            spaces.Discrete(spec.act_size)
            if spec.discrete
            else spaces.Box(-1.0, 1.0, (spec.act_size,), np.float32)
        )
        super().__init__(copies, spaces.Box(-np.inf, np.inf, (spec.obs_size + 1,), np.float32), actions)
        self.reward: Reward | None = None
        self._spec = spec
        self._batch = copies_of(spec, copies)
        self._obs_scale = np.array(spec.obs_scale)
        self._state = protocol in ("absorbing", "state")
        self._offset = protocol in ("absorbing", "offset")
        self._rng = rng
        self._obs = np.zeros((copies, spec.obs_size))
        self._age = np.zeros(copies, np.int64)
        self._absorbed_for = np.full(copies, NOT_ABSORBED)
        self._actions: NDArray[Any]
        self._centre, self._size = 0.0, 1.0
        self._log: list[tuple[Array, Array, Array, Array, NDArray[np.bool_]]] = []

    def raw_rewards(self, obs: Array, act: Array, next_obs: Array, true: Array) -> Array:
        """(B,): what each step pays before normalisation. Raises FloatingPointError if that is not finite."""
        rewards = true if self.reward is None else self.reward(obs, act, next_obs)
        if self.reward is not None and self._offset:
            rewards = rewards - self.reward.absorbing
        if rewards.shape != true.shape or not np.isfinite(rewards).all():
            raise FloatingPointError("the reward must give one finite number for each step")
        return rewards

    @property
    def pays_nothing(self) -> bool:
        """Whether the agent learns on 0 everywhere."""
        reward = self.reward
        return self._offset and isinstance(reward, Constant) and reward.value == reward.absorbing

    def normalise(self) -> Array:
        """Fit the normalisation to all that was seen; every step's rewards (T, copies) under it."""
        obs, act, next_obs, true, alive = (np.stack(column) for column in zip(*self._log, strict=True))
        raw = np.zeros(true.shape)
        raw[alive] = self.raw_rewards(obs[alive], act[alive], next_obs[alive], true[alive])
        size = float(np.abs(raw[alive]).mean())
        self._size = size / REWARD_SIZE if size > 1e-9 else 1.0
        self._centre = float(raw[alive].mean()) if self._state else 0.0
        return (raw - self._centre) / self._size

    def reset(self) -> NDArray[np.float32]:
        for place in range(self.num_envs):
            self._reset(place)
        return self._seen()

    def step_async(self, actions: NDArray[Any]) -> None:
        self._actions = actions

    def step_wait(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[Any]]:
        spec, obs = self._spec, self._obs
        act = np.eye(spec.act_size)[self._actions] if spec.discrete else self._actions.astype(np.float64)
        alive = self._absorbed_for == NOT_ABSORBED
        next_obs, true, terminated = obs.copy(), np.zeros(self.num_envs), np.zeros(self.num_envs, bool)
        raw = np.zeros(self.num_envs)
        if alive.any():
            stepped = self._batch.step(np.flatnonzero(alive).tolist(), act[alive])
            next_obs[alive], true[alive], terminated[alive] = stepped
            raw[alive] = self.raw_rewards(obs[alive], act[alive], next_obs[alive], true[alive])
        self._log.append((obs, act, next_obs, true, alive))
        self._obs = next_obs
        self._age += 1
        self._absorbed_for[~alive] += 1
        ended = terminated & (not self._state)
        self._absorbed_for[terminated & ~ended] = 0
        at_horizon = alive & ~terminated & (self._age == spec.horizon)
        truncated = at_horizon | (self._absorbed_for == ABSORBING_STEPS)
        done = ended | truncated
        seen = self._seen()
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for place in np.flatnonzero(done).tolist():
            infos[place] = {
                "terminal_observation": seen[place],
                "TimeLimit.truncated": bool(truncated[place]),
            }
            self._reset(place)
        rewards = ((raw - self._centre) / self._size).astype(np.float32)
        return self._seen() if done.any() else seen, rewards, done, infos

    def _reset(self, place: int) -> None:
        self._obs = self._obs.copy()  # the log keeps what was seen
        self._obs[place] = self._batch.reset(place, training_seeds(self._rng, 1)[0])
        self._age[place], self._absorbed_for[place] = 0, NOT_ABSORBED

    def _seen(self) -> NDArray[np.float32]:
        absorbed = self._absorbed_for[:, None] != NOT_ABSORBED
        obs = np.where(absorbed, 0.0, self._obs / self._obs_scale)
        return np.concatenate([obs, absorbed], axis=1).astype(np.float32)

    # What stable-baselines3 asks of environments besides.
    render_mode = None

    def close(self) -> None: ...

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [getattr(self, attr_name)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        raise NotImplementedError

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        raise NotImplementedError

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        return [False] * self.num_envs
