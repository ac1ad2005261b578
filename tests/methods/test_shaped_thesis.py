"""The thesis's model to the letter: Keras' step and first weights, figure 4.4, and both ends of the arms."""

from __future__ import annotations

from dataclasses import fields, replace
from itertools import pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from methods.base import Array, Episodes, Unsuitable
from methods.network import Network
from methods.settings import THESIS_ARMS
from methods.shaped import Shaped, ShapedReward, shaped_reward
from methods.shaped_thesis import Clipped, ShapedThesis, _epoch, batch_reward
from tests.methods.worlds import FakeWorld, demonstrate

WORLD = FakeWorld()
DEMOS = demonstrate(lambda obs: 0.5 * obs[:, :2], count=20)
KERAS = ShapedThesis(epochs=1)


class OneAction(FakeWorld):
    act_size = 1

    def random_actions(self, count: int, rng: np.random.Generator) -> Array:
        return rng.uniform(-1, 1, (count, 1))


def batch(size: int, seed: int = 0) -> tuple[Array, ...]:
    """Return actions, f(s) and L(s), (size, 1) each."""
    return tuple(np.random.default_rng(seed).normal(size=(3, size, 1)))


def test_a_step_is_that_of_keras_from_its_first_weights() -> None:
    """By hand, for one layer of one weight w and one bias, from their second step on."""
    rate, rho, epsilon = 1e-3, 0.9, 1e-8
    method = replace(KERAS, f_layers=(), l_layers=(), batch=1)
    obs, act = 2.0, np.array([0.7, -0.4])
    w, bias = 0.3, 0.0
    params: Any = (([np.full((1, 1), w)], [np.zeros(1)]), ([np.zeros((1, 1))], [np.zeros(1)]))
    params = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), params)
    state = (params, method._optimizer.init(params))
    mean_square = np.zeros(2)
    for a in act:
        d = a - (w * obs + bias)
        # |d| + d^2, since L stays 0 where it begins at 0
        gradient = -(np.sign(d) + 2 * d) * np.array([obs, 1.0])
        mean_square = rho * mean_square + (1 - rho) * gradient**2
        w, bias = np.array([w, bias]) - rate * gradient / (np.sqrt(mean_square) + epsilon)
        rows = jnp.array([[obs]]), jnp.array([[a]])
        state, _ = _epoch(method, state, rows, np.arange(1), np.ones(1, np.float32))
        (((weight,), (shift,)), _), _ = state
        assert [float(weight[0, 0]), float(shift[0])] == pytest.approx([w, bias], abs=1e-7)


def test_it_begins_with_glorots_uniform_weights_and_no_biases() -> None:
    reward = replace(KERAS, epochs=0).fit(DEMOS, WORLD, np.random.default_rng(0)).reward
    assert isinstance(reward, ShapedReward)
    for network, sizes in ((reward.f, (3, 32, 16, 2)), (reward.chol, (3, 32, 32, 4))):
        assert [weight.shape for weight in network.weights] == [*pairwise(sizes)]
        for weight, bias in zip(network.weights, network.biases, strict=True):
            bound = np.sqrt(6 / sum(weight.shape))
            assert 0.85 * bound < np.abs(weight).max() <= bound
            assert not bias.any()
        assert (network.mean, network.std) == (pytest.approx(0), pytest.approx(1))


@pytest.mark.parametrize("size", [1, 2, 7])
def test_figure_4_4_is_one_number_for_a_batch_and_equation_4_3_for_an_example(size: int) -> None:
    a, f, chol = batch(size)
    d = (a - f)[:, 0]
    by_hand = -(np.square(chol).sum() * d.sum() ** 2 + np.square(d).sum())
    found = batch_reward(np, a, f, chol)
    assert found.shape == (1, 1)
    assert found[0, 0] == pytest.approx(by_hand)
    pairs = shaped_reward(*map(jnp.asarray, (a, f, chol))).sum()  # type: ignore[arg-type]
    assert (float(pairs) == pytest.approx(by_hand, rel=1e-5)) == (size == 1)


def test_figure_4_4_fits_no_batch_of_two_actions() -> None:
    for size in (1, 2, 7):
        with pytest.raises(ValueError, match="broadcast"):
            batch_reward(np, np.ones((size, 2)), np.zeros((size, 2)), np.ones((size, 4)))
    with pytest.raises(Unsuitable, match="one action"):
        replace(KERAS, batch_matrix=True).fit(DEMOS, WORLD, np.random.default_rng(0))


def test_figure_4_4_learns_where_there_is_one_action() -> None:
    demos = replace(DEMOS, act=tuple(act[:, :1] for act in DEMOS.act))
    fits = [
        replace(KERAS, epochs=30, batch_matrix=literal).fit(demos, OneAction(), np.random.default_rng(0))
        for literal in (False, True)
    ]
    obs, act = demos.pairs()
    assert all(np.abs(fit.policy(obs) - act).mean() < 0.1 * np.abs(act).mean() for fit in fits)
    assert (fits[0].policy(obs) != fits[1].policy(obs)).any()


def test_an_epoch_sees_every_row_once() -> None:
    """Without a learning rate, the losses of batches are those of their rows, the short last one too."""
    method, rows = replace(KERAS, learning_rate=0.0, batch=4), (jnp.ones((10, 1)), jnp.arange(10.0)[:, None])
    params: Any = tuple(([jnp.zeros((1, 1))], [jnp.zeros(1)]) for _ in range(2))
    order = np.random.default_rng(0).permutation(10)
    state = (params, method._optimizer.init(params))
    losses = _epoch(method, state, rows, order, np.ones(1, np.float32))[1]
    parts = np.split(order.astype(float), [4, 8])
    np.testing.assert_allclose(losses, [(part + part**2).mean() for part in parts], rtol=1e-6)


def test_all_arms_but_figure_4_4_are_shaped() -> None:
    on = {name: value for arm, own in THESIS_ARMS.items() for name, value in own.items() if arm != "batch"}
    switches = {field.name for field in fields(ShapedThesis)} - {"epochs", "learning_rate", "epsilon"}
    assert switches - {"batch", "f_layers", "l_layers", "batch_matrix"} == on.keys()
    arms = ShapedThesis(**on | {"soap_steps": 30}).fit(DEMOS, WORLD, np.random.default_rng(3))
    shaped = Shaped(steps=30).fit(DEMOS, WORLD, np.random.default_rng(3))
    obs, act = DEMOS.pairs()
    assert isinstance(arms.policy, Network)
    np.testing.assert_array_equal(arms.policy(3 * obs), shaped.policy(3 * obs))
    assert arms.reward is not None
    assert shaped.reward is not None
    np.testing.assert_array_equal(arms.reward(obs, -act, obs), shaped.reward(obs, -act, obs))
    assert arms.reward.absorbing == shaped.reward.absorbing


@pytest.mark.parametrize("arm", [arm for arm in THESIS_ARMS if arm not in ("batch", "end")])
def test_each_arm_changes_the_fit(arm: str) -> None:
    def fitted(method: ShapedThesis) -> Any:
        return method.fit(DEMOS, WORLD, np.random.default_rng(0)).reward

    own, (obs, act) = THESIS_ARMS[arm], DEMOS.pairs()
    own = own | {"soap_steps": 20} if arm == "soap" else own
    before, after = fitted(KERAS), fitted(replace(KERAS, **own))
    assert (before(obs, -act, obs) != after(obs, -act, obs)).any()
    assert before.absorbing == after.absorbing == 0


def test_the_policy_is_clipped_and_the_reward_is_not() -> None:
    network = Network.of(np.zeros(1), np.ones(1), [[[3.0]]], [[0.0]])
    obs = np.array([[-1.0], [0.1], [1.0]])
    np.testing.assert_allclose(Clipped(network)(obs), [[-1], [0.3], [1]])
    flat = Network.of(np.zeros(1), np.ones(1), [[[0.0]]], [[0.0]])
    act = np.clip(network(obs), -1, 1)
    np.testing.assert_allclose(ShapedReward(network, flat)(obs, act, obs), [-4, 0, -4])


def test_only_a_default_end_pays_something() -> None:
    ends = [
        replace(KERAS, default_end=own).fit(DEMOS, WORLD, np.random.default_rng(0)).reward
        for own in (False, True)
    ]
    assert ends[0] is not None
    assert ends[1] is not None
    assert ends[0].absorbing == 0 > ends[1].absorbing
    assert isinstance(DEMOS, Episodes)
