"""Report each section that was not read, since an object may be lost in one.

The name of a section tells its purpose. The index of an object in another spelling (`[0x2002]`, `[2002h]`), and a name much like
one of the standard (`[OptionalObject]`, `[DeviceInfos]`), are errors: the section was meant, but is left out. Sections of CiA 306
that we do not read (tools, object links) give no finding. All others are a maker's own: a notice.

Source: CiA 306-1 v1.4.0, 4.4 to 4.8 and 5.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Collection
from typing import Final

from canopen_data.eds.ini import EdsDocument, Findings, Section, quoted
from canopen_data.findings import Severity

_NAMES: Final = {
    each.lower(): each
    for each in (
        "FileInfo",
        "DeviceInfo",
        "DummyUsage",
        "Comments",
        "MandatoryObjects",
        "OptionalObjects",
        "ManufacturerObjects",
        "DeviceComissioning",
        "SupportedModules",
        "ConnectedModules",
        "DynamicChannels",
        "Tools",
    )
}
_OTHERS: Final = re.compile(
    r"m[0-9]{1,6}(?:moduleinfo|comments|fixedobjects|subextends|subext[0-9a-f]{1,4}|fixed(?:obj)?[0-9a-f]{1,4}(?:sub[0-9a-f]+)?)"
    r"|tool[0-9]{1,6}|[0-9a-f]{4}objectlinks",
    re.ASCII,
)
_SHORT: Final = re.compile(r"([0-9a-f]{1,3})(?:sub1)?", re.ASCII)
_LIKE_AN_OBJECT: Final = re.compile(
    r"(?:0?x)?0*[0-9a-f]{4}h?(?:(?:sub|var|name|value|index|obj)[0-9a-z]*)?|sub0*[0-9a-f]{4}.*", re.ASCII
)
_NO_LETTERS_OR_DIGITS: Final = re.compile(r"[\W_]+")
_ALIKE: Final = 0.8


def report_unused(document: EdsDocument, findings: Findings, types: Collection[int]) -> None:
    """Report each section that the reader does not use. types: the data types that were looked up; one tool names their sections
    without leading zeros."""
    for name, section in document.named.items():
        short = _SHORT.fullmatch(name)
        is_type = short is not None and int(short[1], 16) in types
        if name not in _NAMES and _OTHERS.fullmatch(name) is None and not is_type:
            _report(section, name, findings)
    for (index, kind), section in document.lists.items():
        whole = document.objects.get(index)
        if whole is None or whole.get("CompactSubObj") is None:
            said = f"[{quoted(section.name)}] was left out; a list of {kind}s is for a CompactSubObj, and [{index:04X}] has none"
            _tell(section, Severity.ERROR, said, findings)


def _report(section: Section, name: str, findings: Findings) -> None:
    bare = _NO_LETTERS_OR_DIGITS.sub("", name)
    near = difflib.get_close_matches(bare[:100], _NAMES, n=1, cutoff=_ALIKE)
    if _LIKE_AN_OBJECT.fullmatch(bare) is not None and any(each.isdigit() for each in bare):
        what = "objects have the names 0001 to FFFF, sub-objects 1018sub1"
        _tell(section, Severity.ERROR, f"[{quoted(section.name)}] was left out; {what}", findings)
    elif near:
        _tell(section, Severity.ERROR, f"[{quoted(section.name)}] was left out; is [{_NAMES[near[0]]}] meant?", findings)
    else:
        _tell(section, Severity.NOTICE, f"[{quoted(section.name)}] is not a section of CiA 306, and was left out", findings)


def _tell(section: Section, severity: Severity, message: str, findings: Findings) -> None:
    if not findings.full(severity):
        findings.add(severity, "unused-section", message, section.line, 1)
