"""What every environment must satisfy."""

import dataclasses
import re

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.wrappers import RescaleAction, TimeLimit, TransformObservation

from envs import EnvSpec, Shape, from_gymnasium
from envs.learners import DDPG, DQN
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


@pytest.fixture(params=ALL, ids=lambda spec: spec.name)
def spec(request: pytest.FixtureRequest) -> EnvSpec:
    return request.param


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


class Deaf(gym.Wrapper):
    """It hears neither seeds nor actions."""

    def reset(self, **given: object) -> tuple:
        return self.env.reset(seed=0)

    def step(self, action: np.ndarray) -> tuple:
        return self.env.step(0 * action)


BROKEN = [
    (broken(rl_steps={"smoke": 900, "quick": 600, "full": 600}), "budgets grow", "rl_steps must not fall"),
    (broken(phi=lambda obs, act: obs), "features are bounded", r"within \[-1, 1\]"),
    (broken(phi=lambda obs, act: np.ones((1, 1))), "features are bounded", "a row for each"),
    (
        *(broken(wrap=lambda env: Forgetful(scaled(env))), "the same seed gives the same episode"),
        "differs after a reset",
    ),
    (broken(wrap=lambda env: Deaf(scaled(env))), "the same seed gives the same episode", "two seeds"),
    (broken(draw=lambda env: {"a b": Shape(np.zeros((2, 2)), (0, 0, 0))}), "drawings keep", "identifiers"),
    (
        broken(draw=lambda env: {"a": Shape(np.zeros((2, 2)), (0, 0, 0))}),
        "drawings keep",
        "nothing that is drawn moves",
    ),
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


def test_of_choices_the_largest_acts_and_the_first_of_equals(spec: EnvSpec) -> None:
    rng = np.random.default_rng(0)
    scores = rng.choice(5, (50, spec.act_size)) / 4 - 0.5
    executed = spec.executed(scores)
    if not spec.discrete:
        assert np.array_equal(executed, scores)
        assert np.array_equal(spec.native(scores[0]), scores[0].astype(np.float32))
        return
    for its_scores, act in zip(scores.tolist(), executed, strict=True):
        first = its_scores.index(max(its_scores))
        assert act.tolist() == [float(i == first) for i in range(spec.act_size)]
        assert spec.native(act) == spec.native(np.array(its_scores)) == first


def test_what_is_no_action_is_refused(spec: EnvSpec) -> None:
    good = spec.random_actions(3, np.random.default_rng(0))
    bad = [good[0], good[:, :0], np.concatenate([good, good], axis=1), good[:, :, None]]
    bad += [np.where(np.arange(3)[:, None] == 1, value, good) for value in (np.nan, np.inf)]
    if not spec.discrete:
        bad += [good + 2, good - 2]
    for act in bad:
        with pytest.raises(ValueError, match="actions must"):
            spec.executed(act)


def test_random_actions_are_uniform(spec: EnvSpec) -> None:
    count = 20_000
    act = spec.random_actions(count, np.random.default_rng(0))
    assert act.shape == (count, spec.act_size)
    if spec.discrete:
        assert np.array_equal(np.sort(act, axis=1), np.tile(np.eye(spec.act_size)[-1], (count, 1)))
        np.testing.assert_allclose(act.mean(axis=0), 1 / spec.act_size, atol=0.015)
    else:
        below = (np.sort(act, axis=0) + 1) / 2
        np.testing.assert_allclose(
            below, np.tile(np.linspace(0, 1, count)[:, None], spec.act_size), atol=0.015
        )


@pytest.mark.parametrize(("spec", "name"), VARIANTS, ids=lambda value: getattr(value, "name", value))
def test_a_variant_is_the_task_with_other_dynamics(spec: EnvSpec, name: str) -> None:
    variant = spec.variant(name)
    shared = ("obs_size", "act_size", "observations", "actions", "obs_scale", "horizon", "rl", "rl_steps")
    for field in shared:
        assert getattr(variant, field) == getattr(spec, field)
    assert (variant.batch is None) == (spec.batch is None)
    assert variant.shipped is None
    assert variant.name not in {s.name for s in NOMINAL}
    with pytest.raises(ValueError, match="there are: none"):
        variant.variant(name)


def test_an_unknown_variant_is_refused_by_the_known_ones(spec: EnvSpec) -> None:
    with pytest.raises(ValueError, match=f"there are: {', '.join(spec.variants) or 'none'}$"):
        spec.variant("upside_down")


def test_a_known_model_has_no_variants() -> None:
    with pytest.raises(ValueError, match="another model"):
        dataclasses.replace(SPECS["gridworld"], variants={"slippery": {}})


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


@pytest.mark.parametrize(
    "wrong",
    [
        {"gamma": 1.0},
        {"horizon": 0},
        {"obs_scale": (1.0,)},
        {"obs_names": (Quantity("x"),)},
        {"act_names": (Quantity("same"),) * 2},
    ],
)
def test_a_spec_that_contradicts_itself_is_refused(spec: EnvSpec, wrong: dict) -> None:
    with pytest.raises(ValueError, match=spec.name):
        dataclasses.replace(spec, **wrong)


def test_a_spec_that_contradicts_its_environment_is_refused(spec: EnvSpec) -> None:
    one_more = {"obs_scale": (*spec.obs_scale, 1.0), "obs_names": (*spec.observations, Quantity("more"))}
    liar = dataclasses.replace(spec, obs_size=spec.obs_size + 1, **one_more)
    with pytest.raises(ValueError, match="contradict"):
        liar.make()
    other = DDPG() if spec.discrete else DQN()
    with pytest.raises(ValueError, match="contradict"):
        dataclasses.replace(spec, discrete=not spec.discrete, rl=other).make()
    with pytest.raises(ValueError, match="choices need DQN"):
        dataclasses.replace(spec, rl=other)
    with pytest.raises(ValueError, match="not truncated at"):
        dataclasses.replace(spec, horizon=spec.horizon + 1).make()


def test_actions_of_other_bounds_are_refused() -> None:
    with pytest.raises(ValueError, match="bounds"):
        dataclasses.replace(SPECS["pendulum"], env_id="InvertedPendulum-v5").make()


def test_wrapped_and_variant_environments_are_checked_too() -> None:
    def refused(message: str, **fields: object) -> None:
        with pytest.raises(ValueError, match=message):
            dataclasses.replace(SPECS["cartpole"], **fields).make()

    made_with = {**SPECS["cartpole"].kwargs}
    refused("bounds", wrap=lambda env: RescaleAction(env, np.float32(-2), np.float32(2)))
    refused("sizes", wrap=lambda env: TransformObservation(env, lambda obs: obs[:3], spaces.Box(-1, 1, (3,))))
    for steps in (499, 501):  # of two limits the earlier counts
        truncated = r"cartpole: .* not truncated at"
        refused(truncated, wrap=lambda env, steps=steps: TimeLimit(env, steps), horizon=501)
        refused(truncated, kwargs=made_with | {"max_episode_steps": steps})
    assert dataclasses.replace(SPECS["cartpole"], wrap=lambda env: TimeLimit(env, 20), horizon=20).make()
    short = dataclasses.replace(SPECS["cartpole"], variants={"short": {"max_episode_steps": 20}})
    assert short.make()
    with pytest.raises(ValueError, match=r"cartpole\.short: .* not truncated at"):
        short.variant("short").make()
    wide = from_gymnasium("InvertedPendulum-v5", "wide", wrap=lambda env: env)
    with pytest.raises(ValueError, match="bounds"):
        wide.make()


def test_every_number_has_a_name(spec: EnvSpec) -> None:
    for names, size in ((spec.observations, spec.obs_size), (spec.actions, spec.act_size)):
        assert len({quantity.name for quantity in names}) == size
    if spec.name.startswith("derived"):
        assert [quantity.name for quantity in spec.observations] == ["obs 0", "obs 1", "obs 2"]
        assert spec.actions == (Quantity("act 0"),)
    else:
        assert not any(quantity.name.startswith(("obs ", "act ")) for quantity in spec.observations)


def test_what_gymnasium_tells_of_a_task_is_taken_from_it() -> None:
    assert (DERIVED.obs_size, DERIVED.act_size, DERIVED.horizon, DERIVED.discrete) == (3, 1, 200, False)
    assert DERIVED.obs_scale[:2] == pytest.approx((0.7, 0.7), abs=0.15)
    assert DERIVED.obs_scale[2] > 2
    ours, theirs = DERIVED.make(), gym.make("Pendulum-v1")
    for env in (ours, theirs):
        env.reset(seed=0)
    assert ours.step(np.array([0.5], np.float32))[1] == theirs.step(np.array([1.0], np.float32))[1]
    assert from_gymnasium("CartPole-v1", "choices").discrete
    with_x = from_gymnasium("Hopper-v5", "x", kwargs={"exclude_current_positions_from_observation": False})
    assert (with_x.obs_size, with_x.make().observation_space.shape) == (12, (12,))


@pytest.mark.parametrize(("env_id", "message"), [("Blackjack-v1", "flat box"), ("FrozenLake-v1", "flat box")])
def test_of_what_too_little_can_be_told_it_is_said(env_id: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        from_gymnasium(env_id, "x")
