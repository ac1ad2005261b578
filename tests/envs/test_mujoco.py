"""MuJoCo's tasks are Gymnasium's, bit for bit, alone and in lockstep."""

from functools import partial
from threading import Lock
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.mujoco import MujocoEnv
from gymnasium.envs.mujoco.inverted_pendulum_v5 import InvertedPendulumEnv
from gymnasium.envs.registration import EnvSpec as Registered
from gymnasium.wrappers import TransformReward

from envs import EnvSpec, from_gymnasium
from envs.copies import try_out
from envs.mujoco_batch import MujocoBatch, twin
from envs.mujoco_tasks import DOUBLE_PENDULUM, HALFCHEETAH, HOPPER, REACHER, WALKER2D, WEAK
from envs.point_maze import HEIGHT, SPEC, TARGET, PointMaze
from harness.registry.contract.lockstep import assert_together_as_alone
from harness.registry.contract.tasks import checks
from harness.rl.simulator import Simulator


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


class Cut(InvertedPendulumEnv):
    """It truncates its episodes itself."""

    steps = 0

    def reset_model(self) -> Any:
        self.steps = 0
        return super().reset_model()

    def step(self, action: Any) -> tuple:
        self.steps += 1
        obs, reward, terminated, _, info = super().step(action)
        return obs, np.array([reward]), terminated, self.steps == 5, info


def register(monkeypatch: pytest.MonkeyPatch, env_id: str, entry: Any) -> None:
    registered = Registered(env_id, entry, max_episode_steps=100, disable_env_checker=True)
    monkeypatch.setitem(gym.registry, env_id, registered)


def test_it_truncates_where_the_task_does(monkeypatch: pytest.MonkeyPatch) -> None:
    register(monkeypatch, "Cut-v0", Cut)
    spec = from_gymnasium("Cut-v0", "x", batch=partial(MujocoBatch, "Cut-v0", EnvSpec.why_ended))
    episodes = Simulator(spec, lanes=2).run(lambda obs: np.zeros((len(obs), 1)), range(3))
    assert {(len(e.act), e.terminated, e.ending) for e in episodes} == {(5, False, "time limit")}
    assert all(check.outcome()[0] == "ok" for check in checks(spec) if "together" in check.title)


def test_what_it_is_made_with_reaches_the_batch_of_a_variant_too() -> None:
    spec = from_gymnasium(
        "Hopper-v5", "x", kwargs={"healthy_reward": 3.0}, variants={"slow": {"frame_skip": 2}}
    )
    assert_together_as_alone(spec, 50)
    assert_together_as_alone(spec.variant("slow"), 50)


def test_of_what_is_wrapped_otherwise_no_batch_is_known() -> None:
    def doubled(env: gym.Env) -> gym.Env:
        return TransformReward(env, lambda reward: 2 * reward)

    assert from_gymnasium("Reacher-v5", "x", wrap=doubled).batch is None
    gym.register("Doubled-v0", lambda: doubled(gym.make("Reacher-v5").unwrapped), max_episode_steps=50)
    assert from_gymnasium("Doubled-v0", "x").batch is None


class Other(InvertedPendulumEnv):
    """It changes its model in each episode, and holds what cannot be copied."""

    def reset_model(self) -> Any:
        self.lock = Lock()
        self.model.opt.gravity[2] = -9.81 * self.np_random.uniform(0.2, 3.0)
        return super().reset_model()


def test_tasks_that_others_derive_are_stepped_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Copies of them would share what each has of its own, or could not be made."""
    register(monkeypatch, "Other-v0", Other)
    spec = from_gymnasium("Other-v0", "x")
    assert spec.batch is None
    try_out(spec)


def test_a_twin_shares_the_model_and_nothing_that_changes() -> None:
    env = gym.make("Reacher-v5").unwrapped
    assert isinstance(env, MujocoEnv)
    env.reset(seed=0)
    env.memory = np.zeros(3)
    its = twin(env)
    assert its.model is env.model
    its.reset(seed=1)
    its.memory += 1
    assert not np.array_equal(its.data.qpos, env.data.qpos)
    assert not np.array_equal(its.goal, env.goal)
    assert (env.memory == 0).all()


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
