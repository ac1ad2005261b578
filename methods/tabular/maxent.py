"""Maximum-entropy deep IRL where the model is known: algorithm 1 of Wulfmeier, Ondruska & Posner 2015.

The likelihood is that of maximum causal entropy up to the horizon (Ziebart, Bagnell & Dey 2010). It has the
discount of the task, because rewards that explain the demonstrations without one may be worth other journeys
with it.
"""

from collections.abc import Sequence

import numpy as np
import torch

from envs.models import Model
from methods.base import Array, Episodes, Learned, Rng, World
from methods.network import ADAM, Network, mlp, standardiser
from methods.rewards import StateReward
from methods.tabular.model import demonstrated, finite_soft_value_iteration, state_visitations


def fit(
    demos: Episodes,
    world: World,
    model: Model,
    rng: Rng,
    layers: Sequence[int],
    iterations: int,
    learning_rate: float,
) -> Learned:
    """Ascend the likelihood of the demonstrations. The lines of algorithm 1 are numbered.

    `layers`: hidden layers of the reward network, which sees states alone. `iterations`: gradient steps, each
    after an exact solve for the soft policy. `learning_rate`: that of Adam.
    """
    mean, std = standardiser(model.obs)
    generator = torch.Generator().manual_seed(int(rng.integers(1 << 31)))
    network = mlp(world.obs_size, *layers, 1, generator=generator)  # 1
    optimizer = torch.optim.Adam(network.parameters(), learning_rate, **ADAM)
    features = torch.as_tensor((model.obs - mean) / std, dtype=torch.float32)
    mu_demo = demonstrated(demos, model)
    likelihoods: list[float] = []
    for _ in range(iterations):  # 2
        r = network(features)[:, 0]  # 3
        likelihood, gradient = log_likelihood(model, r.detach().double().numpy(), mu_demo, world.gamma)
        optimizer.zero_grad()
        r.backward(-torch.as_tensor(gradient, dtype=torch.float32))  # 8
        optimizer.step()  # 9
        likelihoods.append(likelihood)
    reward = StateReward(Network.from_torch(network, mean, std))
    policy = world.solve(reward, rng, world.solve_steps)
    return Learned(policy, reward, {"log-likelihood of a step": likelihoods})


def log_likelihood(model: Model, r: Array, mu_demo: Array, gamma: float) -> tuple[float, Array]:
    """Return the mean log-likelihood of a demonstrated step under the reward r (S,) or (S, A), and its
    gradient mu_D - E[mu], of the shape of r.

    E[mu] starts where the demonstrations do. Chance may lead them elsewhere than the model expects, and E[mu]
    goes on from there, because the reward cannot explain luck. A discount gamma is a chance 1 - gamma at each
    step to go on from where the demonstrations are.
    """
    horizon = len(mu_demo)
    _, policies = finite_soft_value_iteration(model.P, r, horizon, gamma)  # 4
    arrivals = mu_demo.sum(axis=2)
    arrivals[1:] -= np.tensordot(mu_demo[:-1], gamma * model.P, axes=2)
    expected = state_visitations(gamma * model.P, policies, arrivals, horizon)  # 5
    shown = mu_demo > 0
    likelihood = float(mu_demo[shown] @ np.log(policies[shown]))  # 6
    gradient = (mu_demo - expected[:, :, None] * policies).sum(axis=0)  # 7
    return likelihood / horizon, (gradient if r.ndim == 2 else gradient.sum(axis=1)) / horizon
