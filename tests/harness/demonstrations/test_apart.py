"""A file of few bytes takes no more memory than is allowed. One that ends its reader ends nothing else."""

import json
import signal
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from harness.demonstrations import apart
from harness.demonstrations.reading import read, write
from harness.demonstrations.units import SCALED
from tests.harness.demonstrations.made_demonstrations import SWINGUP, imitation, made, refused, same
from tests.harness.demonstrations.made_minari import minari_folder

MIB = 1 << 20
ALLOWED = 250 * MIB
ZEROS = 260 * MIB // 8
"""Numbers in a bomb."""
PART = ZEROS // 100
READ = """
import resource, sys
from harness.demonstrations import apart
from pathlib import Path
apart.MEMORY = int(sys.argv[1])
for path in sys.argv[2:]:
    try:
        apart.recording_in(Path(path))
    except ValueError as error:
        print(error)
print(Path("/proc/self/status").read_text().partition("VmHWM:")[2].split()[0])
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
"""
NUMBERS, FLAGS = pa.list_(pa.float64()), pa.bool_()


def folder(path: Path, obs: pa.Array, times: int = 1) -> Path:
    """A folder of imitation's with a compressed stream of equal batches of these observations."""
    path.mkdir()
    columns = {"obs": obs, "acts": [[0.0]] * len(obs), "terminal": [True] * len(obs)}
    schema = pa.schema({"obs": obs.type, "acts": NUMBERS, "terminal": FLAGS})
    batch = pa.record_batch(columns, schema=schema)
    options = pa.ipc.IpcWriteOptions(compression="zstd")
    with (
        pa.OSFile(str(path / "d.arrow"), "wb") as file,
        pa.ipc.new_stream(file, schema, options=options) as out,
    ):
        for _ in range(times):
            out.write_batch(batch)
    (path / "state.json").write_text(json.dumps({"_data_files": [{"filename": "d.arrow"}]}))
    return path


def zeros() -> pa.Array:
    return pa.ListArray.from_arrays([0, PART], pa.FixedSizeListArray.from_arrays(np.zeros(PART), 1))


def shared_rows() -> pa.Array:
    starts, sizes = pa.array(np.zeros(1000, np.int32)), pa.array(np.full(1000, PART, np.int32))
    return pa.ListViewArray.from_arrays(starts, sizes, pa.array(np.zeros(PART)))


def runs() -> pa.Array:
    """Return a run-end encoded array: two numbers that stand for many."""
    return pa.RunEndEncodedArray.from_arrays(pa.array([5], pa.int32()), pa.array([0.0]))


def dictionary() -> pa.Array:
    return pa.DictionaryArray.from_arrays(pa.array(np.zeros(1000, np.int8)), pa.array([[0.0] * 1000]))


def views() -> pa.Array:
    return pa.array(["a" * 99], pa.string_view())


def zipped(path: Path, claimed: int, written: int) -> Path:
    """An `.npz` whose array obs claims and holds so many numbers."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("obs", "act", "lengths", "terminated"):
            with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                shape = (claimed if name == "obs" else 1,)
                header = {"descr": "<i8", "fortran_order": False, "shape": shape}
                np.lib.format.write_array_header_1_0(file, header)
                for _ in range(100 if name == "obs" else 1):
                    file.write(bytes(8 * (written // 100 if name == "obs" else 1)))
    return path


def minari(path: Path, form: str) -> Path:
    there = made((5,), (True,))
    path = minari_folder(path, form, there[0].obs, there[0].act, there[0].terminated, there[1])
    column = pa.FixedSizeListArray.from_arrays(np.zeros(PART), 1)
    columns = {"observations": column, "actions": column, "rewards": np.zeros(PART)}
    table = pa.table(columns | dict.fromkeys(("terminations", "truncations"), np.zeros(PART, bool)))
    file = path / f"data/0/part-0.{form}"
    options = pa.ipc.IpcWriteOptions(compression="zstd")
    with pa.OSFile(str(file), "wb") as out:
        writer = (
            parquet.ParquetWriter(out, table.schema, compression="zstd")
            if form == "parquet"
            else pa.ipc.new_file(out, table.schema, options=options)
        )
        with writer:
            for _ in range(100):
                writer.write_table(table)
    return path


def deep(path: Path) -> Path:
    path.mkdir()
    (path / "state.json").write_text("[" * (15 * MIB))
    return path


BOMBS: dict[str, Callable[[Path], Path]] = {
    "zeros": lambda path: folder(path, zeros(), 100),
    "zip": lambda path: zipped(path, ZEROS, ZEROS),
    "claims": lambda path: zipped(path, 10**11, 0),
    "parquet": lambda path: minari(path, "parquet"),
    "arrow": lambda path: minari(path, "arrow"),
}


@pytest.mark.parametrize(
    ("make", "kind"),
    [
        *((shared_rows, "list_view"), (runs, "run_end_encoded")),
        *((dictionary, "dictionary"), (views, "string_view")),
    ],
)
def test_columns_whose_rows_may_share_what_they_hold_are_refused(
    tmp_path: Path, make: Callable[[], pa.Array], kind: str
) -> None:
    with pytest.raises(ValueError, match=f"its obs is of type {kind}"):
        apart.recording_here(folder(tmp_path / "d", make()))


def test_few_bytes_take_no_more_memory_than_is_allowed(tmp_path: Path) -> None:
    paths = [make(tmp_path / name) for name, make in BOMBS.items()]
    for path in paths:
        assert sum(file.stat().st_size for file in [path, *path.rglob("*")] if file.is_file()) < 20 * MIB
    program = [sys.executable, "-c", READ, str(ALLOWED), *map(str, [*paths, deep(tmp_path / "deep")])]
    ended = subprocess.run(program, check=True, capture_output=True, text=True)
    *lines, here, there = ended.stdout.splitlines()
    assert len(lines) == len(paths) + 1
    assert all("takes more memory" in line for line in lines[:-1])
    assert 1024 * int(here) < 200 * MIB
    assert 1024 * int(there) < ALLOWED + 100 * MIB  # and what programs and their libraries take


@pytest.mark.parametrize("form", ["npz", "imitation", "hdf5"])
def test_what_is_read_apart_is_what_is_read_here(tmp_path: Path, form: str) -> None:
    episodes, rewards = made()
    path = tmp_path / ("d.npz" if form == "npz" else "d")
    if form == "npz":
        write(path, episodes, rewards)
    elif form == "imitation":
        imitation(path, episodes, rewards, parts=1)
    else:
        minari_folder(path, form, episodes.obs, episodes.act, episodes.terminated, rewards)
    found, here = apart.recording_in(path), apart.recording_here(path)
    for name, array in here.arrays.items():
        assert found.arrays[name].dtype == array.dtype
        assert np.array_equal(found.arrays[name], array)
    assert (found.bounds is None) == (here.bounds is None)
    assert found.bounds is None or np.array_equal(found.bounds, np.asarray(here.bounds))
    assert (found.form, found.first, found.unended) == (here.form, here.first, here.unended)
    assert same(read(path, SWINGUP, SCALED).episodes, episodes)


ENDLESS = """
import sys
sys.path[:] = sys.argv[4:]
from harness.demonstrations import apart
apart._bound(1 << 30, 1)
while True: pass
"""


@pytest.mark.parametrize(
    ("program", "why"),
    [
        (f"import os; os.kill(os.getpid(), {signal.SIGSEGV:d})", "its reader ended (Segmentation fault)"),
        ("print('{\"form\": ', end='')", "its reader ended (exit code 0)"),
        ("raise SystemExit(3)", "its reader ended (exit code 3)"),
        (ENDLESS, "reading it takes more than 600 seconds"),
    ],
)
def test_a_file_that_ends_its_reader_is_refused_in_a_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, program: str, why: str
) -> None:
    monkeypatch.setattr(apart, "PROGRAM", program)
    refused(tmp_path / "d.npz", why)
