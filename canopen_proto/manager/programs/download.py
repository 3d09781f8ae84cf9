"""Write a new program into a device: program download, CiA 302-3.

The steps, in their order; `ProgramStep` has their names, and `LEFT` the state that the device is in if one of them fails:

    look        read 0x1F51, 0x1F56 and 0x1F57: nothing is left to do if the new program runs already; it is only started if it
                is there and does not run, or only confirmed if that is missing
    prepare     command Pre-operational, in which devices take a program
    stop        0x1F51 = 0. The device may jump to its boot loader without an answer, and boot
    clear       0x1F51 = 3, until 0x1F57 is no longer busy
    write       0x1F50, by block transfer where the device has it, else in segments
    program     until 0x1F57 is no longer busy
    verify      0x1F56 is the expected identification. Without an expected one, and without 0x1F57, nothing has verified the
                program: it is not started then, unless the caller allows it
    start       0x1F51 = 1. A boot-up counts as an answer
    check       until 0x1F51 shows that it runs; 0x1F56, 0x100A and 0x1018:03 once more, since a boot loader may have gone back to
                the old program: what they show is compared with what they showed before, and with 0x1F56 after "write"
    confirm     0x1F51 = 0x80, for devices that want it; then the comparison of "check" again

**After a loss the state is read before a step is repeated**: a step without an answer may have been executed, and its repetition
would then be refused. SDO cannot resume a transfer. So a broken one begins again with "clear", up to WRITES times; it goes in
segments if the device broke a block transfer off.

**The next call repairs what this one leaves**, wherever it ended: by a lost device, a power cut or a cancel. Until all of it is
there, the device has no program that could be started; we start it only after "verify".

Nothing is awaited for ever: see `DownloadLimits`. Meanwhile a lost heartbeat of the node does not count, for flash that is being
erased may keep a processor busy; nodes that watch it too (their 0x1016) are not told.

Source: CiA 302-3; the order of the steps is that of Lely's master and of Zephyr's tool.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from enum import StrEnum
from typing import Final, Protocol

from canopen_proto import indices
from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.frame_bits import duration, least_bits
from canopen_proto.machine import SECOND, Event, RequestId, Time
from canopen_proto.manager.programs.identity import FlashError, FlashStatus, ProgramControl
from canopen_proto.manager.programs.objects import (
    LEFTOVER_TIME,
    NOTHING_KNOWN,
    POLL,
    TRIES,
    NotReachedError,
    ProgramFound,
    ProgramIdentity,
    ProgramObjects,
    is_lost,
)
from canopen_proto.nmt import NmtMaster, NmtState
from canopen_proto.procedures.steps import (
    Cancelled,
    Procedure,
    ProcedureError,
    Request,
    SdoTransferError,
    Wait,
    act,
    all_of,
    download,
    sleep,
)
from canopen_proto.remote_node import NMT_REACTION_TIME, RemoteNode
from canopen_proto.sdo.block import MAX_BLOCK_SIZE, SEGMENT_SIZE
from canopen_proto.sdo.client import Block
from canopen_proto.sdo.events import SdoAborted, SdoDownloaded

WRITES: Final = 3
"""How often the data are written at most, each time after a clear."""
MAX_PROGRAM: Final = 254
"""The highest number of a program: its subindex."""
CONFIRM_ADVICE: Final = "confirm it (0x80 in 0x1F51), else the program before comes back at the next reset"
PRE_OPERATIONAL_ADVICE: Final = "canopen nmt preop, since it is Stopped, where a device has no SDO"
ELSEWHERE_ADVICE: Final = "canopen scan, since its boot loader may have another node-ID; canopen lss scan, since it may have none"

_RUNNING: Final = (ProgramControl.START, ProgramControl.CONFIRM)
_OF_A_BROKEN_TRANSFER: Final = (FlashError.NONE, FlashError.NO_PROGRAM, FlashError.NOT_CLEARED)
"""Errors that say nothing about the program that was being written."""


class ProgramStep(StrEnum):
    """The steps of a program download; see this module's text."""

    LOOK = "look"
    PREPARE = "prepare"
    STOP = "stop"
    CLEAR = "clear"
    WRITE = "write"
    PROGRAM = "program"
    VERIFY = "verify"
    START = "start"
    CHECK = "check"
    CONFIRM = "confirm"


LEFT: Final = {
    ProgramStep.LOOK: "nothing was written: it has the program that it had",
    ProgramStep.PREPARE: "nothing was written: it has the program that it had, and is Pre-operational",
    ProgramStep.STOP: "its old program is stopped, or about to be; nothing was erased",
    ProgramStep.CLEAR: "its old program is erased, or about to be: it has no program",
    ProgramStep.WRITE: "it has only a part of the new program, which cannot be started",
    ProgramStep.PROGRAM: "all of the new program was sent; the device has not said that it is right",
    ProgramStep.VERIFY: "it has a program that was not started",
    ProgramStep.START: "the new program is there; it was perhaps not started",
    ProgramStep.CHECK: "the new program is there and was started; the device has not shown that it runs",
    ProgramStep.CONFIRM: "the new program runs on trial: at the next reset the old one comes back",
}
"""The state that a device is in if the download ends in a step, for people."""

FELL_BACK: Final = "it shows the identification of its old program, and runs"
NOT_VERIFIED: Final = "not verified: nothing has shown that the new program runs"


@dataclass(frozen=True, slots=True)
class DownloadLimits:
    """The longest waits, in ns. A node may have longer time-outs of its own for one SDO answer.

    answer: for one SDO answer. data: for one answer while the program is written. busy: until a flash operation is over. start:
    until a device is there again after stop or start, and its program runs.
    """

    answer: Time = 1 * SECOND
    data: Time = 3 * SECOND
    busy: Time = 30 * SECOND
    start: Time = 20 * SECOND


@dataclass(slots=True)
class ProgramDownload:
    """The progress of a program download. It may be read while that runs, and after a failure or a cancel.

    size: of the program, in bytes; delivered: how many of them the device has acknowledged. found: what it had. id_sent: 0x1F56
    when all was written, before the start. id_after: 0x1F56 at the end. Both are None if they cannot be read. verified_by: what
    has shown that the new program runs; "" if nothing has. writes: how often the data were written. is_needed: False if the
    device had the program, and ran it. is_done: all went well. fell_back: it runs its old program after the start. remark:
    something to know when it is done, or "".
    """

    size: int
    step: ProgramStep = ProgramStep.LOOK
    delivered: int = 0
    found: ProgramFound | None = None
    id_sent: int | None = None
    id_after: int | None = None
    verified_by: str = ""
    writes: int = 0
    is_needed: bool = True
    is_done: bool = False
    fell_back: bool = False
    remark: str = ""

    @property
    def id_before(self) -> int | None:
        """0x1F56 at the beginning; None if it cannot be read."""
        return None if self.found is None else self.found.identification

    @property
    def left(self) -> str:
        """The state that the device is in if the download ends now, for people."""
        return FELL_BACK if self.fell_back else LEFT[self.step]


class ProgramDownloadError(ProcedureError):
    """A program download did not come to its end.

    so_far: its progress. seen: the reason. remedy: a next step, or "". is_mismatch: the device shows another identification.
    is_silent: it does not answer.
    """

    def __init__(
        self,
        node_id: int,
        so_far: ProgramDownload,
        seen: str,
        remedy: str = "",
        *,
        is_mismatch: bool = False,
        is_silent: bool = False,
    ) -> None:
        tries = f". Try: {remedy}" if remedy else ""
        step = so_far.step
        super().__init__(f'the program download to node {node_id} ended at "{step}": {seen}; {so_far.left}{tries}')
        self.node_id = node_id
        self.so_far = so_far
        self.seen = seen
        self.remedy = remedy
        self.is_mismatch = is_mismatch
        self.is_silent = is_silent


class ProgramProgress(Event):
    """A program download begins a step, or has written more of its data. done, total: bytes."""

    __match_args__ = ("node_id", "step", "done", "total")

    def __init__(self, node_id: int, step: ProgramStep, done: int, total: int) -> None:
        self.node_id = node_id
        self.step = step
        self.done = done
        self.total = total


def download_program(
    node: RemoteNode,
    nmt: NmtMaster,
    image: bytes,
    so_far: ProgramDownload | None = None,
    *,
    program: int = 1,
    expected_id: int | None = None,
    force: bool = False,
    unverified: bool = False,
    confirm: bool = False,
    limits: DownloadLimits | None = None,
) -> Procedure[ProgramDownload]:
    """Write a program into a device and start it; see this module's text. Nothing else may use the node's SDO meanwhile.

    nmt: the NMT master of the node's network. so_far: takes the progress; a caller that may cancel keeps it. program: its number,
    1..254. expected_id: the software identification (0x1F56) of the new program; None: it is not known, so all is written, and
    only a change can show that the new program runs (`ProgramDownload.verified_by`). force: write the program even if the device
    has it already. unverified: start it even if it was not verified before: the device has no 0x1F57, and `expected_id` is None.
    confirm: write 0x80 to 0x1F51 once the new program runs: without it, Zephyr with MCUboot goes back to the old one at the next
    reset. limits: how long each step may take; None: the defaults. image: the program's bytes.

    A ProgramProgress follows for each step, and each 100 ms while data are written. At the end the node is Pre-operational.
    Raises ProgramDownloadError.
    """
    limits = DownloadLimits() if limits is None else limits
    so_far = ProgramDownload(len(image)) if so_far is None else so_far
    flashing = _Flashing(ProgramObjects(node, program), nmt, image, so_far, expected_id, force, unverified, confirm, limits)
    timeout, heartbeat = node.sdo.timeout, node.heartbeat.timeout
    node.sdo.timeout = max(timeout, limits.answer)
    yield from act(lambda now: node.heartbeat.set_timeout(0, now))
    try:
        yield from flashing.run()
    except (Cancelled, Exception) as ended:
        node.sdo.timeout = timeout
        yield from act(lambda now: node.heartbeat.set_timeout(heartbeat, now))
        if isinstance(ended, SdoTransferError | NotReachedError):
            raise flashing.ended_by(ended) from ended
        raise
    node.sdo.timeout = timeout
    yield from act(lambda now: node.heartbeat.set_timeout(heartbeat, now))
    so_far.is_done = True
    return so_far


def look(
    node: RemoteNode, program: int = 1, so_far: ProgramDownload | None = None, limits: DownloadLimits | None = None
) -> Procedure[ProgramFound]:
    """Return what a device has; nothing is written. Raises ProgramDownloadError, also if it takes no program this way. so_far:
    takes what is found; None: it is only returned. limits: how long the device may take."""
    so_far = ProgramDownload(0) if so_far is None else so_far
    patience = TRIES * (DownloadLimits() if limits is None else limits).answer
    try:
        so_far.found = found = yield from ProgramObjects(node, program).found(patience)
    except (SdoTransferError, NotReachedError) as error:
        silent = isinstance(error, NotReachedError)
        remedy = PRE_OPERATIONAL_ADVICE if node.nmt_state is NmtState.STOPPED else "canopen scan" if silent else ""
        raise ProgramDownloadError(node.node_id, so_far, str(error), remedy, is_silent=silent) from error
    if found.control is None:
        seen = f"it has no program control (0x1F51:{program:02X}): it takes no program this way"
        raise ProgramDownloadError(node.node_id, so_far, seen)
    return found


class WantsSoftware(Protocol):
    """An entry of the network list that names the software of a node: a BootEntry of canopen_proto.manager.boot."""

    @property
    def software(self) -> int | None:
        """The expected software identification (0x1F55); None: it is not checked."""


def updating(
    nmt: NmtMaster, image_of: Callable[[int], bytes | None], *, confirm: bool = False, limits: DownloadLimits | None = None
) -> Callable[[RemoteNode, WantsSoftware], Procedure[None]]:
    """Return the function that a boot-up of CiA 302-2 calls to update a node's software: `update(node, entry)`.

    image_of: returns the program of a node-ID (0x1F58 of the master); None: there is none, which is ProgramDownloadError.
    confirm, limits: as of `download_program`, whose program 1 is written.

    nmt: the master of the network.
    """

    def update(node: RemoteNode, entry: WantsSoftware) -> Procedure[None]:
        image = image_of(node.node_id)
        if image is None:
            raise ProgramDownloadError(node.node_id, ProgramDownload(0), "there is no program file for it (0x1F58 of the master)")
        yield from download_program(node, nmt, image, expected_id=entry.software, confirm=confirm, limits=limits)

    return update


def least_duration(size: int, bitrate: int, *, blocks: bool = True) -> Time:
    """Return the least time that the data of a program take on an empty bus, in ns. bitrate: in bit/s. Devices take longer. size:
    of the program, bytes. blocks: by block transfer; else in segments."""
    segments = -(-size // SEGMENT_SIZE)
    frames = segments + 2 * -(-segments // MAX_BLOCK_SIZE) if blocks else 2 * segments
    return duration(frames * least_bits(8), bitrate)


@dataclass(slots=True)
class _Flashing:
    """One program download, step by step."""

    objects: ProgramObjects
    nmt: NmtMaster
    image: bytes
    so_far: ProgramDownload
    expected: int | None
    force: bool
    unverified: bool
    confirm: bool
    limits: DownloadLimits
    block: Block = "auto"
    state: int | None = None  # 0x1F51, as last seen
    stopped: ProgramIdentity = NOTHING_KNOWN  # what was read after all was written, before the start
    is_judged: bool = False  # the device has said, in 0x1F57, that the program is right

    def run(self) -> Procedure[None]:
        so_far = self.so_far
        yield from self._begin(ProgramStep.LOOK)
        found = yield from look(self.objects.node, self.objects.program, so_far, self.limits)
        self.state = found.control
        is_there = found.is_valid and not self.force and self.expected is not None and found.identification == self.expected
        so_far.is_needed = not is_there or self.state not in _RUNNING or (self.confirm and self.state == ProgramControl.CONFIRM)
        if not so_far.is_needed:
            so_far.id_after = so_far.id_before
            so_far.verified_by = self._as_expected()
            self._remark()
            return
        yield from self._begin(ProgramStep.PREPARE)
        yield from self._pre_operational()
        if self.state == ProgramControl.CONFIRM and self.confirm:  # on trial, a device does not even let its program be stopped
            yield from self._confirm()
        if not is_there:
            yield from self._load()
            yield from self._begin(ProgramStep.VERIFY)
            yield from self._verify()
        if self.state not in _RUNNING:
            yield from self._begin(ProgramStep.START)
            yield from self._command(ProgramControl.START, (*_RUNNING, None))
        yield from self._begin(ProgramStep.CHECK)
        self.state = yield from self.objects.control(self.limits.start, (*_RUNNING, None))
        yield from self._compare()
        if self.confirm and self.state == ProgramControl.CONFIRM:
            yield from self._confirm()
            yield from self._compare()  # a reset before the confirmation was there has brought the old program back
        self._remark()

    # ---- the steps ----

    def _load(self) -> Procedure[None]:
        """Stop, clear and write; all of it again if the transfer breaks."""
        while True:
            yield from self._begin(ProgramStep.CLEAR if self.so_far.writes else ProgramStep.STOP)
            if self.state != ProgramControl.STOP:
                yield from self._command(ProgramControl.STOP, (ProgramControl.STOP, ProgramControl.CLEAR))
            yield from self._begin(ProgramStep.CLEAR)
            yield from self._command(ProgramControl.CLEAR, (ProgramControl.CLEAR,))
            yield from self._idle((FlashError.NONE, FlashError.NO_PROGRAM))
            self.so_far.writes += 1
            yield from self._begin(ProgramStep.WRITE)
            try:
                yield from self._write()
                break
            except SdoTransferError as failed:
                if (yield from self._is_there_after(failed)):
                    break
        self.so_far.delivered = self.so_far.size
        yield from self._begin(ProgramStep.PROGRAM)
        status = yield from self._idle((FlashError.NONE,))
        self.is_judged = status is not None
        self.state = ProgramControl.STOP

    def _write(self) -> Procedure[None]:
        self.so_far.delivered = 0
        client = self.objects.node.sdo
        before, client.timeout = client.timeout, max(client.timeout, self.limits.data)
        open_request: list[RequestId] = []

        def transfer() -> Procedure[None]:
            def submit(now: Time, urgent: bool) -> RequestId:
                request_id = client.download(
                    indices.PROGRAM_DATA, self.objects.program, self.image, now, urgent=urgent, block=self.block
                )
                open_request.append(request_id)
                return request_id

            outcome = yield Request(client, submit)
            if isinstance(outcome, SdoAborted):
                raise SdoTransferError(outcome, "writing")

        def tell() -> Procedure[None]:
            while (yield Wait(POLL, client, lambda ended: ended.request_id in open_request, (SdoDownloaded, SdoAborted))) is None:  # type: ignore[attr-defined]
                self.so_far.delivered = min(client.delivered(open_request[0]), self.so_far.size)
                yield from self._begin(ProgramStep.WRITE)

        try:
            yield from all_of(transfer(), tell())
        finally:
            client.timeout = before

    def _is_there_after(self, failed: SdoTransferError) -> Procedure[bool]:
        """Return whether the program is there though its transfer failed; False: write it again. Raises if that is no use."""
        limits, objects, lost = self.limits, self.objects, is_lost(failed)
        self.state = yield from objects.control(max(limits.busy, limits.start))
        status = yield from objects.settled(limits.busy if failed.not_confirmed else LEFTOVER_TIME)
        if failed.not_confirmed and self.expected is not None:
            found = yield from objects.identification(limits.start)
            if found == self.expected:
                return True
        is_last = self.so_far.writes == WRITES
        may_help = lost or self.block == "auto" or (status is not None and status.error == FlashError.NOT_CLEARED)
        has_reason = status is not None and not status.is_busy and status.error not in _OF_A_BROKEN_TRANSFER
        if is_last or not may_help or (has_reason and not lost):
            raise self._refusal(failed, status) from failed
        if not lost or self.so_far.writes == WRITES - 1:
            self.block = False
        return False

    def _verify(self) -> Procedure[None]:
        """Compare the identification before the program is started."""
        self.stopped = yield from self.objects.identity(self.limits.start)
        self.so_far.id_sent = found = self.stopped.program
        if self.expected is not None and found != self.expected:
            shown = "it shows none" if not found else f"it shows 0x{found:08X}"
            remedy = f"; 0x{found:08X} as the expected one, if that is right: then it is only started" if found else ""
            raise self.failed(
                f"its new program should have the identification 0x{self.expected:08X}, and {shown}; it was not started",
                f"the right file{remedy}",
                is_mismatch=True,
            )
        if self.expected is None and not self.is_judged and not self.unverified:
            raise self.failed(
                "not verified: the device has no flash status (0x1F57), and no identification is expected; it was not started",
                "--expect, with the identification of the new program; or --yes, to start it all the same",
            )

    def _compare(self) -> Procedure[None]:
        """See whether the program that runs is the new one; raise if it shows itself as another."""
        so_far = self.so_far
        identity = yield from self._running_identity()
        so_far.id_after, before = identity.program, self._before()
        is_new = bool(so_far.id_sent) and so_far.id_sent != before.program  # the device has told the sent one from the old one
        wanted = so_far.id_sent if self.expected is None and is_new else self.expected
        so_far.verified_by = ""
        if wanted is not None and identity.program not in (None, wanted):
            so_far.fell_back = identity.program == before.program
            old = ", as before: its boot loader has refused the new program" if so_far.fell_back else ""
            raise self.failed(
                f"the program that runs has the identification 0x{identity.program:08X}, and not 0x{wanted:08X}{old}",
                is_mismatch=True,
            )
        if identity.program == self.expected is not None:
            so_far.verified_by = self._as_expected()
        elif identity.program is not None and identity.program == wanted:
            so_far.verified_by = f"0x1F56 shows what was written: 0x{wanted:08X}"
        elif self.state in _RUNNING:
            so_far.verified_by = before.changed_to(identity, self.stopped)

    def _running_identity(self) -> Procedure[ProgramIdentity]:
        """Return the identity of a program that still runs after it was read: a boot loader shows that of one that has ended."""
        for _ in range(TRIES):
            boots = self.objects.node.boots
            identity = yield from self.objects.identity(self.limits.start)
            try:
                self.state = yield from self.objects.control(self.limits.start, (*_RUNNING, None))
            except NotReachedError as failed:
                if failed.is_silent:
                    raise
                raise self.failed(
                    f"its new program was started, and does not run: {failed}. It has ended, and the boot loader has taken over",
                    "a program that was tried on such a device; the same once more",
                ) from failed
            if self.objects.node.boots == boots:
                return identity
        raise self.failed(
            f"its new program was started, and the device has booted {TRIES} times since: it does not stay",
            "a program that was tried on such a device; the same once more",
        )

    def _before(self) -> ProgramIdentity:
        """Return what told the old program from others; nothing if there was no valid one."""
        found = self.so_far.found
        return found.identity if found is not None and found.is_valid else NOTHING_KNOWN

    def _as_expected(self) -> str:
        return f"0x1F56 is the expected one: 0x{self.expected:08X}"

    def _confirm(self) -> Procedure[None]:
        yield from self._begin(ProgramStep.CONFIRM)
        yield from self._pre_operational()  # it has booted since
        yield from self._command(ProgramControl.CONFIRM, (ProgramControl.START,))
        self.state = ProgramControl.START

    # ---- their parts ----

    def _remark(self) -> None:
        remarks = [] if self.so_far.verified_by else [NOT_VERIFIED]
        if self.state == ProgramControl.CONFIRM and not self.confirm:
            remarks.append(f"the program runs on trial; {CONFIRM_ADVICE}")
        self.so_far.remark = "; ".join(remarks)

    def _begin(self, step: ProgramStep) -> Procedure[None]:
        so_far = self.so_far
        so_far.step = step
        news = ProgramProgress(self.objects.node.node_id, step, so_far.delivered, so_far.size)
        yield from act(lambda now: self.objects.node.out.events.append(news))

    def _pre_operational(self) -> Procedure[None]:
        yield from act(lambda now: self.nmt.enter_pre_operational(self.objects.node.node_id, now))
        yield from sleep(NMT_REACTION_TIME)

    def _command(self, command: ProgramControl, reached: Collection[int | None]) -> Procedure[None]:
        """Write 0x1F51. Without an answer, or if the device refuses in its present state, look whether it has been done.

        reached: the values of 0x1F51 that show it.
        """
        for attempt in range(TRIES):
            try:
                yield from download(self.objects.node.sdo, indices.PROGRAM_CONTROL, self.objects.program, bytes((command,)))
            except SdoTransferError as failed:
                is_out_of_turn = failed.abort_code == AbortCode.DEVICE_STATE and failed.origin is AbortOrigin.PEER
                status = None
                if is_lost(failed) or is_out_of_turn:
                    status = yield from self.objects.settled(
                        self.limits.busy if command is ProgramControl.CLEAR else self.limits.start
                    )
                    self.state = yield from self.objects.control(self.limits.start)
                    if self.state in reached:
                        return
                if attempt + 1 < TRIES and is_lost(failed):
                    continue
                if attempt + 1 < TRIES and is_out_of_turn and self.state != ProgramControl.CONFIRM:
                    yield from self._pre_operational()  # the first command to be so was perhaps lost
                    continue
                raise self._refusal(failed, status or (yield from self.objects.settled(LEFTOVER_TIME))) from failed
            else:
                self.state = command
                return

    def _idle(self, allowed: Collection[int]) -> Procedure[FlashStatus | None]:
        """Wait until the flash is not busy; return its status, None if it cannot be read.

        Raises ProgramDownloadError if it stays busy, or has an error that is not allowed.
        """
        status = yield from self.objects.settled(self.limits.busy)
        if status is None:
            return None
        if status.is_busy:
            raise self.failed(
                f"its flash stays busy (0x1F57:{self.objects.program:02X}), for {self.limits.busy / SECOND:g} s now",
                "once more; power off and on",
            )
        if status.error not in allowed:
            raise self.failed(f"its flash status (0x1F57:{self.objects.program:02X}) is 0x{status.value:08X}: {status.text}")
        return status

    # ---- failures ----

    def failed(self, seen: str, remedy: str = "", *, is_mismatch: bool = False, is_silent: bool = False) -> ProgramDownloadError:
        """Return the error for what was seen."""
        node_id = self.objects.node.node_id
        return ProgramDownloadError(node_id, self.so_far, seen, remedy, is_mismatch=is_mismatch, is_silent=is_silent)

    def ended_by(self, error: SdoTransferError | NotReachedError) -> ProgramDownloadError:
        """Return the error for one of a step."""
        is_silent = isinstance(error, NotReachedError) and error.is_silent
        return self.failed(str(error), ELSEWHERE_ADVICE if is_silent else "", is_silent=is_silent)

    def _refusal(self, failed: SdoTransferError, status: FlashStatus | None) -> ProgramDownloadError:
        """Return the error for a refusal, with the cause that 0x1F57 names."""
        named = status is not None and (status.is_busy or status.error)
        seen = f"; its flash status says: {status.text}" if status is not None and named else ""
        is_silent = failed.origin is AbortOrigin.TIMEOUT
        return self.failed(f"{failed}{seen}", CONFIRM_ADVICE if self.state == ProgramControl.CONFIRM else "", is_silent=is_silent)
