"""The margin problem is the distance to a convex hull, which projections come near to."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from methods.base import Array
from methods.margins import max_margin, projection

POINTS = st.tuples(*[st.integers(-5, 5)] * 3).map(lambda p: np.array(p, float))


def test_one_policy_is_left_behind_along_the_difference() -> None:
    expert, found = np.array([1.0, 2.0, -1.0]), np.array([-2.0, 2.0, 3.0])
    w, t = max_margin(expert, [found])
    np.testing.assert_allclose(w, [3 / 5, 0, -4 / 5], atol=1e-5)
    assert t == pytest.approx(5, abs=1e-5)


def test_of_two_symmetric_policies_neither_is_favoured() -> None:
    w, t = max_margin(np.array([2.0, 0.0]), [np.array([0.0, 1.0]), np.array([0.0, -1.0])])
    np.testing.assert_allclose(w, [1, 0], atol=1e-5)
    assert t == pytest.approx(2, abs=1e-5)


@pytest.mark.parametrize(
    "found",
    [
        [[1, 0], [-1, 0], [0, 1], [0, -1]],
        [[0, 0]],
        [[2, 2], [-1, -1]],
    ],
    ids=["inside", "one of them", "between two"],
)
def test_an_expert_in_the_hull_cannot_be_told_apart(found: list[list[float]]) -> None:
    w, t = max_margin(np.zeros(2), [np.array(mu, float) for mu in found])
    assert t == pytest.approx(0, abs=1e-6)
    assert np.linalg.norm(w) <= 1 + 1e-6


@given(POINTS, POINTS, POINTS)
@settings(deadline=None, max_examples=30)
def test_the_margin_is_the_distance_to_the_segment_of_two(expert: Array, a: Array, b: Array) -> None:
    along = b - a
    share = np.clip((expert - a) @ along / max(along @ along, 1e-12), 0, 1)
    w, t = max_margin(expert, [a, b])
    assert t == pytest.approx(np.linalg.norm(expert - a - share * along), abs=1e-4)
    assert np.linalg.norm(w) <= 1 + 1e-6
    assert min((expert - mu) @ w for mu in (a, b)) == pytest.approx(t, abs=1e-4)


@pytest.mark.parametrize(
    ("found", "point"),
    [
        ([[2, 0]], [2, 0]),
        ([[2, 0], [0, 2]], [1, 1]),
        ([[2, 0], [0, 2], [-1, 0]], [-0.2, 0.4]),
        ([[2, 0], [3, 1]], [2, 0]),
        ([[2, 0], [1, 0]], [1, 0]),
        ([[2, 0], [2, 0], [2, 2]], [2, 0]),
        ([[2, 1], [-4, -2]], [0, 0]),
        ([[0, 0], [1, 1]], [0, 0]),
    ],
    ids=[
        "one",
        "two",
        "three",
        "not away",
        "not beyond",
        "twice the same",
        "reached",
        "there from the start",
    ],
)
def test_projections_by_hand(found: list[list[float]], point: list[float]) -> None:
    expert = np.array([5.0, -3.0])
    w, t = projection(expert, [expert + mu for mu in found])
    margin = np.linalg.norm(point)
    assert t == pytest.approx(margin, abs=1e-12)
    np.testing.assert_allclose(w, -np.array(point) / (margin or 1), atol=1e-12)


@given(POINTS, POINTS)
@settings(deadline=None, max_examples=30)
def test_of_one_policy_both_methods_say_the_same(expert: Array, mu: Array) -> None:
    assume((expert != mu).any())
    w, t = projection(expert, [mu])
    its_w, its_t = max_margin(expert, [mu])
    np.testing.assert_allclose(w, its_w, atol=1e-4)
    assert t == pytest.approx(its_t, abs=1e-4)


@given(POINTS, st.lists(POINTS, min_size=1, max_size=6))
@settings(deadline=None, max_examples=30)
def test_a_projection_lies_in_the_hull_and_comes_nearer_with_each_policy(
    expert: Array, found: list[Array]
) -> None:
    margins = []
    for count in range(1, len(found) + 1):
        w, t = projection(expert, found[:count])
        assert t >= max_margin(expert, found[:count])[1] - 1e-4
        assert np.linalg.norm(w) == pytest.approx(1 if t > 0 else 0)
        margins.append(t)
    assert margins[0] == pytest.approx(np.linalg.norm(expert - found[0]))
    assert (np.diff(margins) <= 1e-12).all()
