"""The data model of a run: its request, cells, rows and results, and the layout of its directory.

DIR/run.sqlite             The request, each cell's result, what it learned, and the baseline's cells.
DIR/scores.csv             One row per (env, method, seed, policy). This and the next are rebuilt from it.
DIR/leaderboard.csv, .md   Means over seeds.
DIR/report.html            The report.
DIR/recordings/*.rrd       Recordings of rerun; ENV__compare.rrd is rebuilt.
DIR/SHA256SUMS             Checksums, as of sha256sum, of tables, report and recordings.
DIR/run.log                The output of the cells' processes, with full tracebacks.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field, fields
from typing import Annotated, Any, Literal

from msgspec import Meta

from harness.registry.bounds import (
    LONGEST_TEXT,
    MOST_CURVES,
    MOST_DETAILS,
    MOST_EPISODES,
    MOST_SOLVES,
    Count,
    Curve,
    Endings,
    FileName,
    LongText,
    Name,
    Seconds,
    Seed,
    Settings,
    Text,
)
from harness.registry.names import Demonstrator, Experts, LearnerName, Library, Record

Status = Literal["ok", "skipped", "failed"]
PolicyName = Literal["expert", "demonstrations", "random", "pi_star", "pi_R"]

PROGRAM_NAME = "irl-bench"
REFERENCE = "reference"
"""The method of the expert's and the random policy's rows."""
LOWER_CONTROLS = ("control_plus1", "control_minus1", "control_untrained")
CONTROLS = ("control_true", *LOWER_CONTROLS, "control_survival", "control_shuffled", "control_clone")
CONTROL_METHODS = {"control_shuffled": "shaped", "control_clone": "bc"}
"""Methods that fit controls."""
UNSHOWN = (REFERENCE, "control_true", "control_plus1", "control_minus1", "control_survival")
"""Methods that see no demonstrations."""
NOMINAL = "nominal"
"""The dynamics of a task itself; its variants have others."""
LEARNED, RESULT = "learned", "result"
"""Names of a cell's inputs that are the artifact and the result of the cell before it."""
RECORDED = ("median", "worst", "", *(f"episode_{number}" for number in range(MOST_EPISODES)))
"""Recorded episodes; '' is the first one, in older runs."""
Recordings = Annotated[dict[FileName, Text], Meta(max_length=2 * len(RECORDED))]


@dataclass(frozen=True)
class Conditions:
    """Settings that all cells of a run share."""

    budget: Name
    protocol: Name
    rl: Library
    """The library of RL's learners."""
    deterministic: bool = True
    """True where libraries may not choose their instructions by the processor."""
    experts: Experts = "shipped"
    """Demonstrators: shipped experts, or one trained for each seed; 'none': demonstrations score 1."""
    record: Record = "both"
    """Recorded evaluation episodes of seed 0's policies. Older runs have 'first'."""
    retrain: bool = True
    """True where there are pi_R, and so controls, beside pi_star."""
    demonstrations: Text = ""
    """The digest and size of a file of demonstrations, if any."""
    learner: LearnerName = "own"
    """The learner of all RL: each task's own, or DDPG."""
    solves: Annotated[int, Meta(ge=0, le=MOST_SOLVES)] = 0
    """Independent solves of a learned reward; 0: the task's number at the budget."""
    env_kwargs: LongText = ""
    """Arguments of tasks that are known by their id in Gymnasium, as JSON, if any."""
    env_vars: LongText = ""
    """Variables of the environment that plug-ins get, with their values, as JSON, if any."""
    encoder: Text = ""
    """The encoder of images (`envs.encoders`), '' for the task's own."""

    def in_words(self, name: str) -> str:
        """Return a field's value as text for people."""
        value = getattr(self, name)
        if name == "solves" and not value:
            return "by task and budget"
        return "none" if value == "" else str(value)


@dataclass(frozen=True, order=True)
class Shown:
    """The demonstrations that a method sees."""

    demos: Count = 0
    """Episodes; 0: the budget's number."""
    every: Annotated[int, Meta(ge=1, le=10**6)] = 1
    """The distance between shown steps; above 1, pairs of observation and action are shown."""
    demonstrator: Demonstrator = "expert"
    """The expert, a worse one, or the expert with noise on its actions."""

    def __str__(self) -> str:
        many = [f"{self.demos} demonstration{'s' * (self.demos > 1)}"] if self.demos else []
        every = [f"1 of {self.every} steps"] if self.every > 1 else []
        return ", ".join([*many, *every, *([self.demonstrator] if self.demonstrator != "expert" else [])])


ALL_SHOWN = Shown()


@dataclass(frozen=True, order=True)
class Cell:
    """One unit of work: a method, control or the reference, in an env under a seed, with what it is shown and
    the dynamics in which its result is used."""

    env: Name
    method: Name
    seed: Seed
    shown: Shown = ALL_SHOWN
    dynamics: Name = NOMINAL

    @property
    def task(self) -> str:
        """The env, and its dynamics where they are a variant's."""
        return self.env if self.dynamics == NOMINAL else f"{self.env}.{self.dynamics}"

    @property
    def name(self) -> str:
        """The cell in the names of its files."""
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
    """The env's own, or the variant in which pi_star is used and pi_R trained."""
    demos: Count = 0
    """As in `Shown`, like the next two."""
    every: Count = 1
    demonstrator: Demonstrator = "expert"
    status: Status = "ok"
    reason: Text = ""
    """Why it was skipped or failed."""
    episodes: Count = 0
    return_mean: float = math.nan
    """Mean and standard deviation of the undiscounted true return over evaluation episodes."""
    return_std: float = math.nan
    discounted_mean: float = math.nan
    """Mean and standard deviation of the return discounted by the env's gamma, the thesis's measure."""
    discounted_std: float = math.nan
    length_mean: float = math.nan
    length_std: float = math.nan
    normalized_score: float = math.nan
    """(J - J_random) / (J_expert - J_random), undiscounted, once the reference cell is known."""
    reward_distance: float = math.nan
    """pi_R rows: distance of the reward from the true one, in [0, 1] (`harness.judge.advantage`)."""
    reward_floor: float = math.nan
    """pi_R rows: distance of the reward from a shaped copy of itself, ideally 0."""
    reward_rank: float = math.nan
    """pi_R rows: Spearman's correlation of the advantages under the two rewards."""
    reward_epic: float = math.nan
    """pi_R rows where the model is known: the EPIC distance, for comparison with other work."""
    policy_ranking: float = math.nan
    """pi_R rows: Spearman's correlation of policies' mean returns under the two rewards."""
    own_return: float = math.nan
    """pi_star and pi_R rows: mean undiscounted return under R* above absorption, over evaluation episodes."""
    own_return_shown: float = math.nan
    """The demonstrations' return under R*, in the same rows of methods, where every step is shown."""
    own_return_random: float = math.nan
    """The random policy's return under R*, in the same rows."""
    solves: Count = 0
    """RL solves that pi_R was chosen from; 0 in other rows."""
    solved: float = math.nan
    """pi_R rows of methods: 1 where RL solved R*, 0 where it did not (`harness.judge.evaluation`)."""
    fit_seconds: float = math.nan
    """Wall time of making this policy: `fit` for pi_star, RL on R* for pi_R."""
    env_steps: Count = 0
    """Environment steps of making it: rollouts, and steps that RL learned from."""
    check_steps: Count = 0
    """Environment steps of the episodes that check RL's checkpoints, besides."""
    rl_solves: Count = 0
    expert: Text = ""
    """The demonstrator's name (`harness.cell.experts.Expert.column`)."""
    pairs: Count = 0
    """Shown pairs of observation and action; 0 where there are none, or it is unknown."""
    source: Text = ""
    """The run that it was computed for, if another (`harness.store.baseline`)."""
    settings: LongText = ""
    """The result's `settings`, as JSON in one line; filled in where results are shown."""

    @property
    def task(self) -> str:
        """As in `Cell`."""
        return Cell(self.env, self.method, self.seed, dynamics=self.dynamics).task

    @property
    def shown(self) -> Shown:
        """As in `Cell`."""
        return Shown(self.demos, self.every, self.demonstrator)


COLUMNS = tuple(f.name for f in fields(Row))


@dataclass(frozen=True)
class Solve:
    """One RL solve of a reward. `judged`: mean return under R* over the judging episodes, NaN for a single
    solve. `own_return`, `return_mean`, `solved`: as in `Row`."""

    judged: float = math.nan
    own_return: float = math.nan
    return_mean: float = math.nan
    solved: float = math.nan


@dataclass(frozen=True)
class CellResult:
    """The result of one cell. Its store sets key, origin, finished, task_version and seconds['start']."""

    cell: Cell
    rows: Annotated[list[Row], Meta(min_length=1, max_length=2)]
    curves: Annotated[dict[Text, Curve], Meta(max_length=MOST_CURVES)] = field(default_factory=dict)
    """Training curves by name. `pi_R` and `expert` have (environment steps, mean return under the learner's
    reward) for each checkpoint, `pi_R_true` the true return, and `pi_R_chosen` the chosen point."""
    endings: dict[PolicyName, Endings] = field(default_factory=dict)
    """The number of each policy's evaluation episodes by why they ended."""
    warnings: Annotated[list[Text], Meta(max_length=100)] = field(default_factory=list)
    """Warnings for the user, such as of an expert that misses its bar."""
    recordings: Recordings = field(default_factory=dict)
    """SHA-256 of each recording, by its file's name."""
    learned: Text = ""
    """SHA-256 of what was learned (`harness.store.artifacts`), '' where nothing is stored."""
    key: Text = ""
    """The digest of all that can change it (`harness.registry.keys`)."""
    origin: Annotated[dict[Text, Text], Meta(max_length=100)] = field(default_factory=dict)
    """The machine and the versions that computed it."""
    finished: Text = ""
    """Date and time, UTC."""
    below_bar: bool = False
    """True where a reference's expert misses its bar, or scores no more than a random policy."""
    details: Annotated[dict[Text, float], Meta(max_length=MOST_DETAILS)] = field(default_factory=dict)
    """A method's numbers about its fit, by name."""
    seconds: Annotated[dict[Text, Seconds], Meta(max_length=20)] = field(default_factory=dict)
    """Wall time by stage; 'start' is the rest."""
    like: Annotated[list[Name], Meta(max_length=10)] = field(default_factory=list)
    """Built-in methods whose class a plug-in's method has or derives from."""
    task_version: Text = ""
    """The version of its task, experts and scoring (`harness.registry.keys.task_version`)."""
    solves: Annotated[list[Solve], Meta(max_length=MOST_SOLVES)] = field(default_factory=list)
    """Every RL solve of the reward, in order. pi_R is the one judged best; ties go to the first."""
    settings: Annotated[Settings, Meta(max_length=10)] = field(default_factory=dict)
    """The settings that it was computed with (`harness.cell.settings`)."""

    @property
    def has_failed(self) -> bool:
        """True where a row of it has failed."""
        return any(row.status == "failed" for row in self.rows)

    @property
    def files(self) -> dict[str, str]:
        """SHA-256 of each recording by its path in the run's directory, and of what was learned."""
        files = {f"recordings/{name}": digest for name, digest in self.recordings.items()}
        return files | ({LEARNED: self.learned} if self.learned else {})


def failed_rows(cell: Cell, protocol: str, reason: str) -> CellResult:
    """Return the result of a cell that failed."""
    columns = {"status": "failed", "reason": reason[:LONGEST_TEXT]}
    return CellResult(cell, [row_of(cell, policy, protocol, **columns) for policy in policies_of(cell)])


def row_of(cell: Cell, policy: PolicyName, protocol: str, **columns: Any) -> Row:
    """Return a row of the cell's. `columns`: the rest of it."""
    columns |= asdict(cell.shown)
    return Row(cell.env, cell.method, cell.seed, policy, protocol, cell.dynamics, **columns)


def policies_of(cell: Cell) -> tuple[PolicyName, ...]:
    """Return the policies that a cell scores."""
    if cell.method == REFERENCE:
        return ("expert", "random")
    return ("pi_R",) if cell.method in CONTROLS else ("pi_star", "pi_R")
