"""AIRL where the model is known: descent on the discriminator's loss, with both densities exact."""

import numpy as np
import torch
from torch.nn.functional import softplus

from envs.models import Model
from methods.base import Array, Episodes, Learned, Rng, World
from methods.network import ADAM
from methods.tabular import model as mdp
from methods.tabular.model import TabularReward, demonstrated


def fit(
    demos: Episodes, world: World, model: Model, rng: Rng, actions: bool, steps: int, rate: float
) -> Learned:
    """Descend the loss, and solve for pi* under g. The options are those of `reward_and_potential`."""
    density = demonstrated(demos, model).sum(axis=0)
    expert = density / density.sum()
    g, _ = reward_and_potential(expert, model, world.gamma, world.horizon, actions, steps, rate)
    reward = TabularReward(model.obs, np.broadcast_to(g, density.shape))
    return Learned(world.solve(reward, rng, world.solve_steps), reward)


def reward_and_potential(
    expert: Array, model: Model, gamma: float, horizon: int, actions: bool, steps: int, rate: float
) -> tuple[Array, Array]:
    """Return g (S, A), or (S, 1) without `actions`, and h (S,).

    `expert` (S, A): the demonstrated density, which sums to 1. The other density is that of the soft policy
    of g in episodes of `horizon` steps. `steps`: gradient steps of Adam at this `rate`, each followed by a
    solve for the policy.
    """
    P = torch.tensor(model.P)
    rewards = torch.zeros(len(P), expert.shape[1] if actions else 1, dtype=P.dtype, requires_grad=True)
    potential = torch.zeros(len(P), dtype=P.dtype, requires_grad=True)
    optimizer = torch.optim.Adam([rewards, potential], rate, **ADAM)
    for _ in range(steps):
        policy, visits = soft_visits(model, rewards.detach().numpy(), expert.shape, gamma, horizon)
        own, shown = (torch.as_tensor(density)[..., None] * P for density in (visits, expert))
        f = rewards[..., None] + gamma * potential - potential[:, None, None]
        logit = f - torch.as_tensor(np.log(policy))[..., None]
        loss = (shown * softplus(-logit) + own * softplus(logit)).sum()
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()
    return rewards.detach().numpy(), potential.detach().numpy()


def soft_visits(
    model: Model, g: Array, shape: tuple[int, ...], gamma: float, horizon: int
) -> tuple[Array, Array]:
    """Return the soft policy of g and the density of its states and actions, each of `shape` (S, A)."""
    policy = mdp.soft_policy(mdp.soft_value_iteration(model.P, np.broadcast_to(g, shape), gamma)[1])
    visits = mdp.state_visitations(model.P, policy, model.start, horizon).mean(axis=0)
    return policy, visits[:, None] * policy
