"""Plug-ins for other machines: copied with the files beside them, and found there."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

from harness.registry.known import KNOWN, Plugin

NO_NUMBERS = "It copies sources, whose content is in the keys."


def packed(folder: Path) -> dict[Plugin, Plugin]:
    """Copy the plug-ins that were named into the folder, for another machine.

    Return them as they are there, with places below the folder.
    """
    copies = {}
    for i, one in enumerate(KNOWN.plugins.values()):
        at = Path("plugins") / str(i)
        (folder / at).mkdir(parents=True)
        source = Path(one.place)
        if not one.is_file:
            source /= one.name.partition(".")[0]
        if one.is_file:
            _copy_helpers(source.parent, folder / at)
        if source.is_dir():
            shutil.copytree(source, folder / at / source.name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            source = source.with_suffix(".py")
            shutil.copy(source, folder / at)
        copies[one] = Plugin(one.name, str(at / source.name if one.is_file else at))
    return copies


def _copy_helpers(place: Path, to: Path) -> None:
    """Copy the files beside a plug-in of one file that numbers come from."""
    for digest in {digest for offer in KNOWN.offers.values() for digest in offer.sources.digests}:
        name, _, _ = digest.rpartition(" ")
        if name and (place / name).is_file():
            (to / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(place / name, to / name)


def unpacked(plugins: Sequence[Plugin]) -> tuple[Plugin, ...]:
    """Return plug-ins that were `packed` into this process's folder, with their places here."""
    return tuple(Plugin(one.name, str(Path(one.place).absolute())) for one in plugins)
