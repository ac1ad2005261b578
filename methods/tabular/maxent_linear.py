"""Linear maximum-entropy IRL where the model is known: the likelihood is concave in the weights, and L-BFGS
maximises it together with their prior."""

from dataclasses import dataclass

import numpy as np
from scipy import optimize

from methods.base import Array, Episodes, Learned, Rng, World
from methods.rewards import LinearReward
from methods.tabular.maxent import log_likelihood
from methods.tabular.model import demonstrated, known_model


@dataclass(frozen=True)
class TabularMaxEntLinear:
    """Hyper-parameters of `methods.maxent_linear.MaxEntLinear` where the model is known."""

    weight_prior: float = 1e-3
    """Inverse variance of the Gaussian prior on weights."""

    def fit(self, demos: Episodes, world: World, rng: Rng) -> Learned:
        """Maximise the posterior density of the weights."""
        model = known_model(world)
        states, actions = model.P.shape[:2]
        every = np.repeat(model.obs, actions, axis=0), np.tile(np.eye(actions), (states, 1))
        phi = world.phi(*every).reshape(states, actions, -1)
        mu_demo = demonstrated(demos, model)
        likelihoods: list[float] = []

        def loss(w: Array) -> tuple[float, Array]:
            likelihood, gradient = log_likelihood(model, phi @ w, mu_demo, world.gamma)
            likelihoods.append(likelihood)
            value = 0.5 * self.weight_prior * float(w @ w) - likelihood
            return value, self.weight_prior * w - np.tensordot(gradient, phi, axes=2)

        w = optimize.minimize(loss, np.zeros(phi.shape[2]), jac=True, method="L-BFGS-B").x
        reward = LinearReward(world.phi, np.append(w, 0.0))
        policy = world.solve(reward, rng, world.solve_steps)
        return Learned(policy, reward, {"log-likelihood of a step": likelihoods})
