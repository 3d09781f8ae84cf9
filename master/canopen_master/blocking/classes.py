"""The blocking forms of the master, its nodes, drives and chains.

Made from the async classes by `python docs/blocking_classes.py`: change those, not this file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path as FilePath
from typing import Any, Final, Generic, Self, overload

from canopen_master.blocking.twin import (
    E,
    MasterTwin,
    NodeTwin,
    R,
    Twin,
    V,
    attribute,
    in_a_thread,
    open_context,
    open_session,
    together_of_none,
)
from canopen_master.commissioning import _NO_SETTINGS, DriveCommissioning, HomingMethods
from canopen_master.errors import ChainError
from canopen_master.machine_file.model import MachineFile
from canopen_master.motion.chain import Chain
from canopen_master.motion.chain_file import ChainDescription
from canopen_master.motion.chain_settings import ChainSettings
from canopen_master.motion.cycles import Cycle, Cycles
from canopen_master.motion.device import Device
from canopen_master.motion.halting import Halt
from canopen_master.motion.member import ChainState
from canopen_master.motion.moving import Moving, PathMaker, Progress, Progresses, Together
from canopen_master.motion.moving import together as _together
from canopen_master.motion.path_motion import Motion, Torques
from canopen_master.motion.recording import Recorder
from canopen_master.motion.target_motion import DEAD_MAN, Jog, Targets
from canopen_master.network_booting import boot_network as _boot_network
from canopen_master.node import BOOT_TIME
from canopen_master.participant.bus import Bus
from canopen_master.participant.subscription import Subscription
from canopen_master.session import BusSource
from canopen_master.session import open_master as _open_master
from canopen_master.simulation.host import DeviceMaker
from canopen_master.simulation.parameter_keeper import ParameterKeeper
from canopen_master.simulation.serving import SimulatedDevices
from canopen_master.simulation.serving import simulated_devices as _simulated_devices
from canopen_master.simulation.serving import simulated_drives as _simulated_drives
from canopen_master.streams import ReadStream
from canopen_proto.datatypes import Value
from canopen_proto.dictionary import Key, Message, ObjectDictionary
from canopen_proto.dictionary.typed import Readable, Writable
from canopen_proto.drives.axis.axis import Axis, AxisSettings
from canopen_proto.drives.axis.following import Following
from canopen_proto.drives.axis.limits import SetPointLimits
from canopen_proto.drives.axis.motion_plan import MotionPlan
from canopen_proto.drives.axis.units import DriveUnits, Unit
from canopen_proto.drives.axis.view import DriveView
from canopen_proto.drives.axis.watchdog import DEFAULT_WATCHDOG, Watchdog
from canopen_proto.drives.cia402.states import State
from canopen_proto.drives.trajectory import JointLimits, Path
from canopen_proto.emcy import EmcyReceived
from canopen_proto.machine import Event, Time
from canopen_proto.manager.boot.network_boot import BootReport
from canopen_proto.multiplexer import Mux
from canopen_proto.network import Network
from canopen_proto.nmt import NmtCommand, NmtMaster, NmtState
from canopen_proto.pdo.configure import PdoDifference
from canopen_proto.procedures.steps import Procedure
from canopen_proto.remote_node import RemoteNode
from canopen_proto.sdo.client import Block
from canopen_proto.sdo.transfer import Buffer
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.settings import Shape
from canopen_transports.realtime import Measure, Realtime


class BlockingNode(NodeTwin):
    """The blocking Node. A device as its master sees it. remote: the core's view of it, with all known values (`remote.values`).
    axes: its drives that this master has used so far (`Master.device`), by number.

    Keys are names or numbers: "statusword", "record:field", 0x6041, (0x60C1, 1), "6041:00"; or those of `canopen eds stubs`, by
    which a type checker knows the type of the value. Reading and writing use SDO. If the call is interrupted, or its time is
    over, the transfer is aborted on the bus. Raises ObjectNotFoundError for an unknown name, SdoTimeoutError, SdoRefusedError,
    SdoGivenUpError, SdoNotConfirmedError (of writes), BusError, MasterClosedError.

    block: whether to use block transfer: False; True (the transfer fails if the device has none); or "auto", if it pays and the
    device has it.
    """

    axes: Final[dict[int, Axis]] = attribute("axes", "Node")

    @property
    def dictionary(self) -> ObjectDictionary:
        """See the async Node."""
        return self._inner.dictionary

    @property
    def nmt_state(self) -> NmtState | None:
        """The NMT state that its heartbeat shows; without a heartbeat, the one that we commanded; None if neither is known."""
        return self._hub.do(lambda: self._inner.nmt_state)

    @property
    def was_enabled(self) -> bool:
        """Whether one of its drives may move: the last controlword known, or written here, enables operation."""
        return self._hub.do(lambda: self._inner.was_enabled)

    @property
    def axes_enabled(self) -> tuple[int, ...]:
        """The axes whose drives may move, as `was_enabled` says."""
        return self._hub.do(lambda: self._inner.axes_enabled)

    def was_axis_enabled(self, axis: int) -> bool:
        """Return whether the drive on an axis may move, as `was_enabled` says."""
        return self._hub.do(self._inner.was_axis_enabled, axis)

    def supervise_heartbeat(self, timeout: float) -> None:
        """Report HeartbeatLost when no heartbeat came for `timeout` seconds, from the first one on; 0 ends this."""
        self._hub.do(self._inner.supervise_heartbeat, timeout)

    @overload
    def read(self, key: Readable[V], *, block: Block = False, timeout: float | None = None) -> V: ...

    @overload
    def read(self, key: Key, *, block: Block = False, timeout: float | None = None) -> Value: ...
    def read(self, key: Any, *, block: Block = False, timeout: float | None = None) -> Any:
        """Read the value of an object. Raises UnexpectedAnswerError if its length is not that of the object's type."""
        return self._hub.run(timeout, self._inner.read, key, block=block)

    def read_message(self, key: Key, *, block: Block = False, timeout: float | None = None) -> Message:
        """Read an object: its value, its name, and the constants that it bears. timestamp: when it came, ns on the loop's clock.

        Bits 12 and 13 of the statusword depend on the mode of operation. If one is set, 0x6061 is read too.
        """
        return self._hub.run(timeout, self._inner.read_message, key, block=block)

    @overload
    def write(self, key: Writable[V], value: V, *, block: Block = False, timeout: float | None = None) -> None: ...

    @overload
    def write(self, key: Key, value: Value, *, block: Block = False, timeout: float | None = None) -> None: ...
    def write(self, key: Any, value: Value, *, block: Block = False, timeout: float | None = None) -> None:
        """Write a value, or a constant by its name; return when the device has confirmed it.

        Raises ValueRangeError, ConstantNotFoundError, LocalProtocolError (read-only), with nothing sent, if the dictionary
        forbids it. After SdoNotConfirmedError, or if interrupted, the write may have been executed nevertheless. It is never
        repeated by itself. Before a controlword that enables operation, the master takes hold of the drive (watchdog.py). Raises
        NodeIdTakenError or NotHeldError, with nothing sent, if it cannot.
        """
        self._hub.run(timeout, self._inner.write, key, value, block=block)

    def matches(self, key: Key, constant: str, *, timeout: float | None = None) -> bool:
        """Read an object, and return whether it bears a constant: `(value & mask) == constant`."""
        return self._hub.run(timeout, self._inner.matches, key, constant)

    def read_int(self, key: Key, *, block: Block = False, timeout: float | None = None) -> int:
        """Read an object that holds an integer or a BOOLEAN. Raises LocalProtocolError, with nothing sent, for another type."""
        return self._hub.run(timeout, self._inner.read_int, key, block=block)

    def read_float(self, key: Key, *, block: Block = False, timeout: float | None = None) -> float:
        """Read an object that holds a REAL32 or REAL64. Raises LocalProtocolError, with nothing sent, for another type."""
        return self._hub.run(timeout, self._inner.read_float, key, block=block)

    def read_str(self, key: Key, *, block: Block = False, timeout: float | None = None) -> str:
        """Read an object that holds text. Raises LocalProtocolError, with nothing sent, for another type."""
        return self._hub.run(timeout, self._inner.read_str, key, block=block)

    def read_bytes(
        self,
        key: Key,
        subindex: int | None = None,
        *,
        block: Block = False,
        patience: float | None = None,
        most: int | None = None,
        timeout: float | None = None,
    ) -> bytes:
        """Read the bytes of any object, in the dictionary or not. subindex: if key is an index alone; 0 by default. patience:
        seconds for each answer of the node, in place of the master's SDO time-out; 1 ms at least. most: bytes that are taken; a
        longer value is refused with 0x05040005; None: 16 MiB.
        """
        return self._hub.run(timeout, self._inner.read_bytes, key, subindex, block=block, patience=patience, most=most)

    def write_bytes(
        self,
        index: int,
        subindex: int,
        data: bytes,
        *,
        block: Block = False,
        patience: float | None = None,
        timeout: float | None = None,
    ) -> None:
        """Write bytes to any object, in the dictionary or not. For controlwords, see `write`. data: little-endian.

        patience: as of `read_bytes`; it counts neither for a controlword nor for the COB-ID of a PDO.
        """
        self._hub.run(timeout, self._inner.write_bytes, index, subindex, data, block=block, patience=patience)

    def read_stream(self, index: int, subindex: int = 0, *, block: Block = "auto") -> BlockingReadStream:
        """Read any object piece by piece: `for piece in node.read_stream(0x1F50, 1)`. See streams.py.

        The pieces are valid only once the loop has ended without an exception: the checksum comes last.
        """
        return BlockingReadStream(self._hub, self._hub.do(self._inner.read_stream, index, subindex, block=block))

    def write_stream(
        self,
        index: int,
        subindex: int,
        pieces: Iterable[Buffer],
        size: int | None = None,
        *,
        block: Block = "auto",
        timeout: float | None = None,
    ) -> None:
        """Write any object from pieces of any size; return when the device has confirmed the whole.

        pieces: an iterable; it is asked in a thread of its own, asked for more only when there is room. An exception that it
        raises aborts the transfer on the bus, and is raised unchanged. size: bytes, if known; some devices insist on it. Raises
        LocalProtocolError if the pieces are more or less than that. See streams.py. A controlword counts as one that enables: see
        `write`.
        """
        self._hub.run(timeout, self._inner.write_stream, index, subindex, in_a_thread(pieces), size, block=block)

    def keep_pdos(self) -> None:
        """Exchange the PDOs as the device has set them up, now and after each boot; see node_pdos.py. Event: PdoDiffers."""
        self._hub.do(self._inner.keep_pdos)

    def leave_pdos(self) -> None:
        """Undo `keep_pdos`: the exchange is not renewed after a boot. PDOs that are exchanged now go on."""
        self._hub.do(self._inner.leave_pdos)

    def exchange_pdos(self, *, timeout: float | None = None) -> tuple[PdoDifference, ...]:
        """Wait until the PDOs are exchanged (`keep_pdos`); return how the device's PDOs differ from those of its file.

        If we have set a PDO up anew since they were read (`configure_pdo`, or a write), all are read and exchanged once more, and
        RPDOs must be enabled again (`enable_rpdo`). Raises SdoTransferError if the device does not answer, InvalidPdoError,
        UnexpectedLengthError.
        """
        return self._hub.run(timeout, self._inner.exchange_pdos)

    def enable_rpdo(self, number: int, enabled: bool = True) -> None:
        """Send RPDO `number` (1..512) to the node while it is Operational, or stop sending it. It carries `remote.values`.
        enabled: False stops it.

        It stops when the node boots. Raises LocalProtocolError if this RPDO is not exchanged. An RPDO with a controlword may
        enable a drive: the master takes hold of the drive beside it (`hold` does so before it). Raises NotHeldError if the drive
        has to be held first (`Watchdog.required`).
        """
        self._hub.do(self._inner.enable_rpdo, number, enabled)

    def send_mpdo(self, number: int, key: Key, value: Value) -> bool:
        """Write an object by RPDO `number`, a multiplexed PDO (`remote.add_mpdo`); see RemoteNode.send_mpdo. Returns False, with
        nothing sent, while the node is not Operational.

        For controlwords, see `enable_rpdo`.
        """
        return self._hub.do(self._inner.send_mpdo, number, key, value)

    def hold(self, axis: int = 0, *, timeout: float | None = None) -> None:
        """Have the drive on this node watch over this master, and stop by itself when the master falls silent; see watchdog.py.

        axis: of the node, 0 for its first one.

        Commands that enable a drive do so by themselves; call this before you send controlwords by RPDO. Raises NodeIdTakenError,
        NotHeldError.
        """
        self._hub.run(timeout, self._inner.hold, axis)

    def start(self, *, timeout: float | None = None) -> None:
        """Start the node (NMT, to Operational). If its file is known, wait before until its PDOs are exchanged, so that none is
        missed.

        Raises as `exchange_pdos`, with nothing sent; BusError, MasterClosedError.
        """
        self._hub.run(timeout, self._inner.start)

    def start_guarding(self, guard_time: float, life_time_factor: int = 3) -> None:
        """Ask the node once per guard time (seconds) whether it lives: for a node without a heartbeat.

        Events: HeartbeatReceived; NodeGuardingLost after guard_time * life_time_factor without an answer.
        """
        self._hub.do(self._inner.start_guarding, guard_time, life_time_factor)

    def stop_guarding(self) -> None:
        """Stop node guarding."""
        self._hub.do(self._inner.stop_guarding)

    def nmt(self, command: NmtCommand, *, timeout: float | None = None) -> None:
        """Send an NMT command to this node; return when it is on its way. Only the node's heartbeat confirms it."""
        self._hub.run(timeout, self._inner.nmt, command)

    def reset(self, timeout: float = BOOT_TIME, *, communication_only: bool = False) -> None:
        """Reset the node and wait for its boot-up frame. Raises NodeSilentError after `timeout` seconds. communication_only: only
        the communication objects (reset communication); else all (reset node).
        """
        self._hub.run(None, self._inner.reset, timeout, communication_only=communication_only)

    def wait_for_boot(self, timeout: float = BOOT_TIME) -> None:
        """Wait for the next boot-up frame. Raises NodeSilentError after `timeout` seconds."""
        self._hub.run(None, self._inner.wait_for_boot, timeout)

    def wait_for_heartbeat(self, timeout: float) -> NmtState:
        """Wait for the next heartbeat, and return the state that it shows. Raises NodeSilentError after `timeout` seconds."""
        return self._hub.run(None, self._inner.wait_for_heartbeat, timeout)

    def drop_commands(self) -> None:
        """Let no controlword leave that waits: for its drive to watch over this master, or behind another transfer. Its write
        ends with SdoGivenUpError. Any stop does this for its own drive; this is for a drive that seems to need none.
        """
        self._hub.do(self._inner.drop_commands)

    def is_held(self, axis: int = 0) -> bool:
        """Return whether the drive on an axis of this node watches the heartbeat of this master; see watchdog.py."""
        return self._hub.do(self._inner.is_held, axis)

    remote: Final[RemoteNode] = attribute("remote", "Node")

    name: Final[str] = attribute("name", "Node")

    @property
    def node_id(self) -> int:
        """See the async Node."""
        return self._inner.node_id

    @property
    def bus(self) -> str:
        """The name of the node's bus."""
        return self._inner.bus

    @property
    def network(self) -> Network:
        """The core's Network on the node's bus."""
        return self._inner.network

    @property
    def where(self) -> str:
        """The node and its bus, for people: "node 3 on can0"."""
        return self._hub.do(lambda: self._inner.where)

    @property
    def bus_has_failed(self) -> bool:
        """Whether nothing can be sent to it any longer."""
        return self._hub.do(lambda: self._inner.bus_has_failed)

    def now(self) -> Time:
        """Return the time of its machines, ns."""
        return self._hub.do(self._inner.now)

    def events(self, *kinds: type[E]) -> BlockingSubscription[E]:
        """Return the events of this node only; see `Master.events`."""
        return BlockingSubscription(self._hub, self._hub.do(self._inner.events, *kinds))


class BlockingDevice(Twin[Device]):
    """The blocking Device. A joint; see this module's text. axis: the core's view of the drive. cyclic: the objects that it sends
    at every n-th SYNC (mux -> n), which show that it is alive; without any, only its heartbeat does. plan: how it follows
    set-points, once `Chain.initialise` has made a plan; None with the PDOs of PDOs.csv. modes: 0x6502, as read for it. following:
    whether it follows its set-points. limits: for its set-points; the drive's own are read by `Chain.initialise`, and each time
    that it begins to follow set-points. last_look: what the drive showed when its chain was stopped, if it had no power then.
    entry: its place in a machine file ("joints.arm1") and the name of that file; None if it is made of none. heartbeat_missed_at:
    when it last told (EMCY 0x8130) that a heartbeat, or a guarding request, did not come in time; it takes that back once one
    comes, so `emcy` may not show it.

    Positions are in the user's unit, as its AxisSettings say; without a scale, in counts.
    """

    @property
    def node(self) -> BlockingNode:
        """As of the async Device; see the text of this class."""
        return self._hub.twin(BlockingNode, self._inner.node)

    axis: Final[Axis] = attribute("axis", "Device")

    cyclic: Final[Mapping[Mux, int]] = attribute("cyclic", "Device")

    plan: Final[MotionPlan | None] = attribute("plan", "Device")

    modes: Final[int | None] = attribute("modes", "Device")

    following: Final[Following] = attribute("following", "Device")

    sdo_round_trips: Final[int] = attribute("sdo_round_trips", "Device")

    limits: Final[SetPointLimits] = attribute("limits", "Device")

    last_look: Final[DriveView | None] = attribute("last_look", "Device")

    entry: Final[tuple[str, str] | None] = attribute("entry", "Device")

    emcy: Final[EmcyReceived | None] = attribute("emcy", "Device")

    emcy_time: Final[Time | None] = attribute("emcy_time", "Device")

    heartbeat_missed_at: Final[Time | None] = attribute("heartbeat_missed_at", "Device")

    @property
    def name(self) -> str:
        """Its name in the chain. The only drive of a node gives the node its name."""
        return self._hub.do(lambda: self._inner.name)

    @name.setter
    def name(self, name: str) -> None:
        self._hub.do(setattr, self._inner, "name", name)

    @property
    def position(self) -> float | None:
        """Actual position, as last heard; None if it never was since the drive's last boot."""
        return self._hub.do(lambda: self._inner.position)

    @property
    def desired_position(self) -> float:
        """The position that the next PDO commands."""
        return self._hub.do(lambda: self._inner.desired_position)

    @property
    def velocity(self) -> float | None:
        """Actual velocity, per second; None if it is not known. It is the drive's own (0x606C), unless the last position is newer
        by more than 100 ms: then it is computed from the last two positions.
        """
        return self._hub.do(lambda: self._inner.velocity)

    @property
    def torque(self) -> float | None:
        """Actual torque, as a share of the rated torque, as last heard; None if it never was."""
        return self._hub.do(lambda: self._inner.torque)

    @property
    def state(self) -> State:
        """The CiA 402 state that the last statusword shows; UNKNOWN if none was heard since the drive's last boot."""
        return self._hub.do(lambda: self._inner.state)

    @property
    def statusword(self) -> int:
        """0x6041, as last heard; 0 if it never was: `state` is UNKNOWN then."""
        return self._hub.do(lambda: self._inner.statusword)

    @property
    def mode(self) -> int | None:
        """The active mode of operation (0x6061), as last heard; None if it never was."""
        return self._hub.do(lambda: self._inner.mode)

    @property
    def has_fault(self) -> bool:
        """Whether the drive is in Fault, or on its way there."""
        return self._hub.do(lambda: self._inner.has_fault)

    @property
    def error_code(self) -> int:
        """0x603F as last heard, 0 for none."""
        return self._hub.do(lambda: self._inner.error_code)

    @property
    def nmt_state(self) -> NmtState | None:
        """The NMT state that its heartbeat shows; without a heartbeat, the one that we commanded."""
        return self._hub.do(lambda: self._inner.nmt_state)

    @property
    def is_homed(self) -> bool:
        """Whether this master has homed it since it was switched on."""
        return self._hub.do(lambda: self._inner.is_homed)

    @property
    def following_error(self) -> float:
        """Commanded minus actual position, both of the same instant; 0 while no set-points are sent."""
        return self._hub.do(lambda: self._inner.following_error)

    @property
    def largest_following_error(self) -> float:
        """The largest absolute following error so far; `following.largest_error` may be reset."""
        return self._hub.do(lambda: self._inner.largest_following_error)

    @property
    def may_move(self) -> bool:
        """Whether it is known to be in Operation enabled, or was last commanded there."""
        return self._hub.do(lambda: self._inner.may_move)

    @property
    def may_be_enabled(self) -> bool:
        """Whether a command under way may yet enable it: it was heard, and still answers."""
        return self._hub.do(lambda: self._inner.may_be_enabled)

    @property
    def where(self) -> str:
        """The joint and its place, for people: "joint1 (node 3 on can0)", or "joint2 (node 3 on can0, axis 1)"."""
        return self._hub.do(lambda: self._inner.where)

    @property
    def taken_over_by(self) -> str:
        """The stop that another thread has commanded while the joint followed set-points; "" if there is none."""
        return self._hub.do(lambda: self._inner.taken_over_by)

    def describe(self) -> str:
        """State, statusword, error code and last emergency, in one line for people."""
        return self._hub.do(self._inner.describe)

    def events(self, *kinds: type[E]) -> BlockingSubscription[E]:
        """As `Master.events`, of this joint only."""
        return BlockingSubscription(self._hub, self._hub.do(self._inner.events, *kinds))


class BlockingSubscription(Twin[Subscription[E]], Generic[E]):
    """The blocking Subscription. An iterator over events: `for event in subscription`. Made by `Master.events`; `with` or `with`
    ends it.

    Events that came together are handed over without a checkpoint between them, up to HANDED_OVER.

    dropped: the number of events that were lost because the reader was too slow.

    close: ends the watch. size: how many events wait at most.
    """

    dropped: Final[int] = attribute("dropped", "Subscription")

    def receive(self, *, timeout: float | None = None) -> E:
        """Wait for the next event and return it. A wait that is interrupted takes no event.

        After HANDED_OVER events without a wait, other tasks of the loop run first. Raises BusError or MasterClosedError at the
        end.
        """
        return self._hub.run(timeout, self._inner.receive)

    def receive_batch(self, *, timeout: float | None = None) -> list[E]:
        """Wait for the next event, and return all that are there. Ends as `receive` does."""
        return self._hub.run(timeout, self._inner.receive_batch)

    def take(self) -> list[E]:
        """Return all waiting events at once."""
        return self._hub.do(self._inner.take)

    def close(self) -> None:
        """Stop taking events. May be called twice."""
        self._hub.do_at_the_end(self._inner.close)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> E:
        return self._hub.next(self._inner)


class BlockingReadStream(Twin[ReadStream]):
    """The blocking ReadStream. Gives the pieces of an object as they come, 1 to 889 bytes each: `for`, once. Made by
    Node.read_stream.

    Raises as Node.read_bytes; pieces that came before an error are not valid. size: bytes so far. `with` closes the stream at
    once if the loop is left early; otherwise it is closed once it is no longer referenced.
    """

    size: Final[int] = attribute("size", "ReadStream")

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> bytes:
        return self._hub.next(self._inner)

    def close(self) -> None:
        """Close the stream. A transfer under way is aborted on the wire."""
        self._hub.end(self._inner.aclose)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


class BlockingRecorder(Twin[Recorder]):
    """The blocking Recorder. A recording under way. rows: recorded so far. lost: rows that were left out, because the disk was
    too slow. failure: why the recording ended before its time, or None.
    """

    path: Final[FilePath] = attribute("path", "Recorder")

    rows: Final[int] = attribute("rows", "Recorder")

    lost: Final[int] = attribute("lost", "Recorder")

    failure: Final[Exception | None] = attribute("failure", "Recorder")

    def close(self) -> None:
        """End the recording with the row that is open. The thread finishes the file by itself."""
        self._hub.do_at_the_end(self._inner.close)

    def wait(self) -> None:
        """Wait until the file is whole; `close` has to be called before. Blocks: for a thread, or where nothing else runs.

        Raises RecordError if rows are missing in it.
        """
        self._inner.wait()


class BlockingCycles(Twin[Cycles]):
    """The blocking Cycles. The iterator that `Chain.cycles` returns. A cycle is given out once: right behind its SYNC, or later
    to a late loop.

    A loop that has given its set-points waits for the SYNC that takes them, so that none is overwritten before it was sent.
    """

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> Cycle:
        return self._hub.next(self._inner)


class BlockingProgresses(Twin[Progresses]):
    """The blocking Progresses. The iterator that `Moving.progress` returns."""

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> Progress:
        return self._hub.next(self._inner)


class BlockingJog(Twin[Jog]):
    """The blocking Jog. Takes velocities while its block runs. Raises as `Targets` does."""

    def velocity(self, velocities: Sequence[float]) -> None:
        """Move at these velocities, in the user's unit per second, and hold the dead man's switch.

        A velocity beyond a speed limit counts as that limit. A joint that comes to a position limit brakes in time, and rests.
        """
        self._hub.do(self._inner.velocity, velocities)

    def renew(self) -> None:
        """Hold the dead man's switch, if there is one: the caller is still there, and wants what it said last."""
        self._hub.do(self._inner.renew)


class BlockingTargets(Twin[Targets]):
    """The blocking Targets. Takes targets while its block runs. Each method raises PlanRefusedError for values that are no
    numbers or not one for each joint, and once it has ended; ChainHaltedError, ChainFaultError, MotionReplacedError if they were
    stopped, or something else moves them.
    """

    def aim_at(self, targets: Sequence[float]) -> None:
        """Go to these positions, each joint as fast as its limits allow, and rest there until others are given.

        A target beyond a position limit counts as that limit.
        """
        self._hub.do(self._inner.aim_at, targets)

    def renew(self) -> None:
        """Hold the dead man's switch, if there is one: the caller is still there, and wants what it said last."""
        self._hub.do(self._inner.renew)


class BlockingMoving(Twin[Moving]):
    """The blocking Moving. Positions and velocities are in the user's units of the joints."""

    def follow(
        self, path: Path | PathMaker | None = None, *, torques: Torques | None = None, timeout: float | None = None
    ) -> None:
        """Follow a path, from its start, where the joints have to stand, to its end; return when they are there.

        path: with the joints in the order of the chain. It is checked as a whole before anything moves. It runs at the rate of
        `override`, slower if SYNCs are late, and never faster to catch up. torques: called with each point, in every cycle and in
        the middle of the master's work; the torques that it returns go along (0x60B2). Velocities go along by themselves if the
        PDOs of a joint have room for them (0x60B1; see feed_forward.py).

        A function in place of a path is called when the motion can begin, perhaps again, with where the joints are and how they
        move then, and returns a path from there. Like `move` it takes over from another call that moves the joints, without a
        stop; that call raises MotionReplacedError.

        Without a path: let all joints follow set-points from where they stand, each in its mode; then give them, see `cycles`. A
        chain that already follows set-points is halted first. They need not be homed before.

        Raises PathRefusedError for a path that begins elsewhere, exceeds a limit, or leaves too little free for a stop on it.
        Raises ChainError if the chain moves already, if a drive does not stand, lacks the mode, or has lost its reference (see
        `recover`); ChainHaltedError, ChainFaultError if it is stopped on its way.
        """
        self._hub.run(timeout, self._inner.follow, path, torques=torques)

    def move(
        self, targets: Sequence[float], *, speed: float = 1.0, torques: Torques | None = None, timeout: float | None = None
    ) -> None:
        """Move all joints to their targets, as fast as their limits allow, and to arrive together; return when they are there.

        It is planned from where the joints stand; or, if another call moves them at present, from how they move, without a stop:
        the other call then raises MotionReplacedError. speed: the share of each speed limit that is used, above 0, at most 1.
        Needs the extra `motion` (ruckig). torques, and the errors: as for `follow`; and PlanRefusedError, for a target beyond a
        limit.
        """
        self._hub.run(timeout, self._inner.move, targets, speed=speed, torques=torques)

    @property
    def path_limits(self) -> list[JointLimits]:
        """The limits of each joint on paths. Those of its drive are known once the chain is initialised."""
        return self._hub.do(lambda: self._inner.path_limits)

    def jog(self, *, speed: float = 1.0, renew_within: float = DEAD_MAN) -> AbstractContextManager[BlockingJog]:
        """Move at velocities that are given while the block runs: `with arm.jog() as jog: jog.velocity([...])`.

        speed: the share of each speed limit that is used. renew_within: seconds, counted in cycles. If neither a velocity nor
        `renew` comes for so long, the joints brake, and the jog is over. The block is left when the joints stand. It may take
        over from a motion under way, as `move` does. Needs the extra `motion` (ruckig). Raises as `move` does.
        """
        return self._hub.context(BlockingJog, lambda: self._inner.jog(speed=speed, renew_within=renew_within))

    def stream(self, *, speed: float = 1.0, renew_within: float | None = None) -> AbstractContextManager[BlockingTargets]:
        """Move to targets that are given while the block runs: `with arm.stream() as targets: targets.aim_at([...])`. speed: as
        for `jog`.

        A new target may come at any time. renew_within: as for `jog`; None: the joints go to their last target and rest there,
        whatever becomes of the caller. Else as `jog`.
        """
        return self._hub.context(BlockingTargets, lambda: self._inner.stream(speed=speed, renew_within=renew_within))

    @property
    def override(self) -> float:
        """The rate at which paths run: 0 (a pause on the path) to 1. It may be set at any time, also for the next motion.

        A motion under way goes to that rate within its limits, and stays on its path. Raises PathError for any other value.
        """
        return self._hub.do(lambda: self._inner.override)

    @override.setter
    def override(self, override: float) -> None:
        self._hub.do(setattr, self._inner, "override", override)

    def pause(self) -> None:
        """Stop on the path until `resume`. Does nothing if it follows no path."""
        self._hub.do(self._inner.pause)

    def resume(self) -> None:
        """Go on along the path, at the rate of `override`."""
        self._hub.do(self._inner.resume)

    def halt(self, *, timeout: float | None = None) -> None:
        """Stop all joints and wait until they stand. A running command ends with ChainHaltedError.

        Joints that move along a path brake along it first, for LONGEST_STOP at most, and all that move with them do so, too. The
        joints stay enabled. Raises ChainError, which names a joint that did not confirm that it stands.

        Of several chains all are told at once, also if one of them fails. Raises the first error; the others are its notes.
        """
        self._hub.run(timeout, self._inner.halt)

    def progress(self) -> BlockingProgresses:
        """How far the motion is, cycle by cycle, as an iterator: the present motion, else the next one, until its end.

        A late loop gets the newest cycle. It goes on if another motion takes over.
        """
        return BlockingProgresses(self._hub, self._hub.do(self._inner.progress))


class BlockingChain(BlockingMoving):
    """The blocking Chain. name: of the chain. devices: its joints, in the order of the file. settings: as it was made with.

    changed: woken when `state` or `motion` changes. begun: woken when a motion begins.
    """

    _inner: Chain

    name: Final[str] = attribute("name", "Chain")

    @property
    def devices(self) -> tuple[BlockingDevice, ...]:
        """As of the async Chain; see the text of this class."""
        return tuple(self._hub.twin(BlockingDevice, each) for each in self._inner.devices)

    settings: Final[ChainSettings] = attribute("settings", "Chain")

    @property
    def state(self) -> ChainState:
        """The state of a chain decides which commands it takes."""
        return self._hub.do(lambda: self._inner.state)

    @property
    def is_busy(self) -> bool:
        """Whether a command is under way: one that may give its joints power, though it is OFF yet; or one that moves them."""
        return self._hub.do(lambda: self._inner.is_busy)

    @property
    def motion(self) -> Motion | None:
        """That along a path, or by a stream of targets, at present; None: it stands, or a loop gives the set-points."""
        return self._hub.do(lambda: self._inner.motion)

    @property
    def interruptions(self) -> int:
        """How often it was initialised, homed, halted, shut down or stopped by a fault.

        Once this number has changed, set-points that were thought of before may be far from the joints.
        """
        return self._hub.do(lambda: self._inner.interruptions)

    @property
    def joints(self) -> Mapping[str, BlockingDevice]:
        """The joints by their names."""
        found = self._hub.do(lambda: self._inner.joints)
        return {name: self._hub.twin(BlockingDevice, each) for name, each in dict(found).items()}

    @property
    def positions(self) -> list[float]:
        """The actual positions, as last heard. Raises ChainError for a joint that was not heard since its last boot."""
        return self._hub.do(lambda: self._inner.positions)

    @property
    def desired_positions(self) -> list[float]:
        """The positions that the next PDOs command."""
        return self._hub.do(lambda: self._inner.desired_positions)

    @property
    def velocities(self) -> list[float]:
        """The actual velocities, per second. Raises ChainError for a joint of which none is known yet."""
        return self._hub.do(lambda: self._inner.velocities)

    @property
    def is_homed(self) -> bool:
        """Whether all joints are homed."""
        return self._hub.do(lambda: self._inner.is_homed)

    @property
    def is_on_path(self) -> bool:
        """Whether its joints are sent where they are wanted; behind a gap of SYNC they come back to their path (late_sync.py)."""
        return self._hub.do(lambda: self._inner.is_on_path)

    @property
    def sync_cycles(self) -> int:
        """SYNCs sent while it followed set-points."""
        return self._hub.do(lambda: self._inner.sync_cycles)

    @property
    def missed_cycles(self) -> int:
        """How many of these cycles brought no new set-point, though a loop over `cycles` was running."""
        return self._hub.do(lambda: self._inner.missed_cycles)

    @property
    def skipped_cycles(self) -> int:
        """Periods in which no SYNC was sent while it followed set-points, because this process was late."""
        return self._hub.do(lambda: self._inner.skipped_cycles)

    @property
    def desired(self) -> list[float]:
        """The set-points that the next SYNC takes along; empty while it follows none."""
        return self._hub.do(lambda: self._inner.desired)

    @property
    def has_sync(self) -> bool:
        """Whether SYNC is sent."""
        return self._hub.do(lambda: self._inner.has_sync)

    def check_open(self) -> None:
        """Raise BusError if a bus has failed, MasterClosedError if the master has been left."""
        self._hub.do(self._inner.check_open)

    def stop_reason(self) -> ChainError:
        """Return why the chain was stopped."""
        return self._hub.do(self._inner.stop_reason)

    def initialise(self, *, timeout: float | None = None) -> None:
        """Make the joints ready to move: PDOs, NMT start, SYNC, fault reset, Operation enabled. Joints that move are halted.

        Raises ChainFaultError if a fault stays, ChainError for a joint that does not answer, does not stand, or refuses, and
        before it sets anything up if the PDOs do not fit on the bus (bus_room.py).
        """
        self._hub.run(timeout, self._inner.initialise)

    def locate(self, device: BlockingDevice, *, timeout: float | None = None) -> None:
        """Ask one of its joints where it is, which unit it has and of which make it is, by SDO. It needs no power, and gets none.

        `device.position` has it. A joint that does not answer, or refuses, keeps what was heard last.
        """
        self._hub.run(timeout, self._inner.locate, device._inner)

    def home(self, *, if_needed: bool = False, timeout: float | None = None) -> None:
        """Home all joints, side by side, from where they stand. If one fails, or the task is interrupted, all are halted.

        if_needed: joints that have their reference stay where they are, see `drive.home_if_needed`.
        """
        self._hub.run(timeout, self._inner.home, if_needed=if_needed)

    def enable_interpolated_position(self, *, timeout: float | None = None) -> None:
        """Do as `follow`, for a chain whose mode is ip: the manual's name. Raises ChainError for a chain with another mode."""
        self._hub.run(timeout, self._inner.enable_interpolated_position)

    def recover(self, *, timeout: float | None = None) -> None:
        """Reset and enable all joints after a fault or a halt. A chain that followed set-points follows them again.

        Raises ChainError, with the chain READY, for a joint that was homed and has lost its reference since (by a reset, or
        without power): its positions would mean something else, so it must be homed first. AxisSettings(keeps_reference=True) is
        for drives with an absolute encoder. A chain that was never homed has no reference to lose.
        """
        self._hub.run(timeout, self._inner.recover)

    def shut_down(self, *, timeout: float | None = None) -> None:
        """Halt, engage the brakes, take the power away, and stop the nodes (NMT stop). SYNC ends with the last chain.

        A node on which another drive of this master has power, as another axis, is not stopped. Every joint is tried. Raises
        ChainError, which names a joint that was not shut down.
        """
        self._hub.run(timeout, self._inner.shut_down)

    def cycles(self) -> BlockingCycles:
        """The SYNC cycles from now on, as an iterator. Read the path at `Cycle.time`. A late loop gets the newest cycle.

        Raises ChainFaultError if a joint fails, ChainHaltedError if the chain is halted; both once the other joints stand.
        """
        return BlockingCycles(self._hub, self._hub.do(self._inner.cycles))

    def set_positions(self, positions: Sequence[float], *, cycles: int = 1) -> None:
        """Give the next set-points, one per joint, in the user's unit; they are sent behind the next SYNC.

        cycles: how many cycles the way takes, on a straight line from the last set-points; none of them counts as missed. Raises
        SetPointRefusedError, with nothing changed, for a wrong count, a number that is not finite or does not fit, a position or
        a speed beyond the `limits` of the joint, a joint without a scale, or a step beyond `max_step` per cycle. Raises
        ChainFaultError, ChainHaltedError or ChainError if the chain follows no set-points.
        """
        self._hub.do(self._inner.set_positions, positions, cycles=cycles)

    def hold(self) -> None:
        """Stay at the set-points that were sent last. Set-points not sent yet are dropped, also the rest of a path.

        The cycle does not count as missed. `Cycle.time` stands still.
        """
        self._hub.do(self._inner.hold)

    def record(self, path: str | FilePath) -> AbstractContextManager[BlockingRecorder]:
        """Record what the chain does while an `with` block runs: a row for each SYNC, see record_files.py.

        path: of the file, Parquet if it ends in ".parquet", else CSV; an older one is overwritten. Rows begin once the chain is
        initialised. Raises OSError; PackageMissingError without pyarrow for Parquet; at the end RecordError if rows are missing.
        A block that ends by an error or is interrupted waits for nothing: `Recorder.wait` does.
        """
        return self._hub.context(BlockingRecorder, lambda: self._inner.record(path))

    def recorder(self, path: str | FilePath) -> BlockingRecorder:
        """Begin to record, until `Recorder.close`; `Recorder.wait` then waits for the file. Else as `record`. path: of the file;
        .csv or .parquet.
        """
        return BlockingRecorder(self._hub, self._hub.do(self._inner.recorder, path))


class BlockingTogether(BlockingMoving):
    """The blocking Together. Several chains that move as one; made by `together`. Their joints stand one after another."""

    _inner: Together


class BlockingMaster(MasterTwin):
    """The blocking Master. Participant says what it does on its buses.

    devices: the drives by node and axis. chains: those made so far, by name. nodes, joints: those of the machine file, by name.
    machine: that file, as it was read; None without one. halts: once the master was left, the halts of its drives. realtime: what
    the operating system was asked for. Times are in seconds here.
    """

    @property
    def devices(self) -> dict[tuple[BlockingNode, int], BlockingDevice]:
        """As of the async Master; see the text of this class."""
        return {
            (self._hub.twin(BlockingNode, node), axis): self._hub.twin(BlockingDevice, each)
            for (node, axis), each in dict(self._inner.devices).items()
        }

    @property
    def chains(self) -> dict[str, BlockingChain]:
        """As of the async Master; see the text of this class."""
        return {name: self._hub.twin(BlockingChain, each) for name, each in dict(self._inner.chains).items()}

    @property
    def nodes(self) -> dict[str, BlockingNode]:
        """As of the async Master; see the text of this class."""
        return {name: self._hub.twin(BlockingNode, each) for name, each in dict(self._inner.nodes).items()}

    @property
    def joints(self) -> dict[str, BlockingDevice]:
        """As of the async Master; see the text of this class."""
        return {name: self._hub.twin(BlockingDevice, each) for name, each in dict(self._inner.joints).items()}

    machine: Final[MachineFile | None] = attribute("machine", "Master")

    halts: Final[list[Halt]] = attribute("halts", "Master")

    realtime: Final[tuple[Measure, ...]] = attribute("realtime", "Master")

    @property
    def dictionary(self) -> ObjectDictionary:
        """The dictionary of nodes that are given none: that of `open_master`, or else that of the data files."""
        return self._hub.do(lambda: self._inner.dictionary)

    @property
    def dictionaries(self) -> tuple[ObjectDictionary, ...]:
        """The dictionaries at hand: that of nodes that are given none, then those of all nodes so far, each once."""
        return self._hub.do(lambda: self._inner.dictionaries)

    def node(
        self,
        node_id: int,
        dictionary: ObjectDictionary | str | FilePath | None = None,
        *,
        bus: str | None = None,
        pdos: bool | None = None,
    ) -> BlockingNode:
        """Return the node with this ID on a bus; the same object each time.

        dictionary: the path of the device's EDS, DCF, XDD or XDC file, or a sample's name, or a dictionary; None = that of the
        data files. pdos: exchange the node's PDOs; None = if `dictionary` is a file. The device is asked for its PDO settings,
        and PdoReceived follows; see `Node.start` and node_pdos.py. Without PDOs nothing is sent.

        Raises LocalProtocolError for an ID outside 1..127, for no bus name if there are several buses, and for another dictionary
        than the first time; DataError, DictionaryError for a file that cannot be read.
        """
        return self._hub.twin(BlockingNode, self._hub.do(self._inner.node, node_id, dictionary, bus=bus, pdos=pdos))

    def device(
        self, node: BlockingNode, name: str = "", settings: AxisSettings | None = None, *, axis: int = 0
    ) -> BlockingDevice:
        """Return the drive on a node; the same object each time. If it is enabled when the master is left, it is halted.

        name: for people, by default "node 12". axis: 0..7, of a node with several drives: the objects of axis k are those of the
        first one plus k * 0x800; its dictionary must have them. settings: units and habits of the drive; by default those of CiA
        402, or those of Schunk's joints if the vendor-ID is Schunk's. Sends nothing. Raises LocalProtocolError if the drive is in
        use with other settings (it names the differences), for a node that is no drive by its dictionary, and for an axis that
        the dictionary does not have.
        """
        return self._hub.twin(BlockingDevice, self._hub.do(self._inner.device, node._inner, name, settings, axis=axis))

    def chain(
        self,
        description: ChainDescription,
        settings: ChainSettings | None = None,
        *,
        axes: AxisSettings | Mapping[str, AxisSettings] | None = None,
        dictionary: ObjectDictionary | None = None,
    ) -> BlockingChain:
        """Make the chain of a description. axes: the settings of all joints, or by joint; by default as in `device`.

        Raises UnknownChainError if the description names a bus that this master does not have, LocalProtocolError for a drive
        that is in use with other settings, and for a name that another chain has.
        """
        return self._hub.twin(
            BlockingChain, self._hub.do(self._inner.chain, description, settings, axes=axes, dictionary=dictionary)
        )

    def load_chains(
        self,
        path: str | FilePath = "",
        *,
        text: str | None = None,
        settings: ChainSettings | None = None,
        axes: AxisSettings | Mapping[str, AxisSettings] | None = None,
        dictionary: ObjectDictionary | None = None,
    ) -> dict[str, BlockingChain]:
        """Make the chains of a file (see chain_file.py), or of a text in that form, by their names. Sends nothing. path: of the
        file, or the name of one of the data files. axes: the settings of all joints, or by their names. settings, dictionary: as
        of `chain`.

        A bus that the file names must be one of this master. If both have only one bus, its name does not matter. Raises
        ChainFileError with every problem found, DataError if the file cannot be read.
        """
        found = self._hub.do(self._inner.load_chains, path, text=text, settings=settings, axes=axes, dictionary=dictionary)
        return {name: self._hub.twin(BlockingChain, each) for name, each in dict(found).items()}

    def events(self, *kinds: type[E], node: BlockingNode | None = None, bus: str | None = None) -> BlockingSubscription[E]:
        """Return an iterator over all events of these kinds from now on: `with master.events(HeartbeatLost) as events: ...`.

        node, bus: only events of this one. The queue is bounded: see Subscription. `Event` as a kind means all.
        """
        return BlockingSubscription(
            self._hub, self._hub.do(self._inner.events, *kinds, node=None if node is None else node._inner, bus=bus)
        )

    buses: Final[dict[str, Bus]] = attribute("buses", "Master")

    failure: Final[Exception | None] = attribute("failure", "Master")

    is_closed: Final[bool] = attribute("is_closed", "Master")

    def now(self) -> Time:
        """Return the time of all machines: the loop's clock, in ns."""
        return self._hub.do(self._inner.now)

    def bus(self, name: str | None = None) -> Bus:
        """Return a bus by its name; the only bus needs no name. Raises UnknownChainError, LocalProtocolError."""
        return self._hub.do(self._inner.bus, name)

    def check_open(self) -> None:
        """Raise BusError if a bus has failed, MasterClosedError if the master has been left; LocalProtocolError in a process that
        was forked from its own.
        """
        self._hub.do(self._inner.check_open)

    def nmt(self, command: NmtCommand, node_id: int = 0, *, bus: str | None = None, timeout: float | None = None) -> None:
        """Send an NMT command to one node, or to all (0; on all buses, unless one is named); return when it is on its way.

        Only the nodes' heartbeats confirm it. The states that this master knows of the nodes follow the command. command: also as
        its number. Raises LocalProtocolError for a number that is no command, and for another node-ID.
        """
        self._hub.run(timeout, self._inner.nmt, command, node_id, bus=bus)

    def nmt_master(self, bus: Bus) -> NmtMaster:
        """Return the machine that sends the NMT commands of a bus, for procedures."""
        return self._hub.do(self._inner.nmt_master, bus)

    def nmt_start(self, node_id: int = 0, *, bus: str | None = None, timeout: float | None = None) -> None:
        """Start remote node: to Operational. node_id: 1..127; 0: all nodes. bus: its name; None: the only one, and for all nodes
        all buses.
        """
        self._hub.run(timeout, self._inner.nmt_start, node_id, bus=bus)

    def nmt_stop(self, node_id: int = 0, *, bus: str | None = None, timeout: float | None = None) -> None:
        """Stop remote node: to Stopped, where only NMT and heartbeat live. node_id, bus: as of `nmt_start`."""
        self._hub.run(timeout, self._inner.nmt_stop, node_id, bus=bus)

    def nmt_enter_pre_operational(self, node_id: int = 0, *, bus: str | None = None, timeout: float | None = None) -> None:
        """Enter pre-operational: SDO, no PDOs. node_id, bus: as of `nmt_start`."""
        self._hub.run(timeout, self._inner.nmt_enter_pre_operational, node_id, bus=bus)

    def nmt_reset_node(self, node_id: int = 0, *, bus: str | None = None, timeout: float | None = None) -> None:
        """Reset node: as after power-on. `Node.reset` also waits for the boot-up. node_id, bus: as of `nmt_start`."""
        self._hub.run(timeout, self._inner.nmt_reset_node, node_id, bus=bus)

    def nmt_reset_communication(self, node_id: int = 0, *, bus: str | None = None, timeout: float | None = None) -> None:
        """Reset communication: the communication objects as after power-on. node_id, bus: as of `nmt_start`."""
        self._hub.run(timeout, self._inner.nmt_reset_communication, node_id, bus=bus)

    @property
    def sync_period(self) -> Time:
        """ns between two SYNCs, 0 while none are sent."""
        return self._hub.do(lambda: self._inner.sync_period)

    def sync_start(self, period: float) -> None:
        """Send SYNC on all buses, now and then once per period (seconds). A SYNC that runs starts again. Events: SyncSent"""
        self._hub.do(self._inner.sync_start, period)

    def sync_stop(self) -> None:
        """Stop sending SYNC periodically."""
        self._hub.do(self._inner.sync_stop)

    def send_sync(self, *, timeout: float | None = None) -> None:
        """Send one SYNC on all buses; return when it is on its way. A running period keeps its phase."""
        self._hub.run(timeout, self._inner.send_sync)

    def run(self, procedure: Procedure[R], *, timeout: float | None = None) -> R:
        """Run a procedure of `canopen_proto.procedures`, or your own, to its end, and return its result.

        If the call is interrupted, or its time is over, the procedure is interrupted, and the task waits for its clean-up (at
        most CLEAN_UP_TIME, 1 s, or longer for a drive that still slows down). Raises the procedure's own error: a ProcedureError.
        """
        return self._hub.run(timeout, self._inner.run, procedure)


class BlockingDriveCommissioning(Twin[DriveCommissioning]):
    """The blocking DriveCommissioning. One drive on its way. settings: of its joint, as they go into a machine file. done: what
    was done so far, for people.

    Each step raises what its procedure raises (ProcedureError); a move before `set_limits` is a LocalProtocolError.
    """

    def __init__(
        self, master: BlockingMaster, node: BlockingNode, settings: AxisSettings = _NO_SETTINGS, done: list[str] | None = None
    ) -> None:
        hub = master._hub
        super().__init__(hub, hub.do(DriveCommissioning, master._inner, node._inner, settings, done))

    @property
    def master(self) -> BlockingMaster:
        """As of the async DriveCommissioning; see the text of this class."""
        return self._hub.twin(BlockingMaster, self._inner.master)

    @property
    def node(self) -> BlockingNode:
        """As of the async DriveCommissioning; see the text of this class."""
        return self._hub.twin(BlockingNode, self._inner.node)

    settings: Final[AxisSettings] = attribute("settings", "DriveCommissioning")

    done: Final[list[str]] = attribute("done", "DriveCommissioning")

    has_moved: Final[bool] = attribute("has_moved", "DriveCommissioning")

    is_homed: Final[bool] = attribute("is_homed", "DriveCommissioning")

    @property
    def axis(self) -> Axis:
        """The axis. Raises NotInDictionaryError if what describes the node lacks an object of a drive."""
        return self._hub.do(lambda: self._inner.axis)

    @property
    def unit_name(self) -> str:
        """The unit of its positions in the plural: "degrees", "counts"."""
        return self._hub.do(lambda: self._inner.unit_name)

    def leave(self) -> None:
        """Give the axis back the settings with which it began; what was found is in `settings`. For a program that goes on with
        the drive, and may have it in a chain.
        """
        self._hub.do(self._inner.leave)

    def look(self, *, timeout: float | None = None) -> DriveView:
        """Return what the drive shows. Raises NodeIsNoDriveError."""
        return self._hub.run(timeout, self._inner.look)

    def reset_fault(self, *, timeout: float | None = None) -> DriveView:
        """Reset a fault, and return what the drive shows then."""
        return self._hub.run(timeout, self._inner.reset_fault)

    def read_units(self, *, timeout: float | None = None) -> DriveUnits:
        """Identify the drive, and return what it tells about its units."""
        return self._hub.run(timeout, self._inner.read_units)

    def set_unit(self, unit: Unit | None, counts_per_unit: float | None) -> None:
        """Choose the unit of its positions. None, None: counts. counts_per_unit: above 0."""
        self._hub.do(self._inner.set_unit, unit, counts_per_unit)

    def read_limits(self, *, timeout: float | None = None) -> tuple[SetPointLimits, float]:
        """Return the limits that the drive tells, and its position, in the chosen unit."""
        return self._hub.run(timeout, self._inner.read_limits)

    def set_limits(self, lowest: float | None, highest: float | None, speed: float | None) -> None:
        """Choose the limits of the joint. None: none but the drive's own. lowest, highest: positions, in the chosen unit. speed:
        per second.
        """
        self._hub.do(self._inner.set_limits, lowest, highest, speed)

    def read_homing_methods(self, *, timeout: float | None = None) -> HomingMethods:
        """Return what the drive tells of its homing methods."""
        return self._hub.run(timeout, self._inner.read_homing_methods)

    def set_homing_method(self, method: int | None) -> None:
        """Choose the method that `home` writes to 0x6098. None: the drive's own stays. Schunk's joints have none."""
        self._hub.do(self._inner.set_homing_method, method)

    def speed_text(self, speed: float, *, timeout: float | None = None) -> str:
        """Return in words how fast a move at this speed, or the joint's greatest, is going to be, wherever that is known."""
        return self._hub.run(timeout, self._inner.speed_text, speed)

    def small_speed(self, way: float) -> float:
        """The speed of a small move: it takes SMALL_MOVE_TIME, if the joint may go so fast. way: in the chosen unit."""
        return self._hub.do(self._inner.small_speed, way)

    def usual_speed(self) -> float:
        """A slow speed for the first move."""
        return self._hub.do(self._inner.usual_speed)

    def small_move(self, way: float, *, timeout: float | None = None) -> tuple[float, float]:
        """Move a little way from where the drive stands. IT MOVES. Return the positions before and after."""
        return self._hub.run(timeout, self._inner.small_move, way)

    def reverse(self) -> None:
        """Turn the direction of the joint round: the small move went the other way."""
        self._hub.do(self._inner.reverse)

    def home(self, *, timeout: float | None = None) -> float:
        """Home the drive. IT MOVES. Return where it stands."""
        return self._hub.run(timeout, self._inner.home)

    def move_to(self, target: float, speed: float, *, timeout: float | None = None) -> float:
        """Move to a position, in the chosen unit, at a speed of at most the joint's. IT MOVES. Return where it stands. target:
        that position. speed: per second.
        """
        return self._hub.run(timeout, self._inner.move_to, target, speed)


class BlockingSimulatedDevices(Twin[SimulatedDevices]):
    """The blocking SimulatedDevices. A set of simulated drives. hosts: one for each bus."""

    @property
    def drives(self) -> dict[int, DriveNode]:
        """The drives by node-ID; the first one if two buses have the same node-ID."""
        return self._hub.do(lambda: self._inner.drives)

    @property
    def node_ids(self) -> list[int]:
        """The node-IDs of all devices."""
        return self._hub.do(lambda: self._inner.node_ids)

    def raise_fault(self, node_id: int, error_code: int) -> None:
        """Let a drive break down. Raises KeyError if no drive has that node-ID. error_code: 0x603F and EMCY then have it."""
        self._hub.do(self._inner.raise_fault, node_id, error_code)

    def change(self, node_id: int, change: Callable[[DriveNode, Time], object]) -> None:
        """Let something happen to a drive. Raises KeyError if no drive has that node-ID. change: called with the drive and the
        time, ns.
        """
        self._hub.do(self._inner.change, node_id, change)

    @property
    def moving(self) -> list[int]:
        """The node-IDs of the drives that really move, whatever they report on the bus."""
        return self._hub.do(lambda: self._inner.moving)


def open_master(
    *locators: BusSource,
    machine: MachineFile | str | FilePath | None = None,
    buses: Mapping[str, BusSource] | None = None,
    sdo_timeout: float | None = None,
    heartbeat_timeout: float | None = None,
    dictionary: ObjectDictionary | None = None,
    watchdog: Watchdog | None = DEFAULT_WATCHDOG,
    realtime: Realtime | bool | None = None,
) -> BlockingMaster:
    """Open a master of one or several buses, at once: `with open_master("socketcan:can0") as master: ...`

    locators: the buses, each named by its locator. buses: buses by names of your own, such as those of a chain file; several
    names may mean one bus. sdo_timeout: seconds (above 0) that a device may take for each answer; by default 0.5.
    heartbeat_timeout: seconds after which a node whose heartbeat stops is lost (chains then have their joints send heartbeats);
    by default 0, no supervision. dictionary: for nodes that are given none; by default that of the data files. watchdog: how
    drives notice that this master is gone, and stop: once it enables a drive, it sends its heartbeat as node 127; None for none.
    See watchdog.py. realtime: what to ask the operating system for, so that SYNC is in time on a busy computer; True for
    `Realtime()`; by default nothing. `Master.realtime` and the log say what was given. It is for the thread that runs the loop;
    at the end it is given back.

    machine: a machine file, or what was read of one: its buses are opened, and its nodes, joints and chains are in `nodes`,
    `joints` and `chains` of the master. buses then replace those of the file, by their names. Arguments go before what the file
    says; a watchdog that is DEFAULT_WATCHDOG is not given. Raises DataError, DictionaryError with every error in the file;
    LocalProtocolError, with nothing opened, for an argument of another kind.

    Raises BusError if a bus cannot be opened, RealtimeRefusedError for `Realtime(required=True)`. How it ends: docs/blocking.md.
    """
    return open_session(
        BlockingMaster,
        _open_master(
            *locators,
            machine=machine,
            buses=buses,
            sdo_timeout=sdo_timeout,
            heartbeat_timeout=heartbeat_timeout,
            dictionary=dictionary,
            watchdog=watchdog,
            realtime=realtime,
        ),
    )


def together(*chains: BlockingMoving) -> BlockingTogether:
    """Return several chains of one master as one, for motions: one path, one clock, one stop. They may be on several buses.

    Raises LocalProtocolError for chains that have another cycle_time or a joint in common.
    """
    if not chains:
        together_of_none()
    hub = chains[0]._hub
    return BlockingTogether(hub, hub.do(_together, *(each._inner for each in chains)))


def boot_network(
    master: BlockingMaster, machine: MachineFile | str | FilePath, *, timeout: float | None = None
) -> dict[str, BootReport]:
    """Reset, check, configure and start the nodes of a machine that have `boot`; return how it went, by the name of the bus.

    master: opened with this machine, or with buses of the same names. A node that fails is not started, and is no exception: see
    `BootReport.missing`. If the call is interrupted, or its time is over, nodes that run go on running. Raises DataError,
    DictionaryError for a file that cannot be used; ChainError, with nothing sent, if a chain of this master has been initialised:
    its drives would be reset.
    """
    return master._hub.run(timeout, _boot_network, master._inner, machine)


def simulated_drives(
    drives: Iterable[tuple[str, int]],
    shape: Shape = Shape.SCHUNK_POWERBALL,
    on_event: Callable[[Event], object] | None = None,
    *,
    make: Callable[[int, int], DeviceMaker] | None = None,
    keeper: ParameterKeeper | None = None,
) -> AbstractContextManager[BlockingSimulatedDevices]:
    """Serve drives, each given as (locator, node-ID), while the block runs. Raises BusError, TransportError.

    keeper: as of `Host`. make: returns the maker of the drive for a place and a node-ID; by default drives of that shape.

    on_event: called with each event of the drives.
    """
    return open_context(BlockingSimulatedDevices, lambda: _simulated_drives(drives, shape, on_event, make=make, keeper=keeper))


def simulated_devices(
    makers: Mapping[str, Sequence[DeviceMaker]],
    on_event: Callable[[Event], object] | None = None,
    *,
    keeper: ParameterKeeper | None = None,
    say: Callable[[str], object] = lambda text: None,
) -> AbstractContextManager[BlockingSimulatedDevices]:
    """Serve devices, by locator, while the block runs. keeper, say: as of `Host`. on_event: called with each event of the
    devices.

    Raises BusError, TransportError, ScriptError; LocalProtocolError for what is no locator, or makes no device, and for two
    devices of one bus that have one node-ID.
    """
    return open_context(BlockingSimulatedDevices, lambda: _simulated_devices(makers, on_event, keeper=keeper, say=say))
