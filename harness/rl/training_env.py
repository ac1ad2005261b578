"""The environment as an agent of the RL library sees it, and the steps that an agent remembers.

Protocol `absorbing` has two parts (Kostrikov et al. 2019, Discriminator-Actor-Critic). The state:
observations carry an absorbing indicator. A step that would terminate leads to the absorbing state instead,
which pays 0. The agent stays there a few steps, and is truncated and bootstrapped as at a time limit. The
offset: the agent learns on reward - reward.absorbing, so that a constant reward is 0 everywhere. Protocols
`state` and `offset` have one part alone, to measure it. Protocol `native` has neither: episodes end, and the
reward is as it is.

Rewards are scaled to a fixed mean size. With an absorbing state they are also centred by one constant, the
absorbing state's own reward included. Neither changes which policy is better.

With demonstrations, half of each batch is demonstrated, as if it had happened here.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.buffers import NStepReplayBuffer
from stable_baselines3.common.type_aliases import ReplayBufferSamples
from stable_baselines3.common.vec_env import VecEnv

from envs import EnvSpec
from envs.checks import LARGEST
from envs.copies import Copies
from harness.rl.seeds import training_seeds
from methods.base import ABSORBING_STEPS, Array, Episodes, Payment, Reward, Transitions
from methods.rewards import Constant, fast

NOT_ABSORBED = -1
REWARD_SIZE = 0.1
"""Mean absolute reward after scaling."""
WRONG_REWARD = "the reward must give one finite number for each step"


class TrainingEnv(VecEnv):
    """Copies of the environment, side by side, as an agent sees them.

    `staggered`: True where first episodes are cut at even intervals, which spreads the copies over an
    episode. `reward`: pays the agent; None is the environment's own. `obs`: their observations, (N, O).
    `latest`: the last step of every copy, and what the environment paid for it, (N,).
    """

    latest: tuple[Transitions, Array]

    def __init__(
        self, spec: EnvSpec, protocol: str, rng: np.random.Generator, copies: int, staggered: bool = False
    ) -> None:
        actions: spaces.Space[Any] = spaces.Box(-1.0, 1.0, (spec.act_size,), np.float32)
        if spec.discrete:
            actions = spaces.Discrete(spec.act_size)
        super().__init__(copies, spaces.Box(-np.inf, np.inf, (spec.obs_size + 1,), np.float32), actions)
        self.reward: Reward | Payment | None = None
        self._noted = np.zeros(2)
        self.spec, self.rng, self.batch = spec, rng, Copies(spec, copies)
        self.absorbs = protocol in ("absorbing", "state")
        self._offset = protocol in ("absorbing", "offset")
        self._staggered = staggered
        self._obs_scale = np.array(spec.obs_scale)
        self.obs = np.zeros((copies, spec.obs_size))
        self._age = np.zeros(copies, np.int64)
        self._absorbed_for = np.full(copies, NOT_ABSORBED)
        self._actions: NDArray[Any]
        self._centre, self._size = 0.0, 1.0

    def raw_rewards(self, steps: Transitions, true: Array) -> Array:
        """Return the pay of each step before normalisation, (N,). `true`: what the environment paid, (N,).

        Raises FloatingPointError unless it is one finite number for each step.
        """
        reward = self.reward
        if reward is None:
            paid = true
        elif isinstance(reward, Reward):
            paid, alive = np.zeros(len(true)), ~steps.absorbing
            if alive.any():
                living = fast(reward)(steps.obs[alive], steps.act[alive], steps.next_obs[alive])
                if living.shape != (alive.sum(),):
                    raise FloatingPointError(WRONG_REWARD)
                paid[alive] = living - reward.absorbing if self._offset else living
        else:
            paid = np.array(reward(Transitions(*(column.copy() for column in vars(steps).values()))))
        if paid.shape != true.shape or not (np.abs(paid) <= LARGEST).all():
            raise FloatingPointError(WRONG_REWARD)
        return paid

    def paid(self, steps: Transitions, true: Array) -> Array:
        """Return the pay of each step, (N,), to an agent that expects nothing after an end: the last step
        includes the absorbing state's pay for ever. Arguments and errors are those of `raw_rewards`."""
        rewards = self.raw_rewards(steps, true)
        if self.absorbs and not isinstance(self.reward, Reward) and steps.next_absorbing.any():
            one = np.zeros(1, bool)
            there = Transitions.own(steps.obs[:1], steps.act[:1], steps.obs[:1], ~one, ~one)
            forever = float(self.raw_rewards(there, np.zeros(1))[0]) / (1 - self.spec.gamma)
            rewards = rewards + self.spec.gamma * forever * steps.next_absorbing
        return rewards

    def note(self, pay: Array) -> None:
        """Note the pay of new steps (N,) for `mean_pay`."""
        self._noted += float(pay.sum()), len(pay)

    def mean_pay(self) -> float:
        """Return the mean pay of the steps that were noted since the last call, 0 for none."""
        (total, count), self._noted = self._noted, np.zeros(2)
        return float(total / max(count, 1))

    @property
    def pays_nothing(self) -> bool:
        """True where the agent learns on 0 everywhere."""
        reward = self.reward
        return self._offset and isinstance(reward, Constant) and reward.value == reward.absorbing

    def normalise(self, *groups: tuple[Transitions, Array]) -> list[Array]:
        """Fit the normalisation to groups of steps, and return each group's normalised rewards.

        Groups have equal weight. Each is the steps and what the environment paid for them, (N,).
        """
        raw = [self.raw_rewards(steps, true) for steps, true in groups]
        alive = [paid[~steps.absorbing] for paid, (steps, _) in zip(raw, groups, strict=True)]
        size = float(np.mean([np.abs(paid).mean() for paid in alive]))
        self._size = size / REWARD_SIZE if size > 1e-9 else 1.0
        self._centre = float(np.mean([paid.mean() for paid in alive])) if self.absorbs else 0.0
        return [(paid - self._centre) / self._size for paid in raw]

    def seen(self, obs: Array, absorbed: NDArray[np.bool_]) -> NDArray[np.float32]:
        """Return what the agent sees, (N, O + 1), of observations (N, O) or of the absorbing state."""
        scaled = np.where(absorbed[:, None], 0.0, obs / self._obs_scale)
        return np.column_stack([scaled, absorbed]).astype(np.float32)

    def reset(self) -> NDArray[np.float32]:
        self.restart(np.ones(self.num_envs, bool))
        if self._staggered:
            self._age = np.arange(self.num_envs) * self.spec.horizon // self.num_envs
        return self._seen()

    def step_async(self, actions: NDArray[Any]) -> None:
        self._actions = actions

    def step_wait(self) -> tuple[NDArray[np.float32], Array, NDArray[np.bool_], list[Any]]:
        spec, drawn = self.spec, self._actions
        terminated, cut = self.advance(np.eye(spec.act_size)[drawn] if spec.discrete else drawn.astype(float))
        raw = self.raw_rewards(*self.latest)
        self.note(raw)
        self._absorbed_for[self._absorbed_for != NOT_ABSORBED] += 1
        if self.absorbs:
            self._absorbed_for[terminated] = 0
            terminated = np.zeros_like(terminated)
        truncated = cut | (self._absorbed_for == ABSORBING_STEPS)
        done, seen = terminated | truncated, self._seen()
        infos: list[dict[str, Any]] = [{} for _ in done]
        for place in np.flatnonzero(done).tolist():
            infos[place]["terminal_observation"] = seen[place]
            infos[place]["TimeLimit.truncated"] = bool(truncated[place])
        self.restart(done)
        rewards = (raw - self._centre) / self._size
        return self._seen() if done.any() else seen, rewards, done, infos

    def advance(self, act: Array) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Step the living copies by their actions, (N, A). Return whether each terminated, and whether a time
        limit cut it, (N,)."""
        alive, next_obs, true = self._absorbed_for == NOT_ABSORBED, self.obs.copy(), np.zeros(self.num_envs)
        terminated, cut = np.zeros((2, self.num_envs), bool)
        if alive.any():
            stepped = self.batch.step(np.flatnonzero(alive).tolist(), act[alive])
            next_obs[alive], true[alive], terminated[alive], cut[alive] = stepped
        self.latest = Transitions.own(self.obs, act, next_obs, ~alive, terminated | ~alive), true
        self.obs = next_obs
        self._age += 1
        return terminated, alive & ~terminated & (cut | (self._age == self.spec.horizon))

    def restart(self, which: NDArray[np.bool_]) -> None:
        """Begin new episodes in these copies, (N,)."""
        self.obs = self.obs.copy()  # `latest` keeps its own
        for place in np.flatnonzero(which).tolist():
            self.obs[place] = self.batch.reset(place, training_seeds(self.rng, 1)[0])
            self._age[place], self._absorbed_for[place] = 0, NOT_ABSORBED

    def _seen(self) -> NDArray[np.float32]:
        return self.seen(self.obs, self._absorbed_for != NOT_ABSORBED)

    # The rest is what Stable-Baselines3 asks of an environment.
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


class Demonstrated(NStepReplayBuffer):
    """All steps of demonstrations, as `Replay` would hold them had they been taken in its source.

    `steps`: those, with random actions in the absorbing state. Raises ValueError where some are not shown.
    """

    def __init__(self, episodes: Episodes, source: TrainingEnv, n_steps: int, gamma: float) -> None:
        if not episodes.whole:
            raise ValueError("an agent learns from demonstrations only where every step is shown")
        steps, lengths = Transitions.of(episodes), episodes.lengths
        if source.absorbs:
            steps, lengths = steps.absorbed(), lengths + ABSORBING_STEPS * np.array(episodes.terminated)
        obs, act = np.where(steps.absorbing[:, None], steps.next_obs, steps.obs), steps.act.copy()
        last = np.zeros(len(steps), bool)
        act[steps.absorbing] = source.spec.random_actions(int(steps.absorbing.sum()), source.rng)
        last[lengths.cumsum() - 1] = True
        ended = last & steps.next_absorbing & ~steps.absorbing
        spaces = source.observation_space, source.action_space
        super().__init__(len(steps), *spaces, "cpu", n_steps=n_steps, gamma=gamma)
        self.steps = replace(steps, obs=obs, act=act, demonstrated=np.ones(len(steps), bool))
        self.observations[:, 0] = source.seen(obs, steps.absorbing)
        self.next_observations[:, 0] = source.seen(steps.next_obs, steps.next_absorbing & ~ended)
        self.actions[:, 0] = act.argmax(axis=1)[:, None] if source.spec.discrete else act
        self.dones[:, 0] = last
        self.timeouts[:, 0] = last & ~ended
        self.full = True


class Replay(NStepReplayBuffer):
    """The latest steps of the source, in the library's form and in their own, and demonstrations, if any."""

    def __init__(
        self, *args: Any, source: TrainingEnv, demonstrations: Episodes | None = None, **settings: Any
    ) -> None:
        super().__init__(*args, **settings)
        self._source, shape = source, (self.buffer_size, self.n_envs)
        sizes = source.spec.obs_size, source.spec.act_size, source.spec.obs_size
        self._columns: list[Any] = [np.empty((*shape, size)) for size in sizes]
        self._columns += [np.empty(shape, bool) for _ in ("absorbing", "next_absorbing")]
        self._true = np.empty(shape)
        self._demonstrated: Demonstrated | None = None
        if demonstrations is not None:
            self._demonstrated = Demonstrated(demonstrations, source, self.n_steps, self.gamma)

    def add(self, *seen: Any) -> None:
        """Add the source's latest step. `seen`: the same in the library's form."""
        steps, self._true[self.pos] = self._source.latest
        for column, values in zip(self._columns, vars(steps).values(), strict=False):
            column[self.pos] = values
        super().add(*seen)

    def relabel(self) -> None:
        """Pay every step by the source's present reward, normalised anew."""
        order = self._order
        groups = [(self.steps(), self._true[order].ravel())]
        if self._demonstrated is None:
            (rewards,) = self._source.normalise(*groups)
        else:
            shown = self._demonstrated.steps
            rewards, paid = self._source.normalise(*groups, (shown, np.zeros(len(shown))))
            self._demonstrated.rewards[:, 0] = paid
        self.rewards[order] = rewards.reshape(len(order), self.n_envs)

    def sample(self, batch_size: int, env: Any = None) -> ReplayBufferSamples:
        """Return a batch of steps. With demonstrations, every second step is demonstrated, because the
        library cuts a sample into batches."""
        if self._demonstrated is None:
            return super().sample(batch_size, env)
        own = super().sample(batch_size - batch_size // 2, env)
        shown = self._demonstrated.sample(batch_size // 2, env)
        mixed: list[Any] = [column.new_empty(batch_size, *column.shape[1:]) for column in cast(Any, own)]
        for column, *halves in zip(mixed, own, shown, strict=True):
            column[::2], column[1::2] = halves
        return ReplayBufferSamples(*mixed)

    def steps(self) -> Transitions:
        """Return its own steps, the oldest first."""
        return Transitions.own(*(c[self._order].reshape(-1, *c.shape[2:]) for c in self._columns))

    @property
    def _order(self) -> NDArray[np.int64]:
        """Rows from the oldest to the latest: once it is full, new steps replace the oldest."""
        return np.roll(np.arange(self.size()), -self.pos if self.full else 0)
