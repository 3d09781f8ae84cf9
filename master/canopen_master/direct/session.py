"""`Session`: the manual's blocking API for scripts and notebooks. `canopen_master.direct` has one session's methods as functions.

One session has one connection: a trio master in a thread of its own (blocking/background.py), which serves every call. Any number
of threads may call, also at the same time. Give one drive one command at a time; `halt` may come at any time.

Three kinds of result:

- commands that take time (init_device, homing ...) return True or False, as the manual says; `last_error` says why it was False,
  to the thread that called;
- calls that only send, or ask for a value (send_sdo, send_pos, get_pos ...), raise SdoError, ProcedureError, BusError;
- a wrong call always raises, with nothing sent: NotConnectedError, LocalProtocolError (node-ID 200), ObjectNotFoundError,
  ConstantNotFoundError, ValueRangeError.

The direct half sends no SYNC by itself: `send_pos` gives a set-point, `send_sync` sends the rPDOs and SYNC. The master half sends
SYNC periodically, and has its chains in `chain_map`.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Final, TypeVar

from canopen_master.assembly import described
from canopen_master.blocking.loop_thread import LOOK_UP
from canopen_master.direct.chain import ChainCalls
from canopen_master.direct.connection import Connection
from canopen_master.direct.drive import COUNTS, DirectDrive, HandSync
from canopen_master.direct.hold_to_run import move_while_held
from canopen_master.direct.incoming import IncomingPdos
from canopen_master.machine_file import MachineFile, read_machine
from canopen_master.master import Master
from canopen_master.motion.chain import ChainSettings
from canopen_master.motion.chain_file import ChainDescription, parse_chains, read_chains
from canopen_master.node import Node
from canopen_master.seconds import nanoseconds
from canopen_master.simulation.host import patient_cycles
from canopen_proto.datatypes import Value
from canopen_proto.dictionary import Key, Message, ObjectDictionary
from canopen_proto.dictionary.model import did_you_mean
from canopen_proto.drives.axis import read_position
from canopen_proto.drives.axis.watchdog import DEFAULT_WATCHDOG, Watchdog
from canopen_proto.drives.cia402.states import State, state_of
from canopen_proto.machine import MILLISECOND, SECOND, LocalProtocolError
from canopen_proto.nmt import NmtCommand
from canopen_proto.pdo.consumer import PdoReceived
from canopen_transports.loop import current_loop
from canopen_transports.realtime import Realtime

R = TypeVar("R")

NMT_TIME: Final = 0.1
"""Seconds that init_nmt gives the devices to get to Operational: nothing confirms an NMT command."""
HOME_HERE: Final = 37
"""The homing method of CiA 402 that takes the present position as the home position."""
SYNC_INTERVAL: Final = 10
"""Milliseconds; the manual's."""


class Session:
    """See this module's text. Node-IDs are 1..127; positions are integers as on the wire, millidegrees for the manual's arm.

    incoming_pdos: the PDOs that devices sent (bounded). chain_map: the chains of `init_chain_map`, by name. using_master_thread:
    set it to True before `init_master_thread`. As a context manager it closes its connection at the end.
    """

    def __init__(self, *, rpdo: str = "schunk_default_rPDO", tpdo: str = "schunk_default_tPDO") -> None:
        """Make a session; opens nothing. rpdo, tpdo: names of the PDOs in PDOs.csv that the drives come with."""
        self.using_master_thread = False
        self.incoming_pdos = IncomingPdos()
        self.chain_map: dict[str, ChainCalls] = {}
        self._rpdo, self._tpdo = rpdo, tpdo
        self._connection = Connection()
        self._drives: dict[tuple[Node, int], DirectDrive] = {}  # of the open connection; used in the master's thread
        self._following: dict[int | str, DirectDrive] = {}  # those that enable_ip_mode was called for, by what it was given
        self._hand_sync: HandSync | None = None  # of the open connection
        self._chain_source: tuple[str | Path, str | None] = "", None
        self._chains: tuple[ChainDescription, ...] = ()
        self._queues_pdos = True
        self._sync_due = 0.0
        self._machine: MachineFile | None = None

    def __enter__(self) -> Session:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None) -> None:
        self.close_connection()

    # ---- connection ----

    def open_connection(
        self,
        bus: str = "",
        *,
        machine: MachineFile | str | Path | None = None,
        buses: Mapping[str, str] | None = None,
        sdo_timeout: float | None = None,
        dictionary: ObjectDictionary | None = None,
        watchdog: Watchdog | None = DEFAULT_WATCHDOG,
        realtime: Realtime | bool | None = None,
    ) -> bool:
        """Open a bus: "/dev/pcan32", "socketcan:can0", "pcan:PCAN_USBBUS1@500k", "virtual:demo". This is the first command.

        Returns False if it fails (`last_error` says why, and what to try), also while a connection is open. bus: the bus of the
        node-IDs. buses: more buses, by the names that a chain file gives them; a file's buses are opened by themselves if `bus`
        is one of them. sdo_timeout: seconds for one answer of a device, by default 0.5. dictionary: by default that of the data
        files. watchdog: how drives notice that this program is gone, and stop; see `open_master`. realtime: what
        to ask the operating system for, for the master's thread; see there.

        machine: a machine file, in place of `bus`. Its chains are in `chain_map`. Wherever a function takes a node-ID, it also
        takes the name of a joint or a node, and positions are in the unit of the joint. A node-ID means the bus of this name
        (`bus`), by default the first one. Raises DictionaryError with every error in the file.
        """
        if machine is not None:
            self._machine = read_machine(machine) if isinstance(machine, str | Path) else machine
            chains = [described(chain, self._machine) for chain in self._machine.chains.values()]
            self.chain_map.clear()
            self.chain_map.update({each.name: ChainCalls(self._connection, each, in_counts=False) for each in chains})
            first = bus or next(iter(self._machine.buses))
            return self._connection.open(
                first, buses or {}, sdo_timeout, dictionary, watchdog, self._prepare, self._machine, realtime
            )
        if not bus:
            raise LocalProtocolError('open_connection needs a bus ("/dev/pcan32"), or a machine file')
        self._machine = None
        named = dict.fromkeys(joint.bus for chain in self._chains for joint in chain.joints)
        more = {name: name for name in named if name != bus} if bus in named else {}
        return self._connection.open(
            bus, {**more, **(buses or {})}, sdo_timeout, dictionary, watchdog, self._prepare, realtime=realtime
        )

    def init_listener_thread(self) -> None:
        """Do nothing: `open_connection` has begun to listen. It is there for the manual's order of calls.

        PDOs of the devices go to `incoming_pdos`. Raises NotConnectedError.
        """
        self._call(_nothing)

    def close_connection(self) -> None:
        """Halt the drives, close the buses, end the thread. Does nothing without a connection.

        Raises HaltNotConfirmedError if a drive did not confirm that it stands; BusError for a bus that failed unnoticed.
        """
        self._connection.close()

    def last_error(self) -> Exception | None:
        """Return why the last call of this thread returned False; None after True. `str` of it is for people."""
        return self._connection.last_error

    def simulated(self, node_ids: Sequence[int], bus: str = "virtual") -> AbstractContextManager[None]:
        """`with session.simulated([12], bus="virtual:demo"):` puts simulated joints on a bus that is opened in the block.
        node_ids: one for each joint.

        They are joints of the Schunk Powerball arm, in this process. Leaving the block closes the connection.
        """
        return self._connection.simulated(node_ids, bus)

    # ---- network management and SYNC ----

    def init_nmt(self) -> None:
        """Start all devices (NMT, to Operational, where PDOs are exchanged). Waits NMT_TIME, since nothing confirms it."""

        async def start(master: Master) -> None:
            await master.nmt(NmtCommand.START)
            await current_loop().sleep(NMT_TIME)

        self._call(start)

    def send_nmt(self, command: str | NmtCommand, node: int | str = 0) -> None:
        """Send an NMT command to one device, or to all of them (0).

        command: a constant of the object NMT in constants.csv ("start_remote_node", "stop_remote_node", ...), or an NmtCommand.
        """

        async def send(master: Master) -> None:
            value = master.dictionary.constant_value("NMT", command) if isinstance(command, str) else command
            if value not in list(NmtCommand):
                raise LocalProtocolError(f"{command!r} is not an NMT command: 0x{value:02X}")
            if node == 0:
                await master.nmt(NmtCommand(value), bus=self._connection.bus)
            else:
                await self._node(master, node).nmt(NmtCommand(value))

        self._call(send)

    def send_sync(self, milliseconds: float = 0) -> None:
        """Send the rPDOs of `send_pos`, then one SYNC, then wait. While the master's own SYNC runs, only wait.

        In a loop it keeps time: the wait ends `milliseconds` after the end of the last one, so that the other work of the loop
        does not add to the period. A loop that was late goes on slowly: the next SYNC comes `milliseconds` after the late one (at
        most a twentieth earlier). If drives that follow may have gone too far meanwhile, they are asked where they are before
        SYNC is sent, and come back to the set-points of the script slowly; until they are there, no SYNC is early.
        """

        interval = round(milliseconds * MILLISECOND)

        async def send(master: Master) -> None:
            if not master.sync_period:
                assert self._hand_sync is not None
                await self._hand_sync.send(interval)

        self._call(send)
        now, wait = time.monotonic(), milliseconds / 1000
        due = self._sync_due + wait
        self._sync_due = due = due if now <= due <= now + wait else now + wait
        time.sleep(max(0.0, due - time.monotonic()))

    # ---- objects ----

    def send_sdo(self, node: int | str, key: Key, value: Value | None = None) -> Message:
        """Read an object, or with a value (or a constant's name) write it: `send_sdo(12, "controlword", "sm_shutdown")`. node:
        its node-ID, or its name. key: a name or a number, see `Key`.

        Once the device has answered, returns the value read or written, with the names of the constants that it bears. Raises
        SdoTimeoutError, SdoRefusedError, SdoGivenUpError (all SdoError), and the errors of wrong calls (see this module's text).
        A controlword that enables the drive may raise NodeIdTakenError or NotHeldError (both ProcedureError), with nothing
        written: the drive must watch over this program first; see `watchdog` of `open_connection`.
        """

        async def transfer(master: Master) -> Message:
            device = self._node(master, node)
            if value is None:
                return await device.read_message(key)
            await device.write(key, value)
            return device.dictionary.message(device.node_id, key, device.dictionary.value_from(key, value))

        return self._call(transfer)

    def define_pdo(self, node: int | str, name: str, *, number: int | None = None, transmission_type: int = 1) -> bool:
        """Declare a PDO of PDOs.csv to a device, and use it: a tPDO goes to `incoming_pdos`, an rPDO with a set-point is sent by
        `send_pos`. Returns False if the device refuses; it then has its old PDO again. name: in PDOs.csv.

        number: by default that of its COB-ID in the predefined connection set. transmission_type: 1 for each SYNC. The device is
        pre-operational meanwhile. Raises PdoNotFoundError.
        """

        async def define(master: Master) -> None:
            drive = self._drive(master, node)
            await drive.define(drive.node.dictionary.pdo(name), number, transmission_type)

        return self._connection.attempt(define)

    # ---- drives ----

    def fault_reset(self, node: int | str) -> bool:
        """Reset a fault; does nothing to a drive without one. Returns False if the fault stays."""
        return self._attempt(node, lambda drive: drive.reset_fault())

    def init_device(self, node: int | str) -> bool:
        """Lead the drive to Operation enabled, step by step. True when it reports that."""
        return self._attempt(node, lambda drive: drive.change_state(State.OPERATION_ENABLED))

    def homing(self, node: int | str) -> bool:
        """Home the drive; return when it has stopped. True if it is referenced. IT MOVES; an interrupt halts it."""
        return self._attempt(node, lambda drive: drive.home())

    def enable_ip_mode(self, node: int | str) -> bool:
        """Make the drive follow the set-points of `send_pos` from where it stands. Returns False if it lacks the mode."""

        async def follow(master: Master) -> None:
            drive = self._drive(master, node)
            await drive.follow()
            self._following[node] = drive

        return self._connection.attempt(follow)

    def send_pos(self, node: int | str, position: float) -> None:
        """Give the set-point of the next SYNC: `send_sync` sends the rPDO with it, and the drive is there one interval later.

        Where somebody else sends SYNC, the rPDO is sent at once.

        position: absolute, in millidegrees (the drive's counts). The rPDO also carries the controlword that was commanded last.
        Raises SetPointRefusedError, with nothing sent, for a position beyond the drive's limits (0x607D), or further from the
        last one than its speed limit allows in an interval (`set_sync_interval`; see `set_max_speed`). Raises LocalProtocolError
        before enable_ip_mode. A drive that does not follow is halted, and the next call raises: DriveInFaultError in fault,
        NodeSilentError if its PDOs no longer come, else ProcedureError. The error names our own SYNC first if that was late. If
        the drive is a joint of a chain, the master's next cycle sends the set-point; raises ChainFaultError and ChainHaltedError
        as the chain does.
        """

        drive = self._following.get(node)
        if drive is not None and self._connection.is_open and drive.give(position):
            return

        async def send(master: Master) -> None:
            await self._drive(master, node).send_position(position)

        self._call(send)

    def move_until_user_interrupt(self, node: int | str, speed: float, held: Callable[[], bool]) -> bool:
        """Move the drive as long as `held` says so, from where it stands: IT MOVES. True once it stands again.

        speed: in millidegrees (the drive's counts) per second; its sign is the direction. held: called again and again, in a
        thread of its own; it waits at most a tenth of a second and returns whether the user still wants the motion. The first
        True starts it; False, an error, Ctrl-C, or a `held` that hangs for longer than DEAD_MAN brake the drive. It accelerates
        and brakes within its limits, and rests before those of its position. In the end it is halted, and stays enabled. SYNC is
        sent meanwhile. Needs the extra `motion` (ruckig). Raises LocalProtocolError while the master's
        own SYNC runs.
        """
        return self._attempt(node, lambda drive: move_while_held(drive, speed, held))

    def interactive_homing(self, node: int | str, speed: float, held: Callable[[], bool], *, method: int = HOME_HERE) -> bool:
        """Move the drive as `move_until_user_interrupt` does; where it stands then becomes its home position. True if so. speed,
        held: as of `move_until_user_interrupt`.

        method: the homing method that takes the present position; 35 for older drives. Schunk's joints have no methods: they
        home in their own way, and MOVE AGAIN.
        """

        async def home(drive: DirectDrive) -> None:
            await move_while_held(drive, speed, held)
            await drive.home(method)

        return self._attempt(node, home)

    def get_pos(self, node: int | str) -> float:
        """Read the actual position (0x6064) from the drive. Raises ProcedureError."""

        async def ask(master: Master) -> float:
            position = await master.run(read_position(self._drive(master, node).axis))
            return round(position) if self._machine is None else position

        return self._call(ask)

    def drive_mode(self, node: int | str, mode: int | str) -> bool:
        """Select a mode of operation: a number, or a constant of modes_of_operation. True when the drive shows it."""

        async def select(master: Master) -> None:
            drive = self._drive(master, node)
            number = drive.node.dictionary.value_from("modes_of_operation", mode)
            assert isinstance(number, int)
            await drive.set_mode(number)

        return self._connection.attempt(select)

    def halt(self, node: int | str) -> bool:
        """Stop the drive, whatever another thread is doing with it. It stays enabled. New set-points need enable_ip_mode."""
        return self._attempt(node, lambda drive: drive.halt())

    def enable_brake(self, node: int | str) -> bool:
        """Lead the drive to Ready to switch on: no torque, the brake is engaged. The manual writes enableBreak."""
        return self._attempt(node, lambda drive: drive.change_state(State.READY_TO_SWITCH_ON))

    enable_break = enable_brake

    def release_brake(self, node: int | str) -> bool:
        """Lead the drive to Operation enabled again. The manual's library has it as releaseBreak."""
        return self.init_device(node)

    release_break = release_brake

    def shutdown_device(self, node: int | str) -> bool:
        """Take the drive's power away (Switch on disabled); then, even if that failed, stop its communication (NMT stop)."""

        async def shut_down(master: Master) -> None:
            drive = self._drive(master, node)
            try:
                await drive.shut_down()
            finally:
                with current_loop().cancel_scope(shield=True):
                    await drive.node.nmt(NmtCommand.STOP)

        return self._connection.attempt(shut_down)

    def set_sync_interval(self, node: int | str, milliseconds: int = SYNC_INTERVAL) -> bool:
        """Write the time between two SYNCs (0x60C2) to the drive, 1 to 255 ms; 10 ms if it is never written. node: its node-ID,
        or its name.

        If the drive has the manual's watch over the SYNC (0x200E), that is switched off: here the user sends the SYNC.
        """
        return self._attempt(node, lambda drive: drive.set_interval(milliseconds))

    def set_max_speed(self, node: int | str, counts_per_second: float) -> bool:
        """Allow set-points of `send_pos`, and of a chain, this fast; millidegrees per second for the manual's arm.
        counts_per_second: above 0.

        The default is the drive's own limit (0x607F, 0x6080), or 30 000 if it has none. Returns False if the drive does not
        answer. Raises LocalProtocolError unless the speed is above 0.
        """
        return self._attempt(node, lambda drive: drive.set_max_speed(counts_per_second))

    def wait_for_status(self, node: int | str, constant: str, timeout: float = 1.0) -> bool:
        """Wait until the statusword bears a constant, such as "operation_enable". Returns False after `timeout` seconds."""
        return self._attempt(node, lambda drive: drive.wait_for(constant, nanoseconds("timeout", timeout)))

    def set_motor_state(self, node: int | str, state: str) -> bool:
        """Lead the drive to a state, up or down, by the shortest way. state: a constant of statusword, such as "switched_on".
        Returns False if the drive did not get there."""

        async def lead(master: Master) -> None:
            drive = self._drive(master, node)
            await drive.change_state(state_of(drive.node.dictionary.constant("statusword", state).value))

        return self._connection.attempt(lead)

    # ---- the master half ----

    def init_chain_map(self, file: str | Path = "", *, text: str | None = None) -> None:
        """Read a chain file (a row: `chain1 joint1 /dev/pcan32 12`) into `chain_map`: name -> ChainCalls.

        file: a path, or the name of one of the data files. text: the content instead of a file. Raises ChainFileError with every
        problem, DataError if the file cannot be read. The chains take commands after `init_master_thread`.
        """
        self._chains = read_chains(file) if text is None else parse_chains(text)
        self._chain_source = file, text
        self.chain_map.clear()
        self.chain_map.update({chain.name: ChainCalls(self._connection, chain) for chain in self._chains})

    def init_incoming_pdo_processor_thread(self, handler: Callable[[PdoReceived], object] | None = None) -> None:
        """Process the devices' PDOs from now on: the chains' joints are kept up to date in any case.

        Without a handler `incoming_pdos` gets no more PDOs. A handler, such as the manual's `updateStatusWithIncomingPDO`, is
        called with each PDO, in a thread of its own that takes them from `incoming_pdos`. If it raises, the error is shown, and
        the thread goes on.
        """
        self._call(_nothing)
        self._queues_pdos = handler is not None
        if handler is not None:
            threading.Thread(target=self._process, args=(handler,), name="canopen incoming PDOs", daemon=True).start()

    def init_master_thread(self, sync_interval: int | None = None) -> None:
        """Begin the master's cycle: SYNC, then the PDOs of the chains that follow set-points, then SDO in the time left.

        sync_interval: milliseconds, by default 10; a machine file says it itself. From now on the chains of `chain_map` take
        commands. `using_master_thread` must be True.
        Raises ChainFileError if the chain file names buses that are not open.
        """
        if not self._uses_master_thread():
            raise LocalProtocolError("init_master_thread() needs using_master_thread = True")
        machine = self._machine
        if machine is not None and sync_interval is not None:
            raise LocalProtocolError(f"{machine.source} says the cycle: init_master_thread() takes no interval")
        interval = SYNC_INTERVAL if sync_interval is None else sync_interval
        cycle_time = interval / 1000 if machine is None else machine.master.cycle / SECOND
        settings = ChainSettings(cycle_time=cycle_time, rpdo=self._rpdo, tpdo=self._tpdo)
        if self._connection.is_simulated:
            settings = replace(settings, max_missed_cycles=patient_cycles(cycle_time))

        async def begin(master: Master) -> None:
            if master.sync_period:
                raise LocalProtocolError("the master's cycle runs already")
            if self._chains and machine is None:
                file, text = self._chain_source
                master.load_chains(file, text=text, settings=settings, axes=COUNTS)
            master.sync_start(settings.cycle_time)

        self._call(begin)

    def _uses_master_thread(self) -> bool:
        return self.using_master_thread

    def _call(self, function: Callable[[Master], Awaitable[R]]) -> R:
        return self._connection.call(function)

    def _attempt(self, node: int | str, function: Callable[[DirectDrive], Awaitable[None]]) -> bool:
        return self._connection.attempt(lambda master: function(self._drive(master, node)))

    def _prepare(self, master: Master) -> None:
        """Prepare for a connection that was just opened. Called in the master's thread."""
        self._drives = {}
        self._following = {}
        self._hand_sync = HandSync(master)
        self._queues_pdos = True
        self.incoming_pdos.clear()
        master.watch((PdoReceived,), self._on_pdo)

    def _node(self, master: Master, node: int | str) -> Node:
        """Return the node with a node-ID, or of a joint or a node of the machine file."""
        if isinstance(node, str) and self._machine is not None:
            if node in master.joints:
                return master.joints[node].node
            if node not in master.nodes:
                known = {**master.joints, **master.nodes}
                raise LocalProtocolError(f"{self._machine.source} has no joint or node {node!r}{did_you_mean(node, known)}")
            return master.nodes[node]
        if not isinstance(node, int):  # an argument of the command line is a text
            raise LocalProtocolError(f"{node!r} is not a node-ID: it must be an int")
        return master.node(node, bus=self._connection.bus)

    def _drive(self, master: Master, node_id: int | str) -> DirectDrive:
        node = self._node(master, node_id)
        named = master.joints.get(node_id) if isinstance(node_id, str) else None
        axis = 0 if named is None else named.axis.number
        drive = self._drives.get((node, axis))
        if drive is None:
            device = master.devices.get((node, axis))
            in_counts = self._machine is None or device is None
            if device is None:
                device = master.device(node, settings=COUNTS)
            drive = self._drives[node, axis] = DirectDrive(master, device, self._rpdo, self._tpdo, in_counts, self._hand_sync)
        return drive

    def _on_pdo(self, report: PdoReceived) -> None:
        if self._queues_pdos:
            self.incoming_pdos.put(report)

    def _process(self, handler: Callable[[PdoReceived], object]) -> None:
        connection = self._connection
        while connection.is_open:
            pdo = self.incoming_pdos.get(LOOK_UP)
            if pdo is not None:
                try:
                    handler(pdo)
                except Exception:  # noqa: BLE001 - the user's code; the next PDO may do better
                    threading.excepthook(threading.ExceptHookArgs((*sys.exc_info(), threading.current_thread())))


async def _nothing(master: Master) -> None:
    master.check_open()
