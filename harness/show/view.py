"""Playing recordings: in rerun's own viewer, or on a page that any browser shows without a network.

Nothing listens beyond this machine, nothing is sent anywhere, and rerun keeps nothing in the user's home.
"""

from __future__ import annotations

import gzip
import http.server
import importlib.util
import json
import os
import shutil
import subprocess
import sys
import tempfile
import webbrowser
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from harness.judge.results import COMPARE
from harness.registry import BadInput

HERE = "127.0.0.1"
OPEN, CLOSE = "//!<INLINE-MARKER-OPEN>", "//!<INLINE-MARKER-CLOSE>"
"""Where rerun's page fetches its program, between these, it is told to unpack ours."""
FETCH = """
  const packed = await fetch(new URL("./viewer.wasm.gz", import.meta.url));
  if (!packed.ok) throw new Error(`viewer.wasm.gz: ${packed.status}`);
  const body = wrap_fetch_with_progress(packed, on_progress).body;
  const unpacked = body.pipeThrough(new DecompressionStream("gzip"));
  return new Response(unpacked, { headers: { "Content-Type": "application/wasm" } });
  """
PAGE = Path(__file__).with_name("viewer.html")


def recordings(
    directory: Path, envs: Sequence[str], env: str | None, method: str | None, compare: bool
) -> list[Path]:
    """Those of a run with these environments that are asked for, comparisons first. Raises BadInput where
    there is none."""
    found = sorted((directory / "recordings").glob("*.rrd"))
    found.sort(key=lambda file: not file.stem.endswith(f"__{COMPARE}"))

    def wanted(file: Path) -> bool:
        task, _, rest = file.name.partition("__")
        compares = rest == f"{COMPARE}.rrd"
        return (
            task.partition(".")[0] in envs
            and (env is None or task == env)
            and (method is None or rest.partition("__")[0] == method)
            and (compares or not compare)
        )

    if not (chosen := [file for file in found if wanted(file)]):
        known = sorted({" ".join(file.stem.split("__")[:2]) for file in found})
        there = f"it has {', '.join(known)[:300]}" if known else "it has none"
        raise BadInput(f"{directory} has no such recordings; {there} (docs/recordings.md)")
    return chosen


def show(files: Sequence[Path]) -> int:
    """Rerun's own viewer, until it is closed; its exit code. Raises BadInput where there is no display."""
    if not _has_display():
        raise BadInput("there is no display; add --web, or --export FOLDER (docs/recordings.md)")
    with tempfile.TemporaryDirectory() as home:
        command = [sys.executable, "-m", "rerun", *map(str, files), "--bind", HERE, "--port", "auto"]
        return subprocess.run(command, env=quiet(Path(home)), check=False).returncode


def _has_display() -> bool:
    asked = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    return bool(asked) or not sys.platform.startswith("linux")


def quiet(home: Path) -> dict[str, str]:
    """The environment of a viewer that keeps what it keeps in `home`, neither counts nor reports anything,
    and asks nobody for a newer version."""
    settings, data = home / "config", home / "data"
    for folder in (settings / "rerun", data / "rerun"):
        folder.mkdir(parents=True)
    counted = {
        "analytics_enabled": False,
        "analytics_id": "",
        "metadata": {},
        "config_file_path": str(settings / "rerun" / "analytics.json"),
        "data_dir_path": str(data / "rerun" / "analytics"),
    }
    (settings / "rerun" / "analytics.json").write_text(json.dumps(counted), encoding="utf-8")
    options = {"app": "(app_options:(check_for_updates_on_startup:false))"}
    (data / "rerun" / "app.ron").write_text(json.dumps(options), encoding="utf-8")
    folders = {"XDG_CONFIG_HOME": settings, "XDG_DATA_HOME": data, "XDG_CACHE_HOME": home / "cache"}
    return {**os.environ, "CI": "1", **{name: str(folder) for name, folder in folders.items()}}


def export(files: Sequence[Path], folder: Path) -> Path:
    """Writes a page that plays the recordings, with all that it needs, into a new folder. Raises BadInput
    where the folder is none, or rerun's page is not installed."""
    if os.path.lexists(folder) and not (folder.is_dir() and not os.listdir(folder)):
        raise BadInput(f"{folder} is there already; give a new folder, or an empty one")
    parts = _parts()
    folder.mkdir(parents=True, exist_ok=True)
    _write_page(files, folder, parts)
    (folder / "viewer.wasm.gz").write_bytes(
        gzip.compress((parts / "re_viewer_bg.wasm").read_bytes(), 6, mtime=0)
    )
    return folder


def serve(files: Sequence[Path], say: Callable[[str], None]) -> int:
    """The same page, from this machine to this machine, until Ctrl-C. say: told its address."""
    parts = _parts()
    with tempfile.TemporaryDirectory() as folder:
        _write_page(files, Path(folder), parts)
        program = gzip.compress((parts / "re_viewer_bg.wasm").read_bytes(), 1)
        (Path(folder) / "viewer.wasm.gz").write_bytes(program)
        with http.server.ThreadingHTTPServer((HERE, 0), partial(_Quiet, directory=folder)) as server:
            address = f"http://{HERE}:{server.server_port}/"
            say(f"{len(files)} recordings at {address}, until Ctrl-C")
            if _has_display():  # else it may be a browser in this terminal
                webbrowser.open(address)
            try:
                server.serve_forever()
            except KeyboardInterrupt:
                return 0
    return 0


class _Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None:
        """Says nothing of requests."""


def _parts() -> Path:
    """Where rerun's page is. Raises BadInput where it is not installed."""
    found = importlib.util.find_spec("rerun_notebook")
    if found is None or found.origin is None:
        raise BadInput("the page is a part of its own: pip install 'irl-bench[view]' (docs/recordings.md)")
    return Path(found.origin).parent / "static"


def _write_page(files: Sequence[Path], folder: Path, parts: Path) -> None:
    script = (parts / "widget.js").read_text(encoding="utf-8")
    before, opened, rest = script.partition(OPEN)
    _, closed, after = rest.partition(CLOSE)
    if not (opened and closed):
        raise BadInput("the installed rerun-notebook has another page than this version knows")
    (folder / "viewer.js").write_text(before + FETCH + after, encoding="utf-8")
    shutil.copyfile(PAGE, folder / "index.html")
    (folder / "recordings").mkdir()
    for file in files:
        shutil.copyfile(file, folder / "recordings" / file.name)
    (folder / "recordings.json").write_text(json.dumps([file.name for file in files]), encoding="utf-8")
