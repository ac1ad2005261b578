"""The table of the thesis's model and its arms, from the study of them."""

from __future__ import annotations

import pandas as pd
from boards import ROOT, table

from harness.judge.statistics import mean_interval

FILE = ROOT / "results/studies/thesis_arms.csv"
PLACES = {"star": "pi_R", "pi_R": "pi_R", "zero": "pi_R", "ddpg": "pi_R", "variant": "variant"}
"""Columns of returns, with the column of the references in the same dynamics."""
TOPS = {"pi_R": "expert", "variant": "true"}
"""References that score 1."""
REFERENCES = ("random", *TOPS.values())
HEADING = ("Task", "Arm", "Seeds", "LLᵀ shown", "LLᵀ away")
HEADING += ("π\\*", "π_R", "An end pays 0", "DDPG, `native`", "Variant", "R\\* solved")


def scores() -> pd.DataFrame:
    """Return a line for each arm, task and seed, with scores in place of returns."""
    lines = pd.read_csv(FILE).set_index(["env", "seed"])
    known = {name: its for name, its in lines.groupby("arm") if name in REFERENCES}
    found = lines[~lines["arm"].isin(REFERENCES)].copy()
    for name, place in PLACES.items():
        least, most = (known[arm][place].reindex(found.index) for arm in ("random", TOPS[place]))
        found[name] = (found[name] - least) / (most - least)
    return found.reset_index()


def arms() -> str:
    """Return means over seeds with 90 % intervals, and how many solves solved R*, in Markdown."""
    lines = []
    for (env, arm), its in scores().groupby(["env", "arm"], sort=False):
        eigenvalues = [f"{its[name].mean():.2g}" for name in ("eig_shown", "eig_away")]
        solved = ", ".join(f"{its[f'solved_{name}'].sum():.0f}" for name in ("pi_R", "zero", "variant"))
        marks = [score(its[name]) for name in PLACES]
        lines.append((f"`{env}`", f"`{arm}`", len(its), *eigenvalues, *marks, solved))
    return table(HEADING, lines)


def score(values: pd.Series[float]) -> str:
    """Return the mean and its 90 % interval; '' without values, and the mean alone of fewer than three."""
    values = values.dropna()
    if values.empty:
        return ""
    low, high = mean_interval([*values])
    return f"{values.mean():z.2f}" + (f" [{low:z.2f}, {high:z.2f}]" if len(values) > 2 else "")
