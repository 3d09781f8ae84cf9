"""Reading an EDS: from its text in memory to a dictionary with all its objects.

The peer gets a text stream, ours the bytes; neither reads a disk. Both come to the same objects, names and data types, which is
checked; ours also checks the file and keeps lines and columns for its findings, which the peer does not. What neither does is
look up a name (ours makes its tables of names when somebody asks first).

Makers' files are not part of the project: they are looked for in `$CANOPEN_VENDOR_EDS`, else in `../shared/eds` beside the
repository, and left out where they are missing. The generated files have 2000 objects of the kinds that such files have, and
28 672, as many as the manufacturer-specific and the profile areas hold together.
"""

from __future__ import annotations

import io
import logging
import os
from collections.abc import Iterator
from pathlib import Path

from canopen import ObjectDictionary as TheirDictionary
from canopen.objectdictionary import ODVariable, import_od
from measure import Case

from canopen_data.eds import read_eds
from canopen_proto.dictionary import ObjectDictionary

FOLDER = Path(os.environ.get("CANOPEN_VENDOR_EDS") or Path(__file__).parents[1] / ".." / "shared" / "eds")
FILES = ("canopen-sample.eds", "inovance-e35.eds")
OBJECTS = 2000
MOST_OBJECTS = 28_672


class _Stream(io.StringIO):
    """A text stream with the name by which the peer knows what it is."""

    name = "file.eds"


def their_dictionary(text: str) -> TheirDictionary:
    """The peer's dictionary of an EDS."""
    return import_od(_Stream(text))


def _variable(section: str, name: str, data_type: int, access: str, default: str, *more: str) -> Iterator[str]:
    yield f"[{section}]"
    yield f"ParameterName={name}"
    yield "ObjectType=0x7"
    yield f"DataType=0x{data_type:04X}"
    yield f"AccessType={access}"
    yield f"DefaultValue={default}"
    yield from more
    yield f"PDOMapping={int(access == 'rww')}"
    yield ""


def _whole(section: str, name: str, object_type: int, count: int) -> list[str]:
    return [f"[{section}]", f"ParameterName={name}", f"ObjectType=0x{object_type:X}", f"SubNumber={count}", ""]


def generated(objects: int = OBJECTS) -> str:
    """An EDS with so many objects: of five, three are variables, one is an array and one a record of four entries each.

    Defaults and limits are round numbers that occur again and again, as they do in makers' files: there, from four to nine tenths
    of the sections say the same as another one, but for the name; here it is seven tenths.
    """
    lines = ["[FileInfo]", "FileName=generated.eds", "", "[DeviceInfo]", "VendorName=Generated", "VendorNumber=1", ""]
    lines += ["[ManufacturerObjects]", f"SupportedObjects={objects}"]
    lines += [f"{number}=0x{0x2000 + number:04X}" for number in range(1, objects + 1)]
    lines.append("")
    for number in range(1, objects + 1):
        section, name = f"{0x2000 + number:04X}", f"Parameter {number}"
        default = "0" if number % 3 else str(number)
        limits = ("LowLimit=-1000", f"HighLimit={number // 20 * 100}")
        match number % 5:
            case 0:
                lines += _whole(section, name, 8, 4)
                lines += _variable(f"{section}sub0", "Number of entries", 5, "ro", "3")
                for subindex in (1, 2, 3):
                    lines += _variable(f"{section}sub{subindex}", f"{name} [{subindex}]", 3, "rw", "0", *limits)
            case 1:
                lines += _whole(section, name, 9, 4)
                lines += _variable(f"{section}sub0", "Highest sub-index supported", 5, "ro", "3")
                lines += _variable(f"{section}sub1", "COB-ID", 7, "rw", f"$NODEID+0x{number:X}")
                lines += _variable(f"{section}sub2", "Gain", 8, "rw", "1.5")
                lines += _variable(f"{section}sub3", "Label", 9, "const", name)
            case 2:
                lines += _variable(section, name, 4, "rww", default, *limits)
            case _:
                lines += _variable(section, name, 6, "ro", default)
    return "\n".join(lines)


def _facts(ours: ObjectDictionary) -> set[tuple[int, int, str]]:
    return {(each.index, each.subindex, each.name) for each in ours}


def _their_facts(theirs: TheirDictionary) -> set[tuple[int, int, str]]:
    objects = [each for each in theirs.values() if each.index > 0x1F]  # the peer has dummies as objects
    variables = [[each] if isinstance(each, ODVariable) else list(each.subindices.values()) for each in objects]
    return {(each.index, each.subindex, each.name) for group in variables for each in group}


def _case(title: str, text: str) -> Case:
    data = text.encode()

    def ours(count: int) -> None:
        for _ in range(count):
            read_eds(data)

    def theirs(count: int) -> None:
        for _ in range(count):
            their_dictionary(text)

    def check() -> None:
        mine, others = _facts(read_eds(data).dictionary), _their_facts(their_dictionary(text))
        differing = {place for place in mine ^ others if place[0] not in COMPACT}
        assert not differing, sorted(differing)[:5]

    return Case(title, ours, theirs, check)


COMPACT = (0x3003, 0x3004, 0x3006)
"""Arrays in compact form, in the peer's sample: the peer makes their entries when they are asked for, and has other names."""


def cases() -> list[Case]:
    """The generated file, and the makers' that are there."""
    logging.getLogger("canopen").setLevel(logging.ERROR)  # the peer warns of its own sample
    found = [path for name in FILES if (path := FOLDER / name).exists()]
    texts = {f"{path.name}, {path.stat().st_size // 1000} kB": path.read_text("utf-8", "replace") for path in found}
    texts |= {f"generated, {count} objects": generated(count) for count in (OBJECTS, MOST_OBJECTS)}
    return [_case(f"EDS import: {name}", text) for name, text in texts.items()]
