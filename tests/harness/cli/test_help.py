"""What the command line says of itself: examples that work, and pages that are there."""

import argparse
import ast
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest

from harness.cli.arguments import parser
from harness.cli.examples import EXAMPLES

ROOT = Path(__file__).parents[3]


def commands(found: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """It and all below it."""
    yield found
    for action in found._actions:
        if isinstance(action, argparse._SubParsersAction):
            for below in action.choices.values():
                yield from commands(below)


def test_the_help_of_every_command_ends_with_two_examples() -> None:
    found = {command.prog: command.format_help() for command in commands(parser())}
    assert found.keys() == EXAMPLES.keys()
    for command, text in found.items():
        first, second = EXAMPLES[command]
        assert text.endswith(f"\nexamples:\n  {first}\n  {second}\n")


@pytest.mark.parametrize("command", EXAMPLES)
def test_examples_are_of_their_command_and_parse(command: str) -> None:
    for example in EXAMPLES[command]:
        assert example.startswith(command)
        parser().parse_args(shlex.split(example)[1:])


def test_pages_that_errors_name_are_there() -> None:
    named = set()
    for file in (ROOT / "harness").rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and ast.unparse(node.func) == "BadInput":
                pages = [*node.args[1:], *(k.value for k in node.keywords)]
                named |= {ast.unparse(page).strip("'") for page in pages}
    assert {"commands", "cluster", "demonstrations"} <= named
    for page in named - {"READ"} | {"plugins"}:
        assert (ROOT / f"docs/{page}.md").exists(), page
