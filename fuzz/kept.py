"""What long runs have found: a target's inputs that each reach something that no other does, in one archive per target.

`fuzz/corpus/TARGET` has a few inputs that people wrote, with names; `fuzz/kept/TARGET.zip` has the hundreds that the fuzzer made
out of them. A run begins with both, and the normal tests run both. `python -m fuzz keep TARGET` brings the archive up to date.
"""

from __future__ import annotations

import hashlib
import zipfile
from pathlib import Path
from typing import Final

HERE: Final = Path(__file__).parent
_THE_SAME_DAY: Final = (1984, 1, 1, 0, 0, 0)
"""Time stamp of all entries: equal inputs make equal archives."""


def archive_of(target: str) -> Path:
    """Where a target's inputs are kept."""
    return HERE / "kept" / f"{target}.zip"


def kept(target: str) -> list[bytes]:
    """A target's kept inputs; none where nothing was kept yet."""
    path = archive_of(target)
    if not path.exists():
        return []
    with zipfile.ZipFile(path) as archive:
        return [archive.read(name) for name in sorted(archive.namelist())]


def unpack(target: str, folder: Path) -> None:
    """Put a target's kept inputs into a folder, each under its hash."""
    for data in kept(target):
        (folder / hashlib.sha1(data, usedforsecurity=False).hexdigest()).write_bytes(data)


def keep(target: str, inputs: list[bytes]) -> None:
    """Make these the kept inputs of a target."""
    path = archive_of(target)
    path.parent.mkdir(exist_ok=True)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for data in sorted(set(inputs)):
            name = hashlib.sha1(data, usedforsecurity=False).hexdigest()
            archive.writestr(zipfile.ZipInfo(name, _THE_SAME_DAY), data, zipfile.ZIP_DEFLATED)
