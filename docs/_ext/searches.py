"""The table of a search of hyper-parameters, from the file that `tune` wrote."""

from __future__ import annotations

import pandas as pd
from boards import ROOT, table

from harness.registry.configured import settings_in

FILE = ROOT / "results/studies/swingup_search.csv"
HEADING = ("Method", "Trial", "Settings", "Score of π\\*", "Seconds")


def trials() -> str:
    """Return a line for each method as it is and for each trial, in Markdown, each method's best in bold."""
    found, lines = pd.read_csv(FILE), []
    best = found.groupby("method")["score"].transform("max")
    for one, most in zip(found.itertuples(), best, strict=True):
        settings = ", ".join(f"`{name}={value}`" for name, value in settings_in(str(one.name)).items())
        score = "failed" if pd.isna(one.score) else f"{one.score:z.2f}"
        marked = f"**{score}**" if one.score == most else score
        number = "as it is" if one.trial < 0 else one.trial
        lines.append((f"`{one.method}`", number, settings, marked, f"{one.seconds:.0f}"))
    return table(HEADING, lines)
