"""Files that a user names: a text, a device's own file. Each fault that makes one unusable is an error that says what to do."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from canopen_data import text_of
from canopen_data.description import DeviceDescription
from canopen_data.descriptions import UnusableFileError, read_file, refuse_without_objects
from canopen_data.reading import read_description

__all__ = ["DescriptionFile", "UnusableFileError", "open_description"]


@dataclass(frozen=True)
class DescriptionFile:
    """A file and its description. description.findings: the faults of the file."""

    path: str
    data: bytes
    description: DeviceDescription

    @property
    def lines(self) -> list[str]:
        """The file's text, in lines as the findings count them."""
        return lines_of(self.data.decode(self.description.encoding, errors="replace"))


def lines_of(text: str) -> list[str]:
    """Return the lines of a text as findings count them: a line feed or a carriage return ends a line. str.splitlines knows more
    ends."""
    return text.removeprefix("\ufeff").replace("\r\n", "\n").replace("\r", "\n").split("\n")


def open_description(path: str, encoding: str = "", connected: tuple[int, ...] = ()) -> DescriptionFile:
    """Read a device's own file, however many faults it has. encoding: of its text, "" for a guess. connected: see
    `read_description`. path: of a file, or the name of a sample.

    Raises DataError if it cannot be read, UnusableFileError if it describes no object.
    """
    data = read_file(path)
    description = read_description(data, path, encoding=encoding, connected=connected)
    refuse_without_objects(description, data)
    return DescriptionFile(path, data, description)


def read_text(path: Path) -> str:
    """Return a text of at most MAX_FILE_SIZE bytes. Raises DataError."""
    text = text_of(path, str(path))
    if text is None:
        raise UnusableFileError(f"there is no file {str(path)!r}", tries=("check the path",))
    return text
