"""`Node`: one device on one bus, to be read and written by the names of its objects. Made by `Master.node`."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from dataclasses import replace
from typing import Any, TypeVar, overload

from canopen_master.errors import (
    NOT_HEARD,
    UNEXPECTED_ANSWER,
    NodeSilentError,
    SdoError,
    SdoRefusedError,
    UnexpectedAnswerError,
)
from canopen_master.node_pdos import NodePdos
from canopen_master.participant.bus import Bus
from canopen_master.participant.participant import Participant
from canopen_master.participant.peer import Peer
from canopen_master.participant.subscription import Subscription
from canopen_master.seconds import check_seconds, nanoseconds
from canopen_master.silence import NOT_BOOTED, missing_frame
from canopen_master.streams import Pieces, ReadStream, write_stream
from canopen_master.watchdog import Watchdogs
from canopen_proto.datatypes import DataType, Value, ValueRangeError, is_integer
from canopen_proto.dictionary import Key, Message, ObjectDictionary, Variable
from canopen_proto.dictionary.typed import Readable, Writable
from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.watchdog import NotHeldError
from canopen_proto.drives.cia402.axes import axes_of, axis_of, swapped
from canopen_proto.drives.cia402.names import names_in_mode
from canopen_proto.drives.cia402.objects import CONTROLWORD, MODES_OF_OPERATION_DISPLAY, STATUSWORD
from canopen_proto.drives.cia402.states import Command, enables_operation
from canopen_proto.explained import counted
from canopen_proto.heartbeat import HeartbeatReceived, NodeBooted
from canopen_proto.machine import MILLISECOND, Event, LocalProtocolError, RequestId, Time
from canopen_proto.multiplexer import Mux, index_of, mux, place_of
from canopen_proto.nmt import NmtCommand, NmtState
from canopen_proto.pdo.configure import PdoDifference
from canopen_proto.pdo.settings import COB_ID, FIRST_PDO_RECORD, LAST_PDO_RECORD
from canopen_proto.procedures.objects import ABSENT
from canopen_proto.remote_node import RemoteNode
from canopen_proto.sdo.client import Block, SdoAborted, SdoDownloaded, SdoUploaded
from canopen_transports.loop import current_loop, protected

E = TypeVar("E", bound=Event)
T = TypeVar("T", bound=Value)

MAX_SHOWN = 16
"""Bytes of what was to be written that an error shows."""
BOOT_TIME = 5.0
"""Seconds that a device may take from a reset to its boot-up frame."""


class Node(Peer):
    """A device as its master sees it. remote: the core's view of it, with all known values (`remote.values`). axes: its drives
    that this master has used so far (`Master.device`), by number.

    Keys are names or numbers: "statusword", "record:field", 0x6041, (0x60C1, 1), "6041:00"; or those of `canopen eds stubs`, by
    which a type checker knows the type of the value. Reading and writing use SDO. If the task is cancelled, the transfer is
    aborted on the bus. Raises ObjectNotFoundError for an unknown name, SdoTimeoutError, SdoRefusedError, SdoGivenUpError,
    SdoNotConfirmedError (of writes), BusError, MasterClosedError.

    block: whether to use block transfer: False; True (the transfer fails if the device has none); or "auto", if it pays and the
    device has it.
    """

    def __init__(self, participant: Participant, bus: Bus, remote: RemoteNode, watchdogs: Watchdogs) -> None:
        super().__init__(participant, bus, remote)
        self._watchdogs = watchdogs
        self._controlwords = {swapped(CONTROLWORD, axis): axis for axis in axes_of(remote.dictionary) or (0,)}
        remote.commanded.update(self._controlwords)  # a drive that somebody else has enabled is not ours to halt
        self._enabled_by_hand: set[int] = set()  # axes; a write may be executed though no task has waited for its confirmation
        self.axes: dict[int, Axis] = {}
        self._drops = 0
        self._guarding_left: Callable[[], None] | None = None  # the guarding under way is somebody else's
        self._pdos: NodePdos | None = None
        self.watch((SdoDownloaded,), self._on_written)

    def __repr__(self) -> str:
        return f"<Node {self.node_id} on {self.bus}>"

    @property
    def dictionary(self) -> ObjectDictionary:
        return self.remote.dictionary

    @property
    def nmt_state(self) -> NmtState | None:
        """The NMT state that its heartbeat shows; without a heartbeat, the one that we commanded; None if neither is known."""
        return self.remote.nmt_state

    @property
    def was_enabled(self) -> bool:
        """Whether one of its drives may move: the last controlword known, or written here, enables operation."""
        return bool(self.axes_enabled)

    @property
    def axes_enabled(self) -> tuple[int, ...]:
        """The axes whose drives may move, as `was_enabled` says."""
        return tuple(axis for axis in self._controlwords.values() if self.was_axis_enabled(axis))

    def was_axis_enabled(self, axis: int) -> bool:
        """Return whether the drive on an axis may move, as `was_enabled` says."""
        held = self.remote.may_hold(swapped(CONTROLWORD, axis))
        return axis in self._enabled_by_hand or any(map(enables_operation, held))

    def supervise_heartbeat(self, timeout: float) -> None:
        """Report HeartbeatLost when no heartbeat came for `timeout` seconds, from the first one on; 0 ends this."""
        self._participant.check_loop()
        self.remote.heartbeat.set_timeout(nanoseconds("timeout", timeout), self.now())
        self._participant.pump.pump()

    # ---- objects ----

    @overload
    async def read(self, key: Readable[T], *, block: Block = False) -> T: ...
    @overload
    async def read(self, key: Key, *, block: Block = False) -> Value: ...
    async def read(self, key: Any, *, block: Block = False) -> Any:
        """Read the value of an object. Raises UnexpectedAnswerError if its length is not that of the object's type."""
        variable = self._variable(key)
        uploaded = await self._upload(lambda now: self.remote.read(variable, now, block=block))
        try:
            return self.remote.value_of(uploaded, variable)
        except ValueRangeError as error:
            raise self._unexpected(variable, uploaded, error) from error

    async def read_message(self, key: Key, *, block: Block = False) -> Message:
        """Read an object: its value, its name, and the constants that it bears. timestamp: when it came, ns on the loop's clock.

        Bits 12 and 13 of the statusword depend on the mode of operation. If one is set, 0x6061 is read too.
        """
        variable = self._variable(key)
        uploaded = await self._upload(lambda now: self.remote.read(variable, now, block=block))
        try:
            message = self.remote.message_of(uploaded)
        except ValueRangeError as error:
            raise self._unexpected(variable, uploaded, error) from error
        constants = message.constants
        axis = axis_of(variable.mux)
        if axis is not None and variable.mux == swapped(STATUSWORD, axis) and constants != names_in_mode(constants, None):
            constants = names_in_mode(constants, await self._active_mode(axis))
        return replace(message, timestamp=self.remote.heard_at.get(variable.mux), constants=constants)

    @overload
    async def write(self, key: Writable[T], value: T, *, block: Block = False) -> None: ...
    @overload
    async def write(self, key: Key, value: Value, *, block: Block = False) -> None: ...
    async def write(self, key: Any, value: Value, *, block: Block = False) -> None:
        """Write a value, or a constant by its name; return when the device has confirmed it.

        Raises ValueRangeError, ConstantNotFoundError, LocalProtocolError (read-only), with nothing sent, if the dictionary
        forbids it. After SdoNotConfirmedError, or if cancelled, the write may have been executed nevertheless. It is never
        repeated by itself. Before a controlword that enables operation, the master takes hold of the drive (watchdog.py). Raises
        NodeIdTakenError or NotHeldError, with nothing sent, if it cannot.
        """
        variable, meant, _ = self.remote.encode(self._variable(key), value)
        attempt = f"writing {meant!r} to"

        def submit(now: Time) -> RequestId:
            return self.remote.write(variable, meant, now, block=block)

        if variable.mux in self._controlwords:
            async with self._commanding(variable.mux, meant):
                await self._download(submit, attempt)
        else:
            await self._download(submit, attempt)

    async def matches(self, key: Key, constant: str) -> bool:
        """Read an object, and return whether it bears a constant: `(value & mask) == constant`."""
        variable = self._variable(key)
        wanted = self.dictionary.constant(variable, constant)  # an unknown name raises before anything is sent
        value = await self.read(variable)
        return isinstance(value, int) and wanted.is_in(value)

    async def read_int(self, key: Key, *, block: Block = False) -> int:
        """Read an object that holds an integer or a BOOLEAN. Raises LocalProtocolError, with nothing sent, for another type."""
        variable = self._of_type(key, "an integer", lambda kind: is_integer(kind) or kind is DataType.BOOLEAN)
        value = await self.read(variable, block=block)
        assert isinstance(value, int)
        return int(value)

    async def read_float(self, key: Key, *, block: Block = False) -> float:
        """Read an object that holds a REAL32 or REAL64. Raises LocalProtocolError, with nothing sent, for another type."""
        variable = self._of_type(key, "a real number", lambda kind: kind in (DataType.REAL32, DataType.REAL64))
        value = await self.read(variable, block=block)
        assert isinstance(value, float)
        return value

    async def read_str(self, key: Key, *, block: Block = False) -> str:
        """Read an object that holds text. Raises LocalProtocolError, with nothing sent, for another type."""
        variable = self._of_type(key, "text", lambda kind: kind in (DataType.VISIBLE_STRING, DataType.UNICODE_STRING))
        value = await self.read(variable, block=block)
        assert isinstance(value, str)
        return value

    def _variable(self, key: Key) -> Variable:
        """Return the object that a key names. Raises ObjectNotFoundError, and LocalProtocolError for what can be no key."""
        try:
            return self.dictionary.variable(key)
        except TypeError as error:
            failed = f"key {key!r} names no object"
            raise LocalProtocolError(f"{failed}; give a name, an index, or (index, subindex)") from error

    def _of_type(self, key: Key, wanted: str, suits: Callable[[DataType], bool]) -> Variable:
        variable = self._variable(key)
        if not suits(variable.data_type):
            raise LocalProtocolError(f"{variable.label} is {variable.data_type.name}, not {wanted}; `read` takes every type")
        return variable

    async def read_bytes(
        self,
        key: Key,
        subindex: int | None = None,
        *,
        block: Block = False,
        patience: float | None = None,
        most: int | None = None,
    ) -> bytes:
        """Read the bytes of any object, in the dictionary or not. subindex: if key is an index alone; 0 by default. patience:
        seconds for each answer of the node, in place of the master's SDO time-out; 1 ms at least. most: bytes that are taken; a
        longer value is refused with 0x05040005; None: 16 MiB."""
        place, timeout = self._place(key, subindex), _time_of(patience)
        uploaded = await self._upload(lambda now: self.remote.sdo.upload(*place, now, block=block, timeout=timeout, most=most))
        return uploaded.data

    async def write_bytes(
        self, index: int, subindex: int, data: bytes, *, block: Block = False, patience: float | None = None
    ) -> None:
        """Write bytes to any object, in the dictionary or not. For controlwords, see `write`. data: little-endian.

        patience: as of `read_bytes`; it counts neither for a controlword nor for the COB-ID of a PDO.
        """
        _check_place(index, subindex)
        if not isinstance(data, bytes | bytearray | memoryview):
            raise LocalProtocolError(f"data {data!r} is no bytes; give bytes, little-endian; `write` takes values")
        is_controlword = mux(index, subindex) in self._controlwords and len(data) == 2
        is_cob_id = subindex == COB_ID and len(data) == 4 and FIRST_PDO_RECORD <= index <= LAST_PDO_RECORD
        known = self.dictionary.get(index, subindex)
        if known is not None and (is_controlword or (is_cob_id and known.access.writable)):  # what they mean has consequences
            await self.write((index, subindex), int.from_bytes(data, "little"), block=block)
            return
        shown = data.hex() if len(data) <= MAX_SHOWN else counted(len(data), "byte")
        timeout = _time_of(patience)
        async with self._commanding(mux(index, subindex), int.from_bytes(data[:2], "little")):
            await self._download(
                lambda now: self.remote.sdo.download(index, subindex, data, now, block=block, timeout=timeout),
                f"writing {shown} to",
            )

    def read_stream(self, index: int, subindex: int = 0, *, block: Block = "auto") -> ReadStream:
        """Read any object piece by piece: `async for piece in node.read_stream(0x1F50, 1)`. See streams.py.

        The pieces are valid only once the loop has ended without an exception: the checksum comes last.
        """
        return ReadStream(self, index, subindex, block)

    async def write_stream(
        self, index: int, subindex: int, pieces: Pieces, size: int | None = None, *, block: Block = "auto"
    ) -> None:
        """Write any object from pieces of any size; return when the device has confirmed the whole.

        pieces: an iterable or an async iterable, asked for more only when there is room. An exception that it raises aborts the
        transfer on the bus, and is raised unchanged. size: bytes, if known; some devices insist on it. Raises LocalProtocolError
        if the pieces are more or less than that. See streams.py. A controlword counts as one that enables: see `write`.
        """
        _check_place(index, subindex)
        async with self._commanding(mux(index, subindex), Command.ENABLE_OPERATION):
            await write_stream(self, index, subindex, pieces, size, block)

    # ---- PDOs ----

    def keep_pdos(self) -> None:
        """Exchange the PDOs as the device has set them up, now and after each boot; see node_pdos.py. Event: PdoDiffers."""
        if self._pdos is None:
            self._pdos = NodePdos(self._participant, self)

    def leave_pdos(self) -> None:
        """Undo `keep_pdos`: the exchange is not renewed after a boot. PDOs that are exchanged now go on."""
        if self._pdos is not None:
            self._pdos.stop()
            self._pdos = None

    async def exchange_pdos(self) -> tuple[PdoDifference, ...]:
        """Wait until the PDOs are exchanged (`keep_pdos`); return how the device's PDOs differ from those of its file.

        If we have set a PDO up anew since they were read (`configure_pdo`, or a write), all are read and exchanged once more, and
        RPDOs must be enabled again (`enable_rpdo`). Raises SdoTransferError if the device does not answer, InvalidPdoError,
        UnexpectedLengthError.
        """
        self.keep_pdos()
        assert self._pdos is not None
        return await self._pdos.compare()

    @protected
    def enable_rpdo(self, number: int, enabled: bool = True) -> None:
        """Send RPDO `number` (1..512) to the node while it is Operational, or stop sending it. It carries `remote.values`.
        enabled: False stops it.

        It stops when the node boots. Raises LocalProtocolError if this RPDO is not exchanged. An RPDO with a controlword may
        enable a drive: the master takes hold of the drive beside it (`hold` does so before it). Raises NotHeldError if the drive
        has to be held first (`Watchdog.required`).
        """
        self._participant.check_loop()
        if enabled and number in self.remote.rpdos:
            for key in self._controlwords.keys() & set(self.remote.rpdos[number].mapping.muxes):
                self._may_enable(self._controlwords[key])
        self.remote.enable_rpdo(number, self.now(), enabled)
        self._participant.pump.pump()

    @protected
    def send_mpdo(self, number: int, key: Key, value: Value) -> bool:
        """Write an object by RPDO `number`, a multiplexed PDO (`remote.add_mpdo`); see RemoteNode.send_mpdo. Returns False, with
        nothing sent, while the node is not Operational.

        For controlwords, see `enable_rpdo`.
        """
        self._participant.check_loop()
        variable, meant, _ = self.remote.encode(self._variable(key), value)
        axis = self._controlwords.get(variable.mux)
        if axis is not None and enables_operation(meant):
            self._may_enable(axis)
            self._enabled_by_hand.add(axis)
        is_sent = self.remote.send_mpdo(number, key, value, self.now())
        self._participant.pump.pump()
        return is_sent

    # ---- network management ----

    async def hold(self, axis: int = 0) -> None:
        """Have the drive on this node watch over this master, and stop by itself when the master falls silent; see watchdog.py.

        axis: of the node, 0 for its first one.

        Commands that enable a drive do so by themselves; call this before you send controlwords by RPDO. Raises NodeIdTakenError,
        NotHeldError.
        """
        await self._participant.run(self._watchdogs.hold(self, axis))

    async def start(self) -> None:
        """Start the node (NMT, to Operational). If its file is known, wait before until its PDOs are exchanged, so that none is
        missed.

        Raises as `exchange_pdos`, with nothing sent; BusError, MasterClosedError.
        """
        if self._pdos is not None:
            await self._pdos.wait()
        await self.nmt(NmtCommand.START)

    @protected
    def start_guarding(self, guard_time: float, life_time_factor: int = 3) -> None:
        """Ask the node once per guard time (seconds) whether it lives: for a node without a heartbeat.

        Events: HeartbeatReceived; NodeGuardingLost after guard_time * life_time_factor without an answer.
        """
        self._participant.check_loop()
        self.remote.start_guarding(nanoseconds("guard_time", guard_time, above_zero=True), life_time_factor, self.now())
        self._guarding_left = None
        self._participant.pump.pump()

    @protected
    def guard_for(self, guard_time: float, life_time_factor: int, left: Callable[[], None]) -> None:
        """Start guarding for somebody outside of this program, as `start_guarding` does. A chain would be stopped without an
        answer: so it ends when one begins to use the node. left: called then, before the guarding stops."""
        self.start_guarding(guard_time, life_time_factor)
        self._guarding_left = left

    def begin_use(self) -> None:
        """End the guarding of `guard_for`: a chain begins to use the node."""
        if self._guarding_left is not None:
            self._guarding_left()
            self.stop_guarding()

    @protected
    def stop_guarding(self) -> None:
        """Stop node guarding."""
        self._participant.check_loop()
        self._guarding_left = None
        self.remote.stop_guarding()
        self._participant.pump.pump()

    async def nmt(self, command: NmtCommand) -> None:
        """Send an NMT command to this node; return when it is on its way. Only the node's heartbeat confirms it."""
        await self._participant.nmt(command, self.node_id, bus=self.bus)

    async def reset(self, timeout: float = BOOT_TIME, *, communication_only: bool = False) -> None:
        """Reset the node and wait for its boot-up frame. Raises NodeSilentError after `timeout` seconds. communication_only: only
        the communication objects (reset communication); else all (reset node)."""
        check_seconds("timeout", timeout, above_zero=True, finite=False)
        with self.events(NodeBooted) as boots:
            await self.nmt(NmtCommand.RESET_COMMUNICATION if communication_only else NmtCommand.RESET_NODE)
            await self._first_of(boots, timeout, "did not boot after a reset", NOT_BOOTED, is_asked=True)

    async def wait_for_boot(self, timeout: float = BOOT_TIME) -> None:
        """Wait for the next boot-up frame. Raises NodeSilentError after `timeout` seconds."""
        check_seconds("timeout", timeout, above_zero=True, finite=False)
        with self.events(NodeBooted) as boots:
            await self._first_of(boots, timeout, "did not boot", "it has no reason to: a boot-up wants a reset")

    async def wait_for_heartbeat(self, timeout: float) -> NmtState:
        """Wait for the next heartbeat, and return the state that it shows. Raises NodeSilentError after `timeout` seconds."""
        check_seconds("timeout", timeout, above_zero=True, finite=False)
        with self.events(HeartbeatReceived) as heartbeats:
            cause = "it has no reason to: a heartbeat wants a time in 0x1017"
            return (await self._first_of(heartbeats, timeout, "sent no heartbeat", cause)).state

    def _place(self, key: Key, subindex: int | None) -> tuple[int, int]:
        """Index and subindex of a key. An object that the dictionary lacks must be given by numbers."""
        if isinstance(key, int):
            return place_of(key) if subindex is None else _check_place(key, subindex)
        if subindex is not None:
            raise LocalProtocolError(f"{key!r} is a whole object: a subindex goes with an index alone")
        if isinstance(key, tuple) and len(key) == 2:
            return _check_place(*key)
        variable = self._variable(key)
        return variable.index, variable.subindex

    async def _active_mode(self, axis: int) -> int | None:
        """Read 0x6061 of an axis; None if the node does not have it, or does not answer."""
        with suppress(SdoError):
            data = await self.read_bytes(index_of(swapped(MODES_OF_OPERATION_DISPLAY, axis)))
            return int.from_bytes(data, "little", signed=True)
        return None

    @asynccontextmanager
    async def _commanding(self, mux: Mux, value: Value) -> AsyncIterator[None]:
        """Wrap a write. The drive counts as enabled from before the command on, and as disabled once it has confirmed that."""
        axis = self._controlwords.get(mux)
        if axis is None:
            yield
            return
        enables = enables_operation(value)
        if enables and not self.was_axis_enabled(axis):
            stops = self._stops_of(axis)
            await self.hold(axis)
            if self._stops_of(axis) != stops:  # behind that stop it would undo it
                raise self.error_of(self.remote.sdo.not_submitted(*place_of(mux)), f"writing {value!r} to")
        if enables:
            self._enabled_by_hand.add(axis)
        yield
        if not enables:
            self._enabled_by_hand.discard(axis)

    def _stops_of(self, axis: int) -> int:
        """Return how many stops of a drive have begun so far."""
        known = self.axes.get(axis)
        return self._drops + (0 if known is None else known.occupancy.stops_begun)

    @protected
    def drop_commands(self) -> None:
        """Let no controlword leave that waits: for its drive to watch over this master, or behind another transfer. Its write
        ends with SdoGivenUpError. Any stop does this for its own drive; this is for a drive that seems to need none."""
        self._drops += 1
        for key in self._controlwords:
            self.remote.drop_waiting(key, self.now())
        self._participant.pump.pump()

    def is_held(self, axis: int = 0) -> bool:
        """Return whether the drive on an axis of this node watches the heartbeat of this master; see watchdog.py."""
        return self._watchdogs.holds(self, axis)

    def _may_enable(self, axis: int) -> None:
        """Take hold of the drive beside the next frame, which may enable it and cannot wait."""
        settings = self._watchdogs.settings
        if settings is not None and settings.required and not self.is_held(axis):
            failed = f"{self.where} is not held, and Watchdog.required says that it must"
            raise NotHeldError(f"{failed}; try `await node.hold()` before")
        self._watchdogs.hold_beside(self, axis)

    def _on_written(self, report: SdoDownloaded) -> None:
        """Take hold of a drive that was enabled past `write`: by `remote.write`, or a procedure of the core."""
        axis = self._controlwords.get(mux(report.index, report.subindex))
        if axis is not None and self.was_axis_enabled(axis):
            self._watchdogs.hold_beside(self, axis)

    async def _upload(self, submit: Callable[[Time], RequestId]) -> SdoUploaded:
        outcome = await self.request(submit)
        if isinstance(outcome, SdoUploaded):
            return outcome
        assert isinstance(outcome, SdoAborted)
        raise self.error_of(outcome, "reading")

    def _unexpected(self, variable: Variable, uploaded: SdoUploaded, error: ValueRangeError) -> UnexpectedAnswerError:
        return UnexpectedAnswerError(
            UNEXPECTED_ANSWER,
            self.node_id,
            self.bus,
            f"node {self.node_id} answered reading {variable.label} with {counted(len(uploaded.data), 'byte')}",
            seen=str(error),
            cause="the device is not the one that the dictionary describes",
            tries=(
                f"await node.read_bytes(0x{variable.index:04X}, {variable.subindex})",
                f"canopen read {self.node_id} {variable.index:04X}:{variable.subindex:02X} -o FILE    (the bytes that it sent)",
            ),
        )

    async def _download(self, submit: Callable[[Time], RequestId], attempt: str) -> None:
        outcome = await self.request(submit)
        if not isinstance(outcome, SdoDownloaded):
            assert isinstance(outcome, SdoAborted)
            raise self.error_of(outcome, attempt)

    async def _first_of(self, events: Subscription[E], timeout: float, missed: str, cause: str, *, is_asked: bool = False) -> E:
        with current_loop().move_on_after(timeout):
            return await events.receive()
        failed = f"node {self.node_id} {missed} within {timeout:g} s"
        tries = ("a longer timeout",) if is_asked else ()
        known = missing_frame(self.network, self.remote, self.now(), cause, tries, pdo=False, is_asked=is_asked)
        raise NodeSilentError(NOT_HEARD, self.node_id, self.bus, failed, **known._asdict())


async def number_if_present(node: Node, index: int, subindex: int = 0) -> int | None:
    """Read an object as an unsigned number; return None if the device does not have it."""
    try:
        return int.from_bytes(await node.read_bytes(index, subindex), "little")
    except SdoRefusedError as refused:
        if refused.abort_code not in ABSENT:
            raise
        return None


def _time_of(patience: float | None) -> Time | None:
    """Return seconds as a time-out in ns."""
    return None if patience is None else max(MILLISECOND, nanoseconds("patience", patience))


def _check_place(index: object, subindex: object) -> tuple[int, int]:
    """Return the place of an object. Raises LocalProtocolError for what is no index or subindex."""
    if isinstance(index, int) and isinstance(subindex, int) and 0 <= index <= 0xFFFF and 0 <= subindex <= 0xFF:
        return index, subindex
    raise LocalProtocolError(f"object {index!r}:{subindex!r}: give an index of 0..0xFFFF and a subindex of 0..0xFF")
