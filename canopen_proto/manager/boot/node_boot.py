"""The boot-up of one node by the NMT master: is it there, is it the right one, is it configured, does it show signs of life?

    step              fails with
    assignment        A   the node is not in the network list. A node that the master is not to boot: only error control follows
    device type       B   0x1000 is not answered. C: it is another one. A node that answers, and has not followed a reset, gets it
                      again
    identity          D, M, N, O   0x1018:01 to :04, as far as they are expected
    NMT state         E, F   only for a node that is kept alive: no heartbeat, or no answer to guarding. If it is Operational,
                      only error control follows (outcome L); else it is reset, and its boot-up awaited
    software          G, H, I   0x1F56:01 against the expected one (older: 0x1F52); an update, if allowed, then all again
    configuration     J   unless 0x1020 shows the expected date: restore the defaults, write, store
    error control     K   one heartbeat within the consumer time, or one answer to guarding; from then on the node is watched.
                      Without a consumer time and guarding, 0x1017 is read: a node that sends heartbeats is watched by that time

Nothing is sent to start the node: that is decided for the whole network (network_boot.py).

**Everything ends.** A read that is not answered is sent TRIES times; a write once, since it may have been executed. The node is
not watched meanwhile, so that a slow one is not taken for lost.

**A boot-up in the middle**, which nobody asked for, means that the node has lost its settings: its boot-up begins again, at most
MAX_RESTARTS times.

Source: CiA 302-2 v4.1.0, boot NMT slave (figures 4 to 6, 8 and 11), as Lely core's master (nmt_boot.c) cites and follows it: the
steps and letters are the same. The order of requests is that of this master, as recorded.

`NmtCommands` sends NMT commands with a pause between them: object 0x102A of a master, the NMT inhibit time (CiA 302-2, as Lely
has it).
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Final, TypeAlias

from canopen_proto import indices
from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.heartbeat import HeartbeatReceived, NodeBooted
from canopen_proto.machine import MILLISECOND, NEVER, SECOND, Event, LocalProtocolError, Time
from canopen_proto.manager.boot.entry import CONSUMER_FACTOR, BootEntry
from canopen_proto.manager.boot.outcome import BootLetter, BootOutcome, BootStep, Shown
from canopen_proto.manager.parameters.restore import STORE_TIMEOUT
from canopen_proto.manager.programs.identity import ProgramControl
from canopen_proto.nmt import NmtCommand, NmtMaster, NmtState
from canopen_proto.parameter_storage import SIGNATURES
from canopen_proto.procedures.steps import (
    NOT_CONFIRMED,
    Procedure,
    ProcedureError,
    SdoTransferError,
    Wait,
    act,
    current_time,
    download,
    sleep,
    upload,
)
from canopen_proto.remote_node import RemoteNode


class NmtCommands:
    """Sends the NMT commands of procedures that run side by side, with a pause between two of them.

    pause: ns, 0 for none.
    """

    def __init__(self, nmt: NmtMaster, pause: Time = 0) -> None:
        if pause < 0:
            raise LocalProtocolError(f"the pause between NMT commands is {pause} ns, less than 0")
        self.nmt = nmt
        self.pause = pause
        self._free_at: Time = -NEVER

    def send(self, command: NmtCommand, node_id: int, condition: Callable[[], bool] = lambda: True) -> Procedure[bool]:
        """Send a command to a node, or to all (0), when the pause since the one before is over.

        condition: asked right before; if it does not hold any more, nothing is sent. Returns whether the command was sent.
        """
        yield from self.wait()
        return (yield from act(lambda now: self._send_now(command, node_id, condition, now)))

    def wait(self) -> Procedure[None]:
        """Wait until the pause is over."""
        while left := (yield from act(self._time_left)):
            yield from sleep(left)

    def _time_left(self, now: Time) -> Time:
        return max(self._free_at - now, 0)

    def _send_now(self, command: NmtCommand, node_id: int, condition: Callable[[], bool], now: Time) -> bool:
        if not condition():
            return False
        self.nmt.send(command, node_id, now)
        self._free_at = now + self.pause
        return True


TRIES: Final = 4
"""How often a read is sent that is not answered."""
MAX_RESTARTS: Final = 3
"""How often a node may boot in the middle of its boot-up: a node that resets over and over has to be reported."""
RESTORE_COMMUNICATION: Final = 2
"""Subindex of 0x1011: only communication parameters are restored, so that a reset of the communication is enough."""
PERIOD_SIZE: Final = 2
"""Bytes of 0x1017."""
MAX_NUMBER: Final = 8
"""Bytes of the longest answer that is taken for a number."""

NodeHook: TypeAlias = Callable[[RemoteNode, BootEntry], Procedure[None]]
"""A procedure for one node that the caller supplies; it raises ProcedureError or LocalProtocolError if it fails."""


@dataclass(frozen=True, slots=True)
class BootTimes:
    """How long a boot-up waits, ns.

    first_answer: for the answer to the first read, each of TRIES times; other requests have the time of the node's SDO client.
    pause: before a silent node is asked again. boot_up: for the boot-up after a reset. guarding: for the answer to the first
    guarding request to a node that is kept alive.
    """

    first_answer: Time = 100 * MILLISECOND
    pause: Time = 1 * SECOND
    boot_up: Time = 2 * SECOND
    guarding: Time = 100 * MILLISECOND


DEFAULT_TIMES: Final = BootTimes()


def boot_node(
    node: RemoteNode,
    commands: NmtCommands,
    entry: BootEntry,
    *,
    times: BootTimes = DEFAULT_TIMES,
    until: Time = 0,
    update: NodeHook | None = None,
    configure: NodeHook | None = None,
    unconfirmed: NmtCommand | None = None,
) -> Procedure[BootOutcome]:
    """Boot a node; return how that ended. It is never started here. Faults of the node are outcomes: nothing is raised for them,
    nor for a full queue of its SDO client.

    until: the driver's time to which a silent node is asked again, once a second (`times.pause`) or when it boots; 0: it is asked
    once. update: replaces the node's program; without it, another program is outcome I. configure: runs after the configuration
    of the entry. unconfirmed: a reset that the node was sent, and after which no boot-up came: if it answers, it gets it again.
    """
    boot = _NodeBoot(node, commands, entry, times, until, update, configure, unconfirmed)
    return (yield from boot.run())


def watch_by(node: RemoteNode, period: bytes, now: Time) -> Time:
    """Watch the heartbeats of a node by its producer heartbeat time (0x1017, as it was read), from now on. period: the two bytes
    of 0x1017, ms.

    Returns the consumer time, ns; 0: it sends none. The node is known to send them, so the first one is awaited too.
    The time is no entry of 0x1016, so it may be longer than one could hold.
    """
    known = int.from_bytes(period, "little") * MILLISECOND if len(period) == PERIOD_SIZE else 0
    timeout = CONSUMER_FACTOR * known
    if timeout:
        node.heartbeat.set_timeout(timeout, now, begun=True)
    return timeout


class _Ended(Exception):
    """The boot-up ends so. Fields: those of BootOutcome."""

    def __init__(
        self,
        letter: BootLetter,
        place: tuple[int, int] | None = None,
        expected: Shown = None,
        found: Shown = None,
        *,
        abort_code: int | None = None,
        remark: str = "",
    ) -> None:
        self.letter = letter
        self.place = place
        self.expected = expected
        self.found = found
        self.abort_code = abort_code
        self.remark = remark


class _BootedAgain(Exception):
    """The node has booted, and nobody has asked it to."""


class _NodeBoot:
    """A boot-up under way. boots: the node's count of boot-ups that are not news. first_boots: that at the beginning."""

    def __init__(
        self,
        node: RemoteNode,
        commands: NmtCommands,
        entry: BootEntry,
        times: BootTimes,
        until: Time,
        update: NodeHook | None,
        configure: NodeHook | None,
        unconfirmed: NmtCommand | None,
    ) -> None:
        self.node = node
        self.commands = commands
        self.entry = entry
        self.assignment = entry.assignment
        self.times = times
        self.until = until
        self.update = update
        self.configure = configure
        self.unconfirmed = unconfirmed
        self.first_boots = node.boots
        self.boots = 0
        self.step = BootStep.ASSIGNMENT
        self.is_updated = False

    def run(self) -> Procedure[BootOutcome]:
        begun = yield from current_time()
        ended = yield from self._to_the_end()
        elapsed = (yield from current_time()) - begun
        seen = ended.place, ended.expected, ended.found, ended.abort_code
        return BootOutcome(self.node.node_id, ended.letter, self.step, *seen, elapsed, ended.remark)

    def _to_the_end(self) -> Procedure[_Ended]:
        """Go through the steps, again if the node boots meanwhile; return how that ended."""
        for _ in range(1 + MAX_RESTARTS):
            try:
                yield from self._steps()
            except _Ended as ended:
                return ended
            except _BootedAgain:
                continue
            except LocalProtocolError as refused:  # such as by the node's SDO client, whose queue others have filled
                return _Ended(_LETTER_OF_STEP[self.step], remark=str(refused))
        return _Ended(_LETTER_OF_STEP[self.step], remark=f"it booted {1 + MAX_RESTARTS} times in the middle of its boot-up")

    def _steps(self) -> Procedure[None]:
        """Go through all steps. Raises _Ended, or _BootedAgain."""
        self.boots = self.node.boots
        self.step = BootStep.ASSIGNMENT
        if not self.assignment.is_listed:
            raise _Ended(BootLetter.NOT_LISTED)
        yield from act(self._stop_watching)
        if not self.assignment.boots:
            yield from self._error_control()
            raise _Ended(BootLetter.READY, remark="not checked: 0x1F81 bit 2 leaves it to the application")
        yield from self._check_device_type()
        if self.unconfirmed is not None and self.node.boots == self.first_boots:
            yield from self._reset_again(self.unconfirmed)
        yield from self._check_identity()
        if self.assignment.keep_alive and (yield from self._is_operational()):
            yield from self._error_control()
            self._check_boots()
            raise _Ended(BootLetter.RUNNING)
        if self.assignment.check_software and (yield from self._replace_software()):
            yield from self._check_device_type()
            yield from self._check_identity()
            yield from self._replace_software()
        yield from self._configure()
        yield from self._error_control()
        self._check_boots()
        raise _Ended(BootLetter.READY)

    # ---- the steps ----

    def _check_device_type(self) -> Procedure[None]:
        self.step = BootStep.DEVICE_TYPE
        expected, found = self.entry.device_type, _number((yield from self._first_read()))
        if expected is not None and found != expected:
            raise _Ended(BootLetter.DEVICE_TYPE, (indices.DEVICE_TYPE, 0), expected, found)

    def _reset_again(self, command: NmtCommand) -> Procedure[None]:
        """Reset a node that may run as before: the command may have been lost. One that sends no boot-up is booted, too."""
        self.unconfirmed = None
        yield from self.commands.send(command, self.node.node_id)
        yield from self._wait(self.times.boot_up, (NodeBooted,))
        self.boots = self.node.boots
        yield from self._check_device_type()

    def _check_identity(self) -> Procedure[None]:
        self.step = BootStep.IDENTITY
        letters = BootLetter.VENDOR, BootLetter.PRODUCT, BootLetter.REVISION, BootLetter.SERIAL_NUMBER
        for subindex, (letter, expected) in enumerate(zip(letters, self.entry.identity, strict=True), start=1):
            if expected is not None:
                found = _number((yield from self._read(indices.IDENTITY_OBJECT, subindex, letter, expected)))
                if found != expected:
                    raise _Ended(letter, (indices.IDENTITY_OBJECT, subindex), expected, found)

    def _is_operational(self) -> Procedure[bool]:
        """Return whether a node that is kept alive is Operational. If it is in another state, it is reset, and has booted."""
        self.step = BootStep.STATE
        if self.entry.consumer_time:
            heard = yield from self._sign_of_life(self.entry.consumer_time)
            letter = BootLetter.NO_HEARTBEAT
        else:
            yield from act(lambda now: self.node.start_guarding(10 * self.times.guarding, 1, now))
            heard = yield from self._sign_of_life(self.times.guarding)
            yield from act(lambda now: self.node.stop_guarding())
            letter = BootLetter.NO_GUARDING
        if heard is None:
            raise _Ended(letter)
        if heard is NmtState.OPERATIONAL:
            return True
        yield from self._reset(NmtCommand.RESET_COMMUNICATION, BootLetter.SILENT)
        return False

    def _replace_software(self) -> Procedure[bool]:
        """Return False if the node has the expected program, and True if it was replaced."""
        self.step = BootStep.SOFTWARE
        if not self.entry.program:
            remark = "the master has no expected software identification (0x1F55), nor a date (0x1F53, 0x1F54)"
            raise _Ended(BootLetter.NO_PROGRAM, remark=remark)
        for index, subindex, expected in self.entry.program:
            place = index, subindex
            found = _number((yield from self._read(*place, BootLetter.NO_PROGRAM, expected)))
            if found != expected:
                break
        if found == expected:
            if not (yield from self._is_left_stopped()):
                return False
        elif self.is_updated:
            raise _Ended(BootLetter.UPDATE_FAILED, place, expected, found, remark="still so after the update")
        elif not self._may_update:
            why = "it is kept alive" if self.assignment.keep_alive else "0x1F81 bit 6 is not set"
            raise _Ended(BootLetter.OTHER_PROGRAM, place, expected, found, remark=why)
        if self.update is None:
            raise _Ended(BootLetter.UPDATE_FAILED, place, expected, found, remark="the master has no program for it")
        try:
            yield from self.update(self.node, self.entry)
        except (ProcedureError, LocalProtocolError) as failed:
            raise _Ended(BootLetter.UPDATE_FAILED, place, expected, found, remark=str(failed)) from failed
        self.is_updated = True
        self.boots = self.node.boots  # a node that starts another program boots
        return True

    @property
    def _may_update(self) -> bool:
        return self.assignment.update_software and not self.assignment.keep_alive

    def _is_left_stopped(self) -> Procedure[bool]:
        """Return whether an update has left the right program stopped: it broke off before the start, and is to go on there."""
        if self.update is None or self.is_updated or not self._may_update:
            return False
        try:
            return _number((yield from self._upload(indices.PROGRAM_CONTROL, 1))) == ProgramControl.STOP
        except SdoTransferError:
            return False

    def _configure(self) -> Procedure[None]:
        self.step = BootStep.CONFIGURATION
        entry = self.entry
        shown = (yield from self._read_date()) if entry.date is not None else None
        if shown is not None and shown == entry.date:
            return
        if self.assignment.restore and entry.restore_subindex:
            yield from self._restore(entry.restore_subindex)
        for index, subindex, data in entry.configuration:
            yield from self._write(index, subindex, data)
        if self.configure is not None:
            try:
                yield from self.configure(self.node, entry)
            except (ProcedureError, LocalProtocolError) as failed:
                raise _Ended(BootLetter.NOT_CONFIGURED, remark=str(failed)) from failed
            self._check_boots()
        if (
            entry.date is not None
            and shown is not None
            and all(index != indices.VERIFY_CONFIGURATION for index, *_ in entry.configuration)
        ):
            for subindex, number in enumerate(entry.date, start=1):
                yield from self._write(indices.VERIFY_CONFIGURATION, subindex, number.to_bytes(4, "little"))
        if entry.save:
            yield from self._write(indices.STORE_PARAMETERS, 1, SIGNATURES[indices.STORE_PARAMETERS].to_bytes(4, "little"))

    def _read_date(self) -> Procedure[tuple[Shown, Shown] | None]:
        """Return the date and time of the configuration that the node has; None if it refuses to say."""
        try:
            date = yield from self._read(indices.VERIFY_CONFIGURATION, 1, BootLetter.NOT_CONFIGURED)
            time = yield from self._read(indices.VERIFY_CONFIGURATION, 2, BootLetter.NOT_CONFIGURED)
        except _Ended as ended:
            if ended.abort_code == AbortCode.TIMED_OUT:
                raise
            return None
        return _number(date), _number(time)

    def _restore(self, subindex: int) -> Procedure[None]:
        load = SIGNATURES[indices.RESTORE_DEFAULT_PARAMETERS].to_bytes(4, "little")
        yield from self._write(indices.RESTORE_DEFAULT_PARAMETERS, subindex, load)
        is_communication = subindex == RESTORE_COMMUNICATION
        command = NmtCommand.RESET_COMMUNICATION if is_communication else NmtCommand.RESET_NODE
        yield from self._reset(command, BootLetter.NOT_CONFIGURED, (indices.RESTORE_DEFAULT_PARAMETERS, subindex))

    def _error_control(self) -> Procedure[None]:
        """See that the node shows a sign of life, and watch it from then on."""
        self.step = BootStep.ERROR_CONTROL
        entry, assignment = self.entry, self.assignment
        if entry.consumer_time:
            if (yield from self._sign_of_life(entry.consumer_time)) is None:
                waited = f"no heartbeat came within its consumer time of {entry.consumer_time / MILLISECOND:g} ms"
                raise _Ended(BootLetter.NO_ERROR_CONTROL, (indices.PRODUCER_HEARTBEAT_TIME, 0), remark=waited)
            yield from act(lambda now: self.node.heartbeat.set_timeout(entry.consumer_time, now))
        elif assignment.guards:
            life_time = assignment.guard_time * assignment.retry_factor
            yield from act(lambda now: self.node.start_guarding(assignment.guard_time, assignment.retry_factor, now))
            if (yield from self._sign_of_life(life_time)) is None:
                yield from act(self._stop_watching)
                waited = f"no answer to guarding came within its life time of {life_time / MILLISECOND:g} ms"
                raise _Ended(BootLetter.NO_ERROR_CONTROL, remark=waited)
        elif entry.learns:
            try:
                period = yield from self._read(indices.PRODUCER_HEARTBEAT_TIME, 0, BootLetter.NO_ERROR_CONTROL)
            except _Ended:  # it has none, or does not say so
                return
            yield from act(lambda now: watch_by(self.node, period, now))

    # ---- parts of the steps ----

    def _stop_watching(self, now: Time) -> None:
        self.node.heartbeat.set_timeout(0, now)
        self.node.stop_guarding()

    def _sign_of_life(self, timeout: Time) -> Procedure[NmtState | None]:
        """Return the state in the next heartbeat, or answer to guarding; None if none comes in time."""
        heard = yield from self._wait(timeout, (HeartbeatReceived, NodeBooted))
        if isinstance(heard, NodeBooted):
            raise _BootedAgain
        return heard.state if isinstance(heard, HeartbeatReceived) else None

    def _reset(self, command: NmtCommand, letter: BootLetter, place: tuple[int, int] | None = None) -> Procedure[None]:
        """Reset the node, and wait for its boot-up."""
        yield from self.commands.send(command, self.node.node_id)
        if (yield from self._wait(self.times.boot_up, (NodeBooted,))) is None:
            words = "reset node" if command is NmtCommand.RESET_NODE else "reset communication"
            remark = f"no boot-up came within {self.times.boot_up / SECOND:g} s after {words}"
            raise _Ended(letter, place, remark=remark)
        self.boots = self.node.boots

    def _wait(self, timeout: Time, kinds: Collection[type[Event]]) -> Procedure[Event | None]:
        """Wait for an event of the node."""
        node_id = self.node.node_id
        event: Event | None = yield Wait(timeout, self.node, lambda event: event.node_id == node_id, kinds)
        return event

    def _first_read(self) -> Procedure[bytes]:
        """Read the device type of a node that may not be there: TRIES times, or again and again until `until`."""
        now = yield from current_time()
        is_limited = now < self.until
        attempts = 0
        while True:
            attempts += 1
            timeout = min(self.times.first_answer, self.until - now) if is_limited else self.times.first_answer
            try:
                return (yield from self._upload(indices.DEVICE_TYPE, 0, timeout))
            except SdoTransferError as failed:
                if failed.origin is not AbortOrigin.TIMEOUT or (attempts == TRIES and not is_limited):
                    raise self._failed(BootLetter.SILENT, failed) from failed
                now = yield from current_time()
                if is_limited and attempts % TRIES == 0 and now < self.until:
                    yield from self._wait(min(self.times.pause, self.until - now), (NodeBooted,))
                    self.boots = self.node.boots
                    now = yield from current_time()
                if is_limited and now >= self.until:
                    raise self._failed(BootLetter.SILENT, failed) from failed

    def _read(self, index: int, subindex: int, letter: BootLetter, expected: Shown = None) -> Procedure[bytes]:
        """Read an object that the node has to have, TRIES times if it is not answered."""
        attempts = 0
        while True:
            attempts += 1
            try:
                return (yield from self._upload(index, subindex))
            except SdoTransferError as failed:
                if failed.origin is not AbortOrigin.TIMEOUT or attempts == TRIES:
                    raise self._failed(letter, failed, expected) from failed

    def _upload(self, index: int, subindex: int, timeout: Time = 0) -> Procedure[bytes]:
        """Read an object once. Raises SdoTransferError, _BootedAgain.

        timeout: ns for the answer instead of the client's own. A late answer then counts for the next try: a constant is read.
        """
        sdo = self.node.sdo
        before = sdo.timeout, sdo.late_guard
        if timeout:
            sdo.timeout, sdo.late_guard = timeout, 0
        try:
            data = yield from upload(sdo, index, subindex)
        except SdoTransferError:
            self._check_boots()
            raise
        finally:
            sdo.timeout, sdo.late_guard = before
        self._check_boots()
        return data

    def _write(self, index: int, subindex: int, data: bytes) -> Procedure[None]:
        sdo = self.node.sdo
        before = sdo.timeout
        if index in SIGNATURES:
            sdo.timeout = max(before, STORE_TIMEOUT)
        try:
            yield from download(sdo, index, subindex, data, block="auto")
        except SdoTransferError as failed:
            self._check_boots()
            raise self._failed(BootLetter.NOT_CONFIGURED, failed, _number(data)) from failed
        finally:
            sdo.timeout = before
        self._check_boots()

    def _check_boots(self) -> None:
        if self.node.boots != self.boots:
            raise _BootedAgain

    def _failed(self, letter: BootLetter, failed: SdoTransferError, expected: Shown = None) -> _Ended:
        """Return the end of the boot-up by an SDO transfer that failed."""
        remark = ""
        if failed.origin is AbortOrigin.TIMEOUT:
            remark = "no answer" + (NOT_CONFIRMED if failed.not_confirmed else "")
            if self.node.nmt_state is NmtState.STOPPED:
                remark += "; the node is Stopped, and has no SDO in this state"
        return _Ended(letter, (failed.index, failed.subindex), expected, abort_code=failed.abort_code, remark=remark)


_LETTER_OF_STEP: Final = {
    BootStep.ASSIGNMENT: BootLetter.SILENT,
    BootStep.DEVICE_TYPE: BootLetter.SILENT,
    BootStep.IDENTITY: BootLetter.SILENT,
    BootStep.STATE: BootLetter.SILENT,
    BootStep.SOFTWARE: BootLetter.NO_PROGRAM,
    BootStep.CONFIGURATION: BootLetter.NOT_CONFIGURED,
    BootStep.ERROR_CONTROL: BootLetter.NO_ERROR_CONTROL,
}
"""The outcome if a node boots in a step over and over, or if our own side refuses a request of the step."""


def _number(data: bytes) -> Shown:
    """Return data as a number, little-endian; long ones in words."""
    return int.from_bytes(data, "little") if len(data) <= MAX_NUMBER else f"{len(data)} bytes"
