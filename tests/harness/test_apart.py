"""A file of few bytes takes no more memory than is allowed. One that ends its reader ends nothing else."""

import json
import signal
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from harness import apart, demonstration_forms
from harness import demonstrations as demos
from harness.registry import BadInput
from tests.harness.made_demonstrations import SWINGUP, imitation, made, same
from tests.harness.made_minari import minari_folder

MIB = 1 << 20
ALLOWED = 250 * MIB
ZEROS = 400 * MIB // 8
"""Numbers in a bomb."""
PART = ZEROS // 100
READ = """
import resource, sys
from harness import apart
from pathlib import Path
apart.MEMORY = int(sys.argv[1])
for path in sys.argv[2:]:
    try:
        apart.raw(Path(path))
    except ValueError as error:
        print(error)
print(Path("/proc/self/status").read_text().partition("VmHWM:")[2].split()[0])
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
"""


def folder(path: Path, kinds: dict[str, Any], columns: dict[str, Any], times: int = 1) -> Path:
    """A folder of imitation's with a compressed stream of as many batches of the same columns."""
    path.mkdir()
    batch = pa.record_batch(columns, schema=pa.schema(kinds))
    options = pa.ipc.IpcWriteOptions(compression="zstd")
    with (
        pa.OSFile(str(path / "d.arrow"), "wb") as file,
        pa.ipc.new_stream(file, batch.schema, options=options) as out,
    ):
        for _ in range(times):
            out.write_batch(batch)
    (path / "state.json").write_text(json.dumps({"_data_files": [{"filename": "d.arrow"}]}))
    return path


def zeros(path: Path) -> Path:
    rows = pa.FixedSizeListArray.from_arrays(np.zeros(PART), 1)
    obs = pa.ListArray.from_arrays([0, PART], rows)
    kinds = {"obs": obs.type, "acts": pa.list_(pa.float64()), "terminal": pa.bool_()}
    return folder(path, kinds, {"obs": obs, "acts": [[0.0]], "terminal": [True]}, 100)


def shared_rows(path: Path) -> Path:
    rows = 1000
    obs = pa.ListViewArray.from_arrays(
        pa.array(np.zeros(rows, np.int32)), pa.array(np.full(rows, PART, np.int32)), pa.array(np.zeros(PART))
    )
    columns = {"obs": obs, "acts": [[0.0]] * rows, "terminal": [True] * rows}
    return folder(path, {"obs": obs.type, "acts": pa.list_(pa.float64()), "terminal": pa.bool_()}, columns)


def runs(path: Path) -> Path:
    """Run-end encoded: two numbers that stand for many."""
    obs = pa.RunEndEncodedArray.from_arrays(pa.array([2**31 - 1], pa.int32()), pa.array([0.0]))
    path = folder(path, {"terminal": pa.bool_()}, {"terminal": [True]})
    with pa.OSFile(str(path / "d.arrow"), "wb") as file:
        table = pa.table({"obs": obs})
        with pa.ipc.new_stream(file, table.schema) as out:
            out.write_table(table)
    return path


def dictionary(path: Path) -> Path:
    obs = pa.DictionaryArray.from_arrays(pa.array(np.zeros(1000, np.int8)), pa.array([[0.0] * 1000]))
    columns = {"obs": obs, "acts": [[0.0]] * 1000, "terminal": [True] * 1000}
    return folder(path, {"obs": obs.type, "acts": pa.list_(pa.float64()), "terminal": pa.bool_()}, columns)


def views(path: Path) -> Path:
    columns = {"obs": ["a" * 99], "acts": [[0.0]], "terminal": [True]}
    return folder(
        path, {"obs": pa.string_view(), "acts": pa.list_(pa.float64()), "terminal": pa.bool_()}, columns
    )


def zipped(path: Path) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("obs", "act", "lengths", "terminated"):
            with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                count = ZEROS if name == "obs" else 1
                np.lib.format.write_array_header_1_0(
                    file, {"descr": "<i8", "fortran_order": False, "shape": (count,)}
                )
                for _ in range(100 if name == "obs" else 1):
                    file.write(bytes(8 * count // (100 if name == "obs" else 1)))
    return path


def claimed(path: Path) -> Path:
    """An array whose header claims more than is there."""
    with zipfile.ZipFile(path, "w") as archive:
        for name in ("obs", "act", "lengths", "terminated"):
            with archive.open(f"{name}.npy", "w") as file:
                np.lib.format.write_array_header_1_0(
                    file, {"descr": "<i8", "fortran_order": False, "shape": (10**11,)}
                )
    return path


def minari(path: Path, form: str) -> Path:
    there = made((5,), (True,))
    path = minari_folder(path, form, there[0].obs, there[0].act, there[0].terminated, there[1])
    column = pa.FixedSizeListArray.from_arrays(np.zeros(PART), 1)
    table = pa.table(
        {"observations": column, "actions": column, "rewards": np.zeros(PART)}
        | dict.fromkeys(("terminations", "truncations"), np.zeros(PART, bool))
    )
    file = path / f"data/0/part-0.{form}"
    if form == "parquet":
        with parquet.ParquetWriter(file, table.schema, compression="zstd") as writer:
            for _ in range(100):
                writer.write_table(table)
    else:
        options = pa.ipc.IpcWriteOptions(compression="zstd")
        with pa.OSFile(str(file), "wb") as out, pa.ipc.new_file(out, table.schema, options=options) as writer:
            for _ in range(100):
                writer.write_table(table)
    return path


def deep(path: Path) -> Path:
    path.mkdir()
    (path / "state.json").write_text("[" * (15 * MIB))
    return path


BOMBS: dict[str, tuple[Callable[[Path], Path], str]] = {
    "zeros": (zeros, "takes more memory"),
    "zip": (zipped, "takes more memory"),
    "claims": (claimed, "takes more memory"),
    "parquet": (lambda path: minari(path, "parquet"), "takes more memory"),
    "arrow": (lambda path: minari(path, "arrow"), "takes more memory"),
    "deep JSON": (deep, ""),
}


@pytest.mark.parametrize(
    ("make", "kind"),
    [
        (shared_rows, "list_view"),
        (runs, "run_end_encoded"),
        (dictionary, "dictionary"),
        (views, "string_view"),
    ],
)
def test_columns_whose_rows_may_share_what_they_hold_are_refused(
    tmp_path: Path, make: Callable[[Path], Path], kind: str
) -> None:
    with pytest.raises(ValueError, match=f"d.arrow has obs of type {kind}"):
        demonstration_forms.raw(make(tmp_path / "d"))


def test_few_bytes_take_no_more_memory_than_is_allowed(tmp_path: Path) -> None:
    paths = [make(tmp_path / name.replace(" ", "_")) for name, (make, _) in BOMBS.items()]
    for path in paths:
        size = sum(file.stat().st_size for file in [path, *path.rglob("*")] if file.is_file())
        assert size < 20 * MIB
    program = [sys.executable, "-c", READ, str(ALLOWED), *map(str, paths)]
    *said, here, there = subprocess.run(
        program, check=True, capture_output=True, text=True
    ).stdout.splitlines()
    assert len(said) == len(BOMBS)
    for line, (_, why) in zip(said, BOMBS.values(), strict=True):
        assert why in line
    assert 1024 * int(here) < 200 * MIB
    assert 1024 * int(there) < ALLOWED + 100 * MIB  # and what programs and their libraries take


@pytest.mark.parametrize("form", ["npz", "imitation", "hdf5"])
def test_what_is_read_apart_is_what_is_read_here(tmp_path: Path, form: str) -> None:
    episodes, rewards = made()
    if form == "npz":
        path = tmp_path / "d.npz"
        demos.write(path, episodes, rewards)
    elif form == "imitation":
        path = imitation(tmp_path / "d", episodes, rewards)
    else:
        path = minari_folder(tmp_path / "d", form, episodes.obs, episodes.act, episodes.terminated, rewards)
    found, here = apart.raw(path), demonstration_forms.raw(path)
    assert [array.dtype for *_, array in found.arrays] == [array.dtype for *_, array in here.arrays]
    for (*one, array), (*other, theirs) in zip(found.arrays, here.arrays, strict=True):
        assert one == other
        assert np.array_equal(array, theirs)
    for name in ("form", "terminated", "vague", "own", "first"):
        assert getattr(found, name) == getattr(here, name)
    assert np.array_equal(found.bounds or (), here.bounds or ())
    read = demos.read(path, SWINGUP, (-1.0, 1.0))
    if form != "imitation":
        assert same(read.episodes, episodes)


@pytest.mark.parametrize(
    ("program", "why"),
    [
        (f"import os; os.kill(os.getpid(), {signal.SIGSEGV:d})", "its reader ended (Segmentation fault)"),
        ("print('{\"form\": ', end='')", "its reader ended (exit code 0)"),
        ("raise SystemExit(3)", "its reader ended (exit code 3)"),
        (
            "import sys; sys.path[:] = sys.argv[4:]; from harness import apart; apart._bound(1 << 30, 1)\n"
            "while True: pass",
            "reading it takes more than 600 seconds",
        ),
    ],
)
def test_a_file_that_ends_its_reader_is_refused_in_a_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, program: str, why: str
) -> None:
    monkeypatch.setattr(apart, "PROGRAM", program)
    with pytest.raises(BadInput, match="no demonstrations of swingup: ") as error:
        demos.read(tmp_path / "d.npz", SWINGUP)
    assert why in str(error.value)
    assert str(error.value).isprintable()
