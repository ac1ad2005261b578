"""The command line; `harness.cli.arguments.EXIT_CODES` says what it returns."""

from __future__ import annotations

import argparse
import os
import resource
import shlex
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from harness.cli.arguments import parser
from harness.process.signals import ignore_stops, importing
from harness.registry import (
    KNOWN,
    BadInput,
    Unfinished,
    ours,
)
from harness.registry.names import plain

NO_MEMORY = ("failed to map segment", "Cannot allocate memory")
"""Parts of messages of errors that mean it."""
COMPUTING = ("run", "tune", "reproduce", "report", "check", "bench", "experts")
LEAST_TO_COMPUTE, LEAST_TO_READ = 4_500_000, 1_500_000
"""KB of address space: `run` took 4.2 million on two cores, `demos` 1.2 million."""
LEAST_DATA = 500_000
"""KB of data: of `run`, which failed with 300,000 and went well with 600,000."""


def main(argv: Sequence[str] | None = None) -> int:
    """Do what `argv` (default: the command line) asks for; return the exit code."""
    argv = list(sys.argv[1:] if argv is None else argv)
    try:
        ours.first()
        return _dispatch(argv)
    except (BadInput, OSError, ImportError, MemoryError) as error:
        said = str(error)
        if isinstance(error, OSError) and error.strerror and error.filename is not None:
            said = f"{error.filename}: {error.strerror}"
        if isinstance(error, MemoryError) or any(sign in said for sign in NO_MEMORY):
            limits = "".join(f" (ulimit -{letter} {most})" for letter, most in _limits().items())
            said = f"out of memory{limits}: {said}".removesuffix(": ")
        print(f"irl-bench: error: {plain(' '.join(said.split()))}", file=sys.stderr)
        return 2
    except Unfinished as error:
        print(f"irl-bench: {plain(str(error))}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        ignore_stops()
        again = plain(shlex.join([*_program(), *argv]))
        kept = f"what is finished is kept. To go on, run the same again:\n  {again}{_how_to_report(argv)}"
        resumes = argv[0] in ("run", "tune", "reproduce") or argv[:2] == ["experts", "train"]
        resumes &= "--plan" not in argv
        print(f"\nstopped; {kept if resumes else 'nothing is kept'}", file=sys.stderr)
        return 130


def _how_to_report(argv: Sequence[str]) -> str:
    """Return how to make the report of a run that was stopped; an empty text for another command."""
    if argv[0] != "run":
        return ""
    command = [*_program(), "report", str(parser().parse_args(argv).out)]
    return f"\nFor a report of what is finished:\n  {plain(shlex.join(command))}"


def _limits() -> dict[str, int]:
    """Return those limits that this process's memory has, in KB, by ulimit's letters."""
    kinds = {"v": resource.RLIMIT_AS, "d": resource.RLIMIT_DATA}
    limits = {letter: resource.getrlimit(kind)[0] for letter, kind in kinds.items()}
    return {letter: most >> 10 for letter, most in limits.items() if most != resource.RLIM_INFINITY}


def _check_memory(command: str) -> None:
    """Raise BadInput where a limit is lower than what libraries ask for: some end the process at that."""
    least = {"v": LEAST_TO_COMPUTE if command in COMPUTING else LEAST_TO_READ, "d": LEAST_DATA}
    for letter, most in _limits().items():
        if most < least[letter]:
            raise BadInput(
                f"`{command}` needs {least[letter]:,} KB of memory, and `ulimit -{letter}` allows {most:,} KB"
            )


def _check_folder() -> None:
    """Raise BadInput where the current folder is gone, amid which some libraries end the process."""
    try:
        os.getcwd()
    except OSError as error:
        raise BadInput(f"the current folder is gone ({error.strerror}); run it from another one") from error


def _program() -> list[str]:
    """Return the command that starts this program, as the user typed it or may type it."""
    name = sys.argv[0]
    return [sys.executable, "-m", "harness"] if Path(name).name == "__main__.py" else [name]


def _dispatch(argv: list[str]) -> int:
    try:
        args = parser().parse_args(argv)
    except SystemExit:  # --help, the only other way out of a parser whose error() raises
        return 0
    with KNOWN.for_now():
        if getattr(args, "env_kwargs", None) or getattr(args, "env_var", None):
            from harness.registry import plugins

            plugins.give(args.env_kwargs, args.env_var)
        return _do(args)


def _do(args: argparse.Namespace) -> int:
    if args.command == "list":
        from harness.cli import checks

        names_only = args.method is args.env is None
        return checks.list_names(args.plugin) if names_only else checks.list_settings(args)
    _check_python()
    if args.command != "verify":
        _check_memory(args.command)
        _check_folder()
    # Imports stand here, for `--help` and `list` to answer at once.
    if args.command in ("verify", "bench", "check", "experts"):
        from harness.cli import checks

        commands: dict[str, Callable[[], int]] = {
            "verify": lambda: checks.verify(args.directory),
            "bench": lambda: checks.bench(args.part, args.json),
            "check": lambda: checks.check(args.names, args.plugin),
            "experts": lambda: checks.experts(args),
        }
        return commands[args.command]()
    with importing():
        from harness.cli import files, runs
    commands = {
        "run": lambda: runs.run(args),
        "tune": lambda: runs.tune(args),
        "reproduce": lambda: runs.reproduce(args),
        "report": lambda: runs.report(args.directory, args.print),
        "demos": lambda: files.demos(args),
        "view": lambda: files.view(args),
        "export": lambda: files.export(args),
        "compare": lambda: files.compare(args.directory, args.others),
        "figure": lambda: files.draw(args),
        "table": lambda: files.draw(args),
    }
    return commands[args.command]()


def _check_python() -> None:
    """Raise BadInput where Python was started in a way in which cells cannot be computed."""
    if sys.flags.optimize > 1:
        raise BadInput("run Python without -OO and PYTHONOPTIMIZE: libraries need their docstrings")
    if sys.flags.ignore_environment:
        raise BadInput(
            "run Python without -E and -I: processes of cells are told by variables what to import"
        )
