"""Makes docs/pictures/*.png: an expert's episode of each task, and one of `shaped` on the highway, as a
browser shows their recordings. `python docs/pictures.py [NAME...]` needs Chromium and the extra `dev`."""

from __future__ import annotations

import http.server
import io
import sys
import tempfile
import threading
from functools import partial
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

from envs import EnvSpec
from harness.cell.experts import source_for
from harness.cell.fitting import fit
from harness.cell.inputs import Inputs
from harness.cell.recording import above_absorption, shaped_parts
from harness.cell.run import prepare
from harness.cell.shared import Shared
from harness.recordings.episode import Episode, record
from harness.recordings.maps import maps
from harness.recordings.pictures import pictures
from harness.recordings.scenes import scene
from harness.recordings.viewer import HERE, export
from harness.records import Cell, Conditions
from harness.registry import BUILT_IN, SPECS
from harness.rl.seeds import evaluation_seeds
from harness.rl.simulator import Simulator
from methods.base import Policy
from methods.shaped import ShapedReward

FOLDER = Path(__file__).with_name("pictures")
SHAPED = "highway_shaped"
CONDITIONS = Conditions("quick", "absorbing", "sbx")
SIZE, LIST = (1040, 650), 272
"""Size of the window, and width of the list of recordings [pixels]."""
WIDTH, COLOURS = 640, 128
"""Width [pixels] and number of colours of a picture."""
GPU = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
WAIT = 90
"""Seconds until something is to be seen, at most."""


def main(names: list[str]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        files = []
        for name in names or [*BUILT_IN["env"], SHAPED]:
            file = Path(folder) / f"{name}__picture.rrd"
            file.write_bytes(shaped() if name == SHAPED else of_expert(SPECS[name]))
            files.append(file)
        page = export(files, Path(folder) / "page")
        handler = partial(http.server.SimpleHTTPRequestHandler, directory=page)
        with http.server.ThreadingHTTPServer((HERE, 0), handler) as server:
            threading.Thread(target=server.serve_forever, daemon=True).start()
            FOLDER.mkdir(exist_ok=True)
            for file in files:
                png = picture(f"http://{HERE}:{server.server_port}/#{file.name}")
                small = Image.open(io.BytesIO(png)).convert("RGB")
                small.thumbnail((WIDTH, WIDTH), Image.Resampling.LANCZOS)
                path = FOLDER / f"{file.name.partition('__')[0]}.png"
                small.quantize(COLOURS).save(path, optimize=True)
                print(path, path.stat().st_size, flush=True)
            server.shutdown()


def of_expert(spec: EnvSpec) -> bytes:
    """Record the expert's first evaluation episode."""
    expert = source_for(spec.name, 0, CONDITIONS).expert.policy
    return played(spec, "reference", "expert", expert, expert, None)


def shaped() -> bytes:
    """Record the same for the policy of `shaped` on the highway, with its R*."""
    spec, expert = SPECS["highway"], source_for("highway", 0, CONDITIONS).expert.policy
    cell = Cell("highway", "shaped", 0)
    star = fit(Inputs(cell, CONDITIONS, Shared(prepare([cell], CONDITIONS)))).star
    assert star is not None
    assert star.policy is not None
    assert isinstance(star.reward, ShapedReward)
    return played(spec, "shaped", "pi_star", star.policy, expert, star.reward)


def played(
    spec: EnvSpec, method: str, name: str, policy: Policy, expert: Policy, reward: ShapedReward | None
) -> bytes:
    """One evaluation episode, recorded."""
    seed = evaluation_seeds(0, 1)[0]
    place = spec.expert_sees if name == "expert" else spec
    (trajectory,) = Simulator(spec, 1).shown(Simulator(place, 1).run(policy, [seed]), [seed])
    obs = trajectory.obs
    f, precision = shaped_parts(reward, obs[:-1])
    episode = Episode(
        trajectory,
        scene=None if spec.name == "gridworld" else scene(spec, seed, trajectory.act),
        learned=None if reward is None else above_absorption(reward, trajectory),
        expert=None if reward is None else expert(obs[:-1]),
        f=f,
        precision=precision,
        maps=None if spec.encoder else maps(spec, policy, reward, obs),
        pictures=pictures(spec, seed, trajectory.act) if spec.encoder else None,
    )
    return record(spec, Cell(spec.name, method, 0), name, "first", episode)


def picture(address: str) -> bytes:
    """Return a PNG of the page, once it shows something."""
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path="/usr/bin/chromium", args=GPU)
        page = browser.new_page(viewport={"width": SIZE[0] + LIST, "height": SIZE[1]})
        page.goto(address)
        png = b""
        for _ in range(WAIT // 10):
            page.wait_for_timeout(10_000)
            png = page.locator("main").screenshot(timeout=120_000)
            colours = Image.open(io.BytesIO(png)).convert("RGB").getcolors(1 << 24)
            if colours and len(colours) > 700:
                break
        browser.close()
    return png


if __name__ == "__main__":
    main(sys.argv[1:])
