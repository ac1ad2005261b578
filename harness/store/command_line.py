"""The command line that asks for a run."""

from __future__ import annotations

from collections.abc import Sequence

from harness.registry.known import GYMNASIUM_NAME
from harness.registry.names import BUILT_IN
from harness.store.request import Request


def as_seeds(seeds: Sequence[int]) -> str:
    """Return seeds as `--seeds` takes them: their number, where they count from 0, else ranges, '0,3,5-9'."""
    if list(seeds) == list(range(len(seeds))):
        return str(len(seeds))
    starts = [s for s in seeds if s - 1 not in seeds]
    ends = [s for s in seeds if s + 1 not in seeds]
    ranges = [f"{a}-{b}" if a < b or len(seeds) == 1 else str(a) for a, b in zip(starts, ends, strict=True)]
    return ",".join(ranges)


def command_of(request: Request, beside: bool = False) -> str:
    """Return the command line of a request, or several, joined by '&&'. `beside`: True for a run beside a
    baseline."""
    c = request.conditions
    words = ["irl-bench run", "--methods", ",".join(request.methods), "--envs", ",".join(request.envs)]
    known = {*BUILT_IN["method"], *BUILT_IN["env"]}
    others = [name for name in (*request.methods, *request.envs) if name not in known]
    words += ["--plugin", "FILE"] if any(not name.startswith(GYMNASIUM_NAME) for name in others) else []
    words += ["--seeds", as_seeds(request.seeds), "--budget", c.budget, "--protocol", c.protocol]
    words += ["--rl", c.rl]
    words += ["--learner", c.learner] if c.learner != "own" else []
    words += ["--solves", str(c.solves)] if c.solves else []
    words += ["--experts", c.experts, "--record", c.record]
    dynamics = dict.fromkeys(variant.partition(".")[2] for variant in request.variants)
    words += ["--transfer", ",".join(dynamics)] if dynamics else []
    words += ["--demos-from", "FILE"] if c.demonstrations else []
    words += ["--baseline", "DIR"] if beside else []
    words += [] if c.retrain else ["--no-retrain"]
    words += [] if c.deterministic else ["--fast"]
    many: dict[tuple[int, str], list[int]] = {}
    for shown in request.shown:
        many.setdefault((shown.every, shown.demonstrator), []).append(shown.demos)
    commands = []
    for (every, demonstrator), demos in many.items():
        more = ["--demos", ",".join(map(str, demos))] if demos != [0] else []
        more += ["--subsample", str(every)] if every > 1 else []
        more += ["--demonstrator", demonstrator] if demonstrator != "expert" else []
        commands.append(" ".join([*words, *more]))
    return " && ".join(commands)
