"""Playing of recordings in rerun's own viewer, or on a page that any browser shows without a network.

Nothing listens beyond this machine, nothing is sent, and rerun keeps nothing in the user's home.
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

from harness.registry import BadInput
from harness.registry.packages import to_install
from harness.store.names import COMPARE

HERE = "127.0.0.1"
OPEN, CLOSE = "//!<INLINE-MARKER-OPEN>", "//!<INLINE-MARKER-CLOSE>"
"""Marks in rerun's page, around the code that fetches its program."""
FETCH = """
  const packed = await fetch(new URL("./viewer.wasm.gz", import.meta.url));
  if (!packed.ok) throw new Error(`viewer.wasm.gz: ${packed.status}`);
  const body = wrap_fetch_with_progress(packed, on_progress).body;
  const unpacked = body.pipeThrough(new DecompressionStream("gzip"));
  return new Response(unpacked, { headers: { "Content-Type": "application/wasm" } });
  """
"""The code in its place, which unpacks the program."""
PAGE = Path(__file__).with_name("viewer.html")


def recordings(
    directory: Path, envs: Sequence[str], env: str | None, method: str | None, compare: bool
) -> list[Path]:
    """Return a run's recordings of these environments that match, comparisons first.

    env, method: None for any. compare: comparisons alone. Raises BadInput where none match.
    """
    files = sorted((directory / "recordings").glob("*.rrd"))
    names = {file: (file.stem + "__").split("__")[:2] for file in files}  # a task, and a method or COMPARE
    result = [
        file
        for file, (task, kind) in names.items()
        if task.partition(".")[0] in envs
        and env in (None, task)
        and method in (None, kind)
        and (kind == COMPARE or not compare)
    ]
    if not result:
        existing = ", ".join(sorted({" ".join(name) for name in names.values()}))[:300] or "none"
        raise BadInput(f"{directory} has no such recordings; it has {existing} (docs/recordings.md)")
    return sorted(result, key=lambda file: names[file][1] != COMPARE)


def show(files: Sequence[Path]) -> int:
    """Run rerun's viewer until it is closed. Return its exit code. Raises BadInput without a display."""
    if not _has_display():
        raise BadInput("there is no display; add --web, or --export FOLDER (docs/recordings.md)")
    with tempfile.TemporaryDirectory() as home:
        command = [sys.executable, "-m", "rerun", *map(str, files), "--bind", HERE, "--port", "auto"]
        return subprocess.run(command, env=_environment(Path(home)), check=False).returncode


def export(files: Sequence[Path], folder: Path) -> Path:
    """Write a page that plays the recordings into a new folder.

    Raises BadInput where the folder has content, or rerun's page is not installed.
    """
    if os.path.lexists(folder) and not (folder.is_dir() and not os.listdir(folder)):
        raise BadInput(f"{folder} is there already; give a new folder, or an empty one")
    _write_page(files, folder, _parts(), 6)
    return folder


def serve(files: Sequence[Path], say: Callable[[str], None]) -> int:
    """Serve the page to this machine alone until Ctrl-C. say: called with its address."""
    parts = _parts()
    with tempfile.TemporaryDirectory() as folder:
        _write_page(files, Path(folder), parts, 1)
        with http.server.ThreadingHTTPServer((HERE, 0), partial(_Silent, directory=folder)) as server:
            address = f"http://{HERE}:{server.server_port}/"
            say(f"{len(files)} recordings at {address}, until Ctrl-C")
            if _has_display():  # otherwise the browser may be one in this terminal
                webbrowser.open(address)
            try:
                server.serve_forever()
            except KeyboardInterrupt:
                return 0
    return 0


class _Silent(http.server.SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None:
        """Log nothing."""


def _has_display() -> bool:
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _environment(home: Path) -> dict[str, str]:
    """Return the environment of a viewer that writes into `home` alone, and sends and asks nothing."""
    analytics = {
        **{"analytics_enabled": False, "analytics_id": "", "metadata": {}},
        **{"config_file_path": str(home / "rerun/analytics.json"), "data_dir_path": str(home / "sent")},
    }
    options = {"app": "(app_options:(check_for_updates_on_startup:false))"}
    (home / "rerun").mkdir()
    (home / "rerun/analytics.json").write_text(json.dumps(analytics), encoding="utf-8")
    (home / "rerun/app.ron").write_text(json.dumps(options), encoding="utf-8")
    homes = dict.fromkeys(("XDG_CONFIG_HOME", "XDG_DATA_HOME", "XDG_CACHE_HOME"), str(home))
    return {**os.environ, "CI": "1", **homes}


def _parts() -> Path:
    """Return the folder of rerun's page. Raises BadInput where it is not installed."""
    package = importlib.util.find_spec("rerun_notebook")
    if package is None or package.origin is None:
        raise BadInput(f"the page is a part of its own: {to_install('view')} (docs/recordings.md)")
    return Path(package.origin).parent / "static"


def _write_page(files: Sequence[Path], folder: Path, parts: Path, level: int) -> None:
    """Write the page, rerun's program packed at this level, and the recordings."""
    script = (parts / "widget.js").read_text(encoding="utf-8")
    before, opened, rest = script.partition(OPEN)
    _, closed, after = rest.partition(CLOSE)
    if not (opened and closed):
        raise BadInput("the installed rerun-notebook has another page than this version knows")
    (folder / "recordings").mkdir(parents=True)
    for file in files:
        shutil.copyfile(file, folder / "recordings" / file.name)
    (folder / "recordings.json").write_text(json.dumps([file.name for file in files]), encoding="utf-8")
    shutil.copyfile(PAGE, folder / "index.html")
    (folder / "viewer.js").write_text(before + FETCH + after, encoding="utf-8")
    program = gzip.compress((parts / "re_viewer_bg.wasm").read_bytes(), level, mtime=0)
    (folder / "viewer.wasm.gz").write_bytes(program)
