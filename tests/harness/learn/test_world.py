"""The world counts what it is asked for and hides its reward; controls and scores are what they claim."""

from __future__ import annotations

import contextlib
import dataclasses
import math
from types import FunctionType
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from envs import EnvSpec
from envs.learners import DDPG, PPO, SAC, Learner
from envs.learners import soft as learner_of
from envs.spec import Model, Tabular
from harness.judge.controls import control_reward
from harness.judge.evaluation import evaluate
from harness.judge.results import CONTROLS
from harness.learn.exact import ExactSolver
from harness.learn.rl import Agent
from harness.learn.simulator import Simulator, Trajectory
from harness.learn.world import TaskWorld, without_rewards
from harness.registry import ENVS, SPECS
from methods.base import Array, Episodes, Learned, Reward, Transitions, default_absorbing
from methods.csil import CSIL
from methods.gaussian import SquashedGaussian
from methods.network import Network
from methods.rewards import Constant
from methods.settings import settings_for
from tests.harness.rewards import Nothing, Seek

ZERO = Nothing()


def on_target(obs: Array) -> Array:
    return obs


def off_target(obs: Array) -> Array:
    return -np.sign(obs)


def uniform(count: int, generator: np.random.Generator) -> Array:
    return generator.uniform(-1, 1, (count, 2))


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_it_counts_steps_and_solves(steady: EnvSpec) -> None:
    world = TaskWorld(steady, "absorbing", "sb3")
    world.rollout(on_target, 3, rng())
    assert (world.env_steps, world.check_steps, world.rl_solves) == (30, 0, 0)
    # So short a solve checks one episode of ten steps before it learns and at its end.
    world.solve(ZERO, rng(), 40)
    assert (world.env_steps, world.check_steps, world.rl_solves) == (30 + 40, 20, 1)
    agent = world.agent(rng())
    agent.learn(20, ZERO)
    agent.learn(20, ZERO)
    assert (world.env_steps, world.check_steps, world.rl_solves) == (30 + 80, 20, 3)
    agent.best(ZERO)
    assert (world.env_steps, world.check_steps, world.rl_solves) == (30 + 80, 40, 3)


def test_short_episodes_count_what_they_took(fragile: EnvSpec) -> None:
    world = TaskWorld(fragile, "native", "sb3")
    episodes = world.rollout(off_target, 4, rng())
    assert world.env_steps == 4
    assert episodes.terminated == (True,) * 4


def test_a_solve_starts_anew(steady: EnvSpec) -> None:
    def solve(world: TaskWorld, seed: int) -> Network:
        policy = world.solve(ZERO, rng(seed), 40)
        assert isinstance(policy, Network)
        return policy

    world, obs = TaskWorld(steady, "absorbing", "sb3"), np.linspace(-0.8, 0.8, 9)[:, None]
    first = solve(world, 0)(obs)
    # Under a constant reward learning stands still, and the first actor of a solve is the one returned.
    np.testing.assert_array_equal(solve(world, 0)(obs), first)
    assert (solve(world, 1)(obs) != first).any()
    agent = world.agent(rng(0))
    agent.learn(40, ZERO)
    np.testing.assert_array_equal(agent.best(ZERO)(obs), first)


def test_what_an_agent_has_seen_is_a_copy_without_rewards(fragile: EnvSpec) -> None:
    agent = TaskWorld(fragile, "absorbing", "sb3").agent(rng())
    with pytest.raises(ValueError, match="has seen nothing"):
        agent.replay()
    with pytest.raises(ValueError, match="has no best policy"):
        agent.best(ZERO)
    agent.learn(40, ZERO)
    seen = agent.replay()
    assert len(seen) == 40
    seen.obs[:] = 7.0
    assert np.abs(agent.replay().obs).max() < 1


def test_an_agent_begins_with_what_its_method_gives_it(steady: EnvSpec) -> None:
    spec = dataclasses.replace(steady, rl=SAC(net=()))
    world = TaskWorld(spec, "absorbing", "sb3")
    network = Network(np.zeros(1), np.ones(1), (np.array([[0.5, -0.2]]),), (np.array([0.1, -1.0]),))
    init = SquashedGaussian(network)
    demos = world.rollout(on_target, 3, rng())
    agent = world.agent(rng(), init=init, demonstrations=demos)
    seen: list[Transitions] = []
    agent.learn(40, lambda steps: seen.append(steps) or np.zeros(len(steps)))
    # The demonstrations were paid, and are no steps of the agent's own.
    assert (world.env_steps, world.rl_solves) == (30 + 40, 1)
    (shown,) = (steps for steps in seen if steps.demonstrated.any())
    np.testing.assert_array_equal(shown.obs, demos.pairs()[0])
    assert shown.demonstrated.all()
    still = world.agent(rng(), init=init)
    still.learn(40, Constant(0.0, 0.0))
    obs, act = demos.pairs()
    np.testing.assert_allclose(still.policy(obs), init.mean(obs), atol=1e-6)
    np.testing.assert_allclose(still.behaviour.log_prob(obs, act), init.log_prob(obs, act), atol=1e-4)


def test_where_the_model_is_known_an_agent_begins_with_nothing() -> None:
    world = TaskWorld(SPECS["gridworld"], "absorbing", "sb3")
    policy = world.solve(ZERO, rng(), 1)
    given: dict[str, Any]
    for given in ({"init": policy}, {"demonstrations": world.rollout(policy, 1, rng())}):
        with pytest.raises(ValueError, match="model is known"):
            world.agent(rng(), **given)
    with pytest.raises(ValueError, match="nothing is explored"):
        world.agent(rng()).behaviour  # noqa: B018


def test_rollouts_are_fresh_episodes_without_rewards(steady: EnvSpec) -> None:
    world, generator = TaskWorld(steady, "absorbing", "sb3"), rng()
    one, other = (world.rollout(on_target, 2, generator) for _ in range(2))
    fields = {f.name for f in dataclasses.fields(one)}
    assert fields == {"obs", "act", "terminated", "times", "steps"}
    assert len({obs.tobytes() for obs in (*one.obs, *other.obs)}) == 4
    again = world.rollout(on_target, 2, rng())
    np.testing.assert_array_equal(again.obs[0], one.obs[0])


def test_what_it_shows_of_the_task_is_no_reward(steady: EnvSpec) -> None:
    public = {
        name: value for name, value in vars(TaskWorld(steady, "absorbing", "sb3")).items() if name[0] != "_"
    }
    assert set(public) == {
        *("obs_size", "act_size", "horizon", "gamma", "phi", "model"),
        *("env_steps", "check_steps", "rl_solves"),
    }
    assert public.pop("model") is None
    assert all(isinstance(value, int | float) for name, value in public.items() if name != "phi")


def test_random_actions_are_the_environments(steady: EnvSpec) -> None:
    for spec in (steady, SPECS["gridworld"]):
        found = TaskWorld(spec, "absorbing", "sb3").random_actions(9, rng())
        np.testing.assert_array_equal(found, spec.random_actions(9, rng()))


def test_what_it_shows_of_a_known_model_is_no_reward() -> None:
    world = TaskWorld(SPECS["gridworld"], "absorbing", "sb3")
    assert type(world.model) is Model
    assert set(vars(world.model)) == {"P", "start", "obs"}
    policy: Any = world.solve(ZERO, rng(), 1)
    assert set(vars(policy)) == {"obs", "values"}


def reachable(start: list[Any]) -> list[Any]:
    """All that public names, items and what arrays are views of lead to, the objects of bound methods too."""
    found, waiting = {id(thing): thing for thing in start}, list(start)
    while waiting:
        thing = waiting.pop()
        inside: list[Any] = []
        if isinstance(thing, np.ndarray):
            inside = [thing.base]
        elif isinstance(thing, dict | list | tuple | set):
            inside = [*(thing.values() if isinstance(thing, dict) else thing)]
        elif not isinstance(thing, type | type(math) | FunctionType | str | int | float):
            for name in (name for name in dir(thing) if name[0] != "_"):
                with contextlib.suppress(AttributeError, ValueError):
                    inside.append(getattr(thing, name))
        for one in inside:
            if id(one) not in found:
                found[id(one)] = one
                waiting.append(one)
    return list(found.values())


@pytest.mark.parametrize("env", ["steady", "gridworld"])
def test_no_public_path_leads_a_method_to_the_true_reward(env: str, steady: EnvSpec) -> None:
    spec = steady if env == "steady" else SPECS[env]
    world = TaskWorld(spec, "absorbing", "sb3")
    policy = world.solve(ZERO, rng(), 20)
    agent = world.agent(rng())
    agent.learn(20, ZERO)
    found = reachable([world, policy, agent, agent.best(ZERO), world.rollout(policy, 2, rng())])
    assert len(found) > 20
    forbidden = (EnvSpec, Tabular, gym.Env, Trajectory, Simulator, Agent, ExactSolver)
    assert [type(thing) for thing in found if isinstance(thing, forbidden)] == []
    if spec.tabular:
        rewards = spec.tabular.reward
        assert not any(np.shares_memory(x, rewards) for x in found if isinstance(x, np.ndarray))


def test_in_a_known_model_a_solve_takes_no_steps() -> None:
    world = TaskWorld(SPECS["gridworld"], "absorbing", "sb3")
    policy = world.solve(ZERO, rng(), 1000)
    agent = world.agent(rng())
    agent.learn(1000, ZERO)
    assert agent.policy(SPECS["gridworld"].tabular.obs).shape == (144, 5)  # type: ignore[union-attr]
    with pytest.raises(ValueError, match="nothing is seen"):
        agent.replay()
    assert (world.env_steps, world.check_steps, world.rl_solves) == (0, 0, 2)
    episodes = world.rollout(policy, 3, rng())
    assert world.env_steps == 3 * 50
    assert episodes.terminated == (False,) * 3
    np.testing.assert_array_equal(episodes.act[0], policy(episodes.obs[0][:-1]))


def test_what_a_method_sees_of_a_trajectory_is_a_copy() -> None:
    trajectory = Trajectory(np.zeros((3, 1)), np.zeros((2, 1)), np.ones(2), True, "missed")
    episodes = without_rewards([trajectory])
    trajectory.obs[:] = 7.0
    trajectory.act[:] = 7.0
    assert (episodes.obs[0] == 0).all()
    assert (episodes.act[0] == 0).all()
    assert episodes.terminated == (True,)


def demonstrations(terminated: bool = False) -> Episodes:
    generator = rng(5)
    count = 200
    return Episodes(
        tuple(generator.normal(3, 2, (11, 3)) for _ in range(count)),
        tuple(generator.uniform(-0.2, 0.2, (10, 2)) for _ in range(count)),
        (terminated,) * count,
    )


def control(name: str, demos: Episodes | None = None, seed: int = 0) -> Any:
    def draw() -> Episodes:
        assert demos is not None, "constants need no demonstrations"
        return demos

    def fit(method: str, demos: Episodes) -> Learned:
        return Learned(lambda obs: np.full((len(obs), 2), 0.1), ZERO)

    return control_reward(name, draw, fit, uniform, rng(seed))


def test_constant_controls() -> None:
    batch = np.zeros((4, 3)), np.zeros((4, 2)), np.zeros((4, 3))
    for name, alive, absorbing in (
        ("control_plus1", 1.0, 1.0),
        ("control_minus1", -1.0, -1.0),
        ("control_survival", 0.0, -1.0),
    ):
        reward = control(name)
        assert isinstance(reward, Reward)
        np.testing.assert_array_equal(reward(*batch), np.full(4, alive))
        assert reward.absorbing == absorbing


def test_the_true_control_is_the_environments_own_reward() -> None:
    assert control("control_true") is None


def test_every_control_of_the_leaderboard_has_a_reward() -> None:
    for name in CONTROLS:
        assert (control(name, demonstrations()) is None) is (name == "control_true")


@pytest.mark.parametrize("seed", range(3))
def test_the_untrained_control_pays_nothing_on_average_above_absorption(seed: int) -> None:
    demos = demonstrations()
    reward = control("control_untrained", demos, seed)
    obs = np.tile(demos.pairs()[0], (10, 1))
    above = reward(obs, rng(9).uniform(-1, 1, (len(obs), 2)), obs) - reward.absorbing
    assert above.std() > 1e-3
    # The absorbing value was estimated from 2000 pairs.
    assert abs(above.mean()) < 4 * above.std() / np.sqrt(2000)


def test_the_untrained_control_of_demonstrations_that_terminate() -> None:
    demos = demonstrations(terminated=True)
    reward = control("control_untrained", demos)
    obs, act = demos.pairs()
    assert reward.absorbing == pytest.approx(reward(obs, act, obs).mean())
    assert reward.absorbing == default_absorbing(reward, demos, uniform, rng())


def test_the_untrained_control_of_choices_averages_over_choices() -> None:
    spec, generator = SPECS["gridworld"], rng(5)
    obs = tuple(generator.normal(size=(51, spec.obs_size)) for _ in range(40))
    demos = Episodes(obs, tuple(np.tile(np.eye(5)[2], (50, 1)) for _ in obs), (False,) * 40)
    reward: Any = control_reward("control_untrained", lambda: demos, never, spec.random_actions, rng())
    at = demos.pairs()[0]
    each = np.stack([reward(at, np.tile(choice, (2000, 1)), at) for choice in np.eye(5)])
    assert abs(each.mean() - reward.absorbing) < 4 * each.std(axis=0).mean() / np.sqrt(2000)
    assert abs(each[2].mean() - reward.absorbing) > 8 * each.std(axis=0).mean() / np.sqrt(2000)


def test_the_clone_control_pays_for_being_near_what_cloning_does() -> None:
    demos = demonstrations()
    reward = control("control_clone", demos)
    obs, act = demos.pairs()
    np.testing.assert_allclose(reward(obs, act, obs), -np.square(act - 0.1).sum(axis=1))
    np.testing.assert_array_equal(reward(obs, np.full((len(obs), 2), 0.1), obs), 0)
    assert reward.absorbing == default_absorbing(reward, demos, uniform, rng())
    asked: list[tuple[str, Episodes]] = []

    def fit(method: str, shown: Episodes) -> Learned:
        asked.append((method, shown))
        return Learned(lambda obs: np.zeros((len(obs), 2)), None)

    control_reward("control_clone", lambda: demos, fit, uniform, rng())
    assert asked == [("bc", demos)]


def never(method: str, demos: Episodes) -> Learned:
    raise AssertionError("this control imitates nobody")


def test_the_shuffled_control_imitates_actions_taken_elsewhere() -> None:
    generator = rng(5)
    demos = Episodes(
        tuple(generator.normal(size=(length + 1, 3)) for length in (100, 3, 40)),
        tuple(generator.uniform(-1, 1, (length, 2)) for length in (100, 3, 40)),
        (False, True, False),
    )
    seen: list[Episodes] = []

    def fit(method: str, shuffled: Episodes) -> Learned:
        assert method == "shaped"
        seen.append(shuffled)
        return Learned(on_target, ZERO)

    for seed in (0, 0, 1):
        assert control_reward("control_shuffled", lambda: demos, fit, uniform, rng(seed)) is ZERO
    one, same, other = (episodes.pairs()[1] for episodes in seen)
    assert seen[0].obs == demos.obs
    assert seen[0].terminated == demos.terminated
    act = demos.pairs()[1]
    assert (one == act).all(axis=1).mean() < 0.1
    np.testing.assert_array_equal(np.sort(one, axis=0), np.sort(act, axis=0))
    assert set(map(tuple, one)) == set(map(tuple, act))
    np.testing.assert_array_equal(one, same)
    assert (one != other).any()


def test_the_untrained_control_differs_by_seed() -> None:
    demos = demonstrations()
    one, same, other = (control("control_untrained", demos, seed) for seed in (0, 0, 1))
    obs, act = demos.pairs()
    np.testing.assert_array_equal(one(obs, act, obs), same(obs, act, obs))
    assert (one(obs, act, obs) != other(obs, act, obs)).any()


def test_returns_are_sums_of_true_rewards(steady: EnvSpec) -> None:
    scored = evaluate(steady, on_target, range(6))
    # Each of ten steps pays 1.
    np.testing.assert_allclose(scored.returns, 10)
    np.testing.assert_allclose(scored.discounted, (1 - 0.9**10) / (1 - 0.9))
    assert scored.lengths.tolist() == [10.0] * 6
    assert scored.endings == {"time limit": 6}
    assert scored.columns() == {
        "episodes": 6,
        **{"return_mean": pytest.approx(10), "return_std": pytest.approx(0)},
        **{"discounted_mean": pytest.approx((1 - 0.9**10) / 0.1), "discounted_std": pytest.approx(0)},
        **{"length_mean": 10, "length_std": 0},
    }


def test_later_rewards_are_discounted_more(steady: EnvSpec) -> None:
    scored = evaluate(steady, lambda obs: 0 * obs, [3])
    rewards = 1 - np.abs(scored.first.obs[:-1, 0])
    np.testing.assert_allclose(scored.first.rewards, rewards, rtol=1e-6)
    assert scored.discounted[0] == pytest.approx(sum(0.9**t * r for t, r in enumerate(rewards)), rel=1e-6)


def test_returns_under_another_reward_are_counted_from_what_absorption_pays(fragile: EnvSpec) -> None:
    scored = evaluate(fragile, lambda obs: -0.2 * obs, range(30), Constant(2.0, absorbing=0.5))
    np.testing.assert_allclose(scored.own, 1.5 * scored.lengths)
    assert scored.columns()["own_return"] == pytest.approx(1.5 * scored.lengths.mean())
    endless = evaluate(fragile, lambda obs: -0.2 * obs, range(3), Constant(np.inf, absorbing=0.5))
    assert "own_return" not in endless.columns()


def test_endings_are_counted(fragile: EnvSpec) -> None:
    scored = evaluate(fragile, lambda obs: -0.2 * obs, range(30))
    assert set(scored.endings) <= {"missed", "time limit"}
    assert sum(scored.endings.values()) == 30
    assert scored.endings["missed"] >= (scored.lengths < 10).sum() > 10
    assert len(scored.first.obs) == scored.lengths[0] + 1
    columns = scored.columns()
    assert columns["length_std"] == pytest.approx(scored.lengths.std())
    assert columns["return_mean"] == pytest.approx(scored.returns.mean())


@pytest.mark.parametrize(
    ("own", "soft"),
    [
        (DDPG(net=(8,), tau=0.1, copies=5), SAC(net=(8,), tau=0.1, copies=5)),
        (PPO(net=(8,), check_episodes=3), SAC(net=(8,), n_steps=1, checkpoint_every=5000, check_episodes=3)),
        (SAC(net=(8,), entropy=0.1), SAC(net=(8,), entropy=0.1)),
    ],
)
def test_a_soft_agent_is_one_whatever_the_tasks_own_is(steady: EnvSpec, own: Learner, soft: SAC) -> None:
    given, asked = (
        TaskWorld(dataclasses.replace(steady, rl=learner), "absorbing", "sb3") for learner in (own, soft)
    )
    agents = given.agent(rng(), soft=True), asked.agent(rng())
    for agent in agents:
        agent.learn(40, Seek())
    obs = np.linspace(-0.8, 0.8, 9)[:, None]
    one, other = (agent.behaviour.sample(obs, rng(1)) for agent in agents)
    np.testing.assert_array_equal(one, other)
    assert len(agents[0].replay()) == 40


def test_where_actions_are_choices_a_soft_agent_is_the_tasks_own() -> None:
    world = TaskWorld(SPECS["cartpole_discrete"], "absorbing", "sb3")
    assert world.agent(rng(), soft=True)._solver.settings == SPECS["cartpole_discrete"].rl
    known = TaskWorld(SPECS["gridworld"], "absorbing", "sb3").agent(rng(), soft=True)
    known.learn(1, ZERO)
    assert known.best(ZERO)


@pytest.mark.parametrize("env", [name for name in ENVS if not SPECS[name].discrete])
def test_csil_clones_what_the_actor_can_begin_as(env: str) -> None:
    clone = settings_for("csil", env, "full").get("layers", CSIL.layers)
    assert clone == learner_of(SPECS[env].rl).net
