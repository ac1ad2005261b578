"""Keys are of plug-ins, of packages that numbers come from, and of tasks of Gymnasium."""

import sys
from collections.abc import Iterator
from pathlib import Path

import gymnasium
import pytest
from gymnasium.envs.registration import EnvSpec

from harness.registry import BadInput, gymnasium_tasks, keys, packages, plugins, sources
from tests.harness.plugged import MINE
from tests.harness.registry.conftest import key_of

pytestmark = pytest.mark.usefixtures("here")


def test_a_key_is_of_what_a_plugin_imports(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Modules beside it, packages, links in them, and this program's."""
    texts = {
        "theirs/__init__.py": "",
        "theirs/deep.py": "from its_helper import VALUE",
        "its_helper.py": "VALUE = 1",
        "elsewhere/linked.py": "",
    }
    for name, text in texts.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    (tmp_path / "theirs/sub").symlink_to(tmp_path / "elsewhere")
    (tmp_path / "theirs/around").symlink_to(tmp_path / "theirs")
    plugin = tmp_path / "imports.py"
    plugin.write_text(f"import theirs.deep\n{MINE}")
    monkeypatch.syspath_prepend(str(tmp_path))
    before, program = key_of(plugin=plugin), keys.program()
    for name, text in texts.items():
        (tmp_path / name).write_text(f"{text}\nMORE = 1\n")
        assert key_of(plugin=plugin) != before, name
        (tmp_path / name).write_text(text)
    assert key_of(plugin=plugin) == before
    for file, counts in (("methods/bc.py", True), ("methods/gail.py", False)):
        edited = program | {file: program[file] + b"\nMORE = 1\n"}
        monkeypatch.setattr(keys, "program", lambda edited=edited: edited)
        assert (key_of() != before) == counts, file


def test_a_key_is_of_its_own_plugin_and_of_no_other(mine: Path) -> None:
    asked = [("mine", "swingup"), ("bc", "moon"), ("bc", "swingup")]
    plugins.add([str(mine)])
    before = [key_of(*cell) for cell in asked]
    mine.write_text(f"{MINE}\nEDITED = 1\n")
    plugins.add([str(mine)])
    after = [key_of(*cell) for cell in asked]
    assert [a == b for a, b in zip(after, before, strict=True)] == [False, False, True]
    assert keys.task_of(before[0]) == keys.task_of(before[2]) == keys.task_of(after[0])


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
    yield tmp_path
    forget()


def test_what_a_requirement_requires_counts(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = ["two>=1", "three; extra == 'more'", "four; python_version < '3'", "rich"]
    install(site, "one", "1.0", *asked, extra="more")
    install(site, "two", "2.0", "One", "absent", "five; extra == 'more'", extra="more")
    assert packages.required("one") == {"one": "1.0", "two": "2.0", "absent": ""}
    assert packages.required("one", extras=True) == {"one": "1.0", "two": "2.0", "absent": "", "three": ""}
    monkeypatch.setattr(sources, "is_installed", lambda place: place.is_relative_to(site))
    (site / "one.py").write_text("import two")
    assert {"one 1.0", "two 2.0"} <= {*sources.sources_of("one").digests}


BOX2D = "Box2D" if sys.version_info < (3, 14) else "box2d_py"  # as Gymnasium asks for it


@pytest.mark.parametrize(("package", "env"), [("tfp_nightly", "cartpole"), (BOX2D, "gym:Pendulum-v1")])
def test_another_version_of_what_numbers_come_from_is_another_key(package: str, env: str, site: Path) -> None:
    """SBX's SAC computes with tfp-nightly. Gymnasium names Box2D as an extra, for some of its tasks."""
    before = key_of("bc", name := gymnasium_tasks.task_or_name(env))
    assert packages.LEFT_OUT.keys().isdisjoint(packages.required())
    install(site, package, "0.0.1")
    assert key_of("bc", name) != before


def test_a_key_is_of_what_a_task_is_registered_with(monkeypatch: pytest.MonkeyPatch) -> None:
    entry = "gymnasium.envs.classic_control:PendulumEnv"

    def key_with(horizon: int = 200, **kwargs: object) -> str:
        spec = EnvSpec("Heavy-v0", entry, max_episode_steps=horizon, kwargs=kwargs)
        monkeypatch.setitem(gymnasium.registry, "Heavy-v0", spec)
        return key_of("bc", gymnasium_tasks.task_or_name("gym:Heavy-v0"))

    assert len({key_with(g=10.0), key_with(g=2.0), key_with(horizon=100, g=2.0)}) == 3
    with pytest.raises(BadInput, match="registered with arguments that are neither numbers nor texts"):
        key_with(g=object())
