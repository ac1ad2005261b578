from functools import partial
from pathlib import Path
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
from envs.mujoco_batch import MujocoBatch, may_touch, twin
from harness.registry.contract.lockstep import assert_together_as_alone
from harness.registry.contract.tasks import checks
from harness.rl.simulator import Simulator


@pytest.fixture(autouse=True)
def _mujocos_log(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Goes to the working directory."""
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize(
    ("env_id", "ends"),
    [
        ("HalfCheetah-v5", False),
        ("Hopper-v5", True),
        ("Walker2d-v5", True),
        ("Reacher-v5", False),
        ("InvertedDoublePendulum-v5", True),
        ("Ant-v5", True),
        ("InvertedPendulum-v5", True),
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
    """It changes its model in each episode, and pays by what it keeps of MuJoCo's own memory."""

    def __init__(self, **given: Any) -> None:
        super().__init__(**given)
        self.lock, self.view, self.pay = Lock(), self.data.qpos, lambda: -abs(self.data.qpos[0])

    def reset_model(self) -> Any:
        self.model.opt.gravity[2] = -9.81 * self.np_random.uniform(0.2, 3.0)
        return super().reset_model()

    def step(self, action: Any) -> tuple:
        obs, _, *rest = super().step(action)
        return obs, self.view[0] + self.pay(), *rest


def made_by_a_function(**given: Any) -> gym.Env:
    env = InvertedPendulumEnv(**given)
    env.model.opt.gravity[2] = -9.81 * np.random.default_rng().uniform(0.2, 3.0)
    return env


@pytest.mark.parametrize("entry", [Other, made_by_a_function])
def test_tasks_that_others_derive_are_stepped_one_by_one(monkeypatch: pytest.MonkeyPatch, entry: Any) -> None:
    """Copies of them would share what each has of its own, or could not be made."""
    register(monkeypatch, "Other-v0", entry)
    spec = from_gymnasium("Other-v0", "x")
    assert spec.batch is None
    try_out(spec)


@pytest.mark.parametrize(
    "entry", [InvertedPendulumEnv, "gymnasium.envs.mujoco.inverted_pendulum_v5:InvertedPendulumEnv"]
)
def test_gymnasiums_class_under_another_name_has_a_batch(monkeypatch: pytest.MonkeyPatch, entry: Any) -> None:
    register(monkeypatch, "Same-v0", entry)
    assert from_gymnasium("Same-v0", "x").batch is not None


@pytest.mark.parametrize(("env_id", "touch"), [("Hopper-v5", True), ("Reacher-v5", False)])
def test_contacts_are_looked_for_where_there_may_be_any(env_id: str, touch: bool) -> None:
    env = gym.make(env_id).unwrapped
    assert isinstance(env, MujocoEnv)
    assert may_touch(env.model) == touch
    found = 0
    env.reset(seed=0)
    for act in np.random.default_rng(0).uniform(-1, 1, (300, env.model.nu)):
        env.step(act.astype(np.float32))
        found += env.data.ncon
    assert bool(found) == touch


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
