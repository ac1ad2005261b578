"""What the documents say is there."""

import csv
import re
from pathlib import Path

ROOT = Path(__file__).parent.parent


def test_every_test_that_the_table_of_faults_names_exists() -> None:
    named = re.findall(r"`(\w+)::(test_\w+)`", (ROOT / "docs/faults.md").read_text(encoding="utf-8"))
    assert len(named) > 60
    for file, test in named:
        assert f"def {test}(" in (ROOT / f"tests/harness/test_{file}.py").read_text(encoding="utf-8"), test


def test_the_readme_is_short_and_what_it_links_to_is_there() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert text.count("\n") < 130
    for page in (ROOT / "README.md", *(ROOT / "docs").glob("*.md")):
        for link in re.findall(r"\]\(([^)#]+)", page.read_text(encoding="utf-8")):
            assert (page.parent / link).exists(), link


def test_the_readmes_table_is_that_of_the_files() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    marked = re.search(r"<!-- the table of (\S+) -->\n(.*?)<!-- end", text, re.DOTALL)
    assert marked is not None
    with (ROOT / marked[1] / "leaderboard.csv").open(encoding="utf-8") as file:
        entries = {(e["method"], e["policy"]): e for e in csv.DictReader(file) if e["role"] != "reference"}
    shown = [line.strip("| ").split(" | ") for line in marked[2].splitlines()[2:]]
    assert {line[0].strip("`") for line in shown} == {method for method, _ in entries}
    for method, *scores in shown:
        for policy, score in zip(("pi_star", "pi_R"), [*scores, ""], strict=False):
            entry = entries.get((method.strip("`"), policy))
            expected = (
                ""
                if entry is None or not entry["score_mean"]
                else "{} [{}, {}]".format(
                    *(f"{float(entry[name]):.2f}" for name in ("score_mean", "score_low", "score_high"))
                )
            )
            assert score.strip("| ") == expected, (method, policy)


def test_every_command_and_option_of_the_documents_exists() -> None:
    from harness.arguments import parser

    text = "".join(
        page.read_text(encoding="utf-8") for page in (ROOT / "README.md", ROOT / "docs/commands.md")
    )
    helps = parser().format_help()
    for command in re.findall(r"irl-bench (\w+)", text):
        assert command in helps, command
    options = set(re.findall(r"--[a-z][a-z-]+", text)) - {"--bind"}  # rerun's
    for option in options:
        assert f'"{option}"' in (ROOT / "harness/arguments.py").read_text(encoding="utf-8"), option
