"""The lists of docs/faults.md: names of tests that inject faults, as sentences."""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).parents[2]
TESTS = ROOT / "tests/harness"
SECTIONS = {
    "Nobody's files": ("store",),
    "What others bring": ("registry", "demonstrations", "api"),
    "No false success": ("report",),
    "Limits and stops": ("engines", "process"),
    "One line, no traceback": ("cli",),
}
"""Folders of tests by the section of the page that lists them."""


def lists() -> str:
    """Return every section in Markdown: a list for each file of tests."""
    parts = []
    for title, folders in SECTIONS.items():
        parts.append(f"## {title}")
        for file in files(folders):
            place = file.relative_to(ROOT).as_posix()
            sentences = [f"- {sentence(name)}" for name in names(file)]
            parts += [f"`{place}`", "\n".join(sentences)]
    return "\n\n".join(parts)


def files(folders: tuple[str, ...]) -> list[Path]:
    """Return the files of tests in these folders."""
    return [file for folder in folders for file in sorted((TESTS / folder).rglob("test_*.py"))]


def names(file: Path) -> list[str]:
    """Return the names of a file's tests, in its order."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    functions = [node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]
    return [name for name in functions if name.startswith("test_")]


def sentence(name: str) -> str:
    """Return a test's name as a sentence."""
    text = name.removeprefix("test_").replace("_", " ")
    return f"{text[:1].upper()}{text[1:]}."
