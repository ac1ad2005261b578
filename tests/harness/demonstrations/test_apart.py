"""A file of few bytes takes no more memory than is allowed. One that ends its reader ends nothing else."""

import os
import signal
import zipfile
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from harness.demonstrations import apart, forms
from harness.demonstrations.reading import read, write
from harness.demonstrations.units import SCALED
from tests.harness.demonstrations.made_demonstrations import (
    SWINGUP,
    imitation,
    made,
    minari_folder,
    refused,
    same,
)

MIB = 1 << 20
ALLOWED = 250 * MIB
ZEROS = 260 * MIB // 8
"""Numbers in a bomb."""


def zipped(path: Path) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("obs", "act", "lengths", "terminated"):
            with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                count = ZEROS if name == "obs" else 1
                header = {"descr": "<i8", "fortran_order": False, "shape": (count,)}
                np.lib.format.write_array_header_1_0(file, header)
                file.write(bytes(8 * count))
    return path


def in_parquet(path: Path) -> Path:
    path = minari_folder(path, "parquet", made((5,), (True,)))
    column = pa.FixedSizeListArray.from_arrays(np.zeros(ZEROS), 1)
    columns = {"observations": column, "actions": column, "rewards": np.zeros(ZEROS)}
    flags = dict.fromkeys(("terminations", "truncations"), np.zeros(ZEROS, bool))
    parquet.write_table(pa.table(columns | flags), path / "data/0/part-0.parquet", compression="zstd")
    return path


@pytest.mark.parametrize("make", [zipped, in_parquet])
def test_few_bytes_take_no_more_memory_than_is_allowed(
    make: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = make(tmp_path / "d")  # type: ignore[operator]
    assert sum(file.stat().st_size for file in [path, *path.rglob("*")] if file.is_file()) < 20 * MIB
    monkeypatch.setattr(apart, "MEMORY", ALLOWED)
    refused(path, "more memory")


@pytest.mark.parametrize("form", ["npz", "imitation", "hdf5"])
def test_what_is_read_apart_is_what_is_read_here(tmp_path: Path, form: str) -> None:
    episodes, rewards = made()
    path = tmp_path / ("d.npz" if form == "npz" else "d")
    if form == "npz":
        write(path, episodes, rewards)
    elif form == "imitation":
        imitation(path, episodes, rewards, parts=1)
    else:
        minari_folder(path, form, (episodes, rewards))
    there, here = apart.recording_in(path), apart.recording_here(path)
    assert all(np.array_equal(there.arrays[name], array) for name, array in here.arrays.items())
    assert (there.bounds is None) == (here.bounds is None)
    assert (there.form, there.first, there.unended) == (here.form, here.first, here.unended)
    assert same(read(path, SWINGUP, SCALED).episodes, episodes)


@pytest.mark.parametrize("program", [f"import os; os.kill(os.getpid(), {signal.SIGSEGV:d})", "while True: 1"])
def test_a_file_that_ends_its_reader_or_has_no_end_is_refused_in_a_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, program: str
) -> None:
    monkeypatch.setattr(apart, "PROGRAM", program)
    monkeypatch.setattr(apart, "SECONDS", 1)
    refused(tmp_path / "d.npz", "its reader ended")


def test_a_pipe_does_not_block_and_a_large_file_is_not_read(
    tmp_path: Path, read_here: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    os.mkfifo(tmp_path / "pipe.npz")
    refused(tmp_path / "pipe.npz", "no regular file")
    monkeypatch.setattr(forms, "LARGEST", 100)
    write(tmp_path / "d.npz", *made())
    refused(tmp_path / "d.npz", "larger than")
