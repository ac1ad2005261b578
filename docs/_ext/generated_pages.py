"""Writes the pages of methods, tasks and the API before Sphinx reads anything, from the registry, docstrings,
specs and the reference boards. They are in no commit, so none can be out of date."""

from __future__ import annotations

import dataclasses
import importlib
import os
import re
from pathlib import Path

from sphinx.application import Sphinx

TITLES = {
    "harness.api.request": "Requests",
    "harness.api.preparing": "Engines",
    "harness.api.running": "Runs",
    "harness.api.results": "Results",
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


OTHERS = {
    "results/reference/thesis/FINDINGS.md": "thesis/findings",
    "results/studies/README.md": "studies/index",
    "CHANGELOG.md": "changes/index",
}
"""Pages from elsewhere, by their file, with their place here."""
MARK = re.compile(r"<!-- generated: (\w+\.\w+) -->\n.*\n<!-- end -->")
"""The place of a generated list in a page written by hand, with a line for readers of the source."""


def write(app: Sphinx) -> None:
    here = Path.cwd()
    os.chdir(Path(__file__).parents[2])
    try:
        import method_pages
        import other_code
        import task_pages

        found = {"methods": method_pages.pages(), "tasks": task_pages.pages(), "api": {"irl_bench": api()}}
        found["others"] = {"index": other_code.page()}
        for source, place in OTHERS.items():
            folder, _, name = place.partition("/")
            found[folder] = {name: moved(Path(source), folder)}
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


def moved(source: Path, folder: str) -> str:
    """Return a page's text with links as they are from a folder of docs/."""

    def relink(match: re.Match[str]) -> str:
        return f"]({Path(os.path.relpath(source.parent / match[1], f'docs/{folder}')).as_posix()}"

    return re.sub(r"\]\((?!https?:|#)([^)#]+)", relink, source.read_text(encoding="utf-8"))


def fill(app: Sphinx, docname: str, source: list[str]) -> None:
    """Put generated lists where a page has their mark, and link pages from elsewhere."""
    for file, place in OTHERS.items():
        source[0] = source[0].replace(f"](../{file}", f"]({place}.md")
    source[0] = MARK.sub(lambda match: generated(match[1]), source[0])


def generated(name: str) -> str:
    """Return the list of this name, such as 'fault_lists.lists', in Markdown."""
    module, _, function = name.partition(".")
    return str(getattr(importlib.import_module(module), function)())


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
    app.connect("source-read", fill)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
