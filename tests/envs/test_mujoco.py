"""MuJoCo's tasks are Gymnasium's, bit for bit, alone and in lockstep."""

from threading import Lock
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.mujoco import MujocoEnv
from gymnasium.envs.mujoco.inverted_pendulum_v5 import InvertedPendulumEnv
from gymnasium.envs.registration import EnvSpec as Registered
from gymnasium.wrappers import TransformReward

from envs import EnvSpec, from_gymnasium, point_maze
from envs.copies import try_out
from envs.mujoco_batch import MujocoBatch
from envs.mujoco_tasks import DOUBLE_PENDULUM, HALFCHEETAH, HOPPER, REACHER, WALKER2D, WEAK
from harness.registry.contract.lockstep import assert_together_as_alone


@pytest.mark.parametrize(
    ("env_id", "ends"),
    [
        ("HalfCheetah-v5", False),
        ("Hopper-v5", True),
        ("Walker2d-v5", True),
        ("Reacher-v5", False),
        ("Ant-v5", True),
    ],
)
def test_mujocos_tasks_in_lockstep_are_bit_for_bit_gymnasiums(env_id: str, ends: bool) -> None:
    """Ant observes forces, and Reacher is paid by distances, of the last frame but one."""
    spec = from_gymnasium(env_id, "x", why_ended=lambda env: f"at {env.unwrapped.data.time}")
    assert isinstance(spec.batch(1), MujocoBatch)
    assert bool(assert_together_as_alone(spec, 300)) == ends


class Other(InvertedPendulumEnv):
    """It changes its model in each episode, and holds what cannot be copied."""

    def reset_model(self) -> Any:
        self.lock = Lock()
        self.model.opt.gravity[2] = -9.81 * self.np_random.uniform(0.2, 3.0)
        return super().reset_model()


def test_what_others_wrap_or_derive_is_stepped_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Copies of them would share what each has of its own, or could not be made."""
    registered = Registered("Other-v0", Other, max_episode_steps=100, disable_env_checker=True)
    monkeypatch.setitem(gym.registry, "Other-v0", registered)
    spec = from_gymnasium("Other-v0", "x")
    assert spec.batch is None
    try_out(spec)
    wrapped = from_gymnasium(
        "Reacher-v5", "x", wrap=lambda env: TransformReward(env, lambda reward: 2 * reward)
    )
    assert wrapped.batch is None


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


def test_a_wall_of_the_maze_stops_the_ball() -> None:
    env = point_maze.SPEC.make()
    obs, _ = env.reset(seed=0)
    for _ in range(point_maze.HORIZON):
        before, act = obs, np.array([0.0, 1.0], np.float32)
        obs, reward, *_ = env.step(act)
    assert point_maze.HEIGHT - 0.1 < obs[1] < point_maze.HEIGHT
    away = np.linalg.norm(before[:2] - point_maze.TARGET)
    assert reward == pytest.approx(-away - point_maze.ENERGY)


def test_balls_are_circles_and_the_ground_has_a_mark_each_metre() -> None:
    env: Any = REACHER.make()
    env.reset(seed=0)
    tip = env.unwrapped.model.geom("fingertip")
    from_centre = REACHER.draw(env)["fingertip"].points - env.unwrapped.data.geom_xpos[tip.id][:2]
    np.testing.assert_allclose(np.hypot(*from_centre.T), float(tip.size[0]))
    env = HOPPER.make()
    env.reset(seed=0)
    env.unwrapped.data.qpos[0] = 2.3
    ticks = HOPPER.draw(env)["ground"].points[::3, 0]
    np.testing.assert_allclose(ticks, np.arange(-1, 7) - 2.3)
