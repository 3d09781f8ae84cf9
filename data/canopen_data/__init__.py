"""The product's data files: the object dictionary of the manual (indices.csv, constants.csv, PDOs.csv) and example chain files.

The files are installed with this package. A user's own file of the same name takes precedence: it is looked for in the folder
that the caller names, else in $CANOPEN_DATA, else in ~/.canopen. `init` copies the installed files there for editing.

Only this module reads these files; `canopen_proto` takes their texts. Nothing here prints: the caller gets a `Finding` of
severity notice, or the list that `init` returns.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Final

from canopen_data.csv import load_csv
from canopen_data.findings import DictionaryError, Finding, Severity
from canopen_proto.dictionary.model import ObjectDictionary
from canopen_proto.explained import Explained

__all__ = [
    "CHAIN_FILES",
    "DICTIONARY_FILES",
    "Copied",
    "DataError",
    "DataFile",
    "content_of",
    "expanded",
    "init",
    "load_dictionary",
    "read",
    "read_chain_file",
    "text_of",
    "user_folder",
]

DICTIONARY_FILES: Final = ("indices.csv", "constants.csv", "PDOs.csv")
CHAIN_FILES: Final = ("single_device.csv", "multiple_devices.csv")
ENVIRONMENT_VARIABLE: Final = "CANOPEN_DATA"

BRING_BACK: Final = "`canopen data init --force` replaces your files by the installed ones"

MAX_FILE_SIZE: Final = 16 * 1024 * 1024
"""Bytes. A larger file is not a data file (perhaps a log or a device node) and would only fill the memory."""


class DataError(Explained, Exception):
    """A data file or folder cannot be used. For the fields see Explained."""

    def __init__(self, failed: str, *tries: str) -> None:
        super().__init__("CO330", failed, tries=tries)


@dataclass(frozen=True, slots=True)
class DataFile:
    """A file's text. source: its path, or "installed NAME". notice: says that a user's file replaces the installed one."""

    name: str
    text: str
    source: str
    notice: Finding | None = None


@dataclass(frozen=True, slots=True)
class Copied:
    """The result of `init` for one file. action: "created", "replaced", "kept" (it differs, and force was not given),
    "unchanged"."""

    path: Path
    action: str


def user_folder(folder: str | Path | None = None) -> Path | None:
    """Return the folder of the user's own files: the argument, else $CANOPEN_DATA, else ~/.canopen if it exists, else None.

    Raises DataError if a folder that was asked for by name does not exist.
    """
    named, origin = folder, ""
    if named is None:
        named, origin = os.environ.get(ENVIRONMENT_VARIABLE), f" (${ENVIRONMENT_VARIABLE})"
    if not named:
        home = _home_directory()
        return home if home is not None and home.is_dir() else None
    path = expanded(named)
    if not os.path.isdir(path):
        if os.path.exists(path):
            raise DataError(f"the data folder {path}{origin} is not a folder", "name another one")
        raise DataError(f"the data folder {path}{origin} does not exist", "`canopen data init` makes one")
    return path


def read(name: str, folder: str | Path | None = None) -> DataFile:
    """Return a data file by its name: the user's own, else the installed one. folder: of the user's files, see `user_folder`.

    Raises DataError if there is neither (it lists the installed ones), or if it cannot be read.
    """
    folder = user_folder(folder)
    installed = name in (*DICTIONARY_FILES, *CHAIN_FILES)
    if folder is not None:
        own = folder / name
        text = text_of(own, str(own))
        if text is not None:
            message = f"used instead of the installed {name}"
            return DataFile(name, text, str(own), Finding(Severity.NOTICE, "user-file", message, str(own)) if installed else None)
    text = text_of(resources.files(__name__) / name, f"installed {name}") if installed else None
    if text is None:
        searched = f" in {folder}" if folder is not None else ""
        known = ", ".join((*DICTIONARY_FILES, *CHAIN_FILES))
        raise DataError(f"there is no data file {name!r}{searched}", f"use one of {known}")
    return DataFile(name, text, f"installed {name}")


def read_chain_file(name: str | Path, folder: str | Path | None = None) -> DataFile:
    """Return a chain file by its path or, if there is no such file, by its name (see `read`). Raises DataError. folder: of the
    user's files, see `user_folder`."""
    path = expanded(name)
    text = text_of(path, str(path))
    return read(str(name), folder) if text is None else DataFile(path.name, text, str(path))


def load_dictionary(folder: str | Path | None = None) -> tuple[ObjectDictionary, list[Finding]]:
    """Return the object dictionary of indices.csv, constants.csv and PDOs.csv, and what was found: notices first, then warnings.
    folder: of the user's files, see `user_folder`.

    A user's indices.csv may have fewer objects than the installed one: lines of installed files about the missing objects are
    left out.

    Raises DataError if a file cannot be read, and DictionaryError, which holds all errors of the user's files.
    """
    files = [read(name, folder) for name in DICTIONARY_FILES]
    notices = [each.notice for each in files if each.notice is not None]
    try:
        dictionary, warnings = _load(files)
    except DictionaryError as error:
        own = [each for each in error.findings if each.source in (notice.source for notice in notices)]
        if own or not notices:
            raise DictionaryError(own or error.findings, "correct the file", BRING_BACK) from None
        files = [_without(each, error.findings, notices) for each in files]
        dictionary, warnings = _load(files)
    return dictionary, notices + warnings


def _load(files: list[DataFile]) -> tuple[ObjectDictionary, list[Finding]]:
    indices, constants, pdos = files
    dictionary, warnings = _parsed(indices.text, constants.text, pdos.text, (indices.source, constants.source, pdos.source))
    return dictionary, list(warnings)


@lru_cache(maxsize=4)
def _parsed(indices: str, constants: str, pdos: str, sources: tuple[str, str, str]) -> tuple[ObjectDictionary, list[Finding]]:
    """Parse the texts once for all nodes that share a description."""
    return load_csv(indices, constants, pdos, sources=sources)


def _without(file: DataFile, errors: Iterable[Finding], notices: list[Finding]) -> DataFile:
    """Return an installed file without the lines that do not fit the user's own files; a notice gives their number."""
    unfit = {each.line for each in errors if each.source == file.source}
    if not unfit:
        return file
    message = f"{len(unfit)} of its lines are left out: your own files do not have the objects that they name"
    notices.append(Finding(Severity.NOTICE, "left-out", message, file.source))
    lines = file.text.split("\n")
    return replace(file, text="\n".join("" if number in unfit else line for number, line in enumerate(lines, start=1)))


def init(folder: str | Path | None = None, *, force: bool = False) -> list[Copied]:
    """Copy the installed files to `folder` ($CANOPEN_DATA, else ~/.canopen) and return what was done with each.

    An existing file stays as it is, unless force is given. Raises DataError if the folder or a file cannot be written; files
    copied before that stay.
    """
    goal = _target(folder)
    try:
        goal.mkdir(parents=True, exist_ok=True)
        return [_copy(name, goal / name, force) for name in (*DICTIONARY_FILES, *CHAIN_FILES)]
    except (OSError, ValueError) as error:  # ValueError: a name that no folder can have
        hint = "`canopen data init -o FOLDER` copies them to another folder"
        raise DataError(f"cannot copy the data files to {goal}: {error}", hint) from None


def _copy(name: str, path: Path, force: bool) -> Copied:
    content = (resources.files(__name__) / name).read_bytes()
    if not path.exists():
        path.write_bytes(content)
        return Copied(path, "created")
    if path.read_bytes() == content:
        return Copied(path, "unchanged")
    if not force:
        return Copied(path, "kept")
    path.write_bytes(content)
    return Copied(path, "replaced")


def _target(target: str | Path | None) -> Path:
    named = target if target is not None else os.environ.get(ENVIRONMENT_VARIABLE)
    if named:
        return expanded(named)
    home = _home_directory()
    if home is None:
        raise DataError("there is no home folder", f"name a folder, or set ${ENVIRONMENT_VARIABLE}")
    return home


def _home_directory() -> Path | None:
    try:
        return Path.home() / ".canopen"
    except RuntimeError:  # no HOME and no entry in the password file, as in some containers
        return None


def expanded(path: str | Path) -> Path:
    """Return a path with ~ replaced. Raises DataError if there is no home folder, and for what names no file."""
    if not isinstance(path, str | os.PathLike) or not str(path):
        raise DataError(f"{path!r} is no path of a file", "name the file")
    try:
        return Path(path).expanduser()
    except RuntimeError:
        raise DataError(f"there is no home folder for {path}", "name the folder without ~") from None


def content_of(path: Path | Traversable, source: str) -> bytes | None:
    """Return the bytes of a file, MAX_FILE_SIZE at most; None if there is none. source: its name in errors. Raises DataError."""
    try:
        with path.open("rb") as file:
            content = file.read(MAX_FILE_SIZE + 1)
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        reason = error.strerror if isinstance(error, OSError) else error
        raise DataError(f"cannot read {source}: {reason}", "check that it is a file and that you may read it") from None
    if len(content) > MAX_FILE_SIZE:
        raise DataError(f"{source} is larger than {MAX_FILE_SIZE // 1024**2} MiB", "check its name: no data file is so large")
    return content


def text_of(path: Path | Traversable, source: str) -> str | None:
    """Return the text of a file; None if there is no such file. source: its name in errors. Raises DataError."""
    content = content_of(path, source)
    if content is None:
        return None
    try:
        return content.decode("utf-8-sig")  # editors on Windows begin a file with a byte order mark
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        fault = f"line {line} has the byte 0x{content[error.start]:02X}"
        raise DataError(f"{source} is not UTF-8 text: {fault}", "save it as UTF-8") from None
