"""Read the program objects of a device (CiA 302-3) that may be busy with its flash, or booting: it is asked until it answers.

A read changes nothing, so it is repeated after a loss. The objects have their numbers in indices.py.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Final, NamedTuple

from canopen_proto import indices
from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.machine import MILLISECOND, SECOND, Time
from canopen_proto.manager.programs.identity import FlashStatus, flash_status
from canopen_proto.procedures.objects import ABSENT
from canopen_proto.procedures.steps import Procedure, ProcedureError, SdoTransferError, current_time, sleep, upload
from canopen_proto.remote_node import RemoteNode

POLL: Final = 100 * MILLISECOND
"""Between two looks at a state that is awaited."""
TRIES: Final = 3
"""How often a read, or a command without an answer, is sent at most."""
LEFTOVER_TIME: Final = 2 * SECOND
"""For a flash that is busy at the beginning: some stay so after a broken transfer until they are cleared."""
_OF_A_LOSS: Final = (
    AbortCode.TOGGLE_NOT_ALTERNATED,
    AbortCode.TIMED_OUT,
    AbortCode.INVALID_COMMAND,
    AbortCode.INVALID_SEQUENCE_NUMBER,
    AbortCode.CRC_ERROR,
)
"""How a device says that frames were lost, or came late."""


class NotReachedError(ProcedureError):
    """A device did not answer for a time, or not with what was awaited. is_silent: it did not answer the last time. message: for
    people."""

    def __init__(self, message: str, *, is_silent: bool) -> None:
        super().__init__(message)
        self.is_silent = is_silent


def is_lost(failed: SdoTransferError) -> bool:
    """Return whether nobody said no: a frame was lost, late or in the wrong place, or the device has booted meanwhile."""
    if failed.origin is AbortOrigin.PEER:
        return failed.abort_code in _OF_A_LOSS
    return failed.origin is not AbortOrigin.CANCELLED and failed.abort_code != AbortCode.CANNOT_TRANSFER


class ProgramIdentity(NamedTuple):
    """What tells one program from another. None for an object that the device does not have, or that cannot be read.

    program: 0x1F56, the software identification. version: 0x100A, as bytes. revision: 0x1018:03.
    """

    program: int | None = None
    version: bytes | None = None
    revision: int | None = None

    def changed_to(self, later: ProgramIdentity, stopped: ProgramIdentity) -> str:
        """Name the first object that shows another program in `later`, for people; "" if none does.

        stopped: what was read in between, with no program running. A version or revision of that time may be the boot loader's
        own, so it shows nothing. Nor does an object that cannot be read, or an identification of 0, which means "no program".
        """
        if self.program and later.program and self.program != later.program:
            return f"0x1F56 has changed from 0x{self.program:08X} to 0x{later.program:08X}"
        if None not in (self.version, later.version) and later.version not in (self.version, stopped.version):
            return "the software version (0x100A) has changed"
        if None not in (self.revision, later.revision) and later.revision not in (self.revision, stopped.revision):
            return "the revision number (0x1018:03) has changed"
        return ""


NOTHING_KNOWN: Final = ProgramIdentity()


class ProgramFound(NamedTuple):
    """The state of a device: 0x1F51, its identity, 0x1F57. None for an object that it does not have, or that cannot be read."""

    control: int | None
    identity: ProgramIdentity
    status: FlashStatus | None

    @property
    def identification(self) -> int | None:
        """0x1F56."""
        return self.identity.program

    @property
    def is_valid(self) -> bool:
        """Whether the flash status says nothing against the program."""
        return self.status in (None, FlashStatus(False))


@dataclass(frozen=True, slots=True)
class ProgramObjects:
    """The objects of one program of a node. timeout: ns, after which NotReachedError is raised."""

    node: RemoteNode
    program: int

    def found(self, timeout: Time) -> Procedure[ProgramFound]:
        """Return what the device has. timeout: for each object."""
        status = yield from self.settled(max(LEFTOVER_TIME, timeout))
        control = yield from self.control(timeout)
        return ProgramFound(control, (yield from self.identity(timeout)), status)

    def control(self, timeout: Time, wanted: Collection[int | None] = ()) -> Procedure[int | None]:
        """Return 0x1F51, None if the device does not have it. wanted: wait until it is one of these."""
        return (yield from self._await(indices.PROGRAM_CONTROL, lambda value: not wanted or value in wanted, timeout))

    def identification(self, timeout: Time) -> Procedure[int | None]:
        """Return 0x1F56; None if it cannot be read: without a program some devices refuse."""
        return (yield from self._await(indices.PROGRAM_SOFTWARE, lambda value: True, timeout, refusal_is_none=True))

    def identity(self, timeout: Time) -> Procedure[ProgramIdentity]:
        """Return what tells the present program from another; if the device boots meanwhile, what it shows then."""
        identity = NOTHING_KNOWN
        for _ in range(TRIES):
            boots = self.node.boots
            version = yield from self._bytes(indices.MANUFACTURER_SOFTWARE_VERSION, 0)
            revision = yield from self._bytes(indices.IDENTITY_OBJECT, 3)
            program = yield from self.identification(timeout)  # the best evidence last: it is the freshest
            number = None if revision is None else int.from_bytes(revision[:4], "little")
            identity = ProgramIdentity(program, version, number)
            if self.node.boots == boots:
                break
        return identity

    def settled(self, timeout: Time) -> Procedure[FlashStatus | None]:
        """Wait until the flash is not busy; return its status, None if it cannot be read. After the timeout a busy flash is
        returned as it is. timeout: ns."""
        value = yield from self._await(
            indices.FLASH_STATUS, lambda value: value is None or not value & 1, timeout, refusal_is_none=True, anything=True
        )
        return None if value is None else flash_status(value)

    def _bytes(self, index: int, subindex: int) -> Procedure[bytes | None]:
        """Read an object; None if the device refuses, or does not answer TRIES times: it is only further evidence."""
        for _ in range(TRIES):
            try:
                return (yield from upload(self.node.sdo, index, subindex))
            except SdoTransferError as failed:
                if not is_lost(failed):
                    return None
        return None

    def _await(
        self,
        index: int,
        is_wanted: Callable[[int | None], bool],
        timeout: Time,
        *,
        refusal_is_none: bool = False,
        anything: bool = False,
    ) -> Procedure[int | None]:
        """Read until the value is wanted. anything: after the timeout, any value will do."""
        end = (yield from current_time()) + timeout
        while True:
            seen = ""
            try:
                value = yield from self._read(index, refusal_is_none)
                if is_wanted(value) or (anything and (yield from current_time()) >= end):
                    return value
                seen = "nothing" if value is None else f"0x{value:02X}"
            except SdoTransferError as failed:
                if not is_lost(failed):
                    raise
            if (yield from current_time()) >= end:
                place = f"0x{index:04X}:{self.program:02X}"
                text = f"it still shows {seen} in {place}" if seen else f"it does not answer reading {place}"
                raise NotReachedError(f"{text} after {timeout / SECOND:g} s", is_silent=not seen)
            yield from sleep(POLL)

    def _read(self, index: int, refusal_is_none: bool) -> Procedure[int | None]:
        """Read a number once; None if the device does not have it."""
        try:
            data = yield from upload(self.node.sdo, index, self.program)
        except SdoTransferError as failed:
            if failed.abort_code in ABSENT or (refusal_is_none and not is_lost(failed)):
                return None
            raise
        return int.from_bytes(data[:4], "little")
