"""`Bench`: one device under test, and the tools with which cases ask it.

The device is known by its node-ID and by its object dictionary, which says what it should have: everything that a case looks
for is found there, so that the cases serve any device on any bus. What an object holds after a reset is its default, and in a
DCF what that has configured: an EDS describes a type of device, a DCF one device as it is commissioned.

The bench is a participant of its own: it asks by SDO (`read`, `write` ...), by NMT, and by frames made by hand (`send`, `ask`),
which no well-behaved machine would send.

What a device does at its inputs no bus can bring about. Where a case needs that, it asks for `stimulus`, a function of whoever
runs the test; without one, these cases check what is left.

Times: a device has ANSWER_TIME for an answer, BOOT_TIME for a restart, REACTION_TIME for what has no answer. Periods may be
wrong by PERIOD_TOLERANCE. The standard gives no figures; these are those of a patient master."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, TypeAlias

from canopen_proto.conformance.case import Violation, does_not_apply, expect, expect_equal
from canopen_proto.conformance.probe import FrameHeard, RawProbe
from canopen_proto.datatypes import Value, ValueRangeError
from canopen_proto.dictionary import ObjectDictionary, Variable
from canopen_proto.dictionary.description import DeviceDescription
from canopen_proto.frame import (
    COB_ID_INVALID,
    EMCY,
    ERROR_CONTROL,
    REMOTE,
    SDO_CLIENT_TO_SERVER,
    SDO_SERVER_TO_CLIENT,
    SYNC,
    Frame,
    frame_for_key,
    key_of_cob_id,
)
from canopen_proto.machine import MILLISECOND, SECOND, Time, check_node_id
from canopen_proto.network import Network
from canopen_proto.nmt import STATE_OF_BYTE, NmtCommand, NmtMaster, NmtState
from canopen_proto.procedures.steps import Procedure, SdoFailed, act, current_time, download, sleep, upload, wait_for_event
from canopen_proto.sdo.abort import AbortOrigin
from canopen_proto.sdo.client import SdoClient

ANSWER_TIME: Final = 1 * SECOND
BOOT_TIME: Final = 5 * SECOND
REACTION_TIME: Final = 100 * MILLISECOND
PERIOD_TOLERANCE: Final = 0.1

SUPERVISION_PERIOD: Final = 100 * MILLISECOND
"""The heartbeat by which the bench sees the device's NMT state."""

Stimulus: TypeAlias = Callable[[Variable, Time], None]
"""Makes the device change the value of an object of its process, now."""


class Bench:
    """See this module's text. node_id, dictionary, description: of the device. probe, sdo, nmt: what it is asked with."""

    def __init__(
        self,
        network: Network,
        node_id: int,
        dictionary: ObjectDictionary,
        *,
        description: DeviceDescription | None = None,
        stimulus: Stimulus | None = None,
    ) -> None:
        """network: on the device's bus; nobody else should use the device's SDO channel meanwhile. node_id: 1..127.

        description: the device's file, of which the dictionary is; None where there is no file, and so none to be checked.
        """
        self.node_id = check_node_id(node_id)
        self.dictionary = dictionary
        self.description = description
        self.stimulus = stimulus
        self.probe = RawProbe(network.out)
        self.sdo = SdoClient(network.out, node_id, timeout=ANSWER_TIME)
        self.nmt = NmtMaster(network.out)
        for machine in (self.probe, self.sdo, self.nmt):
            network.attach(machine)

    # ---- what is where ----

    @property
    def request_key(self) -> int:
        """The CAN-ID of SDO requests to the device."""
        return SDO_CLIENT_TO_SERVER + self.node_id

    @property
    def response_key(self) -> int:
        """The CAN-ID of its answers."""
        return SDO_SERVER_TO_CLIENT + self.node_id

    @property
    def error_control_key(self) -> int:
        """The CAN-ID of its boot-up, heartbeat and guarding."""
        return ERROR_CONTROL + self.node_id

    @property
    def emcy_key(self) -> int:
        """The CAN-ID of its emergencies after a reset; the predefined one where the dictionary does not tell."""
        return key_of_cob_id(self.default(0x1014)) or EMCY + self.node_id

    @property
    def sync_key(self) -> int:
        """The CAN-ID of SYNC after a reset; the predefined one where the dictionary does not tell."""
        return key_of_cob_id(self.default(0x1005)) or SYNC

    def default(self, index: int, subindex: int = 0) -> int:
        """The unsigned number that an object holds after a reset. 0 where the dictionary does not tell."""
        variable = self.dictionary.get(index, subindex)
        value = 0 if variable is None else variable.initial_of(self.node_id)
        return max(value, 0) if isinstance(value, int) else 0

    def content_of(self, variable: Variable) -> bytes | None:
        """The bytes that an object holds after a reset; None where the dictionary does not tell.

        It does not where the object's type cannot hold what stands there, nor where a DCF gives another value than the default to
        an object that no master can write: that is what somebody once read there.
        """
        value = variable.default if variable.configured is None else variable.configured
        if value is None or (not variable.access.writable and value != variable.default):
            return None
        return _encoded(variable, variable.initial_of(self.node_id))

    def restored_content_of(self, variable: Variable) -> bytes | None:
        """The bytes that an object holds after its default was restored; None where the dictionary does not tell."""
        return None if variable.default is None else _encoded(variable, variable.default_of(self.node_id))

    def variable(self, index: int, subindex: int = 0) -> Variable:
        """What the dictionary has there; the case does not apply where that is nothing."""
        variable = self.dictionary.get(index, subindex)
        if variable is None:
            does_not_apply(f"the dictionary has no object 0x{index:04X}:{subindex:02X}")
        return variable

    def check_emergency(self) -> None:
        """The case does not apply to a device that sends no emergency messages after a reset."""
        cob_id = self.default(0x1014)
        if cob_id & COB_ID_INVALID or not cob_id & 0x1FFF_FFFF:
            does_not_apply("0x1014:00 has no valid COB-ID by default")

    # ---- NMT ----

    def reset(self, command: NmtCommand = NmtCommand.RESET_NODE) -> Procedure[None]:
        """Reset the device, by default as after power-on, and wait for its boot-up: it is pre-operational then."""
        self.probe.listen((self.response_key, self.error_control_key, self.emcy_key))
        yield from act(lambda now: self.nmt.send(command, self.node_id, now))
        yield from self.await_boot_up()

    def await_boot_up(self) -> Procedure[None]:
        """Wait for the boot-up frame, whatever heartbeats come before it."""
        begin = yield from current_time()
        data = b""
        while data != b"\x00":
            left = begin + BOOT_TIME - (yield from current_time())
            heard = yield from self.next_frame(self.error_control_key, max(left, 0), "the boot-up frame")
            data = heard.frame.data
        yield from sleep(REACTION_TIME)

    def command(self, command: NmtCommand, node_id: int | None = None) -> Procedure[None]:
        """Send an NMT command, by default to the device, and give it time to obey."""
        target = self.node_id if node_id is None else node_id
        yield from act(lambda now: self.nmt.send(command, target, now))
        yield from sleep(REACTION_TIME)

    def supervise(self) -> Procedure[None]:
        """Make the NMT state visible: by heartbeat where the device has one, else `state` asks by guarding."""
        if self.dictionary.has_index(0x1017):
            yield from self.write(0x1017, 0, SUPERVISION_PERIOD // MILLISECOND)
        elif not self.dictionary.has_index(0x100C):
            does_not_apply("the device has neither a heartbeat nor guarding: nothing shows its NMT state")

    def state(self) -> Procedure[NmtState]:
        """The NMT state that the device shows; call `supervise` before."""
        key = self.error_control_key
        self.probe.forget(key)
        if not self.dictionary.has_index(0x1017):
            yield from self.send_remote(key, 1)
        heard = yield from self.next_frame(key, ANSWER_TIME, "a sign of the NMT state")
        data = heard.frame.data
        state = STATE_OF_BYTE[data[0]] if len(data) == 1 else None
        if state is None:
            raise Violation(f"{heard.frame} shows no NMT state")
        return state

    def expect_state(self, expected: NmtState, when: str) -> Procedure[None]:
        """Look whether the device shows that NMT state."""
        state = yield from self.state()
        expect(state is expected, f"{when}, the device is {state.name}, not {expected.name}")

    # ---- frames made by hand ----

    def send(self, key: int, data: bytes = b"") -> Procedure[None]:
        """Send a data frame."""
        yield from act(lambda now: self.probe.send(frame_for_key(key, data), now))

    def send_remote(self, key: int, dlc: int) -> Procedure[None]:
        """Send a remote frame that asks for `dlc` bytes."""
        extended = frame_for_key(key, b"").flags
        yield from act(lambda now: self.probe.send(Frame(key & 0x1FFF_FFFF, b"", extended | REMOTE, dlc), now))

    def next_frame(self, key: int, timeout: Time, what: str) -> Procedure[FrameHeard]:
        """The next frame with a key that the probe listens to. Raises StepTimeout that names `what`; timeout: ns."""
        while (heard := self.probe.take(key)) is None:  # a frame may have been taken before the news of it came
            yield from wait_for_event(self.probe, FrameHeard, timeout, what, lambda report: report.frame.key == key)
        return heard

    def frames_within(self, key: int, duration: Time) -> Procedure[list[FrameHeard]]:
        """All frames with a key within the time from now on."""
        self.probe.listen_also(key)
        yield from sleep(duration)
        return self.probe.take_all(key)

    def expect_silence(self, key: int, duration: Time, what: str) -> Procedure[None]:
        """Look whether no frame with that key comes within the time."""
        heard = yield from self.frames_within(key, duration)
        if heard:
            raise Violation(f"{what}: {heard[0].frame} came")

    def sync(self, counter: int | None = None) -> Procedure[None]:
        """Send a SYNC, and give the device time for what follows from it."""
        yield from self.send(self.sync_key, b"" if counter is None else bytes((counter,)))
        yield from sleep(REACTION_TIME)

    # ---- objects by SDO ----

    def read(self, index: int, subindex: int = 0) -> Procedure[bytes]:
        """An object's bytes. Raises SdoFailed."""
        return (yield from upload(self.sdo, index, subindex))

    def number(self, index: int, subindex: int = 0) -> Procedure[int]:
        """An object as an unsigned number. Raises SdoFailed."""
        return int.from_bytes((yield from self.read(index, subindex)), "little")

    def write(self, index: int, subindex: int, value: int) -> Procedure[None]:
        """Write an unsigned number, as wide as the dictionary says. Raises SdoFailed."""
        yield from download(self.sdo, index, subindex, self.encode(index, subindex, value))

    def encode(self, index: int, subindex: int, value: int) -> bytes:
        """An unsigned number as wide as the dictionary says of that object."""
        variable = self.variable(index, subindex)
        if variable.size is None or value.bit_length() > 8 * variable.size:
            raise Violation(f"{variable.label} is a {variable.data_type.name}, which does not hold the number {value}")
        return value.to_bytes(variable.size, "little")

    def refusal_of_read(self, index: int, subindex: int) -> Procedure[int | None]:
        """The abort code with which the device refuses a read; None if it does not. No answer at all raises SdoFailed."""
        try:
            yield from upload(self.sdo, index, subindex)
        except SdoFailed as failed:
            return _code_of_peer(failed)
        return None

    def refusal_of_write(self, index: int, subindex: int, value: int | bytes) -> Procedure[int | None]:
        """The abort code with which the device refuses a write; None if it does not. No answer at all raises SdoFailed.

        value: bytes as they are, or a number as wide as the dictionary says.
        """
        data = value if isinstance(value, bytes) else self.encode(index, subindex, value)
        try:
            yield from download(self.sdo, index, subindex, data)
        except SdoFailed as failed:
            return _code_of_peer(failed)
        return None

    def expect_number(self, index: int, subindex: int, expected: int, when: str) -> Procedure[None]:
        """Look whether an object holds that number."""
        seen = yield from self.number(index, subindex)
        expect_equal(seen, expected, f"{when}, 0x{index:04X}:{subindex:02X}")

    def expect_default(self, index: int, subindex: int, when: str) -> Procedure[None]:
        """Look whether an object can be read, and holds its default where the dictionary tells it."""
        content = yield from self.read(index, subindex)
        variable = self.dictionary.get(index, subindex)
        expected = None if variable is None else self.content_of(variable)
        if expected is not None:
            number = int.from_bytes(expected, "little")
            expect_equal(int.from_bytes(content, "little"), number, f"{when}, 0x{index:04X}:{subindex:02X}")

    def stimulate(self, variable: Variable) -> Procedure[bool]:
        """Have an object of the process change, if there is somebody who can. Whether there was."""
        stimulus = self.stimulus
        if stimulus is None:
            return False
        yield from act(lambda now: stimulus(variable, now))
        return True


def _encoded(variable: Variable, value: Value) -> bytes | None:
    try:
        return variable.encode(value)
    except ValueRangeError:
        return None


def _code_of_peer(failed: SdoFailed) -> int:
    if failed.origin is not AbortOrigin.PEER:
        raise failed
    return failed.abort_code
