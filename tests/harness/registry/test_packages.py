"""Keys are of the packages that numbers come from, those of other packages' needs included."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from harness.judge.results import Cell, Conditions
from harness.run import keys, packages, plugin_sources, plugins

CONDITIONS = Conditions("smoke", "absorbing", "sbx")


def install(site: Path, name: str, version: str, *requirements: str) -> None:
    folder = site / f"{name}-{version}.dist-info"
    folder.mkdir(parents=True)
    lines = [f"Requires-Dist: {one}" for one in requirements]
    head = ["Metadata-Version: 2.1", f"Name: {name}", f"Version: {version}"]
    (folder / "METADATA").write_text("\n".join([*head, *lines]) + "\n")
    (folder / "top_level.txt").write_text(f"{name}\n")


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder in which packages can be installed."""
    monkeypatch.syspath_prepend(tmp_path)
    caches = (packages._required, packages._imported, packages.distributions)
    for function in caches:
        function.cache_clear()
    yield tmp_path
    for function in caches:
        function.cache_clear()


def test_what_a_requirement_requires_counts_and_extras_do_not(site: Path) -> None:
    install(site, "one", "1.0", "two>=1", "three; extra == 'more'", "four; python_version < '3'", "rich")
    install(site, "two", "2.0", "One", "absent")
    assert packages.required("one") == {"one": "1.0", "two": "2.0", "absent": ""}


def test_this_programs_keys_are_of_what_its_learners_need(site: Path) -> None:
    """SBX's SAC computes with tfp-nightly, which this program does not name."""
    installed = packages.required()
    assert {"torch", "jaxlib", "sbx-rl", "tfp-nightly", "scs", "numpy"} <= installed.keys()
    assert packages.LEFT_OUT.keys().isdisjoint(installed)
    before = keys.cell_keys([Cell("cartpole", "bc", 0)], CONDITIONS, {})
    install(site, "tfp_nightly", "0.0.1")
    assert keys.cell_keys([Cell("cartpole", "bc", 0)], CONDITIONS, {}) != before


def test_what_is_left_out_is_required_and_has_a_reason() -> None:
    assert all(len(reason.split()) > 1 for reason in packages.LEFT_OUT.values())


def test_a_tasks_simulator_is_found_in_its_modules(site: Path) -> None:
    task = "gymnasium.envs.box2d.lunar_lander"
    assert "Box2D" not in packages.imported(task)
    packages._imported.cache_clear()
    packages.distributions.cache_clear()
    install(site, "Box2D", "2.3.10")
    assert packages.imported(task)["box2d"] == "2.3.10"
    assert "box2d" not in packages.imported("gymnasium.envs.classic_control.pendulum")


def test_another_version_of_a_simulator_is_another_key(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    name = plugins.task_or_name("gym:Pendulum-v1")
    cell = Cell(name, "bc", 0)
    before = keys.cell_keys([cell], CONDITIONS, {})
    monkeypatch.setattr(packages, "imported", lambda module: {"box2d": "2.3.11"})
    assert keys.cell_keys([cell], CONDITIONS, {}) != before


@pytest.fixture
def among_installed(site: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The same folder, taken for one of this Python's own."""
    monkeypatch.setattr(plugin_sources, "_places", lambda: (site.resolve(),))
    return site


def test_what_an_installed_module_of_a_plugin_requires_counts(among_installed: Path) -> None:
    (among_installed / "alpha_of_two.py").write_text("import beta_of_two")
    install(among_installed, "alpha_of_two", "1.0", "beta_of_two")
    install(among_installed, "beta_of_two", "2.0")
    found = plugin_sources.sources_of("alpha_of_two")
    assert found.digests == ["alpha-of-two 1.0", "beta-of-two 2.0"]


@pytest.mark.parametrize("name", ["loose_module.py", "loose_package/__init__.py"])
def test_what_lies_among_installed_packages_without_metadata_counts_by_its_files(
    among_installed: Path, name: str
) -> None:
    file = among_installed / name
    file.parent.mkdir(exist_ok=True)
    module = name.partition("/")[0].removesuffix(".py")
    file.write_text("VALUE = 1")
    before = plugin_sources.sources_of(module)
    file.write_text("VALUE = 2")
    assert before.digests
    assert plugin_sources.sources_of(module) != before
