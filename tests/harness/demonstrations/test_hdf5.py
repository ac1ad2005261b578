"""Of HDF5 only plain arrays of numbers in the file itself are read."""

import pickle
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from harness.demonstrations.reading import read
from tests.harness.demonstrations.made_demonstrations import SWINGUP, refused
from tests.harness.demonstrations.made_minari import FLAGS, made, minari_folder

pytestmark = pytest.mark.usefixtures("read_here")
OTHERWISE = dict.fromkeys(("flags as numbers", "fewer flags", "no steps"), "terminations and truncations")
OTHERWISE["no episode"] = "episode_0"


def odd_hdf5(file: h5py.File, elsewhere: Path) -> dict[str, Callable[[], object]]:
    """What is put in the place of the first episode's rewards, or of the episode."""
    group, kept = file["episode_0"], file["episode_0/rewards"][()]

    def put(**options: Any) -> object:
        return group.create_dataset("rewards", **options)

    def virtual() -> None:
        layout = h5py.VirtualLayout((5,), float)
        layout[:] = h5py.VirtualSource(str(elsewhere), "kept", (5,))
        group.create_virtual_dataset("rewards", layout)

    def linked(link: Any) -> Callable[[], None]:
        return lambda: group.__setitem__("rewards", link)

    return {
        "a link of HDF5 to a file": linked(h5py.ExternalLink(str(elsewhere), "kept")),
        "a link of HDF5": linked(h5py.SoftLink("/episode_1/rewards")),
        "a virtual one": virtual,
        "one in another file": lambda: put(shape=(5,), dtype=float, external=[(str(elsewhere), 0, 40)]),
        "a compressed one": lambda: put(data=kept, compression="gzip"),
        "one that was never written": lambda: put(shape=(10**12,), chunks=(10,), dtype=float),
        "texts": lambda: put(data=["a"] * 5),
        "objects": lambda: put(shape=(5,), dtype=h5py.vlen_dtype(float)),
        "opaque": lambda: put(data=np.void(pickle.dumps(1))),
        "empty": lambda: put(data=h5py.Empty(float)),
        "one number": lambda: put(data=1.0),
        "a table": lambda: put(data=np.zeros((5, 1))),
        "too few": lambda: put(data=kept[:3]),
        "a folder": lambda: group.create_group("rewards"),
        "a type": lambda: group.__setitem__("rewards", np.dtype(float)),
        "nothing": lambda: None,
        "flags as numbers": lambda: (
            put(data=kept),
            group.pop("terminations"),
            group.create_dataset("terminations", data=np.ones(5)),
        ),
        "fewer flags": lambda: (
            put(data=kept),
            group.pop("terminations"),
            group.create_dataset("terminations", data=[True]),
        ),
        "no steps": lambda: (
            put(data=kept[:0]),
            [(group.pop(name), group.create_dataset(name, data=np.zeros(0, bool))) for name in FLAGS],
        ),
        "no episode": lambda: file.pop("episode_0"),
    }


def test_hdf5_reads_from_no_other_file_and_only_arrays_of_numbers(tmp_path: Path) -> None:
    path = minari_folder(tmp_path / "d", "hdf5", **made(lengths=(5, 4)))
    place, elsewhere = path / "data/main_data.hdf5", tmp_path / "elsewhere.hdf5"
    with h5py.File(elsewhere, "w") as file:
        file["kept"] = np.ones(5)
    whole = place.read_bytes()
    with h5py.File(place) as file:
        names = list(odd_hdf5(file, elsewhere))
    for name in names:
        place.write_bytes(whole)
        with h5py.File(place, "a") as file:
            put = odd_hdf5(file, elsewhere)[name]
            del file["episode_0/rewards"]
            put()
        refused(path, OTHERWISE.get(name, "rewards"))
    place.write_bytes(whole)
    assert len(read(path, SWINGUP).episodes) == 2


def test_an_array_of_hdf5_that_was_read_without_an_end_is_refused(tmp_path: Path) -> None:
    path = minari_folder(tmp_path / "d", "hdf5", **made(lengths=(2, 4)))
    place = path / "data/main_data.hdf5"
    dimensions = b"\x01\x02\x01" + bytes(5) + struct.pack("<QQ", 3, 3)  # the second byte: how many
    whole = place.read_bytes()
    assert dimensions in whole
    place.write_bytes(whole.replace(dimensions, b"\x01\x01" + dimensions[2:]))
    refused(path, "/episode_0/observations (3,) is not whole")
