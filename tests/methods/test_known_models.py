"""Methods hand over to their tabular versions where the model is known."""

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from methods.airl import AIRL
from methods.base import Unsuitable
from methods.csil import CSIL
from methods.f_irl import FIRL
from methods.gail import GAIL
from methods.maxent import MaxEnt
from methods.maxent_linear import MaxEntLinear
from methods.maxmargin import MaxMargin
from methods.sqil import SQIL
from methods.tabular import tabular
from methods.tabular.adversarial import TabularGame
from methods.tabular.airl import TabularAIRL
from methods.tabular.csil import TabularCSIL
from methods.tabular.f_irl import TabularFIRL
from methods.tabular.maxent import TabularMaxEnt
from methods.tabular.maxent_linear import TabularMaxEntLinear
from methods.tabular.maxmargin import TabularMaxMargin
from methods.tabular.sqil import TabularSQIL

VERSIONS: list[tuple[Any, Any]] = [
    (AIRL, TabularAIRL),
    (CSIL, TabularCSIL),
    (FIRL, TabularFIRL),
    (GAIL, TabularGame),
    (MaxEnt, TabularMaxEnt),
    (MaxEntLinear, TabularMaxEntLinear),
    (MaxMargin, TabularMaxMargin),
    (SQIL, TabularSQIL),
]


@pytest.mark.parametrize(("method", "version"), VERSIONS)
def test_a_version_has_its_methods_hyper_parameters(method: Any, version: Any) -> None:
    assert tabular(version, method()) == version()
    first = fields(version)[0].name
    assert getattr(tabular(version, replace(method(), **{first: 3})), first) == 3


@pytest.mark.parametrize("version", [version for _, version in VERSIONS if hasattr(version, "fit")])
def test_a_version_refuses_tasks_whose_model_is_not_known(version: Any, world: Any) -> None:
    demos = world.rollout(lambda obs: obs[:, :2], 2, np.random.default_rng(0))
    with pytest.raises(Unsuitable, match="model is known"):
        version().fit(demos, world, np.random.default_rng(0))
