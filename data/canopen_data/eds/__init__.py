"""EDS and DCF: the files of CiA 306 that describe a type of device, and one device."""

from canopen_data.eds.ini import MAX_FILE_SIZE, EdsDocument
from canopen_data.eds.reader import read_eds

__all__ = ["MAX_FILE_SIZE", "EdsDocument", "read_eds"]
