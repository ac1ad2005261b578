"""Maximum-entropy deep inverse reinforcement learning (Wulfmeier, Ondruska & Posner 2015; Ziebart et al.
2008), algorithm 1.

The gradient of the demonstrations' log-likelihood L by the reward of a state is how often demonstrations
visit it, minus how often the policy does. A network propagates it back.

    grad log L = sum_s (mu_D(s) - E[mu(s)]) grad r(s)

In known models `methods.tabular.maxent` is the algorithm line by line.

Deviates from the paper: elsewhere "solve the MDP" is reinforcement learning that goes on a little in each
iteration, as in maximum-likelihood IRL (Zeng et al. 2022). The expected visitations E[mu] come from rollouts
of the stochastic policy that it learns. PPO's is the best in reward plus entropy, as the likelihood demands.
Soft actor-critic weighs entropy by itself. DDPG, TD3 and Q-learning maximise no entropy, and their
deterministic policy is rolled out. The reward sees actions, too; that of `maxent_state` does not, as in the
paper. pi* is deterministic. The paper's prior on the network's weights is one on its slope here,
because with one on its values RL from scratch failed on the swing-up (`docs/tuning.md`). R* is the mean of
the networks. In the game between reward and policy averages converge, and last choices need not (Freund &
Schapire 1999; Syed & Schapire 2007). The network sees an absorbing indicator, and visitations count absorbing
steps up to the horizon, so the reward of absorption is learned like any state's. Once the policy never
terminates, nothing shows that an end is bad. So where demonstrations terminate less often than random
actions, an end pays at most the mean reward of random steps.
"""

import math
from dataclasses import dataclass
from typing import Annotated

import torch

from methods.base import Agent, Array, Episodes, Learned, Policy, Rng, World
from methods.network import ADAM, contrast, mlp, standardiser
from methods.ranges import Between, Count, Hidden, Positive, Rate, Weight
from methods.rewards import MeanReward, NetworkReward, deterred, paid
from methods.stochastic import EpsilonGreedy
from methods.tabular import maxent as tabular
from methods.visits import sample, seen_by_both, visitations


@dataclass(frozen=True)
class MaxEnt:
    """Hyper-parameters of maximum-entropy IRL."""

    layers: Hidden = (64, 64)
    """Hidden layers of the reward network."""
    actions: bool = True
    """True if the reward sees actions, besides observations. Where the model is known it never does."""
    iterations: Count = 20
    """Reward updates, each followed by reinforcement learning that goes on."""
    rl_share: Positive = 0.06
    """Environment steps of each iteration, as a share of a solve from scratch."""
    entropy: Annotated[Weight, Between(0.1, 10)] = 1.0
    """PPO's reward of a nat of its policy's entropy, which is 1 in the likelihood."""
    averaged: Count = 20
    """Latest iterations that R* is the mean of, by default all."""
    final_share: Positive = 0.5
    """Environment steps under R*, as a share of a solve. pi* is the best checkpoint of these."""
    reward_steps: Count = 100
    """Gradient steps on the reward in each iteration."""
    learning_rate: Rate = 1e-3
    """Learning rate of the reward, by Adam."""
    batch: Count = 256
    """Visitations sampled from the demonstrations, and as many from the rollouts."""
    rollouts: Count = 10
    """Episodes that estimate a policy's visitations."""
    remembered: Count = 3
    """Latest iterations whose rollouts estimate E[mu]."""
    slope_prior: Annotated[Weight, Between(0.01, 100)] = 1.0
    """Inverse variance of the Gaussian prior on the reward's slope, observations being standardised."""

    @property
    def needs_actions(self) -> bool:
        """True if demonstrations must have actions."""
        return self.actions

    def fit(self, demos: Episodes, world: World, rng: Rng) -> Learned:
        """Alternate reward ascent and reinforcement learning on the reward."""
        if world.model is not None:
            return tabular.fit(
                demos, world, world.model, rng, self.layers, self.iterations, self.learning_rate
            )
        random = world.rollout(lambda obs: world.random_actions(len(obs), rng), self.rollouts, rng)
        mean, std = standardiser(seen_by_both(demos, random, rng))
        generator = torch.Generator().manual_seed(int(rng.integers(1 << 31)))
        inputs = world.obs_size + (world.act_size if self.actions else 0) + 1
        network = mlp(inputs, *self.layers, 1, generator=generator)
        optimizer = torch.optim.Adam(network.parameters(), self.learning_rate, **ADAM)
        visits_demo = visitations(demos, world.horizon - demos.lengths, mean, std, self.actions)
        visits_policy: list[Array] = []
        rewards: list[NetworkReward] = []
        agent = world.agent(rng, entropy=self.entropy)
        for i in range(self.iterations):
            rollouts = random if i == 0 else world.rollout(drawn_by(agent, rng), self.rollouts, rng)
            visits = visitations(rollouts, world.horizon - rollouts.lengths, mean, std, self.actions)
            visits_policy = [*visits_policy, visits][-self.remembered :]
            for _ in range(self.reward_steps):
                expected = visits_policy[int(rng.integers(len(visits_policy)))]
                d, e = (sample(v, self.batch, rng) for v in (visits_demo, expected))
                values = contrast(network, d, e, generator)
                gap = values.a.mean() - values.b.mean()
                loss = 0.5 * self.slope_prior * values.squared_slope - gap
                optimizer.zero_grad()
                loss.backward()  # type: ignore[no-untyped-call]
                optimizer.step()
            world.log({"mean reward, demonstrations minus rollouts": gap.item()})
            reward = NetworkReward.of(network, mean, std, actions=self.actions)
            rewards.append(deterred(reward, demos, random, float(paid(reward, random).mean())))
            agent.learn(math.ceil(self.rl_share * world.solve_steps), rewards[-1])
        mean_reward = MeanReward(tuple(rewards[-self.averaged :]))
        agent.learn(math.ceil(self.final_share * world.solve_steps), mean_reward)
        return Learned(agent.best(mean_reward), mean_reward)


def drawn_by(agent: Agent, rng: Rng) -> Policy:
    """Return the agent's present stochastic policy, or its deterministic one if it learns no other."""
    try:
        behaviour = agent.behaviour
    except ValueError:
        return agent.policy
    if isinstance(behaviour, EpsilonGreedy):  # stochastic for exploration only
        return agent.policy
    return lambda obs: behaviour.sample(obs, rng)
