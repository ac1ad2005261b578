"""The environment as an agent of the RL library sees it, and what it has seen there.

Protocol `absorbing` has two parts (Kostrikov et al. 2019, Discriminator-Actor-Critic). The state:
observations carry an absorbing indicator; what would terminate goes to the absorbing state instead, which
pays 0, stays there a few steps, and is truncated and bootstrapped like a time limit. The offset: the agent
learns on reward - reward.absorbing, so that a constant reward is 0 everywhere. Protocols `state` and `offset`
have one part alone, to tell what each does. Protocol `native` has neither: episodes end, and the agent learns
on the reward as it is.

Rewards are scaled to a fixed mean size and, where there is an absorbing state, centred by one constant, its
own reward included. Neither changes which policy is better.

Where there are demonstrations, half of what is learned from is theirs, as if they had happened here.
"""

from __future__ import annotations

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
from harness.learn.seeds import training_seeds
from methods.base import ABSORBING_STEPS, Array, Episodes, Payment, Reward, Transitions
from methods.rewards import Constant, fast

NOT_ABSORBED = -1
REWARD_SIZE = 0.1
"""Mean absolute reward after scaling."""


class TrainingEnv(VecEnv):
    """Copies of the environment as the agent sees them. staggered: whether first episodes are cut at even
    intervals, so that copies are at all times of an episode at once."""

    def __init__(
        self, spec: EnvSpec, protocol: str, rng: np.random.Generator, copies: int, staggered: bool = False
    ) -> None:
        actions: spaces.Space[Any] = (
            spaces.Discrete(spec.act_size)
            if spec.discrete
            else spaces.Box(-1.0, 1.0, (spec.act_size,), np.float32)
        )
        super().__init__(copies, spaces.Box(-np.inf, np.inf, (spec.obs_size + 1,), np.float32), actions)
        self.reward: Reward | Payment | None = None
        self.spec = spec
        self.batch = Copies(spec, copies)
        self._obs_scale = np.array(spec.obs_scale)
        self.absorbs = protocol in ("absorbing", "state")
        self._offset = protocol in ("absorbing", "offset")
        self.rng = rng
        self._staggered = staggered
        self._obs = np.zeros((copies, spec.obs_size))
        self._age = np.zeros(copies, np.int64)
        self._absorbed_for = np.full(copies, NOT_ABSORBED)
        self._actions: NDArray[Any]
        self._centre, self._size = 0.0, 1.0
        self.latest: tuple[Transitions, Array]
        """The last step of every copy, and what the environment paid for it."""

    def raw_rewards(self, steps: Transitions, true: Array) -> Array:
        """(N,): what each step pays before normalisation. true: what the environment paid. Raises
        FloatingPointError if that is not finite."""
        reward = self.reward
        if reward is None:
            paid = true
        elif isinstance(reward, Reward):
            paid = np.zeros(len(true))
            alive = ~steps.absorbing
            if alive.any():
                living = fast(reward)(steps.obs[alive], steps.act[alive], steps.next_obs[alive])
                if living.shape != (alive.sum(),):
                    raise FloatingPointError("the reward must give one finite number for each step")
                paid[alive] = living - reward.absorbing if self._offset else living
        else:
            own = Transitions(*(column.copy() for column in vars(steps).values()))
            paid = np.array(reward(own))
        if paid.shape != true.shape or not (np.abs(paid) <= LARGEST).all():
            raise FloatingPointError("the reward must give one finite number for each step")
        return paid

    def paid(self, steps: Transitions, true: Array) -> Array:
        """Return what steps pay an agent that expects nothing after an end, (N,).

        What the absorbing state would pay for ever is part of the last step. The rest as of `raw_rewards`.
        """
        found = self.raw_rewards(steps, true)
        if self.absorbs and not isinstance(self.reward, Reward) and steps.next_absorbing.any():
            one = np.zeros(1, bool)
            there = Transitions.own(steps.obs[:1], steps.act[:1], steps.obs[:1], ~one, ~one)
            forever = float(self.raw_rewards(there, np.zeros(1))[0]) / (1 - self.spec.gamma)
            found = found + self.spec.gamma * forever * steps.next_absorbing
        return found

    @property
    def pays_nothing(self) -> bool:
        """Whether the agent learns on 0 everywhere."""
        reward = self.reward
        return self._offset and isinstance(reward, Constant) and reward.value == reward.absorbing

    def normalise(self, *seen: tuple[Transitions, Array]) -> list[Array]:
        """Fits the normalisation to these groups of steps, one as much as another; their rewards under it."""
        raw = [self.raw_rewards(steps, true) for steps, true in seen]
        alive = [paid[~steps.absorbing] for paid, (steps, _) in zip(raw, seen, strict=True)]
        size = float(np.mean([np.abs(paid).mean() for paid in alive]))
        self._size = size / REWARD_SIZE if size > 1e-9 else 1.0
        self._centre = float(np.mean([paid.mean() for paid in alive])) if self.absorbs else 0.0
        return [(paid - self._centre) / self._size for paid in raw]

    def demonstrated(self, episodes: Episodes) -> tuple[Transitions, NDArray[np.bool_]]:
        """Every step of the episodes as they would go here, those in the absorbing state with random actions;
        and whether each is the last of its episode. Raises ValueError where some are not shown."""
        if not episodes.whole:
            raise ValueError("an agent learns from demonstrations of which every step is shown")
        parts = []
        for obs, act, terminated in zip(episodes.obs, episodes.act, episodes.terminated, strict=True):
            stay = ABSORBING_STEPS if terminated and self.absorbs else 0
            there = np.repeat(obs[-1:], stay, axis=0)
            time = np.arange(len(act) + stay)
            parts.append(
                (
                    np.concatenate([obs[:-1], there]),
                    np.concatenate([act, self.spec.random_actions(stay, self.rng)]),
                    np.concatenate([obs[1:], there]),
                    time >= len(act),
                    (time >= len(act) - 1) & terminated,
                    time >= 0,
                    time == time[-1],
                )
            )
        *columns, last = (np.concatenate(column) for column in zip(*parts, strict=True))
        return Transitions(*columns), last

    def seen(self, obs: Array, absorbed: NDArray[np.bool_]) -> NDArray[np.float32]:
        """(N, O + 1): what the agent sees of observations (N, O), or of the absorbing state."""
        scaled = np.where(absorbed[:, None], 0.0, obs / self._obs_scale)
        return np.column_stack([scaled, absorbed]).astype(np.float32)

    def reset(self) -> NDArray[np.float32]:
        for place in range(self.num_envs):
            self._reset(place)
        if self._staggered:
            self._age = np.arange(self.num_envs) * self.spec.horizon // self.num_envs
        return self._seen()

    def step_async(self, actions: NDArray[Any]) -> None:
        self._actions = actions

    def step_wait(self) -> tuple[NDArray[np.float32], Array, NDArray[np.bool_], list[Any]]:
        spec, obs = self.spec, self._obs
        act = np.eye(spec.act_size)[self._actions] if spec.discrete else self._actions.astype(np.float64)
        alive = self._absorbed_for == NOT_ABSORBED
        next_obs, true = obs.copy(), np.zeros(self.num_envs)
        terminated, cut = np.zeros((2, self.num_envs), bool)
        if alive.any():
            stepped = self.batch.step(np.flatnonzero(alive).tolist(), act[alive])
            next_obs[alive], true[alive], terminated[alive], cut[alive] = stepped
        self.latest = Transitions.own(obs, act, next_obs, ~alive, terminated | ~alive), true
        raw = self.raw_rewards(*self.latest)
        self._obs = next_obs
        self._age += 1
        self._absorbed_for[~alive] += 1
        ended = terminated & (not self.absorbs)
        self._absorbed_for[terminated & ~ended] = 0
        at_limit = alive & ~terminated & (cut | (self._age == spec.horizon))
        truncated = at_limit | (self._absorbed_for == ABSORBING_STEPS)
        done = ended | truncated
        seen = self._seen()
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for place in np.flatnonzero(done).tolist():
            infos[place] = {
                "terminal_observation": seen[place],
                "TimeLimit.truncated": bool(truncated[place]),
            }
            self._reset(place)
        rewards = (raw - self._centre) / self._size
        return self._seen() if done.any() else seen, rewards, done, infos

    def _reset(self, place: int) -> None:
        self._obs = self._obs.copy()  # what was seen stays as it was
        self._obs[place] = self.batch.reset(place, training_seeds(self.rng, 1)[0])
        self._age[place], self._absorbed_for[place] = 0, NOT_ABSORBED

    def _seen(self) -> NDArray[np.float32]:
        return self.seen(self._obs, self._absorbed_for != NOT_ABSORBED)

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


class Demonstrated(NStepReplayBuffer):
    """All steps of demonstrations, as `Replay` would hold them had they been taken in its source."""

    def __init__(self, episodes: Episodes, source: TrainingEnv, n_steps: int, gamma: float) -> None:
        steps, last = source.demonstrated(episodes)
        spaces = source.observation_space, source.action_space
        super().__init__(len(steps), *spaces, "cpu", n_steps=n_steps, gamma=gamma)
        ended = last & steps.next_absorbing & ~steps.absorbing
        self.steps = steps
        self.observations[:, 0] = source.seen(steps.obs, steps.absorbing)
        self.next_observations[:, 0] = source.seen(steps.next_obs, steps.next_absorbing & ~ended)
        self.actions[:, 0] = steps.act.argmax(axis=1)[:, None] if source.spec.discrete else steps.act
        self.dones[:, 0] = last
        self.timeouts[:, 0] = last & ~ended
        self.full = True


class Replay(NStepReplayBuffer):
    """The latest steps, as the agent sees them, for its library, and as they were, for rewards to come; and
    demonstrations, if any."""

    def __init__(
        self, *args: Any, source: TrainingEnv, demonstrations: Episodes | None = None, **settings: Any
    ) -> None:
        super().__init__(*args, **settings)
        self._source = source
        spec, shape = source.spec, (self.buffer_size, self.n_envs)
        self._obs, self._next_obs = (np.empty((*shape, spec.obs_size)) for _ in range(2))
        self._act, self._true = np.empty((*shape, spec.act_size)), np.empty(shape)
        self._absorbing, self._next_absorbing = (np.empty(shape, bool) for _ in range(2))
        self._demonstrated: Demonstrated | None = None
        if demonstrations is not None:
            self._demonstrated = Demonstrated(demonstrations, source, self.n_steps, self.gamma)

    def add(self, *seen: Any) -> None:
        """Adds the source's latest step, `seen` being how the library sees it."""
        at = self.pos
        steps, self._true[at] = self._source.latest
        self._obs[at], self._act[at], self._next_obs[at] = steps.obs, steps.act, steps.next_obs
        self._absorbing[at], self._next_absorbing[at] = steps.absorbing, steps.next_absorbing
        super().add(*seen)

    def relabel(self) -> None:
        """Gives every step the reward that its source pays now, normalised anew."""
        order = self._order
        seen = [(self.steps(), self._true[order].ravel())]
        if self._demonstrated is None:
            (rewards,) = self._source.normalise(*seen)
        else:
            shown = self._demonstrated.steps
            rewards, paid = self._source.normalise(*seen, (shown, np.zeros(len(shown))))
            self._demonstrated.rewards[:, 0] = paid
        self.rewards[order] = rewards.reshape(len(order), self.n_envs)

    def sample(self, batch_size: int, env: Any = None) -> ReplayBufferSamples:
        """So many steps; where there are demonstrations, every second one is of those. (The library cuts what
        it samples into batches.)"""
        if self._demonstrated is None:
            return super().sample(batch_size, env)
        own = super().sample(batch_size - batch_size // 2, env)
        shown = self._demonstrated.sample(batch_size // 2, env)
        mixed: list[Any] = [column.new_empty(batch_size, *column.shape[1:]) for column in cast(Any, own)]
        for column, *halves in zip(mixed, own, shown, strict=True):
            column[::2], column[1::2] = halves
        return ReplayBufferSamples(*mixed)

    def steps(self) -> Transitions:
        """All own ones that are kept, the oldest first."""
        columns: list[Any] = [self._obs, self._act, self._next_obs, self._absorbing, self._next_absorbing]
        return Transitions.own(*(c[self._order].reshape(-1, *c.shape[2:]) for c in columns))

    @property
    def _order(self) -> NDArray[np.int64]:
        """Where they are, from the oldest to the latest: once it is full, it overwrites the oldest."""
        return np.roll(np.arange(self.size()), -self.pos if self.full else 0)
