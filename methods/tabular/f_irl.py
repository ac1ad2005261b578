"""f-IRL where the model is known: descent of the divergence by its exact gradient, also for stochastic
dynamics, which the paper's theorem excludes."""

import numpy as np
import torch

from envs.models import Model
from methods.base import Array, Episodes, Learned, Rng, World
from methods.network import ADAM
from methods.tabular import model as mdp
from methods.tabular.model import TabularReward, demonstrated


def fit(demos: Episodes, world: World, model: Model, rng: Rng, steps: int, rate: float) -> Learned:
    """Descend the divergence by `steps` of Adam at this `rate`, and solve for pi*."""
    density = demonstrated(demos, model).sum(axis=(0, 2))
    density /= density.sum()
    r = torch.zeros(len(density), dtype=torch.float64, requires_grad=True)
    optimizer = torch.optim.Adam([r], rate, **ADAM)
    losses: list[float] = []
    for _ in range(steps):
        divergence, gradient = forward_divergence(
            model, r.detach().numpy(), density, world.horizon, world.gamma
        )
        r.grad = torch.as_tensor(gradient)
        optimizer.step()
        losses.append(divergence)
    values = np.repeat(r.detach().numpy()[:, None], model.P.shape[1], axis=1)
    reward = TabularReward(model.obs, values)
    return Learned(world.solve(reward, rng, world.solve_steps), reward, {"divergence": losses})


def forward_divergence(
    model: Model, r: Array, expert: Array, horizon: int, gamma: float
) -> tuple[float, Array]:
    """Return KL(rho_E || rho) and its gradient by the reward r (S,), (S,).

    `expert` (S,): rho_E, which sums to 1. rho is the density of states of the soft policy of r up to the
    horizon.
    """
    _, policies = mdp.finite_soft_value_iteration(model.P, r, horizon, gamma)
    visits = mdp.state_visitations(model.P, policies, model.start, horizon)
    rho, shown = visits.mean(axis=0), expert > 0
    divergence = float(expert[shown] @ np.log(expert[shown] / rho[shown]))
    change = np.divide(-expert, horizon * rho, out=np.zeros_like(rho), where=shown)
    gains = action_gains(model, policies, change)
    P = model.P.reshape(-1, len(r))
    # An action's soft value at each time counts for the action itself and for those before it.
    gradient, carried = np.zeros_like(r), np.zeros_like(r)
    for t in range(horizon):
        weights = (visits[t, :, None] * gains[t] + carried[:, None]) * policies[t]
        gradient += weights.sum(axis=1)
        carried = gamma * (weights.reshape(-1) @ P)
    return divergence, gradient


def action_gains(model: Model, policies: Array, change: Array) -> Array:
    """Return by how much each action changes the divergence later on, compared with its policy, (T, S, A).

    `change` (S,): change of the divergence by one more visit to each state. `policies`: (T, S, A).
    """
    P, later = model.P.reshape(-1, len(change)), np.zeros_like(policies)
    for t in reversed(range(len(policies) - 1)):
        onward = change + (policies[t + 1] * later[t + 1]).sum(axis=1)
        later[t] = (P @ onward).reshape(later[t].shape)
    return np.asarray(later - (policies * later).sum(axis=2, keepdims=True))
