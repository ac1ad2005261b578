"""A request for a run, as a user states it, and the cells that it means."""

from __future__ import annotations

import json
import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from harness.api.contradictions import contradictions
from harness.process.environment import can_fix_instructions
from harness.records import Conditions, Shown
from harness.registry import (
    BUDGETS,
    DEMONSTRATORS,
    EXPERTS,
    KNOWN,
    LAST_OBSERVATIONS,
    LEARNERS,
    LIBRARIES,
    PROTOCOLS,
    RECORDS,
    SPECS,
    BadInput,
    Demonstrator,
    Experts,
    LastObservation,
    LearnerName,
    Library,
    Record,
    base,
    choose,
    configured,
    plugins,
)
from harness.registry.bounds import MOST_SEEDS
from harness.registry.gymnasium_tasks import check_kwargs, task_or_name
from harness.registry.tasks import seen_through
from harness.schedule.progress import tell
from harness.store.request import Request
from methods.base import Array

if TYPE_CHECKING:
    from harness.demonstrations.reading import Demonstrations

CHOICES = {
    "budget": BUDGETS,
    "protocol": PROTOCOLS,
    "rl": LIBRARIES,
    "learner": LEARNERS,
    "experts": EXPERTS,
    "demonstrator": DEMONSTRATORS,
    "record": RECORDS,
    "last_observation": (None, *LAST_OBSERVATIONS),
}
ITEMS: dict[str, tuple[type, ...]] = {
    **dict.fromkeys(("methods", "envs", "transfer", "env_vars", "obs_keys"), (str,)),
    **dict.fromkeys(("plugins", "baseline"), (str, Path)),
    "demos": (object,),
}
"""Fields that are lists, and what they hold."""
PLUGIN_HINT = (
    "put a class or task of yours into a file that names it in METHODS or ENVS, and the file in plugins"
)


@dataclass(frozen=True, kw_only=True)
class RunRequest:
    """A request for a run. Names, values and defaults are those of `irl-bench run` (docs/commands.md).

    Raises BadInput for a value that no run can have.
    """

    methods: Sequence[str] = ("all",)
    """Names, each with hyper-parameters or without: 'gail', 'gail(layers=(128, 128))'."""
    settings: Mapping[str, Mapping[str, object]] = field(default_factory=dict)
    """Hyper-parameters of methods, by name, for all of their rows: {'gail': {'layers': (128, 128)}}."""
    envs: Sequence[str] = ("all",)
    seeds: int | Sequence[int] | None = None
    """The number of seeds, from 0, or a list of seeds; None for one, or five at `full`."""
    budget: str = "quick"
    protocol: str = "absorbing"
    rl: Library = "sbx"
    learner: LearnerName = "own"
    solves: int = 0
    """RL solves of each learned reward; 0: the number of the task and budget."""
    encoder: str = ""
    """The encoder of images: 'small', 'nature' or 'module:Class' ; '' for each task's own."""
    experts: Experts = "shipped"
    demos: Sequence[int] = (0,)
    """Numbers of demonstrations, one after the other; 0: the number of the budget."""
    subsample: int = 1
    """The distance between shown steps."""
    demonstrator: Demonstrator = "expert"
    demos_from: Path | str | Sequence[Path | str] | None = None
    """A file of demonstrations, or several, instead of the demonstrator's."""
    action_bounds: Sequence[tuple[float, float]] | None = None
    """The lowest and highest action in that file: one pair, or a pair for each component."""
    last_observation: LastObservation | None = None
    """The treatment of episodes with as many observations as actions: 'repeat' the last one, or 'drop' the
    last action."""
    obs_keys: Sequence[str] = ()
    """Names of the file's observations, in the task's order."""
    preferences: Path | str | None = None
    """A CSV file of preferences between those demonstrations, with the columns first, second and better."""
    transfer: Sequence[str] = ()
    """Variants of the tasks in which what was learned is used, too; 'all' for every variant."""
    retrain: bool = True
    record: Record = "both"
    plugins: Sequence[Path | str] = ()
    """Files or modules with methods and tasks."""
    env_kwargs: Mapping[str, Any] = field(default_factory=dict)
    """Arguments of the tasks. No other tasks than those of Gymnasium, 'gym:ID', may be asked for then."""
    env_vars: Sequence[str] = ()
    """Names of variables of the environment that plug-ins get. Their values are stored with the run."""
    baseline: Sequence[Path | str] = ()
    """Runs, or folders of runs, that are shown beside this one."""
    fast: bool = False
    """True where libraries may choose their instructions by the processor."""

    def __post_init__(self) -> None:
        for name, kinds in ITEMS.items():
            items = getattr(self, name)
            if isinstance(items, str) or not isinstance(items, Sequence | np.ndarray):
                raise BadInput(f"{name} must be a list, not {items!r:.40}")
            for item in items:
                if not isinstance(item, kinds):
                    raise BadInput(f"{name} cannot hold {item!r:.80}; {PLUGIN_HINT}", page="plugins")
        for name, choices in CHOICES.items():
            if (value := getattr(self, name)) not in choices:
                raise BadInput(f"{name} must be one of {', '.join(map(str, choices))}, not {value!r:.40}")
        if not isinstance(self.env_kwargs, Mapping):
            raise BadInput(f"env_kwargs must be a dict of arguments by name, not {self.env_kwargs!r:.40}")
        _whole("solves", self.solves, 0)
        _whole("subsample", self.subsample, 1)
        if not [_whole("demos", number, 0) for number in self.demos]:
            raise BadInput("demos must have a number")
        _ = self.bounds, self.all_seeds

    @property
    def all_seeds(self) -> tuple[int, ...]:
        """Every seed, in ascending order."""
        if self.seeds is None:
            return tuple(range(5 if self.budget == "full" else 1))
        if isinstance(self.seeds, str) or not isinstance(self.seeds, Sequence | np.ndarray):
            return tuple(range(_whole("seeds", self.seeds, 1)))
        if not len(self.seeds):
            raise BadInput("seeds must have a number")
        return tuple(sorted({_whole("seeds", seed, 0, MOST_SEEDS - 1) for seed in self.seeds}))

    @property
    def files(self) -> tuple[Path, ...]:
        """Files of demonstrations, if any."""
        given = () if self.demos_from is None else self.demos_from
        several = given if isinstance(given, Sequence) and not isinstance(given, str) else [given]
        return tuple(Path(str(path)) for path in several)

    @property
    def bounds(self) -> Array | None:
        """The lowest and the highest actions, (2, A), or (2, 1) for all components."""
        if self.action_bounds is None:
            return None
        try:
            bounds = np.array(self.action_bounds, np.float64)
        except (TypeError, ValueError) as error:
            raise BadInput(f"action_bounds must be pairs of numbers: {error}") from error
        if bounds.ndim != 2 or bounds.shape[1] != 2 or not (bounds[:, 0] < bounds[:, 1]).all():
            raise BadInput("action_bounds must be a list of pairs, the lowest action and the highest")
        return bounds.T


def _whole(name: str, value: object, least: int, most: int = MOST_SEEDS) -> int:
    """Return a whole number in a range. Raises BadInput for anything else."""
    try:
        number = operator.index(value)  # type: ignore[arg-type]
    except TypeError as error:
        raise BadInput(f"{name} must be whole numbers, not {value!r:.40}") from error
    if isinstance(value, bool) or not least <= number <= most:
        raise BadInput(f"{name} must lie between {least} and {most}, not {value!r:.40}")
    return number


def resolve(asked: RunRequest, fixes_instructions: bool) -> tuple[Request, Demonstrations | None]:
    """Return the cells of a request, and the demonstrations of its file, if it has one.

    The plug-ins become known. `fixes_instructions`: whether the engine can fix the processor's instructions.
    Raises BadInput for unknown names, broken plug-ins, and values that contradict each other.
    """
    plugins.give(asked.env_kwargs, asked.env_vars)
    methods, envs = _names(asked)
    for contradiction in contradictions(asked, methods, envs):
        raise BadInput(contradiction)
    demonstrations = _demonstrations(asked, envs) if asked.files else None
    conditions = Conditions(
        budget=asked.budget,
        protocol=asked.protocol,
        rl=asked.rl,
        deterministic=fixes_instructions and not asked.fast and can_fix_instructions(),
        experts=asked.experts,
        record=asked.record,
        retrain=asked.retrain,
        demonstrations=str(demonstrations) if demonstrations else "",
        learner=asked.learner,
        solves=asked.solves,
        encoder="" if all(plugins.task(env).encoder == asked.encoder for env in envs) else asked.encoder,
        env_kwargs=KNOWN.env_kwargs,
        env_vars=json.dumps(KNOWN.variables, sort_keys=True) if KNOWN.variables else "",
    )
    demos = sorted({operator.index(number) for number in asked.demos})
    shown = tuple(Shown(number, asked.subsample, asked.demonstrator) for number in demos)
    variants = _variants(envs, asked.transfer) if asked.transfer else ()
    return Request(methods, envs, asked.all_seeds, conditions, shown, variants), demonstrations


def _names(asked: RunRequest) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the methods and tasks, and import those of plug-ins. Raises BadInput for unknown ones."""
    methods, envs = ",".join(asked.methods), ",".join(asked.envs)
    words = [methods, envs, *(configured.name_of(*own) for own in asked.settings.items())]
    for trouble in plugins.add([str(plugin) for plugin in asked.plugins], words):
        tell(f"not usable: {trouble}")
    chosen = KNOWN.chosen_envs(",".join(task_or_name(name.strip()) for name in envs.split(",")))
    named = KNOWN.chosen_methods(methods)
    if others := asked.settings.keys() - {*map(base, named)}:
        raise BadInput(f"settings are given of {min(others)}, which is not among the methods")
    own = [configured.name_of(name, asked.settings.get(base(name), {})) for name in named]
    named = KNOWN.chosen_methods(",".join(own))
    check_kwargs(chosen)
    return named, chosen


def _demonstrations(asked: RunRequest, envs: Sequence[str]) -> Demonstrations:
    """Return the demonstrations of a file. Raises BadInput for those that cannot be shown."""
    from harness.demonstrations.reading import read_all
    from harness.demonstrations.recording import Reading

    preferred = None if asked.preferences is None else Path(str(asked.preferences))
    how = Reading(asked.last_observation, tuple(asked.obs_keys))
    spec = seen_through(envs[0], asked.encoder)
    demonstrations = read_all(asked.files, spec, asked.bounds, how, preferred)
    path = ", ".join(map(str, asked.files))
    episodes = len(demonstrations.episodes)
    if asked.experts == "none" and demonstrations.returns is None:
        raise BadInput(f"{path} tells no rewards, so nothing would score 1; leave out --experts none")
    if asked.experts == "none" and not demonstrations.episodes.has_actions:
        raise BadInput(f"{path} has no actions to clone in the expert's place; leave out --experts none")
    if asked.experts == "none" and demonstrations.cut:
        raise BadInput(
            f"{demonstrations.cut} of the {episodes} episodes of {path} neither terminated nor "
            "last until the horizon, so what they return is no score; leave out --experts none"
        )
    if max(asked.demos) > episodes:
        raise BadInput(f"{path} has {episodes} demonstrations, not {max(asked.demos)}")
    return demonstrations


def _variants(envs: Sequence[str], names: Sequence[str]) -> tuple[str, ...]:
    """Return the tasks with other dynamics, by these names or all. Raises BadInput where tasks have none."""
    entries, theirs = KNOWN.entries["env"], KNOWN.of_plugins("env")
    try:
        known = {env: entries[env].variants if env in theirs else SPECS[env].variants for env in envs}
        variants = [f"{env}.{name}" for env in envs for name in known[env]]
    except Exception as error:  # whatever is wrong with an environment's file
        raise BadInput(f"an environment cannot be loaded: {type(error).__name__}: {error}") from error
    if not variants:
        raise BadInput(f"there are no other dynamics of {', '.join(envs)} to carry anything over to")
    named = dict.fromkeys(variant.partition(".")[2] for variant in variants)
    chosen = choose("variant", ",".join(names), named)
    if "all" not in [name.strip() for name in names]:
        for env in envs:
            if lacking := [name for name in chosen if f"{env}.{name}" not in variants]:
                tell(f"{env} has no variant {', '.join(lacking)}")
    return tuple(variant for variant in variants if variant.partition(".")[2] in chosen)
