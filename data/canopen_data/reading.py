"""Read a device description from the bytes of an EDS, DCF, XDD or XDC.

The content decides the kind of file, not its name. XML begins with `<`, after any byte order mark and white space; a text of
sections never does. The readers tell an EDS from a DCF, and an XDD from an XDC: a DCF or XDC commissions a device or sets values.
This module takes bytes; `canopen_data.descriptions` reads files.
"""

from __future__ import annotations

from typing import Final

from canopen_data.description import DeviceDescription

__all__ = ["read_description"]

_BEFORE_XML: Final = b"\xef\xbb\xbf\xff\xfe\x00 \t\r\n"
"""Byte order marks, white space, and the zeros between them in UTF-16."""


def read_description(
    data: bytes, source: str = "", *, strict: bool = False, encoding: str = "", connected: tuple[int, ...] = ()
) -> DeviceDescription:
    """Read a device description of any kind. source: the file's name, for findings. encoding: of an EDS or DCF (XML names its
    own), "" = guess it. connected: the module in each slot of a modular device, instead of the file's own; only for EDS and DCF.
    data: the file's bytes.

    Never raises for faulty content: the description's findings hold everything wrong with it. With strict, raises the first error
    as a DictionaryError.
    """
    if data.lstrip(_BEFORE_XML).startswith(b"<"):
        from canopen_data.xdd import read_xdd  # the reader of the file at hand, not of all kinds: each command reads one, or none

        return read_xdd(data, source, strict=strict)
    from canopen_data.eds.reader import read_eds

    return read_eds(data, source, strict=strict, encoding=encoding, connected=connected)
