"""`Bench`: one device under test, and the tools with which cases test it.

The device is given by its node-ID and its object dictionary, which says what it should have. A case takes everything from the
dictionary, so that the cases serve any device on any bus. After a reset an object holds its default, or the value that a DCF
configures: an EDS describes a type of device, a DCF one device as it is commissioned.

The bench is a participant of its own. It uses SDO (`read`, `write` ...), NMT, and frames made by hand (`send`, `ask`), which no
well-behaved machine would send.

No bus can change a device's inputs. If a case needs that, it calls `stimulus`, a function of the caller of the test; without one,
these cases check the rest.

Times: a device has ANSWER_TIME for an answer, BOOT_TIME for a restart, REACTION_TIME for a command without an answer. Periods may
be wrong by PERIOD_TOLERANCE on average. The standard gives no figures; these are those of a patient master.

Our own process may be late too, on a loaded computer. All waiting goes through `Bench.sleep` and `Bench.next_frame`, which
measure that (`lateness`). A failure of timing that our lateness may explain does not count as a failure (`Case.run`)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, TypeAlias, TypeVar

from canopen_check.expectations import Notes, NotInTimeError, TimingError
from canopen_check.probe import Bystander, FrameHeard, RawProbe
from canopen_data.description import DeviceDescription
from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.datatypes import Value, ValueRangeError
from canopen_proto.dictionary import ObjectDictionary, Variable
from canopen_proto.frame import (
    COB_ID_INVALID,
    EMCY,
    ERROR_CONTROL,
    REMOTE,
    SDO_CLIENT_TO_SERVER,
    SDO_SERVER_TO_CLIENT,
    SYNC,
    Frame,
    RoutingKey,
    frame_for_key,
    key_of_cob_id,
)
from canopen_proto.indices import (
    COB_ID_EMERGENCY,
    COB_ID_SYNC,
    COMMUNICATION_CYCLE_PERIOD,
    GUARD_TIME,
    INHIBIT_TIME_EMERGENCY,
    PRODUCER_HEARTBEAT_TIME,
)
from canopen_proto.machine import MICROSECOND, MILLISECOND, SECOND, Time, check_node_id
from canopen_proto.multiplexer import Mux
from canopen_proto.network import Network
from canopen_proto.nmt import STATE_OF_BYTE, NmtCommand, NmtMaster, NmtState
from canopen_proto.procedures.steps import (
    Procedure,
    SdoTransferError,
    StepTimeoutError,
    act,
    current_time,
    download,
    sleep,
    upload,
    wait_for_event,
)
from canopen_proto.sdo.client import SdoClient
from canopen_proto.verdict import ViolationError, does_not_apply, expect, expect_equal

ANSWER_TIME: Final = 1 * SECOND
BOOT_TIME: Final = 5 * SECOND
REACTION_TIME: Final = 100 * MILLISECOND
PERIOD_TOLERANCE: Final = 0.1

SLICE: Final = 50 * MILLISECOND
"""Waits are cut into slices of this length, to measure how late our process is."""

SYNC_PRODUCER: Final = 1 << 30
"""The bit of 0x1005 for "the device sends SYNC"."""

SUPERVISION_PERIOD: Final = 100 * MILLISECOND
"""The heartbeat by which the bench sees the device's NMT state."""

T = TypeVar("T")

Stimulus: TypeAlias = Callable[[Variable, Time], bool]
"""Makes the device change the value of a process object, now. Returns whether that could be done."""


class Bench:
    """One device under test; see this module's text.

    node_id, dictionary, description: of the device. probe, sdo, nmt: the machines that talk to it. bystander: hears who else is
    on the bus. notes: the findings of the present case. lateness: the most, in ns, that our own process was late since the case
    began. wrong_defaults: what the cases so far have read instead of an object's default, and named, by mux.
    """

    def __init__(
        self,
        network: Network,
        node_id: int,
        dictionary: ObjectDictionary,
        *,
        description: DeviceDescription | None = None,
        stimulus: Stimulus | None = None,
        strict: bool = False,
    ) -> None:
        """Test a device. network: on its bus; nobody else should use the device's SDO channel meanwhile. node_id: 1..127.

        description: the device's file, from which the dictionary comes; None: there is no file to check. strict: ask for more
        than CiA's own tool does.
        """
        self.node_id = check_node_id(node_id)
        self.dictionary = dictionary
        self.description = description
        self.stimulus = stimulus
        self.notes = Notes(strict=strict)
        self.lateness: Time = 0
        self.wrong_defaults: dict[Mux, bytes] = {}
        self.probe = RawProbe(network.out)
        self.sdo = SdoClient(network.out, node_id, timeout=ANSWER_TIME)
        self.nmt = NmtMaster(network.out)
        self.bystander = Bystander(network.out, node_id)
        for machine in (self.probe, self.sdo, self.nmt, self.bystander):
            network.attach(machine)

    @property
    def strict(self) -> bool:
        """Whether the test asks for more than CiA's own tool does."""
        return self.notes.strict

    # ---- CAN-IDs and the dictionary ----

    @property
    def request_key(self) -> RoutingKey:
        """The CAN-ID of SDO requests to the device."""
        return RoutingKey(SDO_CLIENT_TO_SERVER + self.node_id)

    @property
    def response_key(self) -> RoutingKey:
        """The CAN-ID of its answers."""
        return RoutingKey(SDO_SERVER_TO_CLIENT + self.node_id)

    @property
    def error_control_key(self) -> RoutingKey:
        """The CAN-ID of its boot-up, heartbeat and guarding."""
        return RoutingKey(ERROR_CONTROL + self.node_id)

    @property
    def emcy_key(self) -> RoutingKey:
        """The CAN-ID of its emergencies after a reset; the predefined one if the dictionary has none."""
        return key_of_cob_id(self.default(COB_ID_EMERGENCY)) or RoutingKey(EMCY + self.node_id)

    @property
    def sync_key(self) -> RoutingKey:
        """The CAN-ID of SYNC after a reset; the predefined one if the dictionary has none."""
        return key_of_cob_id(self.default(COB_ID_SYNC)) or SYNC

    def default(self, index: int, subindex: int = 0) -> int:
        """Return the unsigned number that an object holds after a reset; 0 if the dictionary has none."""
        variable = self.dictionary.get(index, subindex)
        value = 0 if variable is None else variable.initial_of(self.node_id)
        return max(value, 0) if isinstance(value, int) else 0

    def content_of(self, variable: Variable) -> bytes | None:
        """Return the bytes that an object holds after a reset; None if the dictionary does not tell.

        The dictionary does not tell if the value does not fit the object's type, or if a DCF gives an object that no master can
        write another value than the default: that value was once read from a device.
        """
        value = variable.default if variable.configured is None else variable.configured
        if value is None or (not variable.access.writable and value != variable.default):
            return None
        return _encoded(variable, variable.initial_of(self.node_id))

    def restored_content_of(self, variable: Variable) -> bytes | None:
        """Return the bytes that an object holds after its default was restored; None if the dictionary does not tell."""
        return None if variable.default is None else _encoded(variable, variable.default_of(self.node_id))

    def variable(self, index: int, subindex: int = 0) -> Variable:
        """Return the dictionary's variable; without one, the case does not apply."""
        variable = self.dictionary.get(index, subindex)
        if variable is None:
            does_not_apply(f"the dictionary has no object 0x{index:04X}:{subindex:02X}")
        return variable

    def is_writable(self, index: int, subindex: int = 0) -> bool:
        """Return whether the dictionary has an object that a client may write."""
        variable = self.dictionary.get(index, subindex)
        return variable is not None and variable.access.writable

    def check_writable(self, index: int, subindex: int = 0) -> None:
        """End the case as not applicable if the file has this object, and says that no client can write it."""
        variable = self.dictionary.get(index, subindex)
        if variable is not None and not variable.access.writable:
            does_not_apply(f"{variable.label} cannot be written: it is {variable.access} in the file")

    @property
    def emergency_inhibit_time(self) -> Time:
        """The time, in ns, by which the device may hold back an emergency message after a reset (0x1015, in 100 us)."""
        return self.default(INHIBIT_TIME_EMERGENCY) * 100 * MICROSECOND

    def check_emergency(self) -> None:
        """End the case as not applicable if the device sends no emergency messages after a reset."""
        cob_id = self.default(COB_ID_EMERGENCY)
        if cob_id & COB_ID_INVALID or not cob_id & 0x1FFF_FFFF:
            does_not_apply("0x1014:00 has no valid COB-ID by default")

    # ---- NMT ----

    def reset(self, command: NmtCommand = NmtCommand.RESET_NODE) -> Procedure[None]:
        """Reset the device, by default as after power-on, and command Pre-operational, also if it starts by itself."""
        yield from self.restart(command)
        yield from self.command(NmtCommand.ENTER_PRE_OPERATIONAL)

    def restart(self, command: NmtCommand = NmtCommand.RESET_NODE) -> Procedure[None]:
        """Reset the device and wait for its boot-up; do nothing else."""
        self.probe.listen((self.response_key, self.error_control_key, self.emcy_key))
        yield from act(lambda now: self.nmt.send(command, self.node_id, now))
        yield from self.await_boot_up()

    def await_boot_up(self) -> Procedure[None]:
        """Wait for the boot-up frame, whatever heartbeats come before it."""
        begin, frame = (yield from current_time()), None
        while frame is None or frame.data != b"\x00":
            left = begin + BOOT_TIME - (yield from current_time())
            try:
                frame = (yield from self.next_frame(self.error_control_key, max(left, 0), "the boot-up frame")).frame
            except NotInTimeError:
                came = "" if frame is None else f", only {frame}"
                text = f"the boot-up frame did not come within {BOOT_TIME / SECOND:g} s{came}"
                raise NotInTimeError(text, BOOT_TIME) from None
        yield from self.sleep(REACTION_TIME)

    def command(self, command: NmtCommand, node_id: int | None = None) -> Procedure[None]:
        """Send an NMT command, by default to the device, and give it time to obey."""
        target = self.node_id if node_id is None else node_id
        yield from act(lambda now: self.nmt.send(command, target, now))
        yield from self.sleep(REACTION_TIME)

    @property
    def has_heartbeat(self) -> bool:
        """Whether the device sends a heartbeat, or can be told to. A maker may fix the time (CiA 301 v4.2.0, 7.5.2.20)."""
        heartbeat = self.dictionary.get(PRODUCER_HEARTBEAT_TIME)
        return heartbeat is not None and (heartbeat.access.writable or self.default(PRODUCER_HEARTBEAT_TIME) != 0)

    def supervise(self) -> Procedure[None]:
        """Make the NMT state visible: by heartbeat if the device has one, else `state` uses guarding."""
        if self.is_writable(PRODUCER_HEARTBEAT_TIME):
            yield from self.write(PRODUCER_HEARTBEAT_TIME, 0, SUPERVISION_PERIOD // MILLISECOND)
        elif not self.has_heartbeat and not self.dictionary.has_index(GUARD_TIME):
            does_not_apply("the device has neither a heartbeat nor guarding: nothing shows its NMT state")

    def state(self) -> Procedure[NmtState]:
        """Return the NMT state that the device shows; call `supervise` before."""
        key = self.error_control_key
        self.probe.forget(key)
        timeout = ANSWER_TIME
        if not self.has_heartbeat:
            yield from self.send_remote(key, 1)
        elif not self.is_writable(PRODUCER_HEARTBEAT_TIME):
            timeout += self.default(PRODUCER_HEARTBEAT_TIME) * MILLISECOND
        heard = yield from self.next_frame(key, timeout, "a sign of the NMT state")
        data = heard.frame.data
        state = STATE_OF_BYTE[data[0]] if len(data) == 1 else None
        if state is None:
            raise ViolationError(f"{heard.frame} shows no NMT state")
        return state

    def expect_state(self, expected: NmtState, when: str) -> Procedure[None]:
        """Check that the device shows this NMT state. when: for the text, as in "after its boot-up"."""
        state = yield from self.state()
        expect(state is expected, f"{when}, the device is {state.name}, not {expected.name}")

    # ---- frames made by hand ----

    def send(self, key: RoutingKey, data: bytes = b"") -> Procedure[None]:
        """Send a data frame."""
        yield from act(lambda now: self.probe.send(frame_for_key(key, data), now))

    def send_remote(self, key: RoutingKey, dlc: int) -> Procedure[None]:
        """Send a remote frame that asks for `dlc` bytes."""
        extended = frame_for_key(key, b"").flags
        yield from act(lambda now: self.probe.send(Frame(key & 0x1FFF_FFFF, b"", extended | REMOTE, dlc), now))

    def sleep(self, duration: Time) -> Procedure[None]:
        """Wait for `duration` ns, and measure how late we are."""
        due = yield from current_time()
        end = due + duration
        while due < end:
            now = yield from current_time()
            due = min(max(due, now) + SLICE, end)
            yield from sleep(max(due - now, 0))
            yield from self._look_at_the_clock(due)

    def _look_at_the_clock(self, due: Time) -> Procedure[None]:
        now = yield from current_time()
        self.lateness = max(self.lateness, now - due)

    def next_frame(self, key: RoutingKey, timeout: Time, what: str) -> Procedure[FrameHeard]:
        """Return the next frame with a routing key to which the probe listens. Raises NotInTimeError, naming `what`; timeout:
        ns."""
        begin = yield from current_time()
        while (heard := self.probe.take(key)) is None:  # a frame may have been taken before the news of it came
            left = begin + timeout - (yield from current_time())
            try:
                yield from wait_for_event(self.probe, FrameHeard, max(left, 0), what, lambda report: report.frame.key == key)
            except StepTimeoutError:
                yield from self._look_at_the_clock(begin + timeout)
                late = self.probe.take(key)  # it came while we were late
                if late is not None:
                    return late
                raise NotInTimeError(f"{what} did not come within {timeout / SECOND:g} s", timeout) from None
        return heard

    def frames_within(self, key: RoutingKey, duration: Time) -> Procedure[list[FrameHeard]]:
        """Wait for `duration` ns; return all frames with this routing key that came meanwhile."""
        self.probe.listen_also(key)
        yield from self.sleep(duration)
        return self.probe.take_all(key)

    def expect_period(self, key: RoutingKey, duration: Time, period: Time, what: str) -> Procedure[list[FrameHeard]]:
        """Listen for `duration` ns and check that frames with this routing key come once per period; return the frames. what: the
        frames, for the text.

        The time from the first frame to the last is measured: it is known better than our listening time. Raises TimingError.
        """
        begin = yield from current_time()
        heard = yield from self.frames_within(key, duration)
        self.check_period(heard, begin, (yield from current_time()), period, what)
        return heard

    def check_period(self, heard: Sequence[FrameHeard], begin: Time, end: Time, period: Time, what: str) -> None:
        """Check that the frames heard from `begin` to `end` came once per period. Raises TimingError. what: the frames, for the
        text."""
        wanted = f"the period is {period / MILLISECOND:g} ms ± {PERIOD_TOLERANCE:.0%}"
        seen = f"{what} came {len(heard)} times in {(end - begin) / SECOND:.3g} s"
        if len(heard) < 2:
            raise TimingError(f"{seen}; {wanted}")
        first, last = heard[0].at, heard[-1].at
        average = (last - first) / (len(heard) - 1)
        if abs(average - period) > period * PERIOD_TOLERANCE:
            raise TimingError(f"{seen}, one each {average / MILLISECOND:.1f} ms; {wanted}")
        pause = max(first - begin, end - last)
        if pause > 2 * period:
            raise TimingError(f"{seen}, and then not for {pause / MILLISECOND:.0f} ms; {wanted}")

    def expect_silence(self, key: RoutingKey, duration: Time, what: str) -> Procedure[None]:
        """Check that no frame with this routing key comes within `duration` ns. what: for the text."""
        heard = yield from self.frames_within(key, duration)
        if heard:
            raise ViolationError(f"{what}: {heard[0].frame} came")

    def sync(self, counter: int | None = None) -> Procedure[None]:
        """Send a SYNC, and give the device time to react. counter: 1..240; None: an empty frame.

        Raises ViolationError if there was another SYNC since `silence_sync`: what it sets off would be told of ours.
        """
        other = self.probe.take(self.sync_key)
        if other is not None:
            raise ViolationError(f"{other.frame} came, a SYNC of another node, or of the device, whose own SYNC is off")
        yield from self.send(self.sync_key, b"" if counter is None else bytes((counter,)))
        yield from self.sleep(REACTION_TIME)

    def silence_sync(self) -> Procedure[None]:
        """Set the SYNC period to 0, whether the device is a producer or not. A reset undoes it.

        A producer is silent then: our SYNC must be the only one. And 0x1019 may change only while the period is 0 (7.5.2.22). If
        a producer refuses, it is made a consumer by bit 30 of 0x1005.
        """
        yield from self._stop_own_sync()
        self.probe.listen_also(self.sync_key)

    def _stop_own_sync(self) -> Procedure[None]:
        if not self.dictionary.has_index(COMMUNICATION_CYCLE_PERIOD) or not (yield from self.number(COMMUNICATION_CYCLE_PERIOD)):
            return
        refusal = yield from self.refusal_of_write(COMMUNICATION_CYCLE_PERIOD, 0, 0)
        if refusal is not None and self.dictionary.has_index(COB_ID_SYNC):
            cob_id = yield from self.number(COB_ID_SYNC)
            if cob_id & SYNC_PRODUCER:
                yield from self.write(COB_ID_SYNC, 0, cob_id & ~SYNC_PRODUCER)

    # ---- objects by SDO ----

    def transfer(self, procedure: Procedure[T]) -> Procedure[T]:
        """Carry out an SDO transfer. Raises SdoTransferError; NotInTimeError if there is no answer; ViolationError if there are
        only frames that are none, such as an abort that names another object."""
        self.probe.forget(self.response_key)
        try:
            return (yield from procedure)
        except SdoTransferError as failed:
            if failed.origin is AbortOrigin.TIMEOUT:
                heard = self.probe.take_all(self.response_key)
                if heard and failed.abort_code != AbortCode.CANNOT_TRANSFER:
                    raise ViolationError(f"{failed}: {heard[-1].frame}, which it sent, is no answer to that") from failed
                raise NotInTimeError(str(failed), self.sdo.timeout) from failed
            raise

    def read(self, index: int, subindex: int = 0) -> Procedure[bytes]:
        """Read an object; return its bytes. Raises as `transfer` does."""
        return (yield from self.transfer(upload(self.sdo, index, subindex)))

    def number(self, index: int, subindex: int = 0) -> Procedure[int]:
        """Read an object; return it as an unsigned number. Raises as `transfer` does."""
        return int.from_bytes((yield from self.read(index, subindex)), "little")

    def write(self, index: int, subindex: int, value: int) -> Procedure[None]:
        """Write an unsigned number, with the width in the dictionary. Raises as `transfer` does.

        The case does not apply if the file says that the object cannot be written: that is no refusal of the device's.
        """
        self.check_writable(index, subindex)
        yield from self.transfer(download(self.sdo, index, subindex, self.encode(index, subindex, value)))

    def encode(self, index: int, subindex: int, value: int) -> bytes:
        """Return the bytes of an unsigned number, with the object's width in the dictionary. value: 0 or more; ViolationError if
        the object is too short for it."""
        variable = self.variable(index, subindex)
        if variable.size is None or value.bit_length() > 8 * variable.size:
            raise ViolationError(f"{variable.label} is a {variable.data_type.name}, which does not hold the number {value}")
        return value.to_bytes(variable.size, "little")

    def refusal_of_read(self, index: int, subindex: int) -> Procedure[int | None]:
        """Read an object; return the abort code of a refusal, None if it is not refused. Raises NotInTimeError without an
        answer."""
        return (yield from self._refusal_of(upload(self.sdo, index, subindex)))

    def refusal_of_write(self, index: int, subindex: int, value: int | bytes) -> Procedure[int | None]:
        """Write an object; return the abort code of a refusal, None if it is not refused. Raises NotInTimeError without an
        answer.

        value: bytes as they are, or a number with the width in the dictionary.
        """
        data = value if isinstance(value, bytes) else self.encode(index, subindex, value)
        return (yield from self._refusal_of(download(self.sdo, index, subindex, data)))

    def _refusal_of(self, access: Procedure[object]) -> Procedure[int | None]:
        try:
            yield from self.transfer(access)
        except SdoTransferError as failed:
            if failed.origin is not AbortOrigin.PEER:
                raise
            return failed.abort_code
        return None

    def expect_number(self, index: int, subindex: int, expected: int, when: str) -> Procedure[None]:
        """Check that an object holds this number. expected: unsigned. when: for the text."""
        seen = yield from self.number(index, subindex)
        expect_equal(seen, expected, f"{when}, 0x{index:04X}:{subindex:02X}")

    def expect_default(self, index: int, subindex: int, when: str) -> Procedure[None]:
        """Check that an object can be read, and holds its default, if the dictionary has one. when: for the text."""
        content = yield from self.read(index, subindex)
        variable = self.dictionary.get(index, subindex)
        expected = None if variable is None else self.content_of(variable)
        if expected is not None:
            number = int.from_bytes(expected, "little")
            expect_equal(int.from_bytes(content, "little"), number, f"{when}, 0x{index:04X}:{subindex:02X}")

    def stimulate(self, variable: Variable) -> Procedure[bool]:
        """Make a process object change by `stimulus`; return whether it did."""
        stimulus = self.stimulus
        return stimulus is not None and (yield from act(lambda now: stimulus(variable, now)))


def _encoded(variable: Variable, value: Value) -> bytes | None:
    try:
        return variable.encode(value)
    except ValueRangeError:
        return None
