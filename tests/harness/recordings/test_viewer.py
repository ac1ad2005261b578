"""Recordings are found, and played without a network."""

from __future__ import annotations

import http.server
import importlib.util
import io
import json
import threading
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from harness.cli.main import main
from harness.recordings import viewer
from harness.recordings.episode import Episode, record
from harness.recordings.scenes import scene
from harness.records import Cell
from harness.registry import SPECS, BadInput
from harness.rl.simulator import Simulator
from tests.harness.browser import CHROMIUM

NAMES = (
    "cartpole__bc__seed0__pi_star.median.rrd",
    "cartpole__compare.rrd",
    "swingup.heavy__bc__seed0__pi_star.median.rrd",
    "swingup__shaped__seed0__pi_R.median.rrd",
)
FILE = "cartpole__bc__seed0__pi_star.worst.rrd"
GPU = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
DRAWN = 400  # colours of a page: one on which nothing is drawn has 20 at most


@pytest.fixture
def run(tmp_path: Path) -> Path:
    folder = tmp_path / "run/recordings"
    folder.mkdir(parents=True)
    for name in NAMES:
        (folder / name).write_bytes(b"a recording")
    return folder.parent


def test_the_viewer_keeps_to_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DISPLAY", ":0")
    homes: list[Path] = []

    def started(command: list[str], env: dict[str, str], check: bool) -> object:
        homes.append(Path(env["XDG_CONFIG_HOME"]))
        assert json.loads((homes[0] / "rerun/analytics.json").read_text())["analytics_enabled"] is False
        options = (Path(env["XDG_DATA_HOME"]) / "rerun/app.ron").read_text()
        assert "check_for_updates_on_startup:false" in options
        assert command[-4:] == ["--bind", "127.0.0.1", "--port", "auto"]
        assert env["CI"]
        return type("Done", (), {"returncode": 3})

    monkeypatch.setattr("subprocess.run", started)
    assert viewer.show([Path("a.rrd")]) == 3
    assert not homes[0].exists()


def test_bad_input_is_one_line_and_writes_nothing(
    run: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    before = sorted(run.rglob("*"))
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(BadInput, match="no display; add --web"):
        viewer.show([])
    for words in (["--export", str(run)], ["--web", "--export", "new"], ["--env", "cartpole"]):
        assert main(["view", str(run), *words]) == 2
        assert capsys.readouterr().err.count("\n") == 1
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(BadInput, match=r"irl-bench\[view\]"):
        viewer.export([run / "recordings" / NAMES[0]], run / "page")
    assert sorted(run.rglob("*")) == before


@pytest.fixture
def address(tmp_path: Path) -> Iterator[str]:
    """The address of an exported folder with one recording."""
    if importlib.util.find_spec("rerun_notebook") is None:
        pytest.skip("needs rerun-notebook")
    spec = SPECS["cartpole"]
    (played,) = Simulator(spec, 1).run(lambda obs: 0 * obs[:, :1], [0])
    episode = Episode(played, scene(spec, 0, played.act))
    (tmp_path / FILE).write_bytes(record(spec, Cell("cartpole", "bc", 0), "pi_star", "worst", episode))
    folder = viewer.export([tmp_path / FILE], tmp_path / "page")
    assert (folder / "recordings" / FILE).read_bytes() == (tmp_path / FILE).read_bytes()
    handler = partial(http.server.SimpleHTTPRequestHandler, directory=folder)
    with http.server.ThreadingHTTPServer((viewer.HERE, 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://{viewer.HERE}:{server.server_port}/"
        server.shutdown()


def test_an_exported_folder_plays_in_a_browser_and_asks_nobody_else(play: Any, address: str) -> None:
    asked: list[str] = []
    colours = 0
    browser = play.chromium.launch(executable_path=CHROMIUM, args=GPU)
    shown = browser.new_page(viewport={"width": 800, "height": 450})
    shown.on("response", lambda response: asked.append(response.url))
    shown.on("requestfinished", lambda request: asked.append(request.url))
    shown.goto(address)
    assert shown.locator("nav a").all_inner_texts() == ["bc pi_star, worst"]
    for _ in range(18):
        shown.wait_for_timeout(5000)
        png = shown.locator("main").screenshot(timeout=100_000)
        colours = len(Image.open(io.BytesIO(png)).convert("RGB").getcolors(1 << 24) or ())
        if colours > DRAWN:
            break
    browser.close()
    assert colours > DRAWN
    assert {"viewer.js", "viewer.wasm.gz", FILE} <= {url.rpartition("/")[2] for url in asked}
    assert [url for url in asked if not url.startswith((address, "data:", "blob:"))] == []
