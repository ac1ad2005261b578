"""Fit a method of the library `imitation` 1.0.1 to what `against_others.py demos` wrote.

python results/studies/against_imitation.py METHOD TASK SEED DEMOS FOLDER FILE, in a virtual environment of
its own with `pip install imitation==1.0.1`: append lines as `against_others.py curve` does. METHOD is bc,
dagger, gail, gail_mean_state (a discriminator of states), airl, airl_state or sqil. TASK is swingup
(Pendulum-v1) or cartpole_discrete (CartPole-v1). GAIL and AIRL have settings that were tuned for the swing-up
(costs_swingup.csv), all others are the library's, or Stable-Baselines3's.
"""

import csv
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import imitation.algorithms.adversarial.airl as airl
import imitation.algorithms.adversarial.gail as gail
import imitation.algorithms.bc as bc
import imitation.algorithms.dagger as dagger
import imitation.algorithms.sqil as sqil
import imitation.data.rollout as rollout
import imitation.data.types as types
import imitation.data.wrappers as wrappers
import imitation.policies.base as base
import imitation.rewards.reward_nets as nets
import imitation.util.logger as logger
import imitation.util.networks as networks
import numpy as np
import stable_baselines3 as sb3
import stable_baselines3.common.callbacks as callbacks
import stable_baselines3.common.vec_env as vec_env
import torch

TASKS = {"swingup": "Pendulum-v1", "cartpole_discrete": "CartPole-v1"}
COPIES = 8
GAME_STEPS, SQIL_STEPS, ANSWERS = 286_720, 40_000, 10_000
"""Environment steps of a game and of SQIL, and actions that the expert gives: as many as ours take."""
PPO = {"n_steps": 256, "batch_size": 64, "n_epochs": 10, "learning_rate": 1e-3, "clip_range": 0.2}
GAMMA = {"gail": 0.95, "airl": 0.9}
UPDATES = {"gail": 8, "airl": 30}
"""Updates of the discriminator in a round."""
Points = Iterator[tuple[int, float]]


def make(task: str) -> gym.Env:
    """Return the task with actions in [-1, 1], or choices."""
    env = gym.make(TASKS[task])
    if isinstance(env.action_space, gym.spaces.Box):
        env = gym.wrappers.RescaleAction(env, -1.0, 1.0)
    return wrappers.RolloutInfoWrapper(env)


class Shown:
    """What `against_others.py demos` wrote."""

    def __init__(self, task: str, file: Path) -> None:
        self.task, self.arrays = task, dict(np.load(file))
        self.envs = [make(task) for _ in self.arrays["seeds"]]

    def trajectories(self) -> list[types.Trajectory]:
        a, found = self.arrays, []
        ends = np.cumsum(a["lengths"])
        for i, (end, length, ended) in enumerate(zip(ends, a["lengths"], a["terminated"], strict=True)):
            obs, act = a["obs"][end - length + i : end + i + 1], a["act"][end - length : end]
            act = act.argmax(axis=1) if act.shape[1] > 1 else act.astype(np.float32)
            found.append(types.Trajectory(obs.astype(np.float32), act, None, terminal=bool(ended)))
        return found

    def expert(self, obs: np.ndarray) -> Any:
        """Return the expert's action at one observation."""
        x, a = (obs - self.arrays["expert_mean"]) / self.arrays["expert_std"], self.arrays
        for i in range(2):
            x = np.maximum(x @ a[f"expert_weight{i}"] + a[f"expert_bias{i}"], 0)
        x = x @ a["expert_weight2"] + a["expert_bias2"]
        return np.tanh(x).astype(np.float32) if a["expert_tanh"] else x.argmax()

    def score(self, policy: Any) -> float:
        """Return the score of the policy's mean actions, on our starts of episodes."""
        envs, seeds, total = self.envs, self.arrays["seeds"], np.zeros(len(self.envs))
        obs = np.stack([env.reset(seed=int(seed))[0] for env, seed in zip(envs, seeds, strict=True)])
        alive = np.ones(len(envs), bool)
        while alive.any():
            act = policy.predict(obs, deterministic=True)[0]
            for i in np.flatnonzero(alive):
                obs[i], paid, ended, cut, _ = envs[i].step(act[i])
                total[i] += float(paid)
                alive[i] = not (ended or cut)
        return float((total.mean() - self.arrays["least"]) / (self.arrays["most"] - self.arrays["least"]))


def game(name: str, shown: Shown, seed: int) -> Points:
    kind = name.partition("_")[0]
    copies = vec_env.DummyVecEnv([lambda: make(shown.task)] * COPIES)
    copies.seed(seed)
    features = {
        "features_extractor_class": base.NormalizeFeaturesExtractor,
        "features_extractor_kwargs": {"normalize_class": networks.RunningNorm},
    }
    ppo = sb3.PPO(
        base.FeedForward32Policy,
        copies,
        **PPO,
        gamma=GAMMA[kind],
        seed=seed,
        device="cpu",
        policy_kwargs=features,
    )
    trainer, network = {
        "gail": (gail.GAIL, nets.BasicRewardNet),
        "airl": (airl.AIRL, nets.BasicShapedRewardNet),
    }[kind]
    reward = network(
        copies.observation_space,
        copies.action_space,
        use_action=not name.endswith("_state"),
        normalize_input_layer=networks.RunningNorm,
    )
    rounds = trainer(
        demonstrations=shown.trajectories(),
        demo_batch_size=256,
        n_disc_updates_per_round=UPDATES[kind],
        gen_replay_buffer_capacity=512,
        venv=copies,
        gen_algo=ppo,
        reward_net=reward,
        custom_logger=logger.configure(tempfile.mkdtemp(), []),
    )
    while ppo.num_timesteps < GAME_STEPS:
        rounds.train(5 * rounds.gen_train_timesteps)
        yield ppo.num_timesteps, shown.score(ppo)


def clone(name: str, shown: Shown, seed: int) -> Points:
    env, demos = make(shown.task), shown.trajectories()
    trainer = bc.BC(
        observation_space=env.observation_space,
        action_space=env.action_space,
        rng=np.random.default_rng(seed),
        demonstrations=rollout.flatten_trajectories(demos),
        custom_logger=logger.configure(tempfile.mkdtemp(), []),
        device="cpu",
    )
    trainer.train(n_batches=2000, progress_bar=False)
    yield len(demos), shown.score(trainer.policy)


def asked(name: str, shown: Shown, seed: int) -> Points:
    env = vec_env.DummyVecEnv([lambda: make(shown.task)])
    env.seed(seed)
    rng, quiet = np.random.default_rng(seed), logger.configure(tempfile.mkdtemp(), [])

    class Expert(base.NonTrainablePolicy):
        def _choose_action(self, obs: Any) -> Any:
            return shown.expert(obs)

    cloner = bc.BC(
        observation_space=env.observation_space,
        action_space=env.action_space,
        rng=rng,
        custom_logger=quiet,
        device="cpu",
    )
    trainer = dagger.SimpleDAggerTrainer(
        venv=env,
        scratch_dir=tempfile.mkdtemp(),
        expert_policy=Expert(env.observation_space, env.action_space),
        expert_trajs=shown.trajectories(),
        rng=rng,
        bc_trainer=cloner,
        custom_logger=quiet,
    )
    length = int(shown.arrays["lengths"].max())
    for answers in range(5 * length, ANSWERS + 1, 5 * length):
        trainer.train(5 * length, rollout_round_min_episodes=5, bc_train_kwargs={"progress_bar": False})
        yield answers, shown.score(trainer.policy)


def soft(name: str, shown: Shown, seed: int) -> Points:
    env = vec_env.DummyVecEnv([lambda: make(shown.task)])
    env.seed(seed)
    discrete = isinstance(env.action_space, gym.spaces.Discrete)
    trainer = sqil.SQIL(
        venv=env,
        demonstrations=shown.trajectories(),
        policy="MlpPolicy",
        rl_algo_class=sb3.DQN if discrete else sb3.SAC,
        rl_kwargs={"seed": seed, "device": "cpu", "learning_starts": 1000},
        custom_logger=logger.configure(tempfile.mkdtemp(), []),
    )
    points: list[tuple[int, float]] = []

    def watch(steps: dict[str, Any], _: Any) -> bool:
        at = steps["self"].num_timesteps
        if at % 4000 == 0:
            points.append((at, shown.score(steps["self"])))
        return True

    trainer.train(total_timesteps=SQIL_STEPS, callback=callbacks.ConvertCallback(watch))
    yield from points


METHODS: dict[str, tuple[Callable[..., Points], str]] = {
    "bc": (clone, "demonstrations"),
    "dagger": (asked, "expert's actions"),
    "sqil": (soft, "environment steps"),
}

if __name__ == "__main__":
    method, task, seed, demos, folder, path = sys.argv[1:]
    torch.manual_seed(int(seed))
    torch.set_num_threads(1)
    shown = Shown(task, Path(folder) / f"{task}_{seed}_{demos}.npz")
    fit, unit = METHODS.get(method, (game, "environment steps"))
    for at, score in fit(method, shown, int(seed)):
        with open(path, "a", newline="", encoding="utf-8") as file:
            row = ["imitation", method, task, demos, seed, unit, at, f"{score:.3f}"]
            csv.writer(file, lineterminator="\n").writerow(row)
