"""The solver learns what a reward asks for, and nothing where it asks for nothing."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import numpy as np
import pytest
import sbx
import stable_baselines3

from envs import EnvSpec
from envs.copies import Copies
from envs.learners import DDPG, PPO, SAC, TD3, Learner
from harness.registry import LIBRARIES, Library, all_specs
from harness.rl import ppo
from harness.rl.seeds import TRAINING, evaluation_seeds
from harness.rl.solving import Agent
from methods.base import Array
from tests.harness.rewards import Seek
from tests.harness.rl.solving import STEPS, same, solve

pytestmark = pytest.mark.usefixtures("fused_adam")
OBS = np.linspace(-0.8, 0.8, 33)[:, None]


both_libraries = pytest.mark.parametrize("library", LIBRARIES)
LEARNERS = [TD3(), SAC(), PPO(copies=10, steps=2, batch=10)]
learners = pytest.mark.parametrize("settings", LEARNERS, ids=lambda settings: type(settings).__name__)


def test_a_solve_says_what_it_took(steady: EnvSpec) -> None:
    solution = solve(steady, Seek())
    xs = [x for x, _ in solution.curve]
    assert xs == [STEPS / 2, 2 * DDPG().checkpoint_every, STEPS]
    # Twenty episodes of ten steps at each checkpoint.
    assert (solution.env_steps, solution.check_steps) == (STEPS, len(xs) * 20 * 10)
    short = solve(steady, Seek(), steps=300)  # checked on fewer episodes
    assert (short.env_steps, short.check_steps) == (300, len(short.curve) * 4 * 10)


@pytest.mark.parametrize("steps", [0, 10, 25])
def test_all_copies_take_whole_steps_and_learn_after_the_first(steady: EnvSpec, steps: int) -> None:
    with pytest.raises(ValueError, match=f"multiple of 10 steps, at least 20, not {steps}"):
        solve(steady, Seek(), steps=steps)


@pytest.mark.parametrize(
    "spec", [spec for spec in all_specs() if not spec.tabular], ids=lambda spec: spec.name
)
def test_every_solve_that_runs_ask_for_suits_the_learner(spec: EnvSpec) -> None:
    for one in (spec,) if spec.discrete else (spec, spec.by_ddpg()):
        assert min(one.rl_steps.values()) >= 2 * one.rl.unit
        assert all(steps % one.rl.unit == 0 for steps in (*one.rl_steps.values(), one.rl.checkpoint_every))


def test_no_reward_means_the_environments_own(steady: EnvSpec) -> None:
    own, learned = solve(steady, None), solve(steady, Seek())
    np.testing.assert_allclose(own.policy(OBS), learned.policy(OBS), atol=0.05)
    np.testing.assert_allclose(own.curve, learned.curve, atol=0.2)


@both_libraries
@learners
def test_the_generator_decides_everything(steady: EnvSpec, library: Library, settings: Learner) -> None:
    steady = dataclasses.replace(steady, rl=settings)
    # The library draws from the global generators, whose state must not matter.
    np.random.seed(1)  # noqa: NPY002
    one = solve(steady, Seek(), steps=400, library=library)
    np.random.seed(2)  # noqa: NPY002
    again = solve(steady, Seek(), steps=400, library=library)
    other = solve(steady, Seek(), steps=400, seed=1, library=library)
    assert one.curve == again.curve
    assert one.env_steps == again.env_steps
    assert same(one.policy, again.policy)
    assert not same(one.policy, other.policy)
    assert one.curve != other.curve


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


@both_libraries
@learners
def test_the_learning_rate_falls_within_each_solve(
    steady: EnvSpec, monkeypatch: pytest.MonkeyPatch, library: Library, settings: Learner
) -> None:
    falling = dataclasses.replace(settings, learning_rate=1e-3, final_learning_rate=1e-4)
    spec = dataclasses.replace(steady, rl=falling)
    rates: list[float] = []
    on_policy = isinstance(settings, PPO)
    if on_policy and library == "sbx":
        ours = ppo.functions

        def watched(kind: ppo.Kind) -> ppo.Functions:
            def learn(*arguments: Any) -> Any:
                rates.append(float(arguments[4]))
                return ours(kind).learn(*arguments)

            return ours(kind)._replace(learn=learn)

        monkeypatch.setattr(ppo, "functions", watched)
    else:
        solver: Any = getattr(sbx if library == "sbx" else stable_baselines3, type(settings).__name__)
        train = solver.train

        def spy(self: Any, *arguments: Any, **named: Any) -> None:
            train(self, *arguments, **named)
            if library == "sbx":
                states = self.policy.actor_state.opt_state, self.policy.qf_state.opt_state
                both = {float(state.hyperparams["learning_rate"]) for state in states}
            else:
                nets = [self.policy] if on_policy else [self.actor, self.critic]
                both = {net.optimizer.param_groups[0]["lr"] for net in nets}
            rates.append(*both)

        monkeypatch.setattr(solver, "train", spy)
    agent = Agent(spec, "absorbing", np.random.default_rng(0), library)
    agent.solve(Seek(), 400)
    first = list(rates)
    rates.clear()
    agent.solve(Seek(), 400)
    for solve_rates in (first, rates):
        assert solve_rates == sorted(solve_rates, reverse=True)
        # Our PPO learns at the rate of the middle of each bout.
        half = settings.unit / 800 if on_policy and library == "sbx" else 0.0
        assert solve_rates[-1] == pytest.approx(1e-4 + half * 9e-4)
    assert rates[0] > 9e-4


def test_a_power_of_two_times_the_reward_changes_nothing(fragile: EnvSpec) -> None:
    one, other = (solve(fragile, Seek(1.0, size, -0.5 * size), steps=500) for size in (1.0, 8.0))
    assert same(one.policy, other.policy)
    assert [(x, 8 * y) for x, y in one.curve] == other.curve


def test_what_one_agent_compiled_serves_the_next(steady: EnvSpec, caplog: pytest.LogCaptureFixture) -> None:
    spec = dataclasses.replace(steady, rl=TD3())

    def compiled() -> int:
        caplog.clear()
        with jax.log_compiles():
            solve(spec, Seek(), steps=200, library="sbx")
        return caplog.text.count("Compiling jit(_train)")

    jax.clear_caches()
    assert [compiled() > 0, compiled()] == [True, 0]


class Wide(Seek):
    """Pays a column."""

    def __call__(self, obs: Array, act: Array, next_obs: Array, /) -> Array:
        return super().__call__(obs, act, next_obs)[:, None]


@pytest.mark.parametrize("protocol", ["absorbing", "native"])
@pytest.mark.parametrize("reward", [Seek(scale=np.nan), Seek(scale=np.inf), Wide()])
def test_a_reward_that_is_no_number_is_refused(steady: EnvSpec, protocol: str, reward: Seek) -> None:
    with pytest.raises(FloatingPointError, match="finite"):
        solve(steady, reward, protocol, 40)
