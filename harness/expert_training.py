"""Trains the experts that are shipped, and measures them."""

from __future__ import annotations

import csv
import dataclasses
import io
import time
from concurrent.futures import FIRST_COMPLETED, Future, wait
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from pebble.concurrent import process as in_a_process

from envs import SPECS, EnvSpec
from harness.cache import Kept, as_bytes, load
from harness.evaluation import evaluate
from harness.expert_set import SUMS
from harness.files import read, sha256, write_atomic
from harness.keys import origin
from harness.processes import NAME, fresh_processes
from harness.progress import say
from harness.registry import BadInput
from harness.rl import Learner, disturbed
from harness.rl_settings import rl_settings_for
from harness.seeds import held_out_seeds, rng_for, tuning_seeds
from harness.store import held
from methods.base import Policy
from methods.network import Network

COUNT, MOST_TRIED = 5, 20
"""Experts of a task, and agents that are trained for them at most."""
EPISODES = 1000
"""An agent must reach its bar on as many tuning episodes, and an expert on as many that nothing else uses. Of
checkpoints that are near-ties, the first that does counts, in the order of how they bear noise."""
FIRST_EPISODES = 200
"""Tuning episodes by which checkpoints of one training are compared."""
NEAR, MOST_NEAR = 0.01, 12
"""Checkpoints whose returns differ by less, relative to the range from random to best, are near-ties; of more
than so many, some at equal distances are compared."""
MEDIUM, MEDIUM_TRIED, MEDIUM_OFF = 0.5, 10, 0.15
"""Share of that range which a medium expert should have, checkpoints that are measured for it, and how far
from that share the nearest may be: an agent that learns at a stroke has none."""
MARGIN = 0.5
"""Of the early endings that the bar allows, so much on tuning episodes: others may have more."""
CANDIDATES = "candidates.csv"


class Candidate(NamedTuple):
    """A line of candidates.csv: an agent trained for `env` from `seed`, judged on tuning episodes.
    number: of the expert that it became, '' where it missed the bar or enough were found before."""

    env: str
    seed: int
    number: str
    mean_return: float
    terminated: float
    noisy_return: float
    medium_return: float
    random_return: float
    env_steps: int
    check_steps: int
    seconds: float


class Measured(NamedTuple):
    """An expert's mean true return and share of episodes that ended early."""

    mean_return: float
    terminated: float


def measure(spec: EnvSpec, policy: Policy, seeds: range) -> Measured:
    """On the episodes of these seeds."""
    scored = evaluate(spec, policy, seeds)
    early = (len(seeds) - scored.endings.get("time limit", 0)) / len(seeds)
    return Measured(float(scored.returns.mean()), early)


def meets_bar(spec: EnvSpec, measured: Measured, margin: float = 1.0) -> bool:
    """Whether an expert does what one that is shipped must do. margin: share of the early endings allowed."""
    assert spec.shipped is not None
    allowed = spec.shipped.terminated
    ended_early = round(measured.terminated, 9)  # 10 of 1,000 are 1 %, and no more
    return measured.mean_return >= spec.shipped.bar and (allowed is None or ended_early <= margin * allowed)


def train(env: str, seed: int) -> tuple[Candidate, bytes, bytes]:
    """Trains an agent on the true reward; it, judged on tuning episodes, and the files of the expert and of
    the medium one."""
    spec, settings = SPECS[env], rl_settings_for(env)
    assert spec.shipped is not None
    started = time.perf_counter()
    if every := spec.shipped.checkpoint_every:
        settings = dataclasses.replace(settings, checkpoint_every=every)
    learner = Learner(spec, "absorbing", rng_for(seed, env, "shipped expert"), "sbx", settings)
    solution = learner.solve(None, spec.shipped.steps)
    few, rng = tuning_seeds(FIRST_EPISODES), rng_for(seed, env, "random")
    random_return = measure(spec, lambda obs: spec.random_actions(len(obs), rng), few).mean_return
    checked = np.array([value for _, value in solution.true_curve])
    scale = checked.max() - random_return
    near = np.flatnonzero(checked >= checked.max() - NEAR * scale)
    near = near[np.linspace(0, len(near) - 1, min(len(near), MOST_NEAR)).astype(int)]
    plain = {int(i): measure(spec, solution.checkpoints[i], few) for i in near}
    best = max(one.mean_return for one in plain.values())
    ties = [i for i, one in plain.items() if one.mean_return >= best - NEAR * scale]
    noisy = {
        i: measure(spec, disturbed(solution.checkpoints[i], spec, settings.noise), few).mean_return
        for i in ties
    }
    ties.sort(key=lambda i: (meets_bar(spec, plain[i], MARGIN), noisy[i], i), reverse=True)
    for chosen in ties:
        judged = measure(spec, solution.checkpoints[chosen], tuning_seeds(EPISODES))
        if meets_bar(spec, judged, MARGIN):
            break
    half = random_return + MEDIUM * (judged.mean_return - random_return)
    halves = {
        int(i): measure(spec, solution.checkpoints[i], few).mean_return
        for i in np.abs(checked - half).argsort(kind="stable")[:MEDIUM_TRIED]
    }
    medium = min(halves, key=lambda i: abs(halves[i] - half))
    candidate = Candidate(
        env,
        seed,
        "",
        *judged,
        noisy[chosen],
        halves[medium],
        random_return,
        solution.env_steps,
        solution.check_steps,
        round(time.perf_counter() - started, 1),
    )
    facts = {
        **candidate._asdict(),
        "settings": dataclasses.asdict(settings),
        "curve": solution.true_curve,
        "origin": origin(),
    }
    files = []
    for kind, place in (("expert", chosen), ("medium", medium)):
        policy = solution.checkpoints[place]
        assert isinstance(policy, Network)
        its = {"kind": kind, "checkpoint": solution.true_curve[place][0]}
        files.append(as_bytes(Kept(policy.arrays(), facts | its)))
    return candidate, files[0], files[1]


def train_all(envs: tuple[str, ...], out: Path, workers: int) -> None:
    """Trains agents of each task until enough meet its bar, and writes those to `out`, as they come. What is
    there already is gone on with. Raises BadInput where too few meet it, or another process is at it."""
    out.mkdir(parents=True, exist_ok=True)
    with held(out), fresh_processes("harness.preload") as context:
        candidates = _candidates(out)
        launch = in_a_process(name=NAME, context=context)(train)  # type: ignore[call-overload]
        for env in envs:
            done = {one.seed: one for one in candidates if one.env == env}
            running: dict[Future[tuple[Candidate, bytes, bytes]], int] = {}
            while True:
                missing = COUNT - sum(map(is_good, done.values()))
                waiting = [s for s in range(MOST_TRIED) if s not in done and s not in running.values()]
                for seed in waiting[: max(0, min(workers, missing) - len(running))]:
                    running[launch(env, seed)] = seed
                if not running:
                    break
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    seed = running.pop(future)
                    one, expert, medium = future.result()
                    done[seed] = one
                    candidates.append(one)
                    write_atomic(out / f".{env}__seed{seed}.safetensors", expert)
                    write_atomic(out / f".{env}__seed{seed}__medium.safetensors", medium)
                    _write_candidates(out, candidates)
                    say(f"{env}, agent {seed}: {_told(_measured(one))}, medium {one.medium_return:.1f}")
            candidates = _number(out, env, candidates)
            _write_candidates(out, candidates)
    names = sorted(path.name for path in out.iterdir() if path.name[0] != "." and path.name != SUMS)
    write_atomic(out / SUMS, "".join(f"{sha256(out / name)}  {name}\n" for name in names))


def _number(out: Path, env: str, candidates: list[Candidate]) -> list[Candidate]:
    """The first that meet the bar, in the order of their seeds, become experts 0, 1, ...; others go."""
    mine = sorted((one for one in candidates if one.env == env), key=lambda one: one.seed)
    good = [one.seed for one in mine if is_good(one)][:COUNT]
    if len(good) < COUNT:
        raise BadInput(f"{env}: {len(good)} of {len(mine)} agents meet the bar, {COUNT} are needed")
    for one in mine:
        for kind in ("", "__medium"):
            file = out / f".{env}__seed{one.seed}{kind}.safetensors"
            if one.seed in good and file.exists():
                file.replace(out / f"{env}__{good.index(one.seed)}{kind}.safetensors")
            file.unlink(missing_ok=True)
    numbers = {seed: str(number) for number, seed in enumerate(good)}
    return [one._replace(number=numbers.get(one.seed, "")) if one.env == env else one for one in candidates]


def check(envs: tuple[str, ...], where: Path) -> bool:
    """Says what each expert in the folder `where` reaches on episodes that nothing else uses. Returns whether
    all meet their bar."""
    met = True
    for env in envs:
        spec = SPECS[env]
        for path in sorted(where.glob(f"{env}__*.safetensors")):
            found = load(path)
            if found is None:
                raise BadInput(f"{path} is damaged")
            measured = measure(spec, Network.from_arrays(found.arrays), held_out_seeds(EPISODES))
            medium = found.facts["kind"] == "medium"
            good = medium or meets_bar(spec, measured)
            met &= good
            say(f"{path.name}: {_told(measured)}{'' if good else ' MISSED'}")
    return met


def is_good(one: Candidate) -> bool:
    """Whether it may become an expert, by its tuning episodes, and has a medium one."""
    share = (one.medium_return - one.random_return) / (one.mean_return - one.random_return)
    return meets_bar(SPECS[one.env], _measured(one), MARGIN) and abs(share - MEDIUM) <= MEDIUM_OFF


def _measured(one: Candidate) -> Measured:
    return Measured(one.mean_return, one.terminated)


def _told(measured: Measured) -> str:
    return f"mean return {measured.mean_return:.2f}, {measured.terminated:.1%} ended early"


def _candidates(out: Path) -> list[Candidate]:
    file = out / CANDIDATES
    if not file.exists():
        return []
    try:
        header, *lines = csv.reader(io.StringIO(read(file).decode()))
        if tuple(header) != Candidate._fields:
            raise ValueError("other columns")
        return msgspec.convert(lines, list[Candidate], strict=False)
    except ValueError as error:
        raise BadInput(f"{file} is damaged: {error}") from error


def _write_candidates(out: Path, candidates: list[Candidate]) -> None:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(Candidate._fields)
    writer.writerows(sorted(candidates))
    write_atomic(out / CANDIDATES, text.getvalue())
