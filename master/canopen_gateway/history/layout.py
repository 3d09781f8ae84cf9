"""Where the files of a history stand: a folder for each place and hour.

    DIR/hall-2/arm/5/2026-11-28T22/20261128T221503Z-9f3a1c-000001.parquet     what was taken since the flush before
    DIR/hall-2/arm/5/2026-11-28T22/20261128T221503Z-9f3a1c-all.parquet        all of that hour, once it is over
    DIR/hall-2/arm/0/...                                                      what is known of the bus, and of none of its nodes
    DIR/@recorder/-/0/...                                                     the recorder's own: when it began, and was heard

The hour is that of the recorder's clock, in UTC. The long word is a run of a recorder, or what a run has written of an hour that
came again; several may write to one folder. A file that has its name is whole: it was written under another one, brought to the
disk, and then renamed. `-all` takes the place of the other files with its word in that hour: a reader leaves them out, also where
a kill came before they were removed.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple

from canopen_gateway.fleet.keys import NAME, FleetPlace

RECORDER: Final = FleetPlace("@recorder", "-", 0)
"""The place of the recorder's own rows."""
HOUR: Final = "%Y-%m-%dT%H"
ALL: Final = "all"
SUFFIX: Final = ".parquet"
_FILE: Final = re.compile(r"(\d{8}T\d{6}Z-[0-9a-f]{6,16})-(\d{6,12}|all)\.parquet\Z")
_HOUR: Final = re.compile(r"\d{4}-\d\d-\d\dT\d\d\Z")
_NODE: Final = re.compile(r"0|[1-9]\d{0,2}\Z")


class HistoryFile(NamedTuple):
    """A file of a history. hour: "2026-11-28T22". run: of its recorder. part: its number, or "all"."""

    path: Path
    place: FleetPlace
    hour: str
    run: str
    part: str


def folder_of(folder: Path, place: FleetPlace, hour: str) -> Path:
    """Return the folder for a place and an hour."""
    return folder / place.site / place.bus / str(place.node_id) / hour


def name_of(run: str, part: int | str) -> str:
    """Return the name of a file. part: its number in its run, or ALL."""
    return f"{run}-{part if isinstance(part, str) else f'{part:06d}'}{SUFFIX}"


def files_in(folder: Path) -> tuple[list[HistoryFile], list[Path]]:
    """Return the files of a history, by place, hour and run; and the files in its folder that are none of it. Parts whose hour
    was put together are in neither. Raises OSError."""
    found: list[HistoryFile] = []
    foreign: list[Path] = []
    for path in _files(folder):
        file = _parsed(folder, path)
        if file is not None:
            found.append(file)
        elif not path.name.startswith("."):  # one that is being written, or was when its recorder was killed
            foreign.append(path)
    whole = {(file.place, file.hour, file.run) for file in found if file.part == ALL}
    kept = [file for file in found if file.part == ALL or (file.place, file.hour, file.run) not in whole]
    return sorted(kept, key=lambda each: (each.place, each.hour, each.run, each.part)), sorted(foreign)


def _files(folder: Path) -> Iterator[Path]:
    for path in folder.iterdir():
        if path.is_symlink():  # it may lead anywhere
            continue
        if path.is_dir():
            yield from _files(path)
        else:
            yield path


def _parsed(folder: Path, path: Path) -> HistoryFile | None:
    words = path.relative_to(folder).parts
    if len(words) != 5:
        return None
    site, bus, node, hour, name = words
    file = _FILE.match(name)
    named = (site, bus) == RECORDER[:2] or (NAME.match(site) and NAME.match(bus))
    if file is None or not named or not _NODE.match(node) or int(node) > 127 or not _HOUR.match(hour):
        return None
    return HistoryFile(path, FleetPlace(site, bus, int(node)), hour, file[1], file[2])
