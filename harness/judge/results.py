"""What a run produces: cells, their rows and curves, and the layout of a run's directory.

DIR/run.json               the request: methods, envs, seeds, conditions, and the format's version
DIR/cells/*.json           one file a finished cell; everything below is rebuilt from these
DIR/scores.csv             one row per (env, method, seed, policy)
DIR/leaderboard.csv, .md   aggregated over seeds
DIR/report.html, figures/  the report
DIR/report.key             from which cells, and by which version of the program, those were rebuilt, and the
                           size and digest of the list of checksums that was written then
DIR/recordings/*.rrd       rerun recordings
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
from typing import Annotated, Any, Literal

from msgspec import Meta

from harness.registry import Experts, Library, Record

FORMAT = 7
"""Version of the directory layout; a run of another version is refused."""

CONTROL_CHARACTERS = r"\x00-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff"
"""In a regular expression's brackets: what changes how text is shown, or cannot be written."""
MOST_CURVES, MOST_POINTS, LONGEST_TEXT = 30, 2000, 1000
"""Of a cell; of a curve; characters."""
LARGEST = 1e100
"""Sums and squares of numbers up to this are finite; what is larger counts as unknown, as NaN does."""
Name = Annotated[str, Meta(pattern=r"\A[A-Za-z0-9][A-Za-z0-9_.+-]*\Z", max_length=60)]
"""Of a method or an environment; a part of files' names."""
Names = Annotated[tuple[Name, ...], Meta(min_length=1, max_length=200)]
FileName = Annotated[str, Meta(pattern=r"\A[A-Za-z0-9][A-Za-z0-9_.+-]*\Z", max_length=200)]
Text = Annotated[str, Meta(pattern=rf"\A[^{CONTROL_CHARACTERS}]*\Z", max_length=LONGEST_TEXT)]
"""One line for people."""
MOST_SEEDS = 1000
"""A run's seeds lie below it."""
Seed = Annotated[int, Meta(ge=0, lt=MOST_SEEDS)]
Count = Annotated[int, Meta(ge=0, le=10**15)]
Curve = Annotated[list[tuple[float, float]], Meta(max_length=MOST_POINTS)]

Status = Literal["ok", "skipped", "failed"]
PolicyName = Literal["expert", "random", "pi_star", "pi_R"]
LOWER_CONTROLS = ("control_plus1", "control_minus1", "control_untrained")
PROGRAM_NAME = "irl-bench"
CONTROLS = ("control_true", *LOWER_CONTROLS, "control_survival", "control_shuffled", "control_clone")
CONTROL_METHODS = {"control_shuffled": "shaped", "control_clone": "bc"}
"""Methods that controls are fitted by."""
LEARNED = "learned"
"""The name of what a cell is handed over: what the cell before it learned."""
REFERENCE = "reference"
"""The method of the rows of the expert and of the random policy."""


@dataclass(frozen=True)
class Conditions:
    """What all cells of a run are computed under."""

    budget: Name
    protocol: Name
    rl: Library
    """Whose DDPG learns."""
    deterministic: bool = True
    """Whether libraries are kept from choosing their instructions by the processor."""
    experts: Experts = "shipped"
    """Whose demonstrations: the shipped experts', or those of one trained for each seed."""
    record: Record = "first"
    """Which evaluation episodes of seed 0's policies are recorded."""


@dataclass(frozen=True, order=True)
class Cell:
    """One unit of work: a method (or control, or the reference) in an env under a seed."""

    env: Name
    method: Name
    seed: Seed

    @property
    def name(self) -> str:
        return f"{self.env}__{self.method}__seed{self.seed}"


@dataclass(frozen=True)
class Row:
    """One row of scores.csv. Numbers are NaN unless status is 'ok'."""

    env: Name
    method: Name
    seed: Seed
    policy: PolicyName
    protocol: Name
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
    reward_rank: float = math.nan
    """Of pi_R rows: Spearman's correlation of the advantages under the two."""
    fit_seconds: float = math.nan
    """Wall time of what made this policy: `fit` for pi_star, RL on R* for pi_R."""
    env_steps: Count = 0
    """Environment steps that it took: rollouts, and those that RL learned from."""
    check_steps: Count = 0
    """Environment steps of the episodes by which RL's checkpoints were judged, besides."""
    rl_solves: Count = 0
    expert: Text = ""
    """Whose demonstrations (`harness.run.experts.Expert.name`)."""


COLUMNS = tuple(f.name for f in dataclasses.fields(Row))


@dataclass(frozen=True)
class CellResult:
    """What one cell found."""

    cell: Cell
    rows: Annotated[list[Row], Meta(min_length=1, max_length=2)]
    curves: Annotated[dict[Text, Curve], Meta(max_length=MOST_CURVES)] = field(default_factory=dict)
    """Training curves by name, as (x, y) points. 'pi_R' and 'expert' are RL learning curves:
    x environment steps, y mean return under the reward that was learned from, at each checkpoint; 'pi_R_true'
    is the true return of the same episodes."""
    endings: dict[PolicyName, Annotated[dict[Text, Count], Meta(max_length=100)]] = field(
        default_factory=dict
    )
    """For each policy, how many evaluation episodes ended for which reason."""
    warnings: Annotated[list[Text], Meta(max_length=100)] = field(default_factory=list)
    """What the user must be told, such as an expert that misses its bar."""
    recordings: Annotated[dict[FileName, Text], Meta(max_length=2)] = field(default_factory=dict)
    """SHA-256 of each recording that was made, by its file's name."""
    artifacts: Annotated[dict[FileName, Text], Meta(max_length=1)] = field(default_factory=dict)
    """SHA-256 of the file of what was learned, by its name."""
    key: Text = ""
    """Of all that can change it (`harness.run.keys`); given when it is stored."""
    origin: Annotated[dict[Text, Text], Meta(max_length=100)] = field(default_factory=dict)
    """The machine and the versions that it was computed with; given when it is stored."""
    finished: Text = ""
    """When it was stored: date and time, UTC; given then."""
    below_bar: bool = False
    """Of a reference: whether its expert misses its bar."""
    details: Annotated[dict[Text, float], Meta(max_length=30)] = field(default_factory=dict)
    """Numbers that a method tells of its fit, by name."""
    seconds: Annotated[dict[Text, float], Meta(max_length=20)] = field(default_factory=dict)
    """Wall time by stage, 'start' being all that is none; that one is given when it is stored."""

    @property
    def files(self) -> dict[str, str]:
        """SHA-256 of each file that it has besides its own, by the path in the run's directory."""
        folders = {"recordings": self.recordings, "artifacts": self.artifacts}
        return {f"{at}/{name}": digest for at, files in folders.items() for name, digest in files.items()}

    def to_json(self) -> dict[str, Any]:
        return dataclasses.asdict(self)


def failed_rows(cell: Cell, protocol: str, reason: str) -> CellResult:
    """The rows of a cell that failed."""
    reason = reason[:LONGEST_TEXT]
    rows = [Row(cell.env, cell.method, cell.seed, p, protocol, "failed", reason) for p in policies_of(cell)]
    return CellResult(cell, rows)


def policies_of(cell: Cell) -> tuple[PolicyName, ...]:
    """The policies that a cell scores."""
    if cell.method == REFERENCE:
        return ("expert", "random")
    return ("pi_R",) if cell.method in CONTROLS else ("pi_star", "pi_R")


def before(cell: Cell) -> Cell | None:
    """The cell whose artifact saves this one a fit, if there is one."""
    return dataclasses.replace(cell, method="bc") if cell.method == "control_clone" else None


def artifact_of(cell: Cell) -> str:
    """The file of what a cell learned, by the path in the run's directory."""
    return f"artifacts/{cell.name}.safetensors"


def files_of(cell: Cell) -> set[str]:
    """The files that a cell may have besides its own, by the path in the run's directory."""
    recordings = {f"recordings/{cell.name}__{policy}.rrd" for policy in policies_of(cell)}
    return {*recordings, artifact_of(cell)}


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

    @property
    def cells(self) -> list[Cell]:
        """Every cell, the reference and the controls included."""
        methods = (REFERENCE, *CONTROLS, *self.methods)
        return [Cell(e, m, s) for e in self.envs for m in methods for s in self.seeds]

    def asks_for(self, cell: Cell) -> bool:
        """Whether the cell is one of `cells`."""
        known = cell.method in (REFERENCE, *CONTROLS, *self.methods)
        return known and cell.env in self.envs and cell.seed in self.seeds


def as_seeds(seeds: Sequence[int]) -> str:
    """As `--seeds` takes them: how many, where they are those from 0; else numbers and ranges, '0,3,5-9'."""
    if list(seeds) == list(range(len(seeds))):
        return str(len(seeds))
    starts = [s for s in seeds if s - 1 not in seeds]
    ends = [s for s in seeds if s + 1 not in seeds]
    ranges = [f"{a}-{b}" if a < b or len(seeds) == 1 else str(a) for a, b in zip(starts, ends, strict=True)]
    return ",".join(ranges)


def command_of(request: Request) -> str:
    """The command line that asks for all of it at once."""
    c = request.conditions
    words = ["irl-bench run", "--methods", ",".join(request.methods), "--envs", ",".join(request.envs)]
    words += ["--seeds", as_seeds(request.seeds), "--budget", c.budget, "--protocol", c.protocol]
    words += ["--rl", c.rl]
    words += ["--experts", c.experts, "--record", c.record]
    return " ".join([*words, *([] if c.deterministic else ["--fast"])])
