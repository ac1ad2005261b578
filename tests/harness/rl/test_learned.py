"""What a method must not return is named."""

from typing import Any

import numpy as np
import pytest

from envs import EnvSpec
from harness.rl.learned import check_learned
from methods.base import Episodes, Learned
from methods.rewards import Constant

DEMOS = Episodes((np.linspace(0, 0.5, 11)[:, None],), (np.full((10, 1), 0.5),), (False,))


def still(obs: np.ndarray) -> np.ndarray:
    return np.zeros((len(obs), 1))


def ones(obs: np.ndarray, act: np.ndarray, next_obs: np.ndarray) -> np.ndarray:
    return np.ones(len(obs))


class Odd:
    def __init__(self, absorbing: float, *shape: int) -> None:
        self.absorbing, self.shape = absorbing, shape

    def __call__(self, obs: np.ndarray, act: np.ndarray, next_obs: np.ndarray) -> np.ndarray:
        return np.ones((len(obs), *self.shape))


@pytest.mark.parametrize("reward", [None, Constant(1.0, absorbing=0.0)])
def test_what_a_method_must_return_passes(steady: EnvSpec, reward: Any) -> None:
    check_learned(Learned(still, reward), steady, DEMOS)


@pytest.mark.parametrize(
    ("learned", "error", "message"),
    [
        ((still, None), TypeError, "must return a Learned, not tuple"),
        (Learned(None, None), TypeError, "policy of what fit returns cannot be called"),  # type: ignore[arg-type]
        (Learned(still, 1.0), TypeError, "reward of what fit returns cannot be called"),  # type: ignore[arg-type]
        (Learned(still, ones), TypeError, "lacks `absorbing`"),  # type: ignore[arg-type]
        (Learned(still, Odd(np.nan)), ValueError, "one finite number"),
        (Learned(still, Odd(0.0, 1)), ValueError, "one number a step"),
        (Learned(lambda obs: still(obs)[:1], None), ValueError, "1 actions for 5 observations"),
        (Learned(lambda obs: still(obs) * np.nan, None), ValueError, "actions must be finite"),
        (Learned(lambda obs: still(obs) + 2, None), ValueError, r"lie in \[-1, 1\]"),
        (Learned(lambda obs: still(obs)[0], None), ValueError, "shape"),
    ],
)
def test_what_it_must_not_return_is_named(
    steady: EnvSpec, learned: Any, error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        check_learned(learned, steady, DEMOS)
