"""What every environment must satisfy."""

import dataclasses

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import RescaleAction, TimeLimit, TransformObservation

from envs import BUDGETS, EnvSpec, from_gymnasium
from envs.learners import DDPG, DQN
from envs.spec import Quantity
from harness.registry import SPECS, all_specs
from tests.envs.lockstep import assert_together_as_alone

# A task of others, of which nothing is told but its id: it is wrapped, never terminates and draws nothing.
DERIVED = from_gymnasium("Pendulum-v1", "derived", variants={"moon": {"g": 1.62}})
NOMINAL = [*all_specs(), DERIVED]
VARIANTS = [(spec, name) for spec in NOMINAL for name in spec.variants]
ALL = [*NOMINAL, *(spec.variant(name) for spec, name in VARIANTS)]


@pytest.fixture(params=ALL, ids=lambda spec: spec.name)
def spec(request: pytest.FixtureRequest) -> EnvSpec:
    return request.param


def play(spec: EnvSpec, env: gym.Env, seed: int, steps: int) -> list[tuple]:
    rng = np.random.default_rng(seed)
    obs, _ = env.reset(seed=seed)
    seen = [obs.tolist()]
    for act in spec.random_actions(steps, rng):
        obs, reward, terminated, truncated, _ = env.step(spec.native(act))
        seen.append((obs.tolist(), reward, terminated, truncated))
        if terminated or truncated:
            break
    return seen


def pushed(spec: EnvSpec, env: gym.Env) -> list[float]:
    """What is observed after half a hundred times the same action."""
    obs, _ = env.reset(seed=0)
    for _ in range(50):
        obs, *_ = env.step(spec.native(np.ones(spec.act_size)))
    return obs.tolist()


# Unbounded velocities, and a reset that renders nothing, are both as the environments' authors meant it.
@pytest.mark.filterwarnings("ignore:.*Box observation space (minimum|maximum) value is:UserWarning")
@pytest.mark.filterwarnings("ignore:.*not within the observation space:UserWarning")
@pytest.mark.filterwarnings("ignore:.*different from the unwrapped version:UserWarning")
def test_gymnasium_accepts_it(spec: EnvSpec) -> None:
    check_env(spec.make(), skip_render_check=True)


def test_the_same_seed_gives_the_same_episode(spec: EnvSpec) -> None:
    env = spec.make()
    first = play(spec, env, 5, 60)
    assert play(spec, env, 5, 60) == first
    assert play(spec, spec.make(), 5, 60) == first
    assert play(spec, env, 6, 60) != first


def test_actions_are_scaled_and_sizes_are_as_said(spec: EnvSpec) -> None:
    env = spec.make()
    if spec.discrete:
        assert env.action_space == spaces.Discrete(spec.act_size)
    else:
        assert np.array_equal(env.action_space.low, -np.ones(spec.act_size, np.float32))
        assert np.array_equal(env.action_space.high, np.ones(spec.act_size, np.float32))
    assert env.reset(seed=0)[0].shape == (spec.obs_size,)


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


def test_drawings_keep_their_names_and_lie_in_the_plane(spec: EnvSpec) -> None:
    env = spec.make()
    env.reset(seed=1)
    before = spec.draw(env)
    env.step(spec.native(np.ones(spec.act_size)))
    after = spec.draw(env)
    assert before.keys() == after.keys()
    assert all(name.isidentifier() for name in before), "recordings use them as paths"
    assert all(
        s.points.ndim == 2 and s.points.shape[1] == 2 and np.isfinite(s.points).all() for s in after.values()
    )
    if before:
        assert any(not np.array_equal(before[name].points, after[name].points) for name in before)


def test_features_are_bounded_and_finite(spec: EnvSpec) -> None:
    rng = np.random.default_rng(2)
    obs = 100 * rng.standard_normal((200, spec.obs_size))
    features = spec.features(obs, spec.random_actions(200, rng))
    assert features.shape[0] == 200
    assert np.abs(features).max() <= 1


def test_where_it_terminates_it_says_why(spec: EnvSpec) -> None:
    env = spec.make()
    for seed in range(5):
        env.reset(seed=seed)
        for _ in range(spec.horizon):
            _, _, terminated, truncated, _ = env.step(spec.native(np.ones(spec.act_size)))
            if terminated or truncated:
                break
        assert terminated or truncated
        if terminated:
            assert spec.tabular is None, "a known model has no terminal states"
            assert spec.why_ended(env)
            return


def test_copies_that_step_together_are_bit_for_bit_those_that_step_alone(spec: EnvSpec) -> None:
    if spec.batch:
        assert_together_as_alone(spec, min(spec.horizon, 100))


@pytest.mark.parametrize(("spec", "name"), VARIANTS, ids=lambda value: getattr(value, "name", value))
def test_a_variant_is_the_task_with_other_dynamics(spec: EnvSpec, name: str) -> None:
    variant = spec.variant(name)
    for field in ("obs_size", "act_size", "obs_names", "act_names", "obs_scale", "horizon", "rl", "rl_steps"):
        assert getattr(variant, field) == getattr(spec, field)
    assert (variant.batch is None) == (spec.batch is None)
    assert variant.shipped is None
    assert variant.name not in {s.name for s in NOMINAL}
    both = [(one, one.make()) for one in (spec, variant)]
    assert play(*both[0], 0, 20) != play(*both[1], 0, 20) or pushed(*both[0]) != pushed(*both[1])
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


def test_budgets_grow(spec: EnvSpec) -> None:
    for table in (spec.rl_steps, spec.eval_episodes, spec.demo_episodes):
        assert [table[b] for b in BUDGETS] == sorted(table[b] for b in BUDGETS)


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
    one_more = {"obs_scale": (*spec.obs_scale, 1.0), "obs_names": (*spec.obs_names, Quantity("more"))}
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
    for names, size in ((spec.obs_names, spec.obs_size), (spec.act_names, spec.act_size)):
        assert len({quantity.name for quantity in names}) == size
    if spec.name.startswith("derived"):
        assert [quantity.name for quantity in spec.obs_names] == ["obs 0", "obs 1", "obs 2"]
        assert spec.act_names == (Quantity("act 0"),)
    else:
        assert not any(quantity.name.startswith(("obs ", "act ")) for quantity in spec.obs_names)


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
