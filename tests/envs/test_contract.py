"""What every environment must satisfy."""

import dataclasses

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from envs import BUDGETS, SPECS, EnvSpec


@pytest.fixture(params=SPECS.values(), ids=list(SPECS))
def spec(request: pytest.FixtureRequest) -> EnvSpec:
    return request.param


def play(env: gym.Env, seed: int, steps: int) -> list[tuple]:
    rng = np.random.default_rng(seed)
    obs, _ = env.reset(seed=seed)
    seen = [obs.tolist()]
    for _ in range(steps):
        obs, reward, terminated, truncated, _ = env.step(
            rng.uniform(-1, 1, env.action_space.shape).astype(np.float32)
        )
        seen.append((obs.tolist(), reward, terminated, truncated))
        if terminated or truncated:
            break
    return seen


# Unbounded velocities, and a reset that renders nothing, are both as the environments' authors meant it.
@pytest.mark.filterwarnings("ignore:.*Box observation space (minimum|maximum) value is:UserWarning")
@pytest.mark.filterwarnings("ignore:.*not within the observation space:UserWarning")
def test_gymnasium_accepts_it(spec: EnvSpec) -> None:
    check_env(spec.make().unwrapped, skip_render_check=True)


def test_the_same_seed_gives_the_same_episode(spec: EnvSpec) -> None:
    env = spec.make()
    first = play(env, 5, 60)
    assert play(env, 5, 60) == first
    assert play(spec.make(), 5, 60) == first
    assert play(env, 6, 60) != first


def test_actions_are_scaled_and_sizes_are_as_said(spec: EnvSpec) -> None:
    env = spec.make()
    assert np.array_equal(env.action_space.low, -np.ones(spec.act_size, np.float32))
    assert np.array_equal(env.action_space.high, np.ones(spec.act_size, np.float32))
    assert env.reset(seed=0)[0].shape == (spec.obs_size,)


def test_drawings_keep_their_names_and_lie_in_the_plane(spec: EnvSpec) -> None:
    env = spec.make()
    env.reset(seed=1)
    before = spec.draw(env)
    env.step(np.ones(spec.act_size, np.float32))
    after = spec.draw(env)
    assert before.keys() == after.keys()
    assert all(
        s.points.ndim == 2 and s.points.shape[1] == 2 and np.isfinite(s.points).all() for s in after.values()
    )
    assert any(not np.array_equal(before[name].points, after[name].points) for name in before)


def test_features_are_bounded_and_finite(spec: EnvSpec) -> None:
    rng = np.random.default_rng(2)
    obs = 100 * rng.standard_normal((200, spec.obs_size))
    features = spec.phi(obs, rng.uniform(-1, 1, (200, spec.act_size)))
    assert features.shape[0] == 200
    assert np.abs(features).max() <= 1


def test_it_terminates_and_says_why(spec: EnvSpec) -> None:
    env = spec.make()
    for seed in range(20):
        env.reset(seed=seed)
        for _ in range(spec.horizon):
            _, _, terminated, truncated, _ = env.step(np.ones(spec.act_size, np.float32))
            if terminated or truncated:
                break
        if terminated:
            assert spec.why_ended(env)
            return
    pytest.fail("full actions never ended an episode early")


def test_budgets_grow(spec: EnvSpec) -> None:
    for table in (spec.rl_steps, spec.eval_episodes, spec.demo_episodes):
        assert [table[b] for b in BUDGETS] == sorted(table[b] for b in BUDGETS)


@pytest.mark.parametrize("wrong", [{"gamma": 1.0}, {"horizon": 0}, {"obs_scale": (1.0,)}])
def test_a_spec_that_contradicts_itself_is_refused(spec: EnvSpec, wrong: dict) -> None:
    with pytest.raises(ValueError, match=spec.name):
        dataclasses.replace(spec, **wrong)


def test_a_spec_that_contradicts_its_environment_is_refused(spec: EnvSpec) -> None:
    liar = dataclasses.replace(spec, obs_size=spec.obs_size + 1, obs_scale=(*spec.obs_scale, 1.0))
    with pytest.raises(ValueError, match="contradict"):
        liar.make()
