"""Service data objects: read and write the objects of a device (CiA 301 v4.2.0, 7.2.4).

client.py, server.py: the two machines; request_queue.py, what waits in a client. transfer.py: what each transfer is, with a table
of its kinds and states. access.py, store.py, host.py: what a server serves. channels.py: the channels of a device. codec.py,
block.py: frames, and how a block transfer goes. events.py: what client and server report.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_proto.sdo.access import PENDING as PENDING
    from canopen_proto.sdo.access import ObjectStore as ObjectStore
    from canopen_proto.sdo.access import Pending as Pending
    from canopen_proto.sdo.client import SdoClient as SdoClient
    from canopen_proto.sdo.events import ObjectAccessPending as ObjectAccessPending
    from canopen_proto.sdo.events import ObjectWritten as ObjectWritten
    from canopen_proto.sdo.events import SdoAborted as SdoAborted
    from canopen_proto.sdo.events import SdoChunk as SdoChunk
    from canopen_proto.sdo.events import SdoDataWanted as SdoDataWanted
    from canopen_proto.sdo.events import SdoDownloaded as SdoDownloaded
    from canopen_proto.sdo.events import SdoProgress as SdoProgress
    from canopen_proto.sdo.events import SdoServerAborted as SdoServerAborted
    from canopen_proto.sdo.events import SdoStreamUploaded as SdoStreamUploaded
    from canopen_proto.sdo.events import SdoUploaded as SdoUploaded
    from canopen_proto.sdo.server import SdoServer as SdoServer
    from canopen_proto.sdo.store import ValuesStore as ValuesStore
else:
    from canopen_proto.lazy_names import lazy_names

    __getattr__, __dir__ = lazy_names(globals())
