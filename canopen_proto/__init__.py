"""CANopen as pure state machines: frames and time go in, frames and events come out. See docs/contract.md.

These are the names for a program that runs the core in its own loop. `canopen_proto.procedures` has sequences of requests,
`canopen_proto.drives.axis` the sequences for a CiA 402 drive, `canopen_proto.dictionary` the description of a device. Import
every other name from its module.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_proto.abort import AbortCode as AbortCode
    from canopen_proto.dictionary.model import NotInDictionaryError as NotInDictionaryError
    from canopen_proto.dictionary.model import ObjectDictionary as ObjectDictionary
    from canopen_proto.drives.axis.axis import Axis as Axis
    from canopen_proto.drives.axis.axis import AxisSettings as AxisSettings
    from canopen_proto.emcy import EmcyReceived as EmcyReceived
    from canopen_proto.frame import Frame as Frame
    from canopen_proto.frame import RoutingKey as RoutingKey
    from canopen_proto.frame import routing_key as routing_key
    from canopen_proto.group import Group as Group
    from canopen_proto.heartbeat import HeartbeatLost as HeartbeatLost
    from canopen_proto.heartbeat import HeartbeatReceived as HeartbeatReceived
    from canopen_proto.heartbeat import HeartbeatRecovered as HeartbeatRecovered
    from canopen_proto.heartbeat import NodeBooted as NodeBooted
    from canopen_proto.local_node import LocalNode as LocalNode
    from canopen_proto.machine import COMPILED as COMPILED
    from canopen_proto.machine import MILLISECOND as MILLISECOND
    from canopen_proto.machine import NEVER as NEVER
    from canopen_proto.machine import SECOND as SECOND
    from canopen_proto.machine import Event as Event
    from canopen_proto.machine import LocalProtocolError as LocalProtocolError
    from canopen_proto.machine import Machine as Machine
    from canopen_proto.machine import Outbox as Outbox
    from canopen_proto.machine import Outcome as Outcome
    from canopen_proto.machine import RequestId as RequestId
    from canopen_proto.machine import Time as Time
    from canopen_proto.multiplexer import Mux as Mux
    from canopen_proto.multiplexer import mux as mux
    from canopen_proto.network import Network as Network
    from canopen_proto.nmt import NmtCommand as NmtCommand
    from canopen_proto.nmt import NmtMaster as NmtMaster
    from canopen_proto.nmt import NmtState as NmtState
    from canopen_proto.pdo.consumer import PdoReceived as PdoReceived
    from canopen_proto.procedures.runner import ProcedureCancelled as ProcedureCancelled
    from canopen_proto.procedures.runner import ProcedureFailed as ProcedureFailed
    from canopen_proto.procedures.runner import ProcedureFinished as ProcedureFinished
    from canopen_proto.procedures.steps import Procedure as Procedure
    from canopen_proto.procedures.steps import ProcedureError as ProcedureError
    from canopen_proto.remote_node import RemoteNode as RemoteNode
    from canopen_proto.sdo.client import SdoClient as SdoClient
    from canopen_proto.sdo.events import ObjectAccessPending as ObjectAccessPending
    from canopen_proto.sdo.events import ObjectWritten as ObjectWritten
    from canopen_proto.sdo.events import SdoAborted as SdoAborted
    from canopen_proto.sdo.events import SdoDownloaded as SdoDownloaded
    from canopen_proto.sdo.events import SdoUploaded as SdoUploaded
    from canopen_proto.simulation.drive.node import powerball as powerball
else:
    from canopen_proto.lazy_names import lazy_names

    __getattr__, __dir__ = lazy_names(globals())
