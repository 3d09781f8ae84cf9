"""A device description from bytes of any of the four sorts: EDS, DCF, XDD, XDC.

Theory of operation
-------------------
What a file is, its content says, not its name: XML begins with `<`, whatever stands before it of byte order mark and white space;
a text of sections never does. Whether a text is an EDS or a DCF, and XML an XDD or an XDC, the readers find out: the one that
commissions a device, or sets values, is the second. This module takes bytes; `canopen_data.descriptions` reads files.
"""

from __future__ import annotations

from typing import Final

from canopen_data.description import DeviceDescription
from canopen_data.eds.reader import read_eds
from canopen_data.xdd import read_xdd

_BEFORE_XML: Final = b"\xef\xbb\xbf\xff\xfe\x00 \t\r\n"
"""Byte order marks, white space, and the zeros between them in UTF-16."""


def read_description(data: bytes, source: str = "", *, strict: bool = False, encoding: str = "") -> DeviceDescription:
    """Read a device description, whatever sort it is. source: the file's name, for findings. encoding: of an EDS or DCF (XML says
    its own), "" = to be found out.

    Never raises for what stands in it: all that is wrong is in the description's findings. With strict, the first error is raised
    as a DictionaryError.
    """
    if data.lstrip(_BEFORE_XML).startswith(b"<"):
        return read_xdd(data, source, strict=strict)
    return read_eds(data, source, strict=strict, encoding=encoding)
