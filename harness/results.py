"""What a run produces: cells, their rows and curves, and the layout of a run's directory.

DIR/run.json               the request: methods, envs, seeds, conditions, and the format's version
DIR/cells/*.json           one file a finished cell; everything below is rebuilt from these
DIR/scores.csv             one row per (env, method, seed, policy)
DIR/leaderboard.csv, .md   aggregated over seeds
DIR/report.html, figures/  the report
DIR/report.key             from which cells, and by which version of the program, those were rebuilt
DIR/recordings/*.rrd       rerun recordings
DIR/SHA256SUMS             checksums of the tables, the report and its figures, as of sha256sum
DIR/run.log                what the cells' processes print, full tracebacks included
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from typing import Any, Literal

FORMAT = 4
"""Version of the directory layout; a run of another version is refused."""

Status = Literal["ok", "skipped", "failed"]
PolicyName = Literal["expert", "random", "pi_star", "pi_R"]
Library = Literal["sbx", "sb3"]
LIBRARIES: tuple[Library, ...] = ("sbx", "sb3")
PROTOCOLS = ("absorbing", "native")
LOWER_CONTROLS = ("control_plus1", "control_minus1", "control_untrained")
CONTROLS = ("control_true", *LOWER_CONTROLS, "control_survival", "control_shuffled")
REFERENCE = "reference"
"""The method of the rows of the expert and of the random policy."""


@dataclass(frozen=True)
class Conditions:
    """What all cells of a run are computed under."""

    budget: str
    protocol: str
    rl: Library
    """Whose DDPG learns."""
    deterministic: bool = False
    """Whether libraries are kept from choosing their instructions by the processor."""


@dataclass(frozen=True, order=True)
class Cell:
    """One unit of work: a method (or control, or the reference) in an env under a seed."""

    env: str
    method: str
    seed: int

    @property
    def name(self) -> str:
        return f"{self.env}__{self.method}__seed{self.seed}"


@dataclass(frozen=True)
class Row:
    """One row of scores.csv. Numbers are NaN unless status is 'ok'."""

    env: str
    method: str
    seed: int
    policy: PolicyName
    protocol: str
    status: Status = "ok"
    reason: str = ""
    """Why it was skipped or failed."""
    episodes: int = 0
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
    advantage_correlation: float = math.nan
    """Of pi_R rows: Spearman's, of the reward with the true advantage (`harness.advantage`)."""
    fit_seconds: float = math.nan
    """Wall time of what made this policy: `fit` for pi_star, RL on R* for pi_R."""
    env_steps: int = 0
    """Environment steps that it took, rollouts and checkpoint selection included."""
    rl_steps: int = 0
    """Those among them that RL learned from."""
    rl_solves: int = 0


COLUMNS = tuple(f.name for f in dataclasses.fields(Row))


@dataclass(frozen=True)
class CellResult:
    """What one cell found."""

    cell: Cell
    rows: list[Row]
    curves: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    """Training curves by name, as (x, y) points. 'pi_R' and 'expert' are RL learning curves:
    x environment steps, y mean return under the reward that was learned from, at each checkpoint; 'pi_R_true'
    is the true return of the same episodes."""
    endings: dict[str, dict[str, int]] = field(default_factory=dict)
    """For each policy, how many evaluation episodes ended for which reason."""
    warnings: list[str] = field(default_factory=list)
    """What the user must be told, such as an expert that misses its bar."""
    recordings: dict[str, str] = field(default_factory=dict)
    """SHA-256 of each recording that was made, by its file's name."""
    key: str = ""
    """Of all that can change it (`harness.keys`); given when it is stored."""
    origin: dict[str, str] = field(default_factory=dict)
    """The machine and the versions that it was computed with; given when it is stored."""

    def to_json(self) -> dict[str, Any]:
        return dataclasses.asdict(self)

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> CellResult:
        """Raises KeyError or TypeError where `data` is not such a result."""
        rows = []
        for row in data["rows"]:
            values: dict[str, Any] = {k: math.nan if v is None else v for k, v in row.items()}
            rows.append(Row(**values))
        curves = {name: [(x, y) for x, y in points] for name, points in data["curves"].items()}
        rest = [data[name] for name in ("endings", "warnings", "recordings", "key", "origin")]
        return cls(Cell(**data["cell"]), rows, curves, *rest)
