"""Maximum margin where the model is known: exact solves and feature expectations, as in the paper."""

from dataclasses import dataclass

import numpy as np

from envs.models import Model
from methods.base import Array, Episodes, Learned, Policy, Rng, World
from methods.margins import Margins, discounts, feature_expectations
from methods.tabular.model import known_model, state_visitations


@dataclass(frozen=True)
class TabularMaxMargin(Margins):
    """Hyper-parameters of `methods.maxmargin.MaxMargin` where the model is known: the loop's."""

    def fit(self, demos: Episodes, world: World, rng: Rng) -> Learned:
        """Alternate weights and exact solves, with exact feature expectations."""
        model = known_model(world)

        def expectations(policy: Policy) -> Array:
            return exact_feature_expectations(policy, world, model)

        return self.alternate(
            feature_expectations(demos, world, world.phi), expectations, world.phi, world, rng
        )


def exact_feature_expectations(policy: Policy, world: World, model: Model) -> Array:
    """Return the limit of `feature_expectations` over infinitely many rollouts, (K + 1,)."""
    act = policy(model.obs)
    choices = np.eye(world.act_size)[act.argmax(axis=1)]
    visits = discounts(world) @ state_visitations(model.P, choices, model.start, world.horizon)
    return np.append(visits @ world.phi(model.obs, choices), 0.0)
