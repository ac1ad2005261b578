"""MuJoCo's tasks are Gymnasium's, and their variants what their names say."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.mujoco import MujocoEnv

from envs import EnvSpec
from envs.mujoco_tasks import DOUBLE_PENDULUM, HALFCHEETAH, HOPPER, NOMINAL, REACHER, WALKER2D, WEAK, Physics
from envs.point_maze import HEIGHT, SPEC, TARGET, PointMaze

TASKS = [DOUBLE_PENDULUM, REACHER, HALFCHEETAH, HOPPER, WALKER2D]
ids = lambda spec: spec.name  # noqa: E731


def model_of(spec: EnvSpec) -> MujocoEnv:
    env = spec.make().unwrapped
    assert isinstance(env, MujocoEnv)
    return env


@pytest.mark.parametrize("spec", TASKS, ids=ids)
def test_the_task_is_gymnasiums_bit_for_bit(spec: EnvSpec, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)  # Gymnasium's own may leave MuJoCo's log there
    ours, theirs = spec.make(), gym.make(spec.env_id.removeprefix("irl_bench_bare/"))
    rng = np.random.default_rng(0)
    for seed in range(3):
        assert np.array_equal(ours.reset(seed=seed)[0], theirs.reset(seed=seed)[0])
        for act in spec.random_actions(60, rng):
            found, expected = (env.step(act.astype(np.float32)) for env in (ours, theirs))
            assert np.array_equal(found[0], expected[0])
            assert found[1:4] == expected[1:4]
            if found[2]:
                break


@pytest.mark.parametrize("spec", TASKS, ids=ids)
def test_what_is_observed_is_what_its_name_says(spec: EnvSpec) -> None:
    """Of joints that are observed as they are."""
    env = model_of(spec)
    obs, _ = env.reset(seed=0)
    names = [quantity.name for quantity in spec.observations]
    for i in range(env.model.njnt):
        name = env.model.joint(i).name
        if name in names:
            assert obs[names.index(name)] == env.data.qpos[i]
            assert obs[names.index(f"{name} rate")] == env.data.qvel[i]


def test_variants_change_what_they_name_and_nothing_else() -> None:
    nominal, weak = model_of(HALFCHEETAH), model_of(HALFCHEETAH.variant("weak_leg"))
    strength = weak.model.actuator_gear[:, 0] / nominal.model.actuator_gear[:, 0]
    np.testing.assert_allclose(strength, [1, 1, 1, WEAK, WEAK, WEAK])
    assert np.array_equal(weak.model.body_mass, nominal.model.body_mass)
    heavy = model_of(HALFCHEETAH.variant("heavy")).model
    np.testing.assert_allclose(heavy.body_mass, 1.5 * nominal.model.body_mass)
    np.testing.assert_allclose(heavy.body_inertia, 1.5 * nominal.model.body_inertia)
    assert np.array_equal(heavy.actuator_gear, nominal.model.actuator_gear)
    up = model_of(DOUBLE_PENDULUM.variant("gravity")).model
    np.testing.assert_allclose(up.opt.gravity, 1.4 * model_of(DOUBLE_PENDULUM).model.opt.gravity)


def test_nothing_is_written_where_a_task_is_made(tmp_path, monkeypatch) -> None:
    """MuJoCo warns of one of Gymnasium's models, in a file."""
    monkeypatch.chdir(tmp_path)
    HALFCHEETAH.make()
    assert Physics() == NOMINAL
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("spec", [HALFCHEETAH, HOPPER, WALKER2D], ids=ids)
def test_a_drawing_follows_the_robot(spec: EnvSpec) -> None:
    env = spec.make()
    env.reset(seed=0)
    before = spec.draw(env)
    inner = env.unwrapped
    assert isinstance(inner, MujocoEnv)
    inner.set_state(inner.data.qpos + np.eye(inner.model.nq)[0] * 7.25, inner.data.qvel)
    after = spec.draw(env)
    for name in before.keys() - {"ground"}:
        np.testing.assert_allclose(after[name].points, before[name].points, atol=1e-9)
    assert not np.array_equal(after["ground"].points, before["ground"].points)


def steer(wall_moved: bool) -> tuple[float, float]:
    """The return of a policy that goes around the wall's open end, and how near it comes to the target."""
    spec = SPEC.variant("wall_moved") if wall_moved else SPEC
    env = spec.make()
    obs, _ = env.reset(seed=0)
    total, around = 0.0, 0.5 if wall_moved else 0.05
    for _ in range(spec.horizon):
        goal = np.array([around, HEIGHT + 0.1]) if obs[1] < HEIGHT + 0.05 else np.array(TARGET)
        if obs[1] < HEIGHT - 0.05 and abs(obs[0] - around) > 0.05:
            goal = np.array([around, 0.1])
        act = np.clip(10 * (goal - obs[:2]) - 2 * obs[2:], -1, 1)
        obs, reward, *_ = env.step(act.astype(np.float32))
        total += float(reward)
    return total, float(np.linalg.norm(obs[:2] - TARGET))


def test_the_maze_is_left_by_its_open_end() -> None:
    for moved in (False, True):
        total, off = steer(moved)
        assert off < 0.05
        assert -16 < total < -6
    env = SPEC.make()
    obs, _ = env.reset(seed=0)
    for _ in range(SPEC.horizon):  # straight on there is the wall
        obs, *_ = env.step(np.array([0.0, 1.0], np.float32))
    assert isinstance(env.unwrapped, PointMaze)
    assert obs[1] < HEIGHT
