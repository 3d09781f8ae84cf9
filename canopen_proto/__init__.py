"""CANopen as pure state machines: frames and time go in, frames and events come out. See docs/contract.md.

These are the names for a program that runs the core in its own loop. `canopen_proto.procedures` has sequences of requests,
`canopen_proto.drives` the sequences for a CiA 402 drive, `canopen_proto.dictionary` the description of a device.
docs/names.md lists all public names.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_proto.abort import AbortCode as AbortCode
    from canopen_proto.abort import AbortOrigin as AbortOrigin
    from canopen_proto.application import Application as Application
    from canopen_proto.bus_knowledge import NodeHeard as NodeHeard
    from canopen_proto.datatypes import DataType as DataType
    from canopen_proto.datatypes import ValueRangeError as ValueRangeError
    from canopen_proto.dictionary.model import NotInDictionaryError as NotInDictionaryError
    from canopen_proto.dictionary.model import ObjectDictionary as ObjectDictionary
    from canopen_proto.drives.axis.axis import SCHUNK_POWERBALL as SCHUNK_POWERBALL
    from canopen_proto.drives.axis.axis import Axis as Axis
    from canopen_proto.drives.axis.axis import AxisSettings as AxisSettings
    from canopen_proto.drives.axis.axis import HomingStyle as HomingStyle
    from canopen_proto.emcy import EmcyConsumer as EmcyConsumer
    from canopen_proto.emcy import EmcyDropped as EmcyDropped
    from canopen_proto.emcy import EmcyProducer as EmcyProducer
    from canopen_proto.emcy import EmcyReceived as EmcyReceived
    from canopen_proto.emcy import EmcySent as EmcySent
    from canopen_proto.error_codes import ErrorRegister as ErrorRegister
    from canopen_proto.explained import Explained as Explained
    from canopen_proto.foreign_writes import ForeignWrite as ForeignWrite
    from canopen_proto.frame import Frame as Frame
    from canopen_proto.frame import RoutingKey as RoutingKey
    from canopen_proto.frame import routing_key as routing_key
    from canopen_proto.group import Group as Group
    from canopen_proto.guarding import GuardingAnswered as GuardingAnswered
    from canopen_proto.guarding import GuardingMaster as GuardingMaster
    from canopen_proto.guarding import GuardingRequestsSkipped as GuardingRequestsSkipped
    from canopen_proto.guarding import GuardingSlave as GuardingSlave
    from canopen_proto.guarding import GuardingStateUnexpected as GuardingStateUnexpected
    from canopen_proto.guarding import GuardingToggleRepeated as GuardingToggleRepeated
    from canopen_proto.guarding import LifeGuardingLost as LifeGuardingLost
    from canopen_proto.guarding import LifeGuardingRecovered as LifeGuardingRecovered
    from canopen_proto.guarding import NodeGuardingLost as NodeGuardingLost
    from canopen_proto.guarding import NodeGuardingRecovered as NodeGuardingRecovered
    from canopen_proto.heartbeat import ForeignHeartbeat as ForeignHeartbeat
    from canopen_proto.heartbeat import HeartbeatConsumer as HeartbeatConsumer
    from canopen_proto.heartbeat import HeartbeatLost as HeartbeatLost
    from canopen_proto.heartbeat import HeartbeatProducer as HeartbeatProducer
    from canopen_proto.heartbeat import HeartbeatReceived as HeartbeatReceived
    from canopen_proto.heartbeat import HeartbeatRecovered as HeartbeatRecovered
    from canopen_proto.heartbeat import HeartbeatsSkipped as HeartbeatsSkipped
    from canopen_proto.heartbeat import NmtStateReported as NmtStateReported
    from canopen_proto.heartbeat import NodeBooted as NodeBooted
    from canopen_proto.heartbeat import OwnHeartbeat as OwnHeartbeat
    from canopen_proto.local_node import LocalNode as LocalNode
    from canopen_proto.machine import COMPILED as COMPILED
    from canopen_proto.machine import MICROSECOND as MICROSECOND
    from canopen_proto.machine import MILLISECOND as MILLISECOND
    from canopen_proto.machine import NEVER as NEVER
    from canopen_proto.machine import SECOND as SECOND
    from canopen_proto.machine import Event as Event
    from canopen_proto.machine import FrameIgnored as FrameIgnored
    from canopen_proto.machine import LocalProtocolError as LocalProtocolError
    from canopen_proto.machine import Machine as Machine
    from canopen_proto.machine import Outbox as Outbox
    from canopen_proto.machine import Outcome as Outcome
    from canopen_proto.machine import RequestId as RequestId
    from canopen_proto.machine import Time as Time
    from canopen_proto.manager.scan import Scanner as Scanner
    from canopen_proto.manager.scan import scan as scan
    from canopen_proto.multiplexer import Mux as Mux
    from canopen_proto.multiplexer import mux as mux
    from canopen_proto.network import EventsDropped as EventsDropped
    from canopen_proto.network import Network as Network
    from canopen_proto.network import OutageChanged as OutageChanged
    from canopen_proto.nmt import NmtCommand as NmtCommand
    from canopen_proto.nmt import NmtCommandSent as NmtCommandSent
    from canopen_proto.nmt import NmtMaster as NmtMaster
    from canopen_proto.nmt import NmtResetRequested as NmtResetRequested
    from canopen_proto.nmt import NmtSlave as NmtSlave
    from canopen_proto.nmt import NmtState as NmtState
    from canopen_proto.nmt import NmtStateChanged as NmtStateChanged
    from canopen_proto.nmt import Service as Service
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
    from canopen_proto.sync import SyncConsumer as SyncConsumer
    from canopen_proto.sync import SyncLengthUnexpected as SyncLengthUnexpected
    from canopen_proto.sync import SyncProducer as SyncProducer
    from canopen_proto.sync import SyncReceived as SyncReceived
    from canopen_proto.sync import SyncSent as SyncSent
    from canopen_proto.time_stamp import TimeConsumer as TimeConsumer
    from canopen_proto.time_stamp import TimeProducer as TimeProducer
    from canopen_proto.time_stamp import TimeReceived as TimeReceived
    from canopen_proto.time_stamp import TimeSent as TimeSent
else:
    from canopen_proto.lazy_names import lazy_names

    __getattr__, __dir__ = lazy_names(globals())
