"""What every environment must satisfy."""

import dataclasses
import re

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.wrappers import RescaleAction, TimeLimit, TransformObservation

from envs import EnvSpec, from_gymnasium
from envs.learners import DQN
from envs.scaled import scaled
from envs.spec import Quantity
from harness.registry import SPECS, all_specs
from harness.registry.contract import ContractError, check_env
from harness.registry.contract.check import Check
from harness.registry.contract.tasks import checks

# A task of others, of which nothing is told but its id: it is wrapped, never terminates and draws nothing.
DERIVED = from_gymnasium("Pendulum-v1", "derived", variants={"moon": {"g": 1.62}})
NOMINAL = [*all_specs(), DERIVED]
VARIANTS = [(spec, name) for spec in NOMINAL for name in spec.variants]
ALL = [*NOMINAL, *(spec.variant(name) for spec, name in VARIANTS)]
CHECKS = [(spec, check) for spec in ALL for check in checks(spec)]


@pytest.mark.parametrize("check", [c for _, c in CHECKS], ids=[f"{s.name}: {c.title}" for s, c in CHECKS])
def test_every_task_keeps_the_contract(check: Check) -> None:
    assert check.outcome() == ("ok", "")


def broken(**fields: object) -> EnvSpec:
    return dataclasses.replace(DERIVED, **fields)  # type: ignore[arg-type]


class Forgetful(gym.Wrapper):
    """Its episodes do not depend on the seed alone."""

    resets = 0

    def reset(self, **given: object) -> tuple:
        self.resets += 1
        return self.env.reset(seed=self.resets)


BROKEN = [
    (broken(rl_steps={"smoke": 900, "quick": 600, "full": 600}), "budgets grow", "rl_steps must not fall"),
    (broken(phi=lambda obs, act: obs), "features are bounded", r"within \[-1, 1\]"),
    (broken(wrap=lambda env: Forgetful(scaled(env))), "the same seed", "differs after a reset"),
    (broken(variants={"same": {"g": 10.0}}), "the variant same", "everything is as in the task itself"),
    (broken(wrap=lambda env: env), "actions are scaled", "bounds"),
]


@pytest.mark.parametrize(("spec", "title", "why"), BROKEN)
def test_what_breaks_the_contract_is_told_how(spec: EnvSpec, title: str, why: str) -> None:
    failed = {check.title: check.outcome()[1] for check in checks(spec) if check.outcome()[0] == "FAILED"}
    (found,) = [text for its_title, text in failed.items() if its_title.startswith(title)]
    assert re.search(why, found)
    with pytest.raises(ContractError):
        check_env(spec)


FLIPPED = [spec for spec, name in VARIANTS if name == "flipped"]


@pytest.mark.parametrize("spec", FLIPPED, ids=lambda spec: spec.name)
def test_flipped_answers_the_opposite_action_alike(spec: EnvSpec) -> None:
    for seed in range(3):
        nominal, flipped = spec.make(), spec.variant("flipped").make()
        assert np.array_equal(nominal.reset(seed=seed)[0], flipped.reset(seed=seed)[0])
        for act in spec.random_actions(100, np.random.default_rng(seed)):
            obs, *expected = nominal.step(spec.native(act))
            mirrored, *found = flipped.step(spec.native(-act))
            assert np.array_equal(mirrored, obs)
            assert found[:3] == expected[:3]
            if expected[1]:
                break


def test_what_an_environment_or_a_variant_contradicts_is_refused() -> None:
    def refused(message: str, **fields: object) -> None:
        with pytest.raises(ValueError, match=message):
            dataclasses.replace(SPECS["cartpole"], **fields).make()

    refused("bounds", wrap=lambda env: RescaleAction(env, np.float32(-2), np.float32(2)))
    refused("sizes", wrap=lambda env: TransformObservation(env, lambda obs: obs[:3], spaces.Box(-1, 1, (3,))))
    refused("not truncated at", wrap=lambda env: TimeLimit(env, 499))  # of two limits the earlier counts
    refused("not truncated at", horizon=501)
    refused("contradict", discrete=True, rl=DQN())
    refused("cartpole", gamma=1.0)
    refused("cartpole", obs_names=(Quantity("x"),))
    short = dataclasses.replace(SPECS["cartpole"], variants={"short": {"max_episode_steps": 20}})
    assert short.make()
    with pytest.raises(ValueError, match=r"cartpole\.short: .* not truncated at"):
        short.variant("short").make()
    with pytest.raises(ValueError, match=r"there are: short$"):
        short.variant("upside_down")
    with pytest.raises(ValueError, match="another model"):
        dataclasses.replace(SPECS["gridworld"], variants={"slippery": {}})


def test_what_gymnasium_tells_of_a_task_is_taken_from_it() -> None:
    assert (DERIVED.obs_size, DERIVED.act_size, DERIVED.horizon, DERIVED.discrete) == (3, 1, 200, False)
    assert DERIVED.obs_scale[:2] == pytest.approx((0.7, 0.7), abs=0.15)
    assert DERIVED.obs_scale[2] > 2
    ours, theirs = DERIVED.make(), gym.make("Pendulum-v1")
    for env in (ours, theirs):
        env.reset(seed=0)
    assert ours.step(np.array([0.5], np.float32))[1] == theirs.step(np.array([1.0], np.float32))[1]
    assert from_gymnasium("CartPole-v1", "choices").discrete
    assert from_gymnasium("FrozenLake-v1", "x").obs_size == 16


@pytest.mark.parametrize("name", ["gridworld", "point_maze"])
def test_actions_are_uniform_and_what_is_no_action_is_refused(name: str) -> None:
    spec, count = SPECS[name], 20_000
    act = spec.random_actions(count, np.random.default_rng(0))
    if spec.discrete:  # the largest acts, and the first of equals
        assert np.array_equal(np.sort(act, axis=1), np.tile(np.eye(spec.act_size)[-1], (count, 1)))
        np.testing.assert_allclose(act.mean(axis=0), 1 / spec.act_size, atol=0.015)
        assert spec.executed(np.array([[0.0, 0.3, 0.3, -1.0, 0.1]])).tolist() == [[0, 1, 0, 0, 0]]
    else:
        even = np.tile(np.linspace(-1, 1, count)[:, None], spec.act_size)
        np.testing.assert_allclose(np.sort(act, axis=0), even, atol=0.03)
        with pytest.raises(ValueError, match="actions must"):
            spec.executed(act + 2)
    for bad in (act[0], act[:, :0], np.where(act > 0.5, np.nan, act)):
        with pytest.raises(ValueError, match="actions must"):
            spec.executed(bad)
