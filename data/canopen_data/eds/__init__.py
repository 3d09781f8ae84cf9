"""EDS and DCF: the files of CiA 306 that describe a type of device, and one device."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_data.eds.ini import MAX_FILE_SIZE as MAX_FILE_SIZE
    from canopen_data.eds.ini import EdsDocument as EdsDocument
    from canopen_data.eds.reader import read_eds as read_eds
    from canopen_data.eds.writer import write_eds as write_eds
else:
    from canopen_proto.lazy_names import lazy_names

    __getattr__, __dir__ = lazy_names(globals())
