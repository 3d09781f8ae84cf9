"""XDD and XDC: device descriptions in XML (CiA 311)."""

from canopen_proto.dictionary.xdd.document import XddDocument
from canopen_proto.dictionary.xdd.elements import MAX_FILE_SIZE
from canopen_proto.dictionary.xdd.reader import read_xdd

__all__ = ["MAX_FILE_SIZE", "XddDocument", "read_xdd"]
