"""Export of what was learned: policies for Stable-Baselines3's tools, rewards for any RL library.

FOLDER/learned.json          architecture, spaces, what absorption pays, key, versions
FOLDER/policy.safetensors    the arrays of the policy
FOLDER/reward.safetensors    the arrays of R*, where there is one

Nothing is pickled. Outputs are those of the run, bit for bit.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, SupportsFloat

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from envs import EnvSpec
from envs.checks import number
from harness.records import NOMINAL, REFERENCE, CellResult, PolicyName
from harness.registry import KNOWN, BadInput, Entry, choose, ours, plugins
from harness.registry.gymnasium_tasks import as_json, kwargs_of, task_or_name
from harness.registry.known import id_of
from harness.registry.tasks import seen_through
from harness.rl.stored import from_arrays, to_arrays
from harness.store.artifacts import NOT_KEPT
from harness.store.cache import Kept, as_bytes, from_bytes
from harness.store.codec import checksum, printable
from harness.store.files import LARGEST_OF_CELL, new_folder, read, sha256_of, write_atomic
from harness.store.opening import open_to_verify
from methods.base import Array, Policy, Reward

FORMAT = 1
FACTS = "learned.json"
PARTS = ("policy", "reward")


@dataclass(frozen=True)
class Exported:
    """A policy, R* (None: the method learns none, or it was not kept), their task, and what learned.json
    says."""

    policy: ExportedPolicy
    reward: Reward | None
    spec: EnvSpec
    facts: Mapping[str, Any]


class ExportedPolicy:
    """A policy with the `predict` of Stable-Baselines3, so that its `evaluate_policy` takes it."""

    def __init__(self, policy: Policy, spec: EnvSpec) -> None:
        self.policy, self.spec = policy, spec

    def __call__(self, obs: Array) -> Array:
        """Return actions (B, A) in [-1, 1], or choices, for observations (B, O)."""
        return self.policy(obs)

    def predict(
        self,
        observation: NDArray[Any],
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[Any], tuple[NDArray[Any], ...] | None]:
        """Return what the environment's `step` takes, for one observation (O,) or a batch (B, O), and the
        state as it was. Actions are deterministic, whatever is asked."""
        obs = np.asarray(observation, np.float64)
        chosen = self.policy(obs.reshape(-1, self.spec.obs_size))
        native = np.array([self.spec.native(act) for act in chosen])
        return native.reshape(obs.shape[:-1] + native.shape[1:]), state


class LearnedReward(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """An environment that pays R*, for any RL library. The true reward is `info["true_reward"]`.

    `folder`: of `export`. `offset`: pay R* less what absorption pays (docs/termination.md). The end of an
    episode, after which nothing is paid, is then worth what R* says. Raises BadInput if R* is missing, and
    for an environment with other observations or actions than the task. `make` returns one with the same.
    """

    def __init__(self, env: gym.Env[Any, Any], folder: Path | str | Exported, offset: bool = True) -> None:
        gym.utils.RecordConstructorArgs.__init__(self, folder=folder, offset=offset)
        gym.Wrapper.__init__(self, env)
        exported = folder if isinstance(folder, Exported) else load_learned(folder)
        if exported.reward is None:
            raise BadInput(f"there is no reward in it: {exported.facts['why_no_reward']}")
        own = exported.spec.make()
        spaces = own.observation_space.shape, own.action_space
        encoder = env.get_wrapper_attr("encoder") if env.has_wrapper_attr("encoder") else ""
        if (env.observation_space.shape, env.action_space) != spaces or encoder != exported.spec.encoder:
            raise BadInput(
                f"R* is of {own.observation_space} and {own.action_space}, the environment has "
                f"{env.observation_space} and {env.action_space}; "
                f"irl_bench.make({exported.spec.name!r}) has those, with the encoder if it has one"
            )
        self.reward, self.offset, self._spec = exported.reward, offset, exported.spec
        self._obs: NDArray[Any] | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        obs, info = self.env.reset(seed=seed, options=options)
        self._obs = np.array(obs, np.float64)  # a copy, for some environments write the next one into theirs
        return obs, info

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        before = self._obs
        obs, true, terminated, truncated, info = self.env.step(action)
        self._obs = np.array(obs, np.float64)
        act = np.eye(self._spec.act_size)[int(action)] if self._spec.discrete else np.asarray(action)
        rows = [np.asarray(row, np.float64)[None] for row in (before, act, self._obs)]
        paid = float(self.reward(*rows)[0]) - (self.reward.absorbing if self.offset else 0.0)
        return obs, paid, terminated, truncated, {**info, "true_reward": number(true)}


@ours.meanwhile()
def export(
    directory: Path | str,
    env: str,
    method: str,
    seed: int = 0,
    policy: PolicyName = "pi_star",
    to: Path | str | None = None,
) -> Path:
    """Write what a run's cell learned into a folder, and return the folder. Where cells differ only in what
    they were shown, the first counts.

    `policy`: 'pi_star', 'pi_R', or 'expert' of the method 'reference'. Raises BadInput where the run has no
    such cell, or kept nothing of it.
    """
    directory = Path(directory)
    with open_to_verify(directory) as run:
        conditions = run.request.conditions
    env = task_or_name(env, conditions.env_kwargs)
    result, learned = _learned(directory, env, method, seed)
    cell, reward = result.cell, learned.get("reward")
    if learned.get(policy) is None:
        raise BadInput(f"{cell.name} has no {policy}; it has {', '.join(n for n in learned if learned[n])}")
    facts, files = _facts(result, policy, reward, conditions.encoder), dict[str, bytes]()
    for name, thing in zip(PARTS, (learned[policy], reward), strict=True):
        arrays, facts[name] = to_arrays(thing, name)
        if thing is not None:
            files[f"{name}.safetensors"] = as_bytes(Kept(arrays, {}))
    facts["files"] = {name: sha256_of(data) for name, data in files.items()}
    to = Path(to or f"{cell.name}__{policy}")
    with new_folder(to) as folder:
        for name, data in files.items():
            write_atomic(folder / name, data)
        write_atomic(folder / FACTS, json.dumps({"sha256": checksum(facts), **facts}, indent=1) + "\n")
    return to


def _learned(directory: Path, env: str, method: str, seed: int) -> tuple[CellResult, dict[str, Any]]:
    """Return a run's cell, in the dynamics of its own task, and what it learned, by name."""
    with open_to_verify(directory) as run:
        results, unusable = run.load()
        beside, damaged = run.beside()
    asked = (env, method, seed, NOMINAL)
    cells = [cell for cell in results if (cell.env, cell.method, cell.seed, cell.dynamics) == asked]
    if not cells:
        if any((one.cell.env, one.cell.method) == (env, method) for one in beside):
            raise BadInput(f"{env} {method} in {directory} is of a baseline; export it from the run it is of")
        seeds = sorted({cell.seed for cell in results if (cell.env, cell.method) == (env, method)})
        known = sorted({f"{cell.env} {cell.method}" for cell in results})
        has = f"seeds {', '.join(map(str, seeds))}" if seeds else ", ".join(known)[:300] or "no cell"
        unread = [f"; {file}: {why}" for file, why in (unusable | damaged).items()]
        raise BadInput(f"{directory} has no {env} {method}, seed {seed}; it has {has}{''.join(unread[:1])}")
    if env not in KNOWN.entries["env"]:
        raise BadInput(f"{env} is a plug-in's task: name that with --plugin", page="plugins")
    result = results[cells[0]]
    if not result.learned:
        failed = [row.reason for row in result.rows if row.status == "failed"]
        why = "; ".join([*failed[:1], *result.warnings]) or "only its scores are here"
        raise BadInput(f"{directory} kept nothing of {result.cell.name}: {why}", page="commands")
    with open_to_verify(directory) as run:
        return result, run.read_learned(result)


@ours.meanwhile()
def load_learned(folder: Path | str) -> Exported:
    """Return what `export` wrote. Raises BadInput where that is damaged, or of a task that is not known."""
    folder = Path(folder)
    try:
        facts = json.loads(read(folder / FACTS))
        if "sha256" in facts and facts.pop("sha256") != checksum(facts):
            raise ValueError(f"{FACTS} is not as it was written")
        if facts["format"] != FORMAT:
            raise ValueError(f"it has format {facts['format']!r:.20}, this version reads {FORMAT}")
        env = task_or_name(str(facts["env"]), str(facts.get("env_kwargs", "")))
        if isinstance(facts["env"], str) and env not in KNOWN.entries["env"]:
            raise BadInput(f"{folder} is of the task {env!r:.80} of a plug-in: irl_bench.add_plugins([...])")
        spec = seen_through(env, str(facts.get("encoder", "")))
        policy, reward = (_part(folder, name, facts) for name in PARTS)
        if not callable(policy) or not (reward is None or callable(reward)):
            raise ValueError("it is neither a policy nor a reward")
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise BadInput(f"{folder} holds nothing that was exported: {printable(repr(error)[:200])}") from error
    return Exported(ExportedPolicy(policy, spec), reward, spec, facts)


def _part(folder: Path, part: str, facts: Mapping[str, Any]) -> Any:
    """Return the policy or the reward. Raises OSError or ValueError where its file is another one's."""
    if facts[part] is None:
        return None
    name = f"{part}.safetensors"
    data = read(folder / name, LARGEST_OF_CELL)
    if "files" in facts and facts["files"][name] != sha256_of(data):
        raise ValueError(f"{name} is not the one that was exported with it")
    return from_arrays(from_bytes(data).arrays, facts[part])


@ours.meanwhile()
def make(env: str, *, encoder: str = "", **kwargs: Any) -> gym.Env[Any, Any]:
    """Return the environment that policies of the task are for. encoder: of images, '' for the task's own.
    kwargs: arguments of a task 'gym:ID', as of `--env-kwargs`. Raises BadInput for an unknown one."""
    env = task_or_name(env, as_json(kwargs))
    if kwargs and not id_of(KNOWN.entries["env"].get(env, Entry("", ""))):
        raise BadInput(f"arguments are of tasks gym:ID, not of {env!r:.80}")
    if choose("env", env, KNOWN.entries["env"]) != (env,):
        raise BadInput(f"one env is needed, not {env!r:.80}")
    plugins.load([], [env])
    try:
        return seen_through(env, encoder).make()
    except ValueError as error:
        raise BadInput(str(error)) from error


def _facts(result: CellResult, policy: str, reward: Reward | None, encoder: str) -> dict[str, Any]:
    """Return what learned.json says besides the parts."""
    cell, spec = result.cell, seen_through(result.cell.env, encoder)
    spec = spec.expert_sees if cell.method == REFERENCE else spec
    env = spec.make()
    facts = {
        "format": FORMAT,
        "env": spec.name,
        "encoder": encoder if spec.encoder else "",
        "env_kwargs": kwargs_of(KNOWN.entries["env"][cell.env]),
        "gymnasium_id": spec.env_id,
        "cell": asdict(cell),
        "learned": policy,
        "observation_space": str(env.observation_space),
        "action_space": str(env.action_space),
        "observations": [str(quantity) for quantity in spec.observations],
        "actions": [str(quantity) for quantity in spec.actions],
        "absorbing": None if reward is None or cell.method == REFERENCE else float(reward.absorbing),
        "key": result.key,
        "computed_with": dict(result.origin),
    }
    if reward is None:
        lost = f"{cell.name}: reward {NOT_KEPT}"
        unkept = [warning for warning in result.warnings if warning.startswith(lost)]
        facts["why_no_reward"] = unkept[0] if unkept else "the method learns none"
    return facts
