"""XDD and XDC: device descriptions in XML (CiA 311)."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_data.xdd.reader import XddDocument as XddDocument
    from canopen_data.xdd.reader import read_xdd as read_xdd
    from canopen_data.xdd.writer import write_xdd as write_xdd
else:
    from canopen_proto.lazy_names import lazy_names

    __getattr__, __dir__ = lazy_names(globals())
