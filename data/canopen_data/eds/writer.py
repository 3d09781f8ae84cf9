"""Write an EDS or DCF from a description (CiA 306-1).

`write_eds` writes every fact that CiA 306 has a place for. If the description came from an EDS or DCF, the new text is the old
one with only the changed facts replaced (writer_document.py); an unchanged description gives its own text back. Without such a
document (CSV, XDD, a dictionary made by hand) it writes in the order and the forms of the standard (writer_sections.py).

The text is read again. If it does not give the same description (some faulty files give an inserted line another meaning), the
whole is written in the standard's form, with the old file's sections that a description has no field for.

Source: CiA 306-1 v1.4.0; CiA 306 v1.3.0.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from canopen_data.configured import without_configured
from canopen_data.description import Commissioning, DeviceDescription, FileInfo, FileKind
from canopen_data.eds.ini import EdsDocument
from canopen_data.eds.reader import read_eds
from canopen_data.eds.writer_document import changed_text, foreign_text
from canopen_data.eds.writer_sections import Sections, sections_of, sub_name
from canopen_data.eds.writer_values import check_kept, one_line
from canopen_proto.machine import LocalProtocolError, check_node_id

_OF_ONE_DEVICE: Final = (FileKind.DCF, FileKind.XDC)


def write_eds(
    description: DeviceDescription,
    kind: FileKind | None = None,
    *,
    node_id: int | None = None,
    file_info: FileInfo | None = None,
) -> str:
    """Return the text of an EDS or a DCF.

    kind: EDS or DCF; None: DCF for what describes one device (DCF, XDC), else EDS. An EDS made of a DCF has no configured values
    (`without_configured`); for a DCF made of an EDS see `with_configured`, too. node_id: of the DCF; None: that of its
    commissioning. file_info: of the new file (its name, its author and date: the core has no clock); None: that of the
    description.

    A variable that has its name in the old file among its aliases keeps that name in the new one. These files cannot hold line
    breaks, nor blanks at the ends of names and texts; breaks become blanks.

    Raises LocalProtocolError for another kind, a node-ID outside 1..127 or for an EDS, and a DCF made of another kind of file
    without a node-ID; ValueRangeError for a value that the file cannot give back: one that the object's type cannot hold.
    """
    wanted = _of_kind(description, kind, node_id)
    for variable in wanted.dictionary:
        check_kept(variable)
    if file_info is not None:
        wanted = replace(wanted, file_info=file_info)
    after = sections_of(wanted)
    document = description.document
    if not isinstance(document, EdsDocument):
        return text_of(after)
    before = sections_of(read_eds(document.text))
    _keep_names(after, before, wanted)
    if after == before:
        return document.text
    text = changed_text(document, before, after)
    if sections_of(read_eds(text)) == after:
        return text
    return (text_of(after) + foreign_text(document, {**before, **after})).replace("\n", document.newline)


def _keep_names(after: Sections, before: Sections, description: DeviceDescription) -> None:
    """Keep the file's name of a variable that has another name now (`with_names_of`) but still has the file's among its names."""
    for variable in description.dictionary:
        if variable.aliases:
            own, whole = sub_name(variable.index, variable.subindex), f"{variable.index:04X}"
            section = own if own in after else whole
            name = before.get(section, {}).get("ParameterName", "")
            if name in map(one_line, variable.aliases):
                after[section]["ParameterName"] = name


def text_of(sections: Sections) -> str:
    """Return sections as the text of a file."""
    blocks = (
        "\n".join([f"[{name}]", *(f"{key}={text}" for key, text in entries.items()), ""]) for name, entries in sections.items()
    )
    return "\n".join(blocks)


def encode_eds(text: str, encoding: str = "utf-8") -> bytes:
    """Return the bytes of a file in the old file's encoding (`DeviceDescription.encoding`), or in UTF-8 if that lacks a
    character. text: of the whole file."""
    try:
        return text.encode(encoding)
    except UnicodeEncodeError:
        return text.encode("utf-8", "replace")  # half of a surrogate pair is not a character


def _of_kind(description: DeviceDescription, kind: FileKind | None, node_id: int | None) -> DeviceDescription:
    is_dcf = description.kind in _OF_ONE_DEVICE
    if kind is None:
        kind = FileKind.DCF if is_dcf else FileKind.EDS
    if kind not in (FileKind.EDS, FileKind.DCF):
        raise LocalProtocolError(f"an EDS or a DCF can be written here, no {kind}")
    if node_id is not None:
        check_node_id(node_id)
    if kind == FileKind.EDS:
        if node_id is not None:
            raise LocalProtocolError("an EDS has no node-ID: kind=FileKind.DCF makes the file of one device")
        return without_configured(description) if is_dcf else description
    if node_id is not None:
        commissioning = replace(description.commissioning or Commissioning(), node_id=node_id)
        return replace(description, kind=FileKind.DCF, commissioning=commissioning)
    if not is_dcf and description.commissioning is None:
        raise LocalProtocolError("a DCF is of one device: it needs a node-ID")
    return replace(description, kind=FileKind.DCF)
