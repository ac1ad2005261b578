"""Folder of shipped experts (`harness.cell.shipped`): agents are trained until enough meet their bar, and
measured."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from multiprocessing import get_context
from pathlib import Path

from pebble.concurrent import process as in_a_process

from harness.benchmarks.expert_training import Candidate, Measured, is_good, measure, meets_bar, train
from harness.benchmarks.expert_training import shipped_of as shipped
from harness.cell.experts import source_for
from harness.cell.shipped import ShippedExpert, from_file, to_file
from harness.engines.cell_environment import as_in_cells
from harness.records import Conditions
from harness.registry import SPECS, BadInput
from harness.registry.keys import EXPERTS, ROOT
from harness.rl.seeds import held_out_seeds, rng_for
from harness.schedule.progress import say, tell
from harness.store.files import LARGEST_OF_CELL, SUMS, as_lines, read, sha256, write_atomic
from harness.store.marked import open_marked

MOST_TRIED = 20
"""Agents that are trained for a task's experts, at most."""
CANDIDATES, KIND = "candidates.csv", ".safetensors"
HEADER = ",".join(Candidate._fields) + "\n"
JUDGED = 100
"""Episodes on which an expert that is not shipped is measured."""
Training = Future[tuple[Candidate, ShippedExpert]]
Agents = dict[int, tuple[Candidate, ShippedExpert]]
"""Agents of a task by their seeds."""


def folder() -> Path:
    """Return where the shipped experts are."""
    return next((ROOT / name for name in EXPERTS if (ROOT / name).is_dir()), ROOT / EXPERTS[0])


def train_all(envs: tuple[str, ...], out: Path, workers: int) -> None:
    """Train agents of each task until enough meet its bar, and write those to `out`, task by task. Tasks
    whose file is there already are left alone.

    Raises BadInput where too few meet the bar, where `out` holds anything else, or where another process has
    it.
    """

    def is_list(data: bytes) -> bool:
        return data.isascii() and data.startswith(HEADER.encode())

    def is_whole(env: str) -> bool:
        try:
            return len(_experts(out, env)) == shipped(SPECS[env]).experts
        except BadInput:
            return False

    with open_marked(out, CANDIDATES, HEADER.encode(), "experts", is_list), as_in_cells():
        launch = in_a_process(context=get_context("spawn"))(train)  # type: ignore[call-overload]
        for env in envs:
            if not is_whole(env):
                _write_task(out, env, _trained(env, workers, launch))
        files = sorted(path.name for path in out.glob(f"*{KIND}") if path.stem in SPECS)
        write_atomic(out / SUMS, as_lines((sha256(out / name), name) for name in (CANDIDATES, *files)))


def _trained(env: str, workers: int, launch: Callable[[str, int], Training]) -> Agents:
    """Return agents, trained side by side and in the order of their seeds until enough meet the bar."""
    agents, running, waiting = Agents(), dict[Training, int](), [*range(MOST_TRIED)]
    while True:
        missing = shipped(SPECS[env]).experts - sum(is_good(one) for one, _ in agents.values())
        while waiting and len(running) < min(workers, missing):
            seed = waiting.pop(0)
            running[launch(env, seed)] = seed
        if not running:
            return agents
        for future in wait(running, return_when=FIRST_COMPLETED).done:
            seed = running.pop(future)
            agents[seed] = future.result()
            one = agents[seed][0]
            reached = Measured(one.mean_return, one.terminated)
            say(f"{env}, agent {seed}: {reached}, medium {one.medium_return:.1f}")


def _write_task(out: Path, env: str, agents: Agents) -> None:
    """Write all agents into the list, and the first that meet the bar, by their seeds, as experts."""
    count = shipped(SPECS[env]).experts
    good = [seed for seed in sorted(agents) if is_good(agents[seed][0])][:count]
    text = io.StringIO()
    for seed, (one, _) in sorted(agents.items()):
        number = str(good.index(seed)) if seed in good and len(good) == count else ""
        csv.writer(text, lineterminator="\n").writerow(one._replace(number=number))
    listed = read(out / CANDIDATES).decode().splitlines(keepends=True)[1:]
    lines = [line for line in listed if not line.startswith(f"{env},")]
    lines += text.getvalue().splitlines(keepends=True)
    lines.sort(key=lambda line: line.split(",")[0])
    write_atomic(out / CANDIDATES, "".join([HEADER, *lines]))
    if len(good) < count:
        raise BadInput(f"{env}: {len(good)} of {len(agents)} agents meet the bar, {count} are needed")
    write_atomic(out / f"{env}{KIND}", to_file(env, [agents[seed][1] for seed in good]))


def train_for_runs(envs: Sequence[str], seeds: Sequence[int], budget: str) -> None:
    """Train the experts that runs with this budget use in tasks without shipped ones, as far as the cache
    lacks them. Say what they reach on episodes that nothing else uses."""
    conditions, held_out = Conditions(budget, "absorbing", "sbx"), held_out_seeds(JUDGED)
    for env in envs:
        spec, rng = SPECS[env], rng_for(0, env, "held out")
        random = measure(spec, lambda obs: spec.random_actions(len(obs), rng), held_out).mean_return  # noqa: B023
        for seed in seeds:
            expert = source_for(env, seed, conditions).expert
            reached = f"{measure(spec, expert.policy, held_out)}, a random policy {random:.2f}"
            say(f"{env}, seed {seed}: {reached}; {expert.env_steps:,} steps of RL in {expert.seconds:.0f} s")


def check(envs: tuple[str, ...], where: Path) -> bool:
    """Say what each expert in a folder reaches on episodes that nothing else uses. Returns whether all meet
    their bar. Raises BadInput where a task has none there, or they are damaged."""
    experts = {env: _experts(where, env) for env in envs}
    missed = []
    for env in envs:
        spec, seeds = SPECS[env], held_out_seeds(shipped(SPECS[env]).episodes)
        for number, one in enumerate(experts[env]):
            for kind, policy in (("expert", one.expert), ("medium", one.medium)):
                measured, name = measure(spec, policy, seeds), f"{env} {kind}{number}"
                good = kind == "medium" or meets_bar(spec, measured)
                missed += [] if good else [name]
                say(f"{name}: {measured}{'' if good else ' MISSED'}")
    if missed:
        tell(f"MISSED: {', '.join(missed)}: below the bar of their task")
    return not missed


def _experts(where: Path, env: str) -> list[ShippedExpert]:
    path = where / f"{env}{KIND}"
    try:
        return from_file(read(path, LARGEST_OF_CELL), env)
    except FileNotFoundError as error:
        raise BadInput(f"{where} holds no experts of {env}") from error
    except (OSError, ValueError) as error:
        raise BadInput(f"{path} is damaged: {error}") from error
