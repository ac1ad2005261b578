import math
from dataclasses import replace

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from hypothesis import given, settings
from hypothesis import strategies as st

from envs.gridworld import ACTIONS, SPEC, WORLD, GridWorld, ObjectWorld, grid, objectworld, transitions
from envs.models import Model, Tabular

RIGHT, UP, LEFT, DOWN, STAY = range(5)


def test_moves_and_walls_without_slip() -> None:
    """States 2 and 3 lie above 0 and 1."""
    after = transitions(2, 0.0).argmax(axis=2)
    assert after[:, RIGHT].tolist() == [1, 1, 3, 3]
    assert after[:, UP].tolist() == [2, 3, 2, 3]
    assert after[:, LEFT].tolist() == [0, 0, 2, 2]
    assert after[:, DOWN].tolist() == [0, 1, 0, 1]
    assert after[:, STAY].tolist() == [0, 1, 2, 3]
    assert transitions(2, 0.0).max(axis=2).min() == 1


def test_slip_by_hand() -> None:
    """From the bottom left corner, `right`: 0.7 + 0.3/5 to go right, 0.3/5 to go up, the rest stays."""
    np.testing.assert_allclose(transitions(2, 0.3)[0, RIGHT], [0.18, 0.76, 0.06, 0.0], atol=1e-15)


def test_a_slip_of_one_makes_actions_equal() -> None:
    model = transitions(3, 1.0)
    np.testing.assert_allclose(model, np.broadcast_to(model[:, :1], model.shape))


def transition_by_other_action(chance: float) -> np.ndarray:
    """(9, 5, 9): with this probability one of the other four actions."""
    sure = transitions(3, 0.0)
    others = (sure.sum(axis=1, keepdims=True) - sure) / 4
    return (1 - chance) * sure + chance * others


def test_slip_of_0375_is_the_papers_chance_of_another_action() -> None:
    np.testing.assert_allclose(transitions(3, 0.375)[4], transition_by_other_action(0.3)[4])


@settings(deadline=None)
@given(st.integers(2, 7), st.floats(0, 1))
def test_rows_are_distributions_over_the_cell_and_its_neighbours(size: int, slip: float) -> None:
    model = transitions(size, slip)
    assert model.shape == (size**2, len(ACTIONS), size**2)
    np.testing.assert_allclose(model.sum(axis=2), 1, atol=1e-12)
    y, x = np.divmod(np.arange(size**2), size)
    steps = np.abs(x[:, None] - x) + np.abs(y[:, None] - y)
    assert (model.max(axis=1)[steps > 1] == 0).all()


def test_grid_rewards_one_corner_and_marks_each_state() -> None:
    world = grid(3, 0.1)
    assert world.obs.tolist() == [[x, y] for y in (-1, 0, 1) for x in (-1, 0, 1)]
    assert world.reward.tolist() == [0.0] * 8 + [1.0]
    assert np.array_equal(world.features, np.eye(9))
    assert world.start.sum() == pytest.approx(1)


def naive_distance(world: ObjectWorld, size: int, state: int, colours: np.ndarray, colour: int) -> float:
    found = [
        math.dist(divmod(state, size), divmod(int(cell), size))
        for cell, its in zip(world.cells, colours, strict=True)
        if its == colour
    ]
    return min(found, default=math.sqrt(2) * size)


@settings(deadline=None, max_examples=30)
@given(st.integers(2, 8), st.integers(1, 8), st.integers(2, 4), st.integers(0, 2**32))
def test_objectworld_recomputed_object_by_object(size: int, objects: int, colours: int, seed: int) -> None:
    objects = min(objects, size**2)
    world = objectworld(size, objects, colours, 0.3, np.random.default_rng(seed))
    assert len(set(world.cells.tolist())) == objects
    for state in range(size**2):
        distances = [
            naive_distance(world, size, state, kind, colour)
            for kind in (world.inner, world.outer)
            for colour in range(colours)
        ]
        if distances[colours] >= 3:
            assert world.reward[state] == 0
        else:
            assert world.reward[state] == (1 if distances[colours + 1] < 2 else -1)
        y, x = divmod(state, size)
        place = [2 * x / (size - 1) - 1, 2 * y / (size - 1) - 1]
        scaled = [2 * d / (math.sqrt(2) * size) - 1 for d in distances]
        np.testing.assert_allclose(world.obs[state], [*place, *scaled], atol=1e-7)
        expected = [float(d < limit) for d in distances for limit in range(1, size + 1)]
        assert world.features[state].tolist() == expected


def test_objectworld_of_the_papers_size() -> None:
    world = objectworld(32, 51, 2, 0.375, np.random.default_rng(0))
    assert (world.obs.shape, world.features.shape) == ((1024, 2 + 4), (1024, 128))
    assert set(world.reward) == {-1.0, 0.0, 1.0}


def test_discrete_features_determine_the_reward() -> None:
    world = objectworld(12, 10, 3, 0.3, np.random.default_rng(1))
    rewards: dict[bytes, set[float]] = {}
    for features, reward in zip(world.features, world.reward, strict=True):
        rewards.setdefault(features.tobytes(), set()).add(float(reward))
    assert max(len(values) for values in rewards.values()) == 1


@pytest.mark.parametrize(
    ("size", "objects", "colours", "slip", "names"),
    [
        (1, 1, 2, 0.3, "size"),
        (3, 1, 2, -0.1, "slip"),
        (3, 1, 2, math.nan, "slip"),
        (3, 0, 2, 0.3, "objects"),
        (3, 10, 2, 0.3, "objects"),
        (3, 3, 1, 0.3, "colours"),
    ],
)
def test_objectworld_refuses(size: int, objects: int, colours: int, slip: float, names: str) -> None:
    with pytest.raises(ValueError, match=names):
        objectworld(size, objects, colours, slip, np.random.default_rng(0))


@pytest.mark.parametrize(
    ("changes", "names"),
    [
        ({"P": np.ones((4, 5, 3)) / 3}, "P must be"),
        ({"P": np.zeros((4, 0, 4))}, "P must be"),
        ({"P": np.ones((4, 5, 4)) / 3}, "P must hold"),
        ({"P": np.full((4, 5, 4), math.nan)}, "P must hold"),
        ({"P": np.tile([2.0, -1.0, 0.0, 0.0], (4, 5, 1))}, "P must hold"),
        ({"start": np.ones(4)}, "start must hold"),
        ({"start": np.ones(3) / 3}, "S = 3"),
        ({"obs": np.ones((3, 2))}, "obs must be"),
        ({"obs": np.zeros((4, 0))}, "obs must be"),
        ({"obs": np.zeros((4, 2))}, "different in each state"),
        ({"obs": np.array([[0.1], [0.2], [0.3], [0.4]])}, "32-bit"),
        ({"obs": np.array([[0], [1], [2], [math.nan]])}, "32-bit"),
        ({"reward": np.array([0, 0, 0, math.inf])}, "finite"),
        ({"reward": np.zeros((4, 5))}, r"\(S,\)"),
        ({"features": np.full((4, 2), 1.01)}, "features must lie"),
        ({"features": np.full((4, 2), math.nan)}, "features must lie"),
        ({"features": np.ones((3, 2))}, "features must be"),
    ],
)
def test_tabular_refuses(changes: dict[str, np.ndarray], names: str) -> None:
    with pytest.raises(ValueError, match=names):
        replace(grid(2, 0.3), **changes)


@pytest.mark.parametrize("name", ["P", "start", "obs", "reward", "features"])
def test_tabular_is_read_only(name: str) -> None:
    with pytest.raises(ValueError, match="read-only"):
        vars(grid(2, 0.3))[name].flat[0] = 1


def test_states_are_those_whose_observation_is_nearest() -> None:
    rng = np.random.default_rng(0)
    order = rng.permutation(len(WORLD.obs))
    assert WORLD.states(WORLD.obs[order]).tolist() == order.tolist()
    seen = rng.uniform(-1.5, 1.5, (300, WORLD.obs.shape[1]))
    distances = np.linalg.norm(seen[:, None] - WORLD.obs, axis=2)
    assert WORLD.states(seen).tolist() == distances.argmin(axis=1).tolist()


def test_a_model_tells_no_reward() -> None:
    model = WORLD.model
    assert type(model) is Model
    assert set(vars(model)) == {"P", "start", "obs"}
    for name, array in vars(model).items():
        assert array is vars(WORLD)[name]


def test_features_of_the_task_are_those_of_the_state_observed() -> None:
    env = SPEC.make()
    obs, info = env.reset(seed=3)
    rng = np.random.default_rng(0)
    for act in SPEC.random_actions(SPEC.horizon, rng):
        features = SPEC.features(obs.astype(np.float64)[None], act[None])
        assert features.tolist() == [WORLD.features[info["state"]].tolist()]
        obs, *_, info = env.step(SPEC.native(act))


def test_drawings_show_what_cells_pay_and_where_the_agent_is() -> None:
    env = SPEC.make()
    rng = np.random.default_rng(0)
    env.reset(seed=0)
    for act in SPEC.random_actions(20, rng):
        _, reward, *_, info = env.step(SPEC.native(act))
        scene = SPEC.draw(env)
        where = scene["agent"].points[:-1].mean(axis=0)
        y, x = divmod(info["state"], 12)
        np.testing.assert_allclose(where, [x, y], atol=1e-12)
    del scene["agent"]
    assert len(scene) == 144
    for state, reward in enumerate(WORLD.reward):
        y, x = divmod(state, 12)
        red, green, _ = scene[f"cell_{x}_{y}"].colour
        assert np.sign(green - red) == reward
        np.testing.assert_allclose(scene[f"cell_{x}_{y}"].points[:-1].mean(axis=0), [x, y], atol=1e-12)


def test_env_passes_gymnasiums_checks() -> None:
    for world in (objectworld(5, 4, 2, 0.3, np.random.default_rng(0)), grid(5, 0.3)):
        check_env(GridWorld(world), skip_render_check=True)


def play(env: GridWorld, seed: int, steps: int) -> list[tuple[int, float]]:
    """States and rewards under actions drawn from the same seed."""
    env.reset(seed=seed)
    rng = np.random.default_rng(seed)
    seen = []
    for _ in range(steps):
        before = env.state
        obs, reward, terminated, truncated, info = env.step(rng.integers(5))
        assert (terminated, truncated) == (False, False)
        assert info["state"] == env.state
        assert reward == env.tabular.reward[before]
        assert obs.dtype == np.float32
        assert np.array_equal(obs, env.tabular.obs[env.state])
        seen.append((env.state, reward))
    return seen


def test_episodes_follow_from_the_seed() -> None:
    world = objectworld(5, 6, 2, 0.3, np.random.default_rng(0))
    assert play(GridWorld(world), 1, 200) == play(GridWorld(world), 1, 200)
    assert play(GridWorld(world), 1, 200) != play(GridWorld(world), 2, 200)


def test_without_slip_the_env_goes_where_it_is_told() -> None:
    corner = np.eye(9)[0]
    env = GridWorld(Tabular(**{**vars(grid(3, 0.0)), "start": corner}))
    assert env.reset(seed=0)[1] == {"state": 0}
    path = [env.step(np.int64(a)) for a in (RIGHT, RIGHT, RIGHT, UP, UP, STAY, LEFT)]
    assert [info["state"] for *_, info in path] == [1, 2, 2, 5, 8, 8, 7]
    assert [reward for _, reward, *_ in path] == [0, 0, 0, 0, 0, 1, 1]


def test_the_env_slips_as_its_model_says() -> None:
    env = GridWorld(grid(3, 0.5))
    env.reset(seed=0)
    counts = np.zeros(9)
    for _ in range(4000):
        env.state = 4
        env.step(np.int64(RIGHT))
        counts[env.state] += 1
    np.testing.assert_allclose(counts / 4000, env.tabular.P[4, RIGHT], atol=0.03)
