"""Trains the experts that are shipped, and measures them."""

from __future__ import annotations

import csv
import dataclasses
import io
import re
import time
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from pebble.concurrent import process as in_a_process

from envs import EnvSpec
from envs.spec import Shipped
from harness.judge.evaluation import evaluate
from harness.judge.results import Conditions, thinned
from harness.learn.rl import Agent, disturbed
from harness.learn.seeds import held_out_seeds, rng_for, tuning_seeds
from harness.learn.stored import compact
from harness.registry import SPECS, BadInput
from harness.registry.machine import origin
from harness.run.cache import Kept, as_bytes, load
from harness.run.experts import expert_for
from harness.run.files import read, sha256, write_atomic
from harness.run.marked import open_marked
from harness.run.processes import NAME, fresh_processes
from harness.run.progress import say, tell
from harness.run.sums import SUMS, as_lines
from methods.base import Policy
from methods.network import Network

MOST_TRIED = 20
"""Agents that are trained for a task's experts, at most. An agent must reach its bar on so many tuning
episodes as the task says, and an expert on as many that nothing else uses. Of checkpoints that are near-ties,
the first that does counts, in the order of how they bear noise."""
MORE = 4
"""So many times as many further tuning episodes must end as seldom early: the best of several flatters."""
FEWER = 5
"""Checkpoints of one training are compared by a share of 1 in so many of those episodes."""
NEAR, MOST_NEAR = 0.01, 12
"""Checkpoints whose returns differ by less, relative to the range from random to best, are near-ties; of more
than so many, some at equal distances are compared."""
MEDIUM, MEDIUM_TRIED, MEDIUM_OFF = 0.5, 10, 0.15
"""Share of that range which a medium expert should have, checkpoints that are measured for it, and how far
from that share the nearest may be: an agent that learns at a stroke has none."""
MARGIN = 0.5
"""Of the early endings that the bar allows, so much on tuning episodes: others may have more."""
MOST_CHECKS = 200
"""Of the curve that is kept of a training."""
CANDIDATES = "candidates.csv"
MEDIUM_FILE = "__medium"
"""What a medium expert's file is called besides."""
JUDGED = 100
"""Episodes on which an expert that is not shipped is measured."""
_AGENT = rf"\.\w+__seed\d+({MEDIUM_FILE})?\.safetensors"
_EXPERT = re.compile(rf"\w+__\d+({MEDIUM_FILE})?\.safetensors")


class Candidate(NamedTuple):
    """A line of candidates.csv: an agent trained for `env` from `seed`, judged on tuning episodes.
    number: of the expert that it became, '' where it missed the bar or enough were found before. terminated:
    share of episodes that ended early; confirmed: of `MORE` times as many, 1 where that was not measured, for
    something else rules the agent out."""

    env: str
    seed: int
    number: str
    mean_return: float
    terminated: float
    confirmed: float
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


def confirm(spec: EnvSpec, policy: Policy, judged: Measured) -> float:
    """The share of further tuning episodes that end early, where those before do not rule the policy out and
    it matters."""
    assert spec.shipped is not None
    if not meets_bar(spec, judged, MARGIN):
        return 1.0
    if spec.shipped.terminated is None:
        return judged.terminated
    episodes = spec.shipped.episodes
    return measure(spec, policy, tuning_seeds((1 + MORE) * episodes)[episodes:]).terminated


def train(env: str, seed: int) -> tuple[Candidate, bytes, bytes]:
    """Trains an agent on the true reward; it, judged on tuning episodes, and the files of the expert and of
    the medium one."""
    spec = SPECS[env]
    assert spec.shipped is not None
    settings = spec.shipped.rl or spec.rl
    started = time.perf_counter()
    if every := spec.shipped.checkpoint_every:
        settings = dataclasses.replace(settings, checkpoint_every=every)
    learner = Agent(spec, "absorbing", rng_for(seed, env, "shipped expert"), "sbx", settings)
    solution = learner.solve(None, spec.shipped.steps)
    few, rng = tuning_seeds(spec.shipped.episodes // FEWER), rng_for(seed, env, "random")
    random_return = measure(spec, lambda obs: spec.random_actions(len(obs), rng), few).mean_return
    checked = np.array([value for _, value in solution.true_curve])
    scale = checked.max() - random_return
    near = np.flatnonzero(checked >= checked.max() - NEAR * scale)
    plain = {i: measure(spec, solution.checkpoints[i], few) for i in thinned(near.tolist(), MOST_NEAR)}
    best = max(one.mean_return for one in plain.values())
    ties = [i for i, one in plain.items() if one.mean_return >= best - NEAR * scale]
    noisy = {
        i: measure(spec, disturbed(solution.checkpoints[i], spec, settings.noise), few).mean_return
        for i in ties
    }
    ties.sort(key=lambda i: (meets_bar(spec, plain[i], MARGIN), noisy[i], i), reverse=True)
    for chosen in ties:
        judged = measure(spec, solution.checkpoints[chosen], tuning_seeds(spec.shipped.episodes))
        confirmed = confirm(spec, solution.checkpoints[chosen], judged)
        if meets_bar(spec, judged._replace(terminated=confirmed), MARGIN):
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
        confirmed,
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
        "curve": thinned(solution.true_curve, MOST_CHECKS),
        "origin": origin(),
    }
    files = []
    for kind, place in (("expert", chosen), ("medium", medium)):
        policy = solution.checkpoints[place]
        assert isinstance(policy, Network)
        its = {"kind": kind, "checkpoint": solution.true_curve[place][0]}
        arrays = {name: compact(array) for name, array in policy.arrays().items()}
        files.append(as_bytes(Kept(arrays, facts | its)))
    return candidate, files[0], files[1]


def train_all(envs: tuple[str, ...], out: Path, workers: int) -> None:
    """Trains agents of each task until enough meet its bar, and writes those to `out`, as they come. What is
    there already is gone on with. Raises BadInput where too few meet it, where `out` holds anything else,
    or where another process is at it."""
    ours = open_marked(out, CANDIDATES, _as_text([]).encode(), "experts", _is_list, rf"{SUMS}|{_AGENT}")
    with ours, fresh_processes("harness.run.preload") as context:
        launch = in_a_process(name=NAME, context=context)(train)  # type: ignore[call-overload]
        for env in envs:
            count = _shipped(env).experts
            done = {one.seed: one for one in _set_aside(out, env)}
            running: dict[Future[tuple[Candidate, bytes, bytes]], int] = {}
            while True:
                missing = count - sum(map(is_good, done.values()))
                waiting = [s for s in range(MOST_TRIED) if s not in done and s not in running.values()]
                for seed in waiting[: max(0, min(workers, missing) - len(running))]:
                    running[launch(env, seed)] = seed
                if not running:
                    break
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    seed = running.pop(future)
                    one, expert, medium = future.result()
                    done[seed] = one
                    write_atomic(_unnumbered(out, env, seed, ""), expert)
                    write_atomic(_unnumbered(out, env, seed, MEDIUM_FILE), medium)
                    _replace(out, [one])
                    say(f"{env}, agent {seed}: {_told(_measured(one))}, medium {one.medium_return:.1f}")
            _number(out, env, list(done.values()))
        names = [CANDIDATES, *sorted(path.name for path in out.iterdir() if _EXPERT.fullmatch(path.name))]
        write_atomic(out / SUMS, as_lines((sha256(out / name), name) for name in names))


def train_for_runs(envs: Sequence[str], seeds: Sequence[int], budget: str) -> None:
    """Trains the experts that runs with this budget use in tasks of which none are shipped, as far as the
    cache lacks them, and says what they reach on episodes that nothing else uses."""
    conditions = Conditions(budget, "absorbing", "sbx")
    held_out = held_out_seeds(JUDGED)
    for env in envs:
        spec = SPECS[env]
        random = measure(spec, _random(spec), held_out)
        for seed in seeds:
            expert = expert_for(env, seed, conditions)
            reached = (
                f"{_told(measure(spec, expert.policy, held_out))}, a random policy {random.mean_return:.2f}"
            )
            say(f"{env}, seed {seed}: {reached}; {expert.env_steps:,} steps of RL in {expert.seconds:.0f} s")


def _random(spec: EnvSpec) -> Policy:
    rng = rng_for(0, spec.name, "held out")
    return lambda obs: spec.random_actions(len(obs), rng)


def _shipped(env: str) -> Shipped:
    """Raises BadInput where the task has none."""
    if (shipped := SPECS[env].shipped) is None:
        raise BadInput(f"{env} has no experts that are shipped")
    return shipped


def _unnumbered(out: Path, env: str, seed: int, kind: str) -> Path:
    """The file of an agent that has no number yet. kind: '' or `MEDIUM_FILE`."""
    return out / f".{env}__seed{seed}{kind}.safetensors"


def _set_aside(out: Path, env: str) -> list[Candidate]:
    """A task's agents, all without a number, but for those that would do and whose files are gone."""
    mine = [one for one in _candidates(out) if one.env == env]
    for one in mine:
        for kind in ("", MEDIUM_FILE) if one.number else ():
            with suppress(FileNotFoundError):
                (out / f"{env}__{one.number}{kind}.safetensors").replace(
                    _unnumbered(out, env, one.seed, kind)
                )
    mine = [one._replace(number="") for one in mine]
    _replace(out, mine)
    files = {one.seed: [_unnumbered(out, env, one.seed, kind) for kind in ("", MEDIUM_FILE)] for one in mine}
    return [one for one in mine if not is_good(one) or all(file.is_file() for file in files[one.seed])]


def _number(out: Path, env: str, mine: list[Candidate]) -> None:
    """The first that meet the bar, in the order of their seeds, become experts 0, 1, ...; others go."""
    count = _shipped(env).experts
    good = [one for one in sorted(mine, key=lambda one: one.seed) if is_good(one)][:count]
    if len(good) < count:
        raise BadInput(f"{env}: {len(good)} of {len(mine)} agents meet the bar, {count} are needed")
    for number, one in enumerate(good):
        for kind in ("", MEDIUM_FILE):
            _unnumbered(out, env, one.seed, kind).replace(out / f"{env}__{number}{kind}.safetensors")
    _replace(out, [one._replace(number=str(number)) for number, one in enumerate(good)])
    for one in mine:
        for kind in ("", MEDIUM_FILE):
            _unnumbered(out, env, one.seed, kind).unlink(missing_ok=True)


def check(envs: tuple[str, ...], where: Path) -> bool:
    """Says what each expert in the folder `where` reaches on episodes that nothing else uses. Returns whether
    all meet their bar. Raises BadInput where a task has none there, or one is damaged."""
    files = {env: sorted(where.glob(f"{env}__*.safetensors")) for env in envs}
    for env in envs:
        if not files[env]:
            raise BadInput(f"{where} holds no experts of {env}")
    missed = []
    for env in envs:
        spec = SPECS[env]
        for path in files[env]:
            found = load(path)
            if found is None:
                raise BadInput(f"{path} is damaged")
            seeds = held_out_seeds(_shipped(env).episodes)
            measured = measure(spec, Network.from_arrays(found.arrays), seeds)
            good = found.facts["kind"] == "medium" or meets_bar(spec, measured)
            missed += [] if good else [path.name]
            say(f"{path.name}: {_told(measured)}{'' if good else ' MISSED'}")
    if missed:
        tell(f"MISSED: {', '.join(missed)}: below the bar of their task")
    return not missed


def is_good(one: Candidate) -> bool:
    """Whether it may become an expert, by its tuning episodes, and has a medium one."""
    share = (one.medium_return - one.random_return) / (one.mean_return - one.random_return)
    both = (
        meets_bar(SPECS[one.env], Measured(one.mean_return, t), MARGIN)
        for t in (one.terminated, one.confirmed)
    )
    return all(both) and abs(share - MEDIUM) <= MEDIUM_OFF


def _measured(one: Candidate) -> Measured:
    return Measured(one.mean_return, one.terminated)


def _told(measured: Measured) -> str:
    return f"mean return {measured.mean_return:.2f}, {measured.terminated:.1%} ended early"


def _is_list(data: bytes) -> bool:
    """Whether it is what `candidates.csv` may hold."""
    try:
        _parsed(data)
    except ValueError:
        return False
    return True


def _parsed(data: bytes) -> list[Candidate]:
    """Raises ValueError for anything else."""
    header, *lines = csv.reader(io.StringIO(data.decode()))
    if tuple(header) != Candidate._fields:
        raise ValueError("other columns")
    return msgspec.convert(lines, list[Candidate], strict=False)


def _candidates(out: Path) -> list[Candidate]:
    return _parsed(read(out / CANDIDATES))


def _replace(out: Path, ones: list[Candidate]) -> None:
    """Writes them into the list, in the place of those of the same task and seed."""
    agents = {(one.env, one.seed): one for one in [*_candidates(out), *ones]}
    write_atomic(out / CANDIDATES, _as_text(sorted(agents.values())))


def _as_text(candidates: list[Candidate]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(Candidate._fields)
    writer.writerows(candidates)
    return text.getvalue()
