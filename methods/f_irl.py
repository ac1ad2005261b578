"""f-IRL (Ni et al. 2020), of the forward divergence: a reward of states whose soft policy visits what the
demonstrations visit. It descends the divergence of the two densities of states itself, whose gradient needs
no game: it is in proportion to a covariance over the policy's trajectories tau.

    grad KL(rho_E || rho) ~ -cov_tau(sum_t rho_E(s_t) / rho(s_t), sum_t grad r(s_t))     (theorem 4.1)

The ratio comes from a discriminator, and trajectories from what the agent explores with; those that are
demonstrated stand among them, as in the authors' code. Where the model is known the gradient is exact, also
where the dynamics are by chance, for which the theorem is not.

Deviates from the paper: only the gradient's direction counts, for its size is divided by the spread of the
trajectories' ratios; several steps go along each; the reward has a penalty on its slope instead of bounds, of
half the weight of the discriminator's, which has one as well; ratios have bounds (`LARGEST_LOG`);
the ratio is of the agent's latest steps, and so of slightly older policies too; where actions are choices the
policy is Q-learning's, which has no entropy; R* is the mean of all networks, for single ones swing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from envs.spec import Model
from methods.adversarial import Game, Turn, contrast_among_living
from methods.base import ABSORBING_STEPS, Array, Episodes, Learned, Transitions, World
from methods.network import ADAM, mlp
from methods.rewards import NetworkReward
from methods.tabular import TabularReward, finite_soft_value_iteration, state_visitations
from methods.visits import demonstrated, sample, visitations, visited

LARGEST_LOG = 5.0
"""Of the logarithm of a density ratio."""


@dataclass(frozen=True)
class FIRL(Game):
    """Its hyper-parameters, besides the game's; `rollouts` are also what estimates each gradient."""

    known_steps: int = 300
    """Where the model is known: steps of gradient descent."""
    known_rate: float = 3e-2
    """Of Adam there."""

    def fit(self, demos: Episodes, world: World, rng: np.random.Generator) -> Learned:
        """Descend the divergence."""
        if world.model is not None:
            return self._fit_exactly(demos, world, world.model, rng)
        mean, std, generator = self.standard(demos, world, rng)
        logit, network = (mlp(world.obs_size + 1, *self.layers, 1, generator=generator) for _ in range(2))
        discriminator = self.discriminator(logit, generator)
        optimizer = torch.optim.Adam(network.parameters(), self.learning_rate, **ADAM)
        shown = visitations(demos, ABSORBING_STEPS, mean, std, False)
        agent = world.agent(rng, kind="stochastic")
        losses: list[float] = []

        def turn() -> Turn:
            reward = NetworkReward.of(network, mean, std, actions=False)
            return Turn(reward, reward)

        def answer(seen: Transitions) -> Turn:
            losses.append(discriminator.tell(shown, visited(seen, mean, std, False), rng))
            behaviour = agent.behaviour
            own = world.rollout(lambda obs: behaviour.sample(obs, rng), self.rollouts, rng)
            each = [trajectory(one, mean, std) for one in (*separate(own), *separate(demos))]
            weighted = weigh(each, logit)
            for _ in range(self.reward_steps):
                rows = sample(weighted, self.batch, rng)
                a, b = rows[:, :-1].chunk(2)
                said = contrast_among_living(network, a, b, generator)
                gain = (rows[:, -1:] * torch.cat([said.a, said.b])).mean()
                loss = 0.5 * self.slope_penalty * said.squared_slope - gain
                optimizer.zero_grad()
                loss.backward()  # type: ignore[no-untyped-call]
                optimizer.step()
            return turn()

        found = self.play(world, agent, turn(), answer, rng)
        return Learned(found.policy, found.mean, {"discriminator's loss": losses})

    def _fit_exactly(self, demos: Episodes, world: World, model: Model, rng: np.random.Generator) -> Learned:
        shown = demonstrated(demos, model).sum(axis=(0, 2))
        shown /= shown.sum()
        r = torch.zeros(len(shown), dtype=torch.float64, requires_grad=True)
        optimizer = torch.optim.Adam([r], self.known_rate, **ADAM)
        losses: list[float] = []
        for _ in range(self.known_steps):
            divergence, gradient = forward_divergence(
                model, r.detach().numpy(), shown, world.horizon, world.gamma
            )
            r.grad = torch.as_tensor(gradient)
            optimizer.step()
            losses.append(divergence)
        values = np.repeat(r.detach().numpy()[:, None], model.P.shape[1], axis=1)
        reward = TabularReward(model.obs, values)
        return Learned(world.solve(reward, rng, world.solve_steps), reward, {"divergence": losses})


def forward_divergence(
    model: Model, r: Array, shown: Array, horizon: int, gamma: float
) -> tuple[float, Array]:
    """KL(rho_E || rho) of the states that are shown (S,), which sum to 1, and those that the soft policy of
    the reward r (S,) visits up to the horizon; and its gradient by r, (S,)."""
    P = model.P.reshape(-1, len(r))
    _, policies = finite_soft_value_iteration(model.P, r, horizon, gamma)
    visits = state_visitations(model.P, policies, model.start, horizon)
    rho, seen = visits.mean(axis=0), shown > 0
    divergence = float(shown[seen] @ np.log(shown[seen] / rho[seen]))
    # What a visit to each state changes, and what an action at each time changes from there on.
    change = np.divide(-shown, horizon * rho, out=np.zeros_like(rho), where=seen)
    later = np.zeros_like(policies)
    for t in reversed(range(horizon - 1)):
        onward = change + (policies[t + 1] * later[t + 1]).sum(axis=1)
        later[t] = (P @ onward).reshape(later[t].shape)
    gains = later - (policies * later).sum(axis=2, keepdims=True)
    # By how much each action's soft value counts at each time: for its own sake, and for those before it.
    gradient, carried = np.zeros_like(r), np.zeros_like(r)
    for t in range(horizon):
        weights = (visits[t, :, None] * gains[t] + carried[:, None]) * policies[t]
        gradient += weights.sum(axis=1)
        carried = gamma * (weights.reshape(-1) @ P)
    return divergence, gradient


def separate(episodes: Episodes) -> list[Episodes]:
    """Each episode alone."""
    every = zip(episodes.obs, episodes.act, episodes.terminated, episodes.steps, strict=True)
    return [
        Episodes((obs,), (act,), (ended,), None if episodes.times is None else (episodes.times[i],), (steps,))
        for i, (obs, act, ended, steps) in enumerate(every)
    ]


def trajectory(episode: Episodes, mean: Array, std: Array) -> tuple[Array, Array]:
    """Of one episode: rows (N, O + 1), and for how many steps each counts. Where it terminated the last row
    is the absorbing state, and counts as `ABSORBING_STEPS` beside as many steps as the episode has."""
    rows = visitations(episode, 0, mean, std, False)
    counts = np.ones(len(rows))
    if episode.terminated[0]:
        rows = np.concatenate([rows, np.eye(rows.shape[1])[-1:]])
        counts = np.append(counts, ABSORBING_STEPS * len(counts) / episode.lengths[0])
    return rows, counts


def weigh(trajectories: list[tuple[Array, Array]], logit: torch.nn.Module) -> Array:
    """(N, K + 1): all rows (M, K) of the trajectories, each with a weight: by how many standard deviations
    the mean density ratio exp(logit) of its trajectory is above those of the others, times the share of the
    trajectory that it is. Each trajectory counts as much as another."""
    ratios, shares = [], []
    for rows, counts in trajectories:
        with torch.no_grad():
            logs = logit(torch.as_tensor(rows, dtype=torch.float32))[:, 0].numpy()
        shares.append(counts / counts.sum())
        ratios.append(float(shares[-1] @ np.exp(np.clip(logs, -LARGEST_LOG, LARGEST_LOG))))
    above = (np.array(ratios) - np.mean(ratios)) / max(float(np.std(ratios)), 1e-8)
    rows = np.concatenate([rows for rows, _ in trajectories])
    weights = np.concatenate([share * a for share, a in zip(shares, above, strict=True)])
    return np.column_stack([rows, weights * len(rows) / len(trajectories)])
