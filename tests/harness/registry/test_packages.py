"""Keys are of the packages that numbers come from, and of all that these require."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from harness.records import Cell
from harness.registry import KNOWN, gymnasium_tasks, keys, packages, sources
from tests.harness.registry.conftest import CONDITIONS


def install(site: Path, name: str, version: str, *requirements: str, extra: str = "") -> None:
    folder = site / f"{name}-{version}.dist-info"
    folder.mkdir(parents=True)
    lines = [f"Requires-Dist: {one}" for one in requirements]
    lines += [f"Provides-Extra: {extra}"] if extra else []
    head = ["Metadata-Version: 2.1", f"Name: {name}", f"Version: {version}"]
    (folder / "METADATA").write_text("\n".join([*head, *lines]) + "\n")
    (folder / "top_level.txt").write_text(f"{name}\n")
    forget()


def forget() -> None:
    for function in (packages._required, packages.distributions, packages.facts):
        function.cache_clear()


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder in which packages can be installed."""
    monkeypatch.syspath_prepend(tmp_path)
    forget()
    with KNOWN.for_now():
        yield tmp_path
    forget()


def key(env: str) -> str:
    cell = Cell(env, "bc", 0)
    return keys.cell_keys([cell], CONDITIONS, {})[cell]


def test_what_a_requirement_requires_counts(site: Path) -> None:
    asked = ["two>=1", "three; extra == 'more'", "four; python_version < '3'", "rich"]
    install(site, "one", "1.0", *asked, extra="more")
    install(site, "two", "2.0", "One", "absent", "five; extra == 'more'", extra="more")
    assert packages.required("one") == {"one": "1.0", "two": "2.0", "absent": ""}
    assert packages.required("one", extras=True) == {"one": "1.0", "two": "2.0", "absent": "", "three": ""}


def test_this_programs_keys_are_of_what_its_learners_need(site: Path) -> None:
    """SBX's SAC computes with tfp-nightly, which this program does not name."""
    installed = packages.required()
    assert {"torch", "jaxlib", "sbx-rl", "tfp-nightly", "scs", "numpy"} <= installed.keys()
    assert packages.LEFT_OUT.keys().isdisjoint(installed)
    before = key("cartpole")
    install(site, "tfp_nightly", "0.0.1")
    assert key("cartpole") != before


def test_another_version_of_a_simulator_is_another_key(site: Path) -> None:
    """Gymnasium names Box2D as an extra, for some of its tasks."""
    name = gymnasium_tasks.task_or_name("gym:Pendulum-v1")
    before = key(name)
    install(site, "Box2D", "2.3.10")
    assert packages.versions_of_module("gymnasium", extras=True)["box2d"] == "2.3.10"
    assert key(name) != before


@pytest.fixture
def among_installed(site: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The same folder, taken for one of this Python's own."""
    monkeypatch.setattr(sources, "is_installed", lambda place: place.is_relative_to(site))
    return site


def test_what_an_installed_module_of_a_plugin_requires_counts(among_installed: Path) -> None:
    (among_installed / "alpha_of_two.py").write_text("import beta_of_two")
    install(among_installed, "alpha_of_two", "1.0", "beta_of_two")
    install(among_installed, "beta_of_two", "2.0")
    assert sources.sources_of("alpha_of_two").digests == ["alpha-of-two 1.0", "beta-of-two 2.0"]


@pytest.mark.parametrize("name", ["loose_module.py", "loose_package/__init__.py"])
def test_what_lies_among_installed_packages_without_metadata_counts_by_its_files(
    among_installed: Path, name: str
) -> None:
    file = among_installed / name
    file.parent.mkdir(exist_ok=True)
    module = name.partition("/")[0].removesuffix(".py")
    file.write_text("VALUE = 1")
    before = sources.sources_of(module)
    file.write_text("VALUE = 2")
    assert before.digests
    assert sources.sources_of(module) != before
