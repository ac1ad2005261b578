"""What the documents say is there."""

import re
from pathlib import Path

ROOT = Path(__file__).parent.parent


def test_every_test_that_the_table_of_faults_names_exists() -> None:
    named = re.findall(r"`(\w+)::(test_\w+)`", (ROOT / "docs/faults.md").read_text(encoding="utf-8"))
    assert len(named) > 60
    for file, test in named:
        assert f"def {test}(" in (ROOT / f"tests/harness/test_{file}.py").read_text(encoding="utf-8"), test
