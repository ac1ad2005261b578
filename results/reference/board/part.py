"""A part of the board: a run without most of what it learned, and without its recordings.

Of seed 0, in the task's own dynamics, policies and rewards of the expert, the methods of `all` and
`shaped_thesis` are kept, large arrays in 32 bits. From the root:

    python results/reference/board/part.py RUN FOLDER [METHOD,METHOD]

The last are methods to keep instead, such as `none` where another part has the task's, so that all parts have
less than 25 MB of them.
`irl-bench report FOLDER` then makes its tables and its page.
"""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import numpy as np

from harness.records import NOMINAL, REFERENCE
from harness.registry import METHODS
from harness.store.artifacts import artifact
from harness.store.cache import Kept, as_bytes, from_bytes
from harness.store.codec import encode
from harness.store.database import FILE, open_database
from harness.store.files import sha256_of
from harness.store.opening import open_to_verify
from harness.store.store import REQUEST

KEPT = {*METHODS, "shaped_thesis", REFERENCE}
"""Methods whose policies and rewards of seed 0 are kept."""
LARGE = 10_000
"""Numbers of an array from which it is kept in 32 bits. Only the matrix of `csil`'s reward has as many of 64;
it then pays the same to 3e-4, on average 0.02 to 0.58."""
VARIANT = "gail_mean"
"""A reward that a fit of `gail` has beside its own; another method, which is not kept."""


def write(run: Path, folder: Path, kept_of: set[str]) -> None:
    """Write the part of a run into a new folder, with what these methods learned. Raises BadInput where the
    run is damaged."""
    folder.mkdir(parents=True)
    with open_to_verify(run) as whole, open_database(folder / FILE, write=True) as part:
        results, unusable = whole.load()
        if unusable:
            raise SystemExit(f"{run}: {unusable}")
        with part.writing():
            part.put("run", REQUEST, encode(whole.request))
            for cell, result in results.items():
                data = b""
                if (cell.seed, cell.dynamics) == (0, NOMINAL) and cell.method in kept_of and result.learned:
                    learned = {name: it for name, it in whole.read_learned(result).items() if name != VARIANT}
                    data, lost = artifact(cell, whole.request.conditions, learned)
                    if lost:
                        raise SystemExit(f"{cell.name}: {lost}")
                    exact = from_bytes(data)
                    arrays = {
                        name: array.astype(np.float32) if array.size > LARGE else array
                        for name, array in exact.arrays.items()
                    }
                    data = as_bytes(Kept(arrays, exact.facts))
                    part.put("learned", cell.name, data)
                kept = dataclasses.replace(result, recordings={}, learned=sha256_of(data) if data else "")
                part.put("cells", cell.name, encode(kept))


if __name__ == "__main__":
    write(Path(sys.argv[1]), Path(sys.argv[2]), {*sys.argv[3].split(",")} if sys.argv[3:] else KEPT)
