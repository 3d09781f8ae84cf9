"""`BootLoader`: a simulated device whose program can be written over the bus (CiA 302-3), to try a program download on.

It is a LocalNode with a boot loader and, while its program runs, an "application", which looks the same from outside. Its flash
is a `ProgramMemory`, which outlives the node: to cut its power, drop the BootLoader at any moment, and make another with the same
memory. A program that was being erased or written then is not valid.

    0x1F51  written   stop      the program stops; perhaps the device jumps to its boot loader without an answer (`jumps`)
                      clear     after "stop": the memory is erased, 0x1F57 is busy meanwhile
                      start     a valid program starts: the device boots into it; else refused
                      reset     stop and start
            read      1 it runs, 0 it does not, 3 the memory is erased, 0x80 it runs on trial (`trial`)
    0x1F50            after "clear" only: the program, in blocks or segments; checked and programmed at the end, busy meanwhile
    0x1F56            the identification of the program: by default the CRC-32 of its bytes; 0 without one
    0x1F57            the flash status

A write that is out of turn is refused with 0x08000022, and 0x1F57 says why. So is any but in Pre-operational.

Source: CiA 302-3; abort codes and states as in Zephyr's slave.
"""

from __future__ import annotations

from binascii import crc32
from collections.abc import Callable, Collection
from dataclasses import dataclass
from enum import Enum
from typing import Final

from canopen_proto import indices
from canopen_proto.abort import AbortCode
from canopen_proto.compiling import mypyc_attr
from canopen_proto.datatypes import Value
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.frame import Frame
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import MILLISECOND, NEVER, Event, Machine, Outbox, Time
from canopen_proto.manager.programs.identity import FlashError, FlashStatus, ProgramControl
from canopen_proto.nmt import NmtCommand, NmtResetRequested, NmtState
from canopen_proto.sdo.server import PENDING, ObjectAccessPending, Pending, SdoServerAborted

PROGRAM: Final = 1
"""The number of the only program."""
HEARTBEAT_MS: Final = 500
DEVICE_TYPE: Final = 0
"""No device profile."""
MAX_WAITING: Final = 32
"""Frames that wait in the CAN controller while the processor is busy with its flash."""
FIRST_PROGRAM: Final = b"the program of the factory"


class Slot(Enum):
    """The state of a memory for one program."""

    ERASED = "erased"
    TORN = "torn"
    """It is being erased or written, or that was broken off."""
    VALID = "valid"


class ProgramMemory:
    """The flash of a device: what it has without power.

    content, slot: of the program. previous: the one before, as long as the new one is not confirmed, in a device that wants that.
    is_on_trial: the new one has been started since.
    """

    def __init__(self, program: bytes | None = FIRST_PROGRAM) -> None:
        """program: None if the device comes without one."""
        self.content = bytearray(program or b"")
        self.slot = Slot.ERASED if program is None else Slot.VALID
        self.previous: bytes | None = None
        self.is_on_trial = False

    @property
    def program(self) -> bytes | None:
        """The program, if there is a valid one."""
        return bytes(self.content) if self.slot is Slot.VALID else None

    def begin(self, *, keeps: bool = False) -> None:
        """Begin to erase or to write: until `finish`, there is no valid program. keeps: the present one may come back."""
        if keeps and self.previous is None:
            self.previous = self.program
        self.slot = Slot.TORN

    def finish(self, slot: Slot) -> None:
        """Finish what was begun."""
        self.slot = slot
        if slot is Slot.ERASED:
            self.content.clear()

    def power_on(self) -> None:
        """Choose the program to start: the previous one, if the new one is not whole, or was on trial already."""
        if self.previous is None:
            return
        if self.slot is Slot.VALID and not self.is_on_trial:
            self.is_on_trial = True
            return
        self.content, self.slot = bytearray(self.previous), Slot.VALID
        self.confirm()

    def confirm(self) -> None:
        """Forget the previous program."""
        self.previous, self.is_on_trial = None, False


@dataclass(frozen=True)
class BootLoaderSettings:
    """How the device behaves. Times in ns.

    erase_time, program_time: how long the flash is busy after "clear", and after the last byte. boot_time: from a reset to
    the boot-up. holds_clear: the answer to "clear" comes when the memory is erased, for masters that do not poll 0x1F57 before
    they write (Lely's); such a master waits 100 ms for an answer, so `erase_time` has to be shorter. is_deaf: the processor does
    nothing else while the flash is busy: answers come late, and no heartbeat. jumps: the commands that it executes by a reset
    without an answer. resets: a start resets the device into its program; else the answer is all. blocks: has block transfer.
    identify: returns the identification of a program; None: its CRC-32. judge: returns the FlashError of a whole program; None:
    any but an empty one is right. is_secured: it may not be written. trial:
    a new program runs on trial until it is confirmed by 0x80, as with MCUboot. size: of the memory, in bytes.
    """

    erase_time: Time = 300 * MILLISECOND
    program_time: Time = 150 * MILLISECOND
    boot_time: Time = 50 * MILLISECOND
    holds_clear: bool = False
    is_deaf: bool = False
    jumps: Collection[int] = ()
    resets: bool = True
    blocks: bool = True
    identify: Callable[[bytes], int] | None = None
    judge: Callable[[bytes], int] | None = None
    is_secured: bool = False
    trial: bool = False
    size: int = 1 << 22


class ProgramStarted(Event):
    """A device runs a program. identification: of it."""

    __match_args__ = ("node_id", "identification")

    def __init__(self, node_id: int, identification: int) -> None:
        self.node_id = node_id
        self.identification = identification


class ProgramErased(Event):
    """A device has erased its program."""


class ProgramWritten(Event):
    """A device has received a whole program. error: of FlashError; size: in bytes."""

    __match_args__ = ("node_id", "error", "size")

    def __init__(self, node_id: int, error: int, size: int) -> None:
        self.node_id = node_id
        self.error = error
        self.size = size


class _Alarm(Machine):
    """Rings once."""

    def __init__(self, out: Outbox, bell: Event) -> None:
        super().__init__(out)
        self.bell = bell

    def set(self, time: Time) -> None:
        """Ring at this time instead of any other."""
        self._arm(time)

    def handle_timeout(self, now: Time) -> None:
        if now >= self.deadline:
            self._arm(NEVER)
            self.out.events.append(self.bell)


class FlashDone(Event):
    """The flash of a device is no longer busy."""


class BootDone(Event):
    """The boot time of a device is over."""


def boot_loader_dictionary(node_id: int, heartbeat_ms: int = HEARTBEAT_MS) -> ObjectDictionary:
    """Return the dictionary of a BootLoader: the usual communication objects, and those of its program. heartbeat_ms: the default
    of 0x1017, ms."""
    identity: dict[int, Value] = {1: 0, 2: 0x302, 3: 0x10000, 4: node_id}
    return ObjectDictionary(
        [
            standard_object(indices.DEVICE_TYPE, DEVICE_TYPE),
            standard_object(indices.ERROR_REGISTER),
            standard_object(indices.MANUFACTURER_DEVICE_NAME, "Boot loader"),
            standard_object(indices.PRODUCER_HEARTBEAT_TIME, heartbeat_ms),
            standard_object(indices.IDENTITY_OBJECT, highest=4, defaults=identity),
            standard_object(indices.PROGRAM_DATA, highest=PROGRAM),
            standard_object(indices.PROGRAM_CONTROL, highest=PROGRAM),
            standard_object(indices.PROGRAM_SOFTWARE, highest=PROGRAM),
            standard_object(indices.FLASH_STATUS, highest=PROGRAM),
        ]
    )


@mypyc_attr(allow_interpreted_subclasses=True)
class BootLoader(LocalNode):
    """A simulated device with a program; see this module's text.

    memory: what it has without power. runs: its program runs. error: what 0x1F57 shows while it is not busy.
    """

    def __init__(
        self,
        out: Outbox,
        node_id: int,
        settings: BootLoaderSettings | None = None,
        memory: ProgramMemory | None = None,
        dictionary: ObjectDictionary | None = None,
    ) -> None:
        super().__init__(out, node_id, boot_loader_dictionary(node_id) if dictionary is None else dictionary)
        self.settings = BootLoaderSettings() if settings is None else settings
        self.memory = ProgramMemory() if memory is None else memory
        self.runs = False
        self.error: int = FlashError.NONE
        self.sdo.serves_blocks = self.settings.blocks
        self._is_cleared = False  # a program may be written
        self._stays = False  # the next boot does not start the program
        self._reset: NmtResetRequested | None = None  # the one that is under way
        self._done: Slot | None = None  # the state of the memory once the flash is no longer busy
        self._held = 0  # the access that is answered then
        self._waiting: list[Frame] = []  # what has come meanwhile, of a device that is deaf
        self._flash = _Alarm(self.inner, FlashDone(node_id))
        self._boot = _Alarm(self.inner, BootDone(node_id))
        self._members.attach(self._flash)
        self._members.attach(self._boot)
        self._reactions.update(
            {
                ObjectAccessPending: self._on_access,
                SdoServerAborted: self._on_transfer_broken,
                FlashDone: self._on_flash_done,
                BootDone: self._on_boot_done,
            }
        )

    @property
    def status(self) -> FlashStatus:
        """What 0x1F57 shows."""
        return FlashStatus(True) if self._done is not None else FlashStatus(False, self.error)

    @property
    def identification(self) -> int:
        """What 0x1F56 shows."""
        program = self.memory.program
        if program is None:
            return 0
        identify = self.settings.identify
        return crc32(program) if identify is None else identify(program)

    @property
    def control(self) -> int:
        """What 0x1F51 shows."""
        if self.runs:
            return ProgramControl.CONFIRM if self.memory.is_on_trial else ProgramControl.START
        return ProgramControl.CLEAR if self._is_cleared else ProgramControl.STOP

    # ---- power and reset ----

    def _on_reset(self, request: NmtResetRequested, now: Time) -> None:
        """Be away for the boot time; then boot. The work of the flash is broken off."""
        self.runs = False
        self._done, self._held = None, 0
        self._waiting.clear()
        self._flash.set(NEVER)
        self._reset = request
        self._boot.set(now + self.settings.boot_time)

    def _on_boot_done(self, done: BootDone, now: Time) -> None:
        request, self._reset = self._reset, None
        if request is not None:
            super()._on_reset(request, now)

    def _start(self, now: Time) -> None:
        memory = self.memory
        if self._stays:
            self._stays = False
        else:
            memory.power_on()
            self.runs = memory.slot is Slot.VALID
        self._is_cleared = memory.slot is Slot.ERASED
        self.error = FlashError.NONE if memory.slot is Slot.VALID else FlashError.NO_PROGRAM
        super()._start(now)
        self._tell_start()

    def _tell_start(self) -> None:
        if self.runs:
            self.inner.events.append(ProgramStarted(self.node_id, self.identification))

    def receive(self, frame: Frame, now: Time) -> None:
        if self._done is not None and self.settings.is_deaf:
            if len(self._waiting) < MAX_WAITING:
                self._waiting.append(frame)
        else:
            super().receive(frame, now)

    # ---- what the SDO server asks ----

    def read(self, index: int, subindex: int, now: Time) -> bytes | AbortCode | Pending:
        if subindex == PROGRAM:
            if index == indices.PROGRAM_CONTROL:
                return bytes((self.control,))
            if index == indices.PROGRAM_SOFTWARE:
                return self.identification.to_bytes(4, "little")
            if index == indices.FLASH_STATUS:
                return self.status.value.to_bytes(4, "little")
        return super().read(index, subindex, now)

    def check_write(self, index: int, subindex: int, size: int | None) -> AbortCode | Pending | None:
        if index == indices.PROGRAM_DATA and subindex == PROGRAM:
            return self._refusal_of_data(size) or PENDING
        return super().check_write(index, subindex, size)

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> AbortCode | Pending | None:
        if subindex == PROGRAM and index == indices.PROGRAM_DATA:  # up to four bytes, at once
            return self._refusal_of_data(len(data)) or PENDING
        if subindex == PROGRAM and index == indices.PROGRAM_CONTROL:
            return self._execute(data[0], now) if len(data) == 1 else self._store.check_write(index, subindex, len(data))
        return super().write(index, subindex, data, now)

    def _refusal_of_data(self, size: int | None) -> AbortCode | None:
        """Return why no program of that size may be written now; 0x1F57 tells it, too."""
        is_taken = self.channels.host_takes(indices.PROGRAM_DATA, PROGRAM)
        if self._done is not None or is_taken or self.state is not NmtState.PRE_OPERATIONAL:
            return AbortCode.DEVICE_STATE
        if not self._is_cleared:
            self.error = FlashError.NOT_CLEARED
            return AbortCode.DEVICE_STATE
        if size is not None and size > self.settings.size:
            self.error = FlashError.ADDRESS_ERROR
            return AbortCode.LENGTH_TOO_HIGH
        return None

    def _execute(self, command: int, now: Time) -> AbortCode | Pending | None:
        """Execute a command that was written to 0x1F51."""
        if self._done is not None or self.state is not NmtState.PRE_OPERATIONAL:
            return AbortCode.DEVICE_STATE
        if command == ProgramControl.STOP:
            return self._stop(now)
        if command == ProgramControl.CLEAR:
            return self._clear(now)
        if command == ProgramControl.START:
            return AbortCode.DEVICE_STATE if self.runs else self._run(command, now)
        if command == ProgramControl.RESET:
            return self._run(command, now)
        if command == ProgramControl.CONFIRM and self.settings.trial:
            self.memory.confirm()
            return None
        return AbortCode.INVALID_VALUE

    def _stop(self, now: Time) -> AbortCode | Pending | None:
        if self.control == ProgramControl.CONFIRM:
            return AbortCode.DEVICE_STATE
        self._is_cleared = False
        if not self.runs or ProgramControl.STOP not in self.settings.jumps:
            self.runs = False
            return None
        self._stays = True
        return self._boot_after(ProgramControl.STOP, now)

    def _run(self, command: int, now: Time) -> AbortCode | Pending | None:
        if self.memory.slot is not Slot.VALID:
            self.error = FlashError.NO_PROGRAM
            return AbortCode.DEVICE_STATE
        if self.settings.resets or command in self.settings.jumps:
            return self._boot_after(command, now)
        self.memory.power_on()
        self.runs = True
        self._tell_start()
        return None

    def _boot_after(self, command: int, now: Time) -> Pending | None:
        """Reset, after the answer or without one."""
        self.nmt.execute(NmtCommand.RESET_NODE, now)
        return PENDING if command in self.settings.jumps else None

    def _clear(self, now: Time) -> AbortCode | Pending | None:
        if self.settings.is_secured:
            self.error = FlashError.SECURED
            return AbortCode.DEVICE_STATE
        if self.runs or self._is_cleared:
            return AbortCode.DEVICE_STATE
        self.memory.begin(keeps=self.settings.trial)
        self.error = FlashError.NONE
        self._be_busy(Slot.ERASED, self.settings.erase_time, now)
        self.inner.events.append(ProgramErased(self.node_id))
        return PENDING if self.settings.is_deaf or self.settings.holds_clear else None

    # ---- the flash ----

    def _be_busy(self, result: Slot, duration: Time, now: Time) -> None:
        self._done = result
        self._flash.set(now + duration)
        if self.settings.is_deaf:
            self.communication.set_state(NmtState.INITIALISING, now)  # no heartbeat either

    def _on_flash_done(self, done: FlashDone, now: Time) -> None:
        if self._done is None:
            return
        self.memory.finish(self._done)
        self._is_cleared = self._done is Slot.ERASED
        self._done = None
        if self.settings.is_deaf:
            self.communication.set_state(self.state, now)
        if self._held:
            self.channels.complete(self._held, None, now)
            self._held = 0
        waiting, self._waiting = self._waiting, []
        for frame in waiting:
            self.receive(frame, now)

    def _on_access(self, access: ObjectAccessPending, now: Time) -> None:
        if access.index == indices.PROGRAM_DATA and access.data is not None:
            self._take_piece(access, access.data, now)
        elif access.index == indices.PROGRAM_CONTROL:
            self._held = access.access_id
        else:
            self._on_pending(access, now)

    def _take_piece(self, access: ObjectAccessPending, piece: bytes, now: Time) -> None:
        """Take a piece of the program, which comes in order; with the last one, check and program it."""
        memory = self.memory
        if access.offset == 0:
            memory.begin()
            memory.content.clear()
            self._is_cleared = False
        memory.content += piece
        if len(memory.content) > self.settings.size:
            self.error = FlashError.ADDRESS_ERROR
            self.channels.complete(access.access_id, AbortCode.OUT_OF_MEMORY, now)
            return
        if access.more:
            self.channels.complete(access.access_id, None, now)
            return
        self.error = self._judgement()
        self._be_busy(Slot.TORN if self.error else Slot.VALID, self.settings.program_time, now)
        self.inner.events.append(ProgramWritten(self.node_id, self.error, len(memory.content)))
        if self.settings.is_deaf:
            self._held = access.access_id
        else:
            self.channels.complete(access.access_id, None, now)

    def _judgement(self) -> int:
        judge, content = self.settings.judge, self.memory.content
        if judge is None:
            return FlashError.NONE if content else FlashError.UNKNOWN_FORMAT
        return judge(bytes(content))

    def _on_transfer_broken(self, report: SdoServerAborted, now: Time) -> None:
        if report.index == indices.PROGRAM_DATA and self._done is None and self.memory.slot is Slot.TORN and not self.error:
            self.error = FlashError.NO_PROGRAM
        self._on_aborted(report, now)
