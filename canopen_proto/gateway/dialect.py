"""`Dialect`: how a gateway writes its answers, where makers differ.

Both forms of an error are understood by `parse_answer`, whatever the dialect. The end of a line is not: an answer of CANopenNode
may hold single line feeds, so a client has to know whom it talks to.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class Dialect:
    """The habits of a gateway's text.

    name: as users choose it. line_end: of what the gateway sends. unsigned_hex: UNSIGNEDn are written as 0x, with all digits.
    spaced_errors: "ERROR: 06020000 (text)", else "ERROR:0x06020000 #text". escapes: control characters of a text are written
    as in C. answers_blank: an empty line and a comment are answered by an empty line. assumes_net: with one net, it is the
    default from the beginning. hex_fallback: a value that does not have the length of its type is written as bytes.
    """

    name: str
    line_end: bytes
    unsigned_hex: bool
    spaced_errors: bool
    escapes: bool
    answers_blank: bool
    assumes_net: bool
    hex_fallback: bool


CANOPENNODE: Final = Dialect("canopennode", b"\r\n", False, False, False, True, True, True)
"""For `cocomm`, the client of CANopenNode, and for whatever was written for its `canopend`. The default."""
LELY: Final = Dialect("lely", b"\n", True, True, True, False, False, False)
"""For programs that were written for Lely CANopen's `coctl`."""
DIALECTS: Final = {each.name: each for each in (CANOPENNODE, LELY)}
