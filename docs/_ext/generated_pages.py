"""Writes the pages of methods, tasks and the API before Sphinx reads anything, from the registry, docstrings,
specs and the reference boards. They are in no commit, so none can be out of date."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path

from sphinx.application import Sphinx

TITLES = {
    "harness.api.frames": "Runs",
    "harness.api.exported": "What was learned, in other programs",
    "methods.base": "Methods",
    "methods.network": "Networks",
    "methods.rewards": "Rewards",
    "envs": "Tasks",
    "envs.spec": "Parts of a task",
    "envs.learners": "Learners",
    "harness.registry.contract": "The contract",
}
"""Titles of the modules that define public names, in the order of the page."""


FINDINGS = "results/reference/thesis/FINDINGS.md"
"""Equations of the thesis, which have a page of their own here."""


def write(app: Sphinx) -> None:
    here = Path.cwd()
    os.chdir(Path(__file__).parents[2])
    try:
        import method_pages
        import task_pages

        found = {"methods": method_pages.pages(), "tasks": task_pages.pages(), "api": {"irl_bench": api()}}
        found["thesis"] = {"findings": (Path.cwd() / FINDINGS).read_text(encoding="utf-8")}
    finally:
        os.chdir(here)
    for folder, pages in found.items():
        where = Path(app.srcdir) / folder
        where.mkdir(exist_ok=True)
        for old in where.glob("*.md"):
            if old.stem not in pages:
                old.unlink()
        for name, text in pages.items():
            file = where / f"{name}.md"
            if not file.exists() or file.read_text(encoding="utf-8") != text:
                file.write_text(text, encoding="utf-8")


def relink(app: Sphinx, docname: str, source: list[str]) -> None:
    """Links to the thesis's findings lead to their page."""
    source[0] = source[0].replace(f"](../{FINDINGS}", "](thesis/findings.md")


def api() -> str:
    """A directive for each public name."""
    import irl_bench

    homes: dict[str, list[str]] = {module: [] for module in TITLES}
    for name, module in irl_bench.WHERE.items():
        homes[module].append(name)
    parts = ["# API: irl_bench", "All that a plug-in, a notebook or another program needs, under one name."]
    for module, names in homes.items():
        parts.append(f"## {TITLES[module]}")
        for name in sorted(names):
            its = getattr(irl_bench, name)
            directive = "autoclass" if isinstance(its, type) else "autofunction"
            options = ["   :members:", "   :undoc-members:"] if isinstance(its, type) else []
            made_by_fields = dataclasses.is_dataclass(its) or getattr(its, "_is_protocol", False)
            options += ["   :exclude-members: __init__"] * made_by_fields
            lines = "\n".join(["```{eval-rst}", f".. {directive}:: irl_bench.{name}", *options, "```"])
            parts.append(lines)
    return "\n\n".join(parts) + "\n"


def setup(app: Sphinx) -> dict[str, bool]:
    app.connect("builder-inited", write)
    app.connect("source-read", relink)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
