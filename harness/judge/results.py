"""What a run produces: cells, their rows and curves, and the layout of a run's directory.

DIR/run.json               the request: methods, envs, seeds, conditions, and the format's version
DIR/cells/*.json           one file a finished cell; everything below is rebuilt from these
DIR/baseline/*.json        cells of other runs that this one is shown beside, where it has any
DIR/scores.csv             one row per (env, method, seed, policy)
DIR/leaderboard.csv, .md   aggregated over seeds
DIR/report.html, figures/  the report
DIR/report.key             from which cells, and by which version of the program, those were rebuilt, and the
                           size and digest of the list of checksums that was written then
DIR/recordings/*.rrd       rerun recordings, ENV__compare.rrd being rebuilt
DIR/artifacts/*.safetensors  what each cell learned (`harness.run.artifacts`)
DIR/SHA256SUMS             checksums, as of sha256sum, of all of these but run.json, which has its own; where
                           a file is listed twice, the last line counts
DIR/run.log                what the cells' processes print, full tracebacks included

Types say what a directory may hold that a stranger made; `harness.run.codec` checks them.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, TypeVar

from msgspec import Meta

from harness.registry.names import Demonstrator, Experts, LearnerName, Library, Record

Point = TypeVar("Point")

FORMATS = (7, 8)
"""Versions of the directory layout that are read; the first is written where it can hold the run."""

CONTROL_CHARACTERS = r"\x00-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff"
"""In a regular expression's brackets: what changes how text is shown, or cannot be written."""
MOST_CURVES, MOST_POINTS, MOST_SOLVES, LONGEST_TEXT = 30, 2000, 1000, 1000
"""Of a cell; of a curve; of a reward; characters."""
LARGEST = 1e100
"""Sums and squares of numbers up to this are finite; what is larger counts as unknown, as NaN does."""
Name = Annotated[str, Meta(pattern=r"\A[A-Za-z0-9][A-Za-z0-9_.+-]*\Z", max_length=60)]
"""Of a method or an environment; a part of files' names."""
Names = Annotated[tuple[Name, ...], Meta(min_length=1, max_length=200)]
FileName = Annotated[str, Meta(pattern=r"\A[A-Za-z0-9][A-Za-z0-9_.+-]*\Z", max_length=200)]
Seconds = Annotated[float, Meta(ge=0)]
Text = Annotated[str, Meta(pattern=rf"\A[^{CONTROL_CHARACTERS}]*\Z", max_length=LONGEST_TEXT)]
"""One line for people."""
MOST_SEEDS = 1000
"""A run's seeds lie below it."""
Seed = Annotated[int, Meta(ge=0, lt=MOST_SEEDS)]
Count = Annotated[int, Meta(ge=0, le=10**15)]
Curve = Annotated[list[tuple[float, float]], Meta(max_length=MOST_POINTS)]

Status = Literal["ok", "skipped", "failed"]
PolicyName = Literal["expert", "demonstrations", "random", "pi_star", "pi_R"]
LOWER_CONTROLS = ("control_plus1", "control_minus1", "control_untrained")
PROGRAM_NAME = "irl-bench"
CONTROLS = ("control_true", *LOWER_CONTROLS, "control_survival", "control_shuffled", "control_clone")
CONTROL_METHODS = {"control_shuffled": "shaped", "control_clone": "bc"}
"""Methods that controls are fitted by."""
MOST_EPISODES = 100
"""Recorded of a policy."""
RECORDED = ("median", "worst", "", *(f"episode_{number}" for number in range(MOST_EPISODES)))
"""Which episode a recording is of; the third is an earlier version's first one."""
COMPARE = "compare"
"""How the name ends of a recording of all methods on one episode."""
Recordings = Annotated[dict[FileName, Text], Meta(max_length=2 * len(RECORDED))]
LEARNED = "learned"
"""The name of what a cell is handed over: what the cell before it learned."""
REFERENCE = "reference"
"""The method of the rows of the expert and of the random policy."""
NOMINAL = "nominal"
"""The dynamics of a task as they are; others are those of its variants."""
UNSHOWN = (REFERENCE, "control_true", "control_plus1", "control_minus1", "control_survival")
"""What no demonstrations are shown to."""


@dataclass(frozen=True)
class Conditions:
    """What all cells of a run are computed under."""

    budget: Name
    protocol: Name
    rl: Library
    """Whose learners learn."""
    deterministic: bool = True
    """Whether libraries are kept from choosing their instructions by the processor."""
    experts: Experts = "shipped"
    """Whose demonstrations: the shipped experts', or those of one trained for each seed; none: there is no
    expert, and a score of 1 is what the demonstrations of a file return."""
    record: Record = "both"
    """Which evaluation episodes of seed 0's policies are recorded: the median and the worst, one of those,
    all or none. Runs of earlier versions say 'first'."""
    retrain: bool = True
    """Whether there are pi_R, and so controls; or pi_star alone."""
    demonstrations: Text = ""
    """Where they were given in a file: the digest of what it holds, and how much that is."""
    learner: LearnerName = "own"
    """The learner of all RL of the run: each task's own, or DDPG."""
    solves: Annotated[int, Meta(ge=0, le=MOST_SOLVES)] = 0
    """Independent solves of a learned reward; 0: as many as the task has at the budget."""

    def in_words(self, name: str) -> str:
        """Return the value of a field as people are told it."""
        value = getattr(self, name)
        if name == "solves" and not value:
            return "by task and budget"
        return "none" if value == "" else str(value)


@dataclass(frozen=True, order=True)
class Shown:
    """What is shown of an expert."""

    demos: Count = 0
    """Episodes; 0: as many as the budget says."""
    every: Annotated[int, Meta(ge=1, le=10**6)] = 1
    """Of whose steps every so-many-th is shown, as a pair of observation and action."""
    demonstrator: Demonstrator = "expert"
    """Who is shown: the expert, a worse one, or the expert with noise on its actions."""

    def __str__(self) -> str:
        many = [f"{self.demos} demonstration{'s' * (self.demos > 1)}"] if self.demos else []
        every = [f"1 of {self.every} steps"] if self.every > 1 else []
        return ", ".join([*many, *every, *([self.demonstrator] if self.demonstrator != "expert" else [])])


ALL_SHOWN = Shown()


@dataclass(frozen=True, order=True)
class Cell:
    """One unit of work: a method (or control, or the reference) in an env under a seed; with what is shown to
    it, and the dynamics in which what it learned is used."""

    env: Name
    method: Name
    seed: Seed
    shown: Shown = ALL_SHOWN
    dynamics: Name = NOMINAL

    @property
    def task(self) -> str:
        """The env, and its dynamics where they are not its own."""
        return self.env if self.dynamics == NOMINAL else f"{self.env}.{self.dynamics}"

    @property
    def name(self) -> str:
        shown = self.shown
        parts = [self.task, self.method, f"seed{self.seed}"]
        parts += [f"{shown.demos}_demos"] if shown.demos else []
        parts += [f"every_{shown.every}"] if shown.every > 1 else []
        parts += [shown.demonstrator] if shown.demonstrator != "expert" else []
        return "__".join(parts)


@dataclass(frozen=True)
class Row:
    """One row of scores.csv. Numbers are NaN unless status is 'ok'."""

    env: Name
    method: Name
    seed: Seed
    policy: PolicyName
    protocol: Name
    dynamics: Name = NOMINAL
    """Those of the env as it is, or the variant in which pi_star is used and pi_R trained."""
    demos: Count = 0
    """Demonstrations that were asked for; 0: as many as the budget says."""
    every: Count = 1
    """Of whose steps every so-many-th was shown."""
    demonstrator: Demonstrator = "expert"
    """Who was shown."""
    status: Status = "ok"
    reason: Text = ""
    """Why it was skipped or failed."""
    episodes: Count = 0
    return_mean: float = math.nan
    """Undiscounted true return over the evaluation episodes: mean and standard deviation."""
    return_std: float = math.nan
    discounted_mean: float = math.nan
    """True return discounted with the env's gamma, the thesis's measure."""
    discounted_std: float = math.nan
    length_mean: float = math.nan
    length_std: float = math.nan
    normalized_score: float = math.nan
    """(J - J_random) / (J_expert - J_random), undiscounted; known once the env's reference cell is."""
    reward_distance: float = math.nan
    """Of pi_R rows: how far the reward is from the true one, in [0, 1] (`harness.judge.advantage`)."""
    reward_floor: float = math.nan
    """Of pi_R rows: the distance of the reward from a shaped copy of itself, which ought to be 0."""
    reward_rank: float = math.nan
    """Of pi_R rows: Spearman's correlation of the advantages under the two."""
    reward_epic: float = math.nan
    """Of pi_R rows, where the model is known: the EPIC distance, for comparison with other work."""
    policy_ranking: float = math.nan
    """Of pi_R rows: that of policies' mean returns under the two (`harness.judge.ranking`)."""
    own_return: float = math.nan
    """Of pi_star and pi_R rows: mean undiscounted return under R* over the evaluation episodes, counted from
    what absorption pays."""
    own_return_shown: float = math.nan
    """Of the same rows of methods: that of the demonstrations, where every step of theirs is shown."""
    own_return_random: float = math.nan
    """The random policy's return under R*, over the same evaluation episodes, in the same rows."""
    solves: Count = 0
    """Number of RL solves that pi_R was chosen from; 0 in other rows."""
    solved: float = math.nan
    """1 where RL solved R*, 0 where it did not, in pi_R rows of methods (`harness.judge.solved`)."""
    fit_seconds: float = math.nan
    """Wall time of what made this policy: `fit` for pi_star, RL on R* for pi_R."""
    env_steps: Count = 0
    """Environment steps that it took: rollouts, and those that RL learned from."""
    check_steps: Count = 0
    """Environment steps of the episodes by which RL's checkpoints were judged, besides."""
    rl_solves: Count = 0
    expert: Text = ""
    """Whose demonstrations (`harness.run.experts.Expert.name`)."""
    pairs: Count = 0
    """Pairs of observation and action that were shown; 0 where none were, or it is not known."""
    source: Text = ""
    """Where it comes from, where it was not computed for this run (`harness.run.baseline`)."""

    @property
    def task(self) -> str:
        """As of `Cell`."""
        return Cell(self.env, self.method, self.seed, dynamics=self.dynamics).task

    @property
    def shown(self) -> Shown:
        """As of `Cell`."""
        return Shown(self.demos, self.every, self.demonstrator)


COLUMNS = tuple(f.name for f in dataclasses.fields(Row))


@dataclass(frozen=True)
class Solve:
    """One RL solve of a reward. judged: mean return under R* over the judging episodes, NaN where no other
    solve is compared. own_return, return_mean, solved: as of `Row`."""

    judged: float = math.nan
    own_return: float = math.nan
    return_mean: float = math.nan
    solved: float = math.nan


@dataclass(frozen=True)
class CellResult:
    """What one cell found."""

    cell: Cell
    rows: Annotated[list[Row], Meta(min_length=1, max_length=2)]
    curves: Annotated[dict[Text, Curve], Meta(max_length=MOST_CURVES)] = field(default_factory=dict)
    """Training curves by name, as (x, y) points. 'pi_R' and 'expert' are RL learning curves:
    x environment steps, y mean return under the reward that was learned from, at each checkpoint; 'pi_R_true'
    is the true return of the same episodes, and 'pi_R_chosen' the point of 'pi_R' whose policy is pi_R."""
    endings: dict[PolicyName, Annotated[dict[Text, Count], Meta(max_length=100)]] = field(
        default_factory=dict
    )
    """For each policy, how many evaluation episodes ended for which reason."""
    warnings: Annotated[list[Text], Meta(max_length=100)] = field(default_factory=list)
    """What the user must be told, such as an expert that misses its bar."""
    recordings: Recordings = field(default_factory=dict)
    """SHA-256 of each recording that was made, by its file's name."""
    artifacts: Annotated[dict[FileName, Text], Meta(max_length=1)] = field(default_factory=dict)
    """SHA-256 of the file of what was learned, by its name."""
    key: Text = ""
    """Of all that can change it (`harness.registry.keys`); given when it is stored."""
    origin: Annotated[dict[Text, Text], Meta(max_length=100)] = field(default_factory=dict)
    """The machine and the versions that it was computed with; given when it is stored."""
    finished: Text = ""
    """When it was stored: date and time, UTC; given then."""
    below_bar: bool = False
    """Of a reference: whether its expert misses its bar."""
    details: Annotated[dict[Text, float], Meta(max_length=30)] = field(default_factory=dict)
    """Numbers that a method tells of its fit, by name."""
    seconds: Annotated[dict[Text, Seconds], Meta(max_length=20)] = field(default_factory=dict)
    """Wall time by stage, 'start' being all that is none; that one is given when it is stored."""
    like: Annotated[list[Name], Meta(max_length=10)] = field(default_factory=list)
    """Built-in methods whose class a plug-in's method has, or derives from; one is enough to compare with."""
    task_version: Text = ""
    """Of its task, the experts and how policies are scored (`harness.registry.keys.task_version`); given when
    it is stored."""
    solves: Annotated[list[Solve], Meta(max_length=MOST_SOLVES)] = field(default_factory=list)
    """Every RL solve of the reward, in order. pi_R is the one that was judged best, of equals the first."""

    @property
    def files(self) -> dict[str, str]:
        """SHA-256 of each file that it has besides its own, by the path in the run's directory."""
        folders = {"recordings": self.recordings, "artifacts": self.artifacts}
        return {f"{at}/{name}": digest for at, files in folders.items() for name, digest in files.items()}


def failed_rows(cell: Cell, protocol: str, reason: str) -> CellResult:
    """The rows of a cell that failed."""
    reason = reason[:LONGEST_TEXT]
    rows = [row_of(cell, p, protocol, status="failed", reason=reason) for p in policies_of(cell)]
    return CellResult(cell, rows)


def thinned(points: Sequence[Point], most: int) -> list[Point]:
    """So many of them, at equal distances, with the first and the last; all where there are no more."""
    kept = min(len(points), most)
    return [points[i * (len(points) - 1) // max(1, kept - 1)] for i in range(kept)]


def row_of(cell: Cell, policy: PolicyName, protocol: str, **columns: Any) -> Row:
    """A row of the cell's."""
    asked = dataclasses.asdict(cell.shown)
    return Row(cell.env, cell.method, cell.seed, policy, protocol, cell.dynamics, **asked, **columns)


def policies_of(cell: Cell) -> tuple[PolicyName, ...]:
    """The policies that a cell scores."""
    if cell.method == REFERENCE:
        return ("expert", "random")
    return ("pi_R",) if cell.method in CONTROLS else ("pi_star", "pi_R")


def takes_one_solve(cell: Cell) -> bool:
    """Return whether RL solves its reward once, or has none to solve, however many solves are asked for."""
    return cell.method in (REFERENCE, *CONTROLS) or cell.dynamics != NOMINAL


def before(cell: Cell) -> Cell | None:
    """The cell whose artifact saves this one a fit, if there is one."""
    if cell.method == "control_clone":
        return dataclasses.replace(cell, method="bc", dynamics=NOMINAL)
    fitted = cell.dynamics != NOMINAL and cell.method not in UNSHOWN
    return dataclasses.replace(cell, dynamics=NOMINAL) if fitted else None


def name_of(shown: Shown) -> str:
    """The name, among what cells share, of the demonstrations that are shown."""
    return f"demonstrations {shown}"


def needs(cell: Cell, name: str) -> bool:
    """Whether the cell uses what is shared under this name: of demonstrations those that it is shown."""
    is_shown = name.startswith(name_of(ALL_SHOWN))
    return not is_shown or (cell.method not in UNSHOWN and name == name_of(cell.shown))


def artifact_of(cell: Cell) -> str:
    """The file of what a cell learned, by the path in the run's directory."""
    return f"artifacts/{cell.name}.safetensors"


def files_of(cell: Cell) -> set[str]:
    """The files that a cell may have besides its own, by the path in the run's directory."""
    if cell.seed:
        return {artifact_of(cell)}
    names = {recording_of(cell, policy, which) for policy in policies_of(cell) for which in RECORDED}
    return {*(f"recordings/{name}" for name in names), artifact_of(cell)}


def recording_of(cell: Cell, policy: PolicyName, which: str) -> str:
    """The name of a recording in the run's recordings/. which: of `RECORDED`."""
    return f"{cell.name}__{policy}{which and '.'}{which}.rrd"


def compared_in(env: str) -> str:
    """The name of the recording of all methods on one episode."""
    return f"{env}__{COMPARE}.rrd"


def usable(value: float) -> bool:
    """Whether it is a number, and no larger than `LARGEST`."""
    return abs(value) <= LARGEST


@dataclass(frozen=True)
class Request:
    """What a run computes."""

    methods: Names
    envs: Names
    seeds: Annotated[tuple[Seed, ...], Meta(min_length=1, max_length=MOST_SEEDS)]
    """In ascending order."""
    conditions: Conditions
    shown: Annotated[tuple[Shown, ...], Meta(min_length=1, max_length=100)] = (ALL_SHOWN,)
    """What is shown to methods: each in turn."""
    variants: Annotated[tuple[Name, ...], Meta(max_length=1000)] = ()
    """Tasks of other dynamics that what was learned is carried over to, 'ENV.VARIANT'."""

    @property
    def _methods(self) -> tuple[str, ...]:
        controls = CONTROLS if self.conditions.retrain else ()
        return (REFERENCE, *controls, *self.methods)

    def _shown_to(self, method: str) -> tuple[Shown, ...]:
        return (ALL_SHOWN,) if method in UNSHOWN else self.shown

    def _variants(self, env: str) -> list[str]:
        return [variant for of, _, variant in (v.partition(".") for v in self.variants) if of == env]

    @property
    def cells(self) -> list[Cell]:
        """Every cell, the reference and the controls included."""
        return [
            Cell(env, method, seed, shown, dynamics)
            for env in self.envs
            for dynamics in (NOMINAL, *self._variants(env))
            for method in self._methods
            for shown in self._shown_to(method)
            for seed in self.seeds
        ]

    def asks_for(self, cell: Cell) -> bool:
        """Whether the cell is one of `cells`."""
        return (
            cell.method in self._methods
            and cell.env in self.envs
            and cell.seed in self.seeds
            and cell.shown in self._shown_to(cell.method)
            and (cell.dynamics == NOMINAL or cell.task in self.variants)
        )
