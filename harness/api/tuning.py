"""A search of methods' hyper-parameters: the same number of trials for each method, on tuning seeds, with
experts that are trained for these.

FILE             Optuna's storage: a study for each method, with its finished trials.
FILE.csv         A row for each trial, and one for each method as it is.
FILE.cells       The run that computed them.

Trials are proposed in batches. A batch depends on the trials of earlier batches alone, whatever finishes
first, so a search that was stopped goes on to the trials of an unbroken one.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from harness.api.preparing import ISOLATED, Engine, Prepared, prepare
from harness.api.request import RunRequest
from harness.api.running import Watch, cells
from harness.judge.leaderboard import scored_rows
from harness.records import CONTROLS, REFERENCE, Cell, CellResult
from harness.registry import BadInput, base, keys, plugins
from harness.registry.configured import Search, name_of, settings_in
from harness.registry.names import Sampler
from harness.registry.packages import to_install
from harness.report.tables import as_csv
from harness.schedule.progress import progress_for
from harness.store.files import write_atomic

NO_NUMBERS = "Its trials are cells of a run, which have keys of their own."

FIRST, LAST = 100, 199
"""Tuning seeds."""
BATCH = 5
"""Trials of a method that are proposed at once."""
DIGITS = 3
"""Significant digits of a proposed number, which is part of a row's name."""
ASKED = "asked"
"""The attribute of a study that holds what it is a search of."""


@dataclass(frozen=True)
class Trial:
    """A method with settings, and how it scored.

    `number`: from 0; -1 for the method as it is. `score`: the mean of pi* and, where there is one, pi_R, over
    tasks and seeds; NaN where a cell failed. `seconds`: of fits and RL.
    """

    method: str
    number: int
    name: str
    score: float
    pi_star: float
    pi_R: float
    seconds: float

    def as_options(self) -> str:
        """Return the settings as options of `run`."""
        pairs = settings_in(self.name).items()
        return " ".join(f"--set {self.method}.{field}={_option(value)}" for field, value in pairs)


def _option(value: object) -> str:
    return ",".join(map(str, value)) + "," * (len(value) == 1) if isinstance(value, tuple) else str(value)


def tune(
    asked: RunRequest,
    trials: int,
    storage: Path,
    sampler: Sampler = "tpe",
    engine: Engine = ISOLATED,
    watch: Watch = progress_for,
) -> dict[str, list[Trial]]:
    """Search the settings of the request's methods, and return the trials of each, the method as it is first.

    `trials`: of each method, those of earlier calls included. `storage`: a file, new or of such a search.
    Raises BadInput for other seeds than tuning seeds, a method without settings that are searched, and a file
    of another search, and Unfinished where the run ended early.
    """
    if wrong := [seed for seed in asked.all_seeds if not FIRST <= seed <= LAST]:
        raise BadInput(f"seed {wrong[0]} is no tuning seed: those are {FIRST} to {LAST}", "tuning")
    asked = replace(asked, experts="trained", record="none")

    def ready(asked: RunRequest) -> Prepared:
        prepared = prepare(asked, engine, storage.with_name(f"{storage.name}.cells"))
        return replace(prepared, request=replace(prepared.request, controls=False))

    prepared = ready(asked)
    plain = prepared.request.methods
    spaces = {method: plugins.searched(method) for method in plain}
    if fixed := [method for method in plain if base(method) != method or not spaces[method]]:
        raise BadInput(f"{fixed[0]} has no settings that are searched; leave it out", "tuning")
    studies = {method: _study(storage, method, _asked_of(method, prepared, sampler)) for method in plain}
    while True:
        proposed = {
            method: _proposals(study, spaces[method], sampler, trials) for method, study in studies.items()
        }
        named = [(method, _name(method, one.params), one) for method in plain for one in proposed[method]]
        before = [_named(one) for study in studies.values() for one in study.get_trials()]
        methods = [*plain, *before, *(name for _, name, _ in named)]
        found = _scored(cells(ready(replace(asked, methods=methods)), watch))
        for method, name, one in named:
            _keep(studies[method], one, found[name])
        every = {
            method: [
                found[method],
                *(replace(found[_named(one)], number=one.number) for one in study.get_trials()),
            ]
            for method, study in studies.items()
        }
        _write(storage, every)
        if not named:
            return every


def best_of(found: Mapping[str, Sequence[Trial]]) -> list[str]:
    """Return a line for each method: its best trial, the method as it is, and the options of `run`."""
    lines = []
    for method, (plain, *trials) in found.items():
        best = max(trials, key=lambda one: -np.inf if np.isnan(one.score) else one.score)
        failed = sum(np.isnan(one.score) for one in trials)
        is_better = round(best.score, 3) > round(plain.score, 3) or np.isnan(plain.score)
        lines.append(
            f"{method}: best of {len(trials)} trials {best.score:.3f}, as it is {plain.score:.3f}"
            f"{f', {failed} failed' if failed else ''}: "
            f"{best.as_options() if is_better else 'no trial is better'}"
        )
    return lines


def _study(storage: Path, method: str, asked: str) -> Any:
    """Return the study of a method. Raises BadInput where the file holds another one, or none."""
    try:
        import optuna
    except ImportError as error:
        raise BadInput(f"optuna cannot be imported: {to_install('tune')}", "tuning") from error
    from sqlalchemy import URL
    from sqlalchemy.exc import SQLAlchemyError
    from sqlalchemy.pool import NullPool

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    storage.parent.mkdir(parents=True, exist_ok=True)
    try:
        url = URL.create("sqlite", database=str(storage.absolute())).render_as_string()
        kept = optuna.storages.RDBStorage(url, engine_kwargs={"poolclass": NullPool})  # no connection stays
        study = optuna.create_study(
            storage=kept, study_name=method, direction="maximize", load_if_exists=True
        )
    except (SQLAlchemyError, RuntimeError) as error:
        raise BadInput(f"{storage} holds no search: {' '.join(str(error).split())[:200]}") from error
    there = study.user_attrs.get(ASKED, "")
    if not there:
        study.set_user_attr(ASKED, asked)
    elif there != asked:
        now, then = json.loads(asked), json.loads(there)
        differs = next(name for name in now if now[name] != then.get(name))
        raise BadInput(f"{storage} holds a search of {method} with other {differs}; give another --storage")
    return study


def _asked_of(method: str, prepared: Prepared, sampler: Sampler) -> str:
    """Return as JSON what a search is of. Where it is the same, trials can be compared."""
    request = prepared.request
    plain = [
        Cell(env, method, seed, shown)
        for env in request.envs
        for seed in request.seeds
        for shown in request.shown
    ]
    digests = keys.cell_keys(plain, request.conditions, prepared.engine.variables)
    said = {name: request.conditions.in_words(name) for name in vars(request.conditions)}
    axes = {"envs": request.envs, "seeds": request.seeds, "demos": [str(one) for one in request.shown]}
    return json.dumps({"sampler": sampler, **axes, **said, "code or packages": [*digests.values()]})


def _proposals(study: Any, space: Mapping[str, Search], sampler: Sampler, trials: int) -> list[Any]:
    """Return the trials of the latest batch that the study lacks, with values of few digits."""
    import optuna

    there = study.get_trials()
    begun = len(there) // BATCH * BATCH
    seed = zlib.crc32(f"{study.study_name} {begun}".encode())
    kinds = {"tpe": optuna.samplers.TPESampler, "random": optuna.samplers.RandomSampler}
    alone = optuna.create_study(direction="maximize", sampler=kinds[sampler](seed=seed))
    alone.add_trials(there[:begun])
    distributions = {name: _distribution(one) for name, one in space.items()}
    batch = []
    for _ in range(min(BATCH, trials - begun)):
        proposed = alone.ask(distributions).params
        values = {
            name: float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value
            for name, value in proposed.items()
        }
        batch.append(optuna.trial.create_trial(params=values, distributions=distributions, value=0.0))
    return batch[len(there) - begun :]


def _distribution(search: Search) -> Any:
    from optuna import distributions

    if search.kind == "choice":
        return distributions.CategoricalDistribution(search.values)
    low, high = map(float, search.values)
    if search.kind == "int":
        return distributions.IntDistribution(int(low), int(high), log=True)
    return distributions.FloatDistribution(low, high, log=True)


def _name(method: str, params: Mapping[str, Any]) -> str:
    """Return the name of a method with proposed values. Choices are words of names."""
    values = {name: settings_in(f"+{name}-{value}")[name] for name, value in params.items()}
    return name_of(method, values)


def _scored(results: Mapping[Cell, CellResult]) -> dict[str, Trial]:
    """Return how each method of a run scored, by its name."""
    trials, rows = dict[str, Trial](), scored_rows([*results.values()])
    failed = {cell.method for cell, result in results.items() if result.has_failed}
    for name in {cell.method for cell in results} - {REFERENCE, *CONTROLS}:
        own = [row for row in rows if row.method == name and row.status == "ok"]
        scores = {
            policy: float(np.mean(found)) if found else np.nan
            for policy in ("pi_star", "pi_R")
            for found in [[row.normalized_score for row in own if row.policy == policy]]
        }
        score = np.nan if name in failed or not own else float(np.nanmean([*scores.values()]))
        seconds = sum(row.fit_seconds for row in own)
        trials[name] = Trial(base(name), -1, name, score, scores["pi_star"], scores["pi_R"], seconds)
    return trials


def _keep(study: Any, proposed: Any, scored: Trial) -> None:
    """Store a finished trial."""
    from optuna.trial import TrialState, create_trial

    failed = np.isnan(scored.score)
    study.add_trial(
        create_trial(
            state=TrialState.FAIL if failed else TrialState.COMPLETE,
            value=None if failed else scored.score,
            params=proposed.params,
            distributions=proposed.distributions,
            user_attrs={"name": scored.name, "seconds": scored.seconds},
        )
    )


def _named(kept: Any) -> str:
    """Return the name of a stored trial's method with its settings."""
    return str(kept.user_attrs["name"])


def _write(storage: Path, trials: Mapping[str, Sequence[Trial]]) -> None:
    rows = [vars(one) for of_method in trials.values() for one in of_method]
    table = pd.DataFrame(rows).rename(columns={"number": "trial"})
    write_atomic(storage.with_name(f"{storage.name}.csv"), as_csv(table))
