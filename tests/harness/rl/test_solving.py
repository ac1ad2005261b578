"""What a solve takes and returns: the best of its checkpoints, and of a reward that says nothing, nothing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from envs import EnvSpec
from envs.copies import Copies
from envs.learners import DDPG, PPO, SAC, TD3, Learner
from harness.registry import LIBRARIES, Library, all_specs
from harness.rl.seeds import TRAINING, evaluation_seeds
from harness.rl.solving import OWN, PAY, TRUE, Agent, Solution
from methods.base import Array, Policy
from methods.network import Network
from methods.rewards import Constant
from tests.harness.rewards import Seek

pytestmark = pytest.mark.usefixtures("fused_adam")
STEPS = 1500


def solve(
    spec: EnvSpec,
    reward: Any,
    protocol: str = "absorbing",
    steps: int = STEPS,
    seed: int = 0,
    library: Library = "sb3",
) -> Solution:
    """By default with Stable-Baselines3, whose first step takes no seconds of compiling."""
    return Agent(spec, protocol, np.random.default_rng(seed), library).solve(reward, steps)


def same(one: Network, other: Network) -> bool:
    a, b = one.arrays(), other.arrays()
    return all(np.array_equal(a[name], b[name]) for name in a)


def test_a_solve_says_what_it_took(steady: EnvSpec) -> None:
    solution = solve(steady, Seek())
    xs = [x for x, _ in solution.curve]
    assert xs == [STEPS / 2, 2 * DDPG().checkpoint_every, STEPS]
    # Twenty episodes of ten steps at each checkpoint.
    assert (solution.env_steps, solution.check_steps) == (STEPS, len(xs) * 20 * 10)
    with pytest.raises(ValueError, match="multiple of 10 steps, at least 20, not 25"):
        solve(steady, Seek(), steps=25)


@pytest.mark.parametrize(
    "spec", [spec for spec in all_specs() if not spec.tabular], ids=lambda spec: spec.name
)
def test_every_solve_that_runs_ask_for_suits_the_learner(spec: EnvSpec) -> None:
    for one in (spec,) if spec.discrete else (spec, spec.by_ddpg()):
        assert min(one.rl_steps.values()) >= 2 * one.rl.unit
        assert all(steps % one.rl.unit == 0 for steps in (*one.rl_steps.values(), one.rl.checkpoint_every))


@pytest.mark.parametrize("library", LIBRARIES)
@pytest.mark.parametrize(
    "settings", [TD3(), SAC(), PPO(copies=10, steps=2, batch=10)], ids=["TD3", "SAC", "PPO"]
)
def test_the_generator_decides_everything(steady: EnvSpec, library: Library, settings: Learner) -> None:
    steady = replace(steady, rl=settings)
    # The library draws from the global generators, whose state must not matter.
    np.random.seed(1)  # noqa: NPY002
    one = solve(steady, Seek(), steps=400, library=library)
    np.random.seed(2)  # noqa: NPY002
    again = solve(steady, Seek(), steps=400, library=library)
    other = solve(steady, Seek(), steps=400, seed=1, library=library)
    assert (one.curve, one.env_steps) == (again.curve, again.env_steps)
    assert same(one.policy, again.policy)
    assert not same(one.policy, other.policy)
    assert one.curve != other.curve


@pytest.mark.parametrize("library", LIBRARIES)
@pytest.mark.parametrize("settings", [TD3(), PPO(copies=10, steps=2, batch=10)], ids=["TD3", "PPO"])
def test_checkpoints_that_are_scored_while_it_learns_are_those_that_are_scored_afterwards(
    fragile: EnvSpec, library: Library, settings: Learner
) -> None:
    told, spec = (
        list[tuple[float, float, float]](),
        replace(fragile, rl=replace(settings, checkpoint_every=100)),
    )

    def tell(done: int, values: Mapping[str, float]) -> None:
        assert values.keys() == {OWN, TRUE} | ({PAY} if told else set())
        told.append((done, values[OWN], values[TRUE]))

    one = Agent(spec, "absorbing", np.random.default_rng(0), library, told=tell)
    other = Agent(spec, "absorbing", np.random.default_rng(0), library)
    solution = one.solve(Seek(), 400)
    other.learn(400, Seek())
    assert other.check_steps == 0
    later = other.best(Seek())
    assert (solution.curve, solution.true_curve, solution.best) == (later.curve, later.true_curve, later.best)
    assert solution.check_steps == later.check_steps == one.check_steps > 0
    assert same(solution.policy, later.policy)
    assert told == [(*own, true) for own, (_, true) in zip(later.curve, later.true_curve, strict=True)]
    assert len(told) > 2


def test_it_never_sees_an_evaluation_episode(fragile: EnvSpec, monkeypatch: pytest.MonkeyPatch) -> None:
    seeds: list[int] = []
    reset = Copies.reset

    def spy(self: Copies, place: int, seed: int) -> Array:
        seeds.append(seed)
        return reset(self, place, seed)

    monkeypatch.setattr(Copies, "reset", spy)
    assert solve(fragile, Seek()).check_steps > 20
    assert len(seeds) > 120
    assert min(seeds) >= TRAINING > evaluation_seeds(999, 1000).stop


def test_a_power_of_two_times_the_reward_changes_nothing(fragile: EnvSpec) -> None:
    one, other = (solve(fragile, Seek(1.0, size, -0.5 * size), steps=500) for size in (1.0, 8.0))
    assert same(one.policy, other.policy)
    assert [(x, 8 * y) for x, y in one.curve] == other.curve


class Wide(Seek):
    """Pays a column."""

    def __call__(self, obs: Array, act: Array, next_obs: Array, /) -> Array:
        return super().__call__(obs, act, next_obs)[:, None]


@pytest.mark.parametrize("reward", [Seek(scale=np.nan), Seek(scale=np.inf), Wide()])
def test_a_reward_that_is_no_number_is_refused(steady: EnvSpec, reward: Seek) -> None:
    with pytest.raises(FloatingPointError, match="finite"):
        solve(steady, reward, steps=40)


@pytest.fixture
def actors(monkeypatch: pytest.MonkeyPatch) -> list[Network]:
    """The actor at every checkpoint, the untrained one first."""
    seen: list[Network] = []
    policy = Agent.policy.fget
    assert policy is not None

    def spy(self: Agent) -> Network:
        seen.append(policy(self))
        return seen[-1]

    monkeypatch.setattr(Agent, "policy", property(spy))
    return seen


@pytest.mark.parametrize("protocol", ["absorbing", "offset"])
def test_a_reward_that_pays_nothing_teaches_nothing(
    fragile: EnvSpec, actors: list[Network], protocol: str
) -> None:
    solution = solve(fragile, Seek(scale=0.0), protocol, steps=400)
    assert [y for _, y in solution.curve] == [0.0, 0.0]
    assert solution.env_steps == 400
    assert len(actors) == 2
    assert same(solution.policy, actors[0])
    # A constant that is nothing by the offset is not even trained on, and others are.
    constant = solve(fragile, Constant(0.3, absorbing=0.3), protocol, steps=400)
    assert same(constant.policy, solution.policy)
    assert (constant.curve, constant.env_steps) == (solution.curve[:1], 200)
    assert solve(fragile, Constant(0.0, absorbing=-1.0), protocol, steps=400).env_steps == 400


@pytest.mark.parametrize(
    ("returns", "disturbed", "chosen"),
    [([1, 5, 3, 5, 5], [2, 3, 1], 3), ([1, 5, 3, 5, 4], [2, 2], 3), ([5, 5, 4, 5, 5], [], 0)],
)
def test_ties_go_to_the_checkpoint_that_scores_best_with_noise_and_then_to_the_latest(
    steady: EnvSpec,
    actors: list[Network],
    monkeypatch: pytest.MonkeyPatch,
    returns: list[float],
    disturbed: list[float],
    chosen: int,
) -> None:
    spec = replace(steady, rl=DDPG(checkpoint_every=100, gradient_steps=1))
    scores = iter(returns + disturbed)

    def check(self: Agent, policies: Sequence[Policy]) -> list[tuple[float, float]]:
        self.check_steps += len(policies)
        return [((score := next(scores)), -score) for _ in policies]

    monkeypatch.setattr(Agent, "check", check)
    solution = solve(spec, Seek(), steps=800)
    assert [value for _, value in solution.curve] == returns
    assert [value for _, value in solution.true_curve] == [-value for value in returns]
    assert (solution.env_steps, solution.check_steps) == (800, len(returns + disturbed))
    assert all(map(same, solution.checkpoints, actors))
    assert same(solution.policy, actors[chosen])
    assert next(scores, None) is None
