"""XDD and XDC: device descriptions in XML (CiA 311)."""

from canopen_data.xdd.document import XddDocument
from canopen_data.xdd.reader import read_xdd

__all__ = ["XddDocument", "read_xdd"]
