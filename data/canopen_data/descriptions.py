"""Device descriptions from files: EDS, DCF, XDD and XDC, a user's own or one of the samples that come with this package.

The samples were written for this project. A sample is named without a folder (`sample_io.xdd`); a file of that name in the
current folder takes precedence. Files are read here, `canopen_proto` takes their bytes, and nothing prints.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Final

from canopen_data import DataError, content_of, expanded, load_dictionary
from canopen_data.description import DeviceDescription
from canopen_data.findings import Severity
from canopen_data.reading import read_description
from canopen_proto import indices
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary.model import ObjectDictionary
from canopen_proto.drives.cia402.axes import with_names_of_axes

__all__ = ["load_description", "load_description_with_names", "read_file", "samples", "with_names"]

SUFFIXES: Final = (".eds", ".dcf", ".xdd", ".xdc")
DRIVE_PROFILE: Final = 402

_SAMPLES: Final = resources.files("canopen_data") / "samples"


class UnusableFileError(DataError):
    """A file that a user named cannot be used. For the fields see Explained."""

    def __init__(self, failed: str, code: str = "CO330", *, seen: str = "", cause: str = "", tries: Iterable[str] = ()) -> None:
        super().__init__(failed, *tries)
        self.code, self.seen, self.cause = code, seen, cause


def samples() -> list[str]:
    """Return the names of the samples."""
    return sorted(each.name for each in _SAMPLES.iterdir() if each.name.endswith(SUFFIXES))


def read_file(path: str | Path) -> bytes:
    """Return the bytes of a description's file, or of a sample. Raises DataError if there is none, or if it cannot be read. path:
    of a file, or the name of a sample."""
    own = expanded(path)
    content = content_of(own, str(own))
    if content is None and str(path) in samples():
        content = content_of(_SAMPLES / str(path), f"installed {path}")
    if content is None:
        raise DataError(f"there is no file {str(own)!r}", "check the path", f"use a sample: {', '.join(samples())}")
    return content


def load_description(path: str | Path, *, strict: bool = False) -> DeviceDescription:
    """Return the description in a file. Its findings list everything wrong with the file. path: of a file, or the name of a
    sample.

    Raises DataError if it cannot be read or describes no object; with strict, DictionaryError for the first error in it.
    """
    data = read_file(path)
    description = read_description(data, str(path), strict=strict)
    refuse_without_objects(description, data)
    return description


def refuse_without_objects(description: DeviceDescription, data: bytes) -> None:
    """Refuse a file that describes no object: it is another one. data: its bytes. Raises UnusableFileError."""
    if description.dictionary.objects:
        return
    first = next((each for each in description.findings if each.severity is Severity.ERROR), None)
    seen = f"{len(data)} bytes"
    if first is not None:
        seen = f"line {first.line}: {first.message}" if first.line else first.message
    raise UnusableFileError(
        f"{description.source} describes no object",
        "CO301",
        seen=seen,
        cause="it is no EDS, DCF, XDD or XDC, or it was cut off",
        tries=("check the path", "ask the device's maker for its file"),
    )


def load_description_with_names(path: str | Path, *, overlay: bool = True, folder: str | Path | None = None) -> DeviceDescription:
    """Do as `load_description`, and lay aliases and constants of the data files over the dictionary; see `with_names`.

    overlay: False keeps only the file's own names. folder: of the user's data files. Raises also what `load_dictionary`
    raises.
    """
    description = load_description(path)
    return with_names(description, load_dictionary(folder)[0]) if overlay else description


def with_names(description: DeviceDescription, names: ObjectDictionary) -> DeviceDescription:
    """Return the description with names, aliases and constants of another dictionary laid over its own, which stay as further
    aliases.

    Communication objects mean the same in all devices. Objects of the profile area are named only if the device is a drive: the
    data files describe drives.
    """
    whole = description.dictionary
    if _is_drive(whole):
        return replace(description, dictionary=with_names_of_axes(whole.with_names_of(names)))
    # From the profile area on, the meaning of an index depends on the device profile (CiA 301 v4.2.0, table 41)
    common = ObjectDictionary(
        [each for each in whole.objects.values() if each.index < indices.PROFILE_AREA.start],
        constants={each.mux: whole.constants_of(each) for each in whole},
        pdos=whole.pdos,
        fillers=whole.fillers.values(),
        source=whole.source,
    )
    rest = [each for each in whole.objects.values() if each.index >= indices.PROFILE_AREA.start]
    return replace(description, dictionary=common.with_names_of(names).with_objects(rest))


def _is_drive(dictionary: ObjectDictionary) -> bool:
    """Return whether this is a drive: by its device type, or by controlword and statusword if the file has no device type."""
    device_type = dictionary.get(indices.DEVICE_TYPE)
    value = None if device_type is None else device_type.default if device_type.configured is None else device_type.configured
    if isinstance(value, int):
        return value & 0xFFFF == DRIVE_PROFILE
    words = (dictionary.get(0x6040), dictionary.get(0x6041))
    return all(word is not None and word.data_type is DataType.UNSIGNED16 for word in words)
