"""The steps of procedures.

A procedure is a sequence of requests without I/O: homing, PDO remapping, a scan. It is a generator that yields `Step`s to a
`Runner` and gets their results. Typed helpers hide the yields, so that it reads like blocking code and passes `mypy --strict`:

    def identify(node: RemoteNode) -> Procedure[int]:
        data = yield from upload(node.sdo, 0x1018, 1)
        yield from sleep(100 * MILLISECOND)
        return int.from_bytes(data, "little")

`yield from` runs procedures in sequence, `all_of` side by side. A step that fails raises a `ProcedureError` at the `yield from`.
A procedure that is cancelled gets `Cancelled` there: a BaseException, so that no `except Exception` swallows it. Clean-up belongs
in `except Cancelled:` and may use steps again. These go before all queued requests, and share CLEAN_UP_TIME, unless they ask for
more by `ask_for_time`. Do not clean up in `finally`: a generator that is collected may not yield.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Generator, Sequence
from typing import TYPE_CHECKING, Any, Final, Protocol, TypeAlias, TypeVar

from canopen_proto.abort import AbortCode, AbortOrigin, text_of
from canopen_proto.machine import Event, Machine, Outbox, Outcome, RequestId, Time
from canopen_proto.sdo.events import SdoAborted, SdoDownloaded, SdoProgress, SdoUploaded

if TYPE_CHECKING:  # a device that runs procedures of its own need not load the client
    from canopen_proto.sdo.client import Block, SdoClient
    from canopen_proto.sdo.transfer import Buffer

T = TypeVar("T")
E = TypeVar("E", bound=Event)

NOT_CONFIRMED: Final = " (not confirmed: it may have been executed)"
"""The end of a message about a write that got no answer."""


class Cancelled(BaseException):
    """Thrown into a procedure that is cancelled. Catch it to clean up with further steps; then end or raise it again."""


class ProcedureError(Exception):
    """A procedure failed. The message says what failed, what was seen, and what to try."""


class StepTimeoutError(ProcedureError):
    """An awaited event or state did not come in time."""


class SdoTransferError(ProcedureError):
    """An SDO transfer of the procedure ended with an abort, ours or the node's. Fields: those of SdoAborted.

    not_confirmed: a write that may have been executed; it is never sent again automatically. attempt: "reading" or "writing".
    """

    def __init__(self, aborted: SdoAborted, attempt: str) -> None:
        self.aborted = aborted
        self.attempt = attempt
        self.node_id = aborted.node_id
        self.index = aborted.index
        self.subindex = aborted.subindex
        self.abort_code = aborted.abort_code
        self.origin = aborted.origin
        self.not_confirmed = aborted.not_confirmed
        place = f"{attempt} 0x{aborted.index:04X}:{aborted.subindex:02X}"
        if aborted.origin is AbortOrigin.TIMEOUT and aborted.abort_code != AbortCode.CANNOT_TRANSFER:  # that was our own side
            message = f"node {self.node_id} did not answer {place}"
        elif aborted.origin is AbortOrigin.PEER:
            message = f"node {self.node_id} refused {place}: abort 0x{self.abort_code:08X}, {text_of(self.abort_code)}"
        elif aborted.origin is AbortOrigin.CANCELLED:
            message = f"{place} of node {self.node_id} was given up: a stop of its drive went before it, or it was taken back"
        elif aborted.origin is AbortOrigin.CONTESTED:
            message = f"{place} of node {self.node_id} was disturbed: another SDO client on its channel {aborted.others_doing}"
        else:
            message = f"{place} of node {self.node_id} was given up: 0x{self.abort_code:08X}, {text_of(self.abort_code)}"
        Exception.__init__(self, message + (NOT_CONFIRMED if aborted.not_confirmed else ""))


class Requester(Protocol):
    """A machine whose commands have outcomes and can be cancelled."""

    out: Outbox

    def cancel(self, request_id: RequestId, now: Time) -> object:
        """Cancel a command."""


class HasOutbox(Protocol):
    """A part of a network: a machine, or a view of one."""

    out: Outbox


class Step:
    """A step, as a procedure yields it. There are only the five subclasses."""

    __slots__ = ()


class Act(Step):
    """Call `function(now)` at once; its result is the step's. For commands without an outcome (NMT, a PDO image, SYNC)."""

    __slots__ = ("function",)

    def __init__(self, function: Callable[[Time], object]) -> None:
        self.function = function


class Request(Step):
    """Give a command with an outcome: `submit(now, urgent)` returns its RequestId; the step's result is the Outcome event.
    requester: whose command it is, to cancel it.

    news: for a stream, called with each SdoProgress event. If it raises, the request is cancelled, and the error is raised here.
    """

    __slots__ = ("news", "requester", "submit")

    def __init__(
        self,
        requester: Requester,
        submit: Callable[[Time, bool], RequestId],
        news: Callable[[SdoProgress, Time], object] | None = None,
    ) -> None:
        self.requester = requester
        self.submit = submit
        self.news = news


class Wait(Step):
    """Wait until an event of `source`'s network matches (the result), or until `timeout` ns have passed (the result is None).

    kinds: the types of event that can match, exactly; None: `match` is asked about each event.
    """

    __slots__ = ("kinds", "match", "source", "timeout")

    def __init__(
        self,
        timeout: Time | None,
        source: HasOutbox | None = None,
        match: Callable[[Event], bool] | None = None,
        kinds: Collection[type[Event]] | None = None,
    ) -> None:
        self.timeout = timeout
        self.source = source
        self.match = match
        self.kinds = kinds


class AllOf(Step):
    """Run procedures side by side; the result is a list of theirs. The first failure cancels the rest, then is raised here."""

    __slots__ = ("procedures",)

    def __init__(self, procedures: Sequence[Procedure[Any]]) -> None:
        self.procedures = procedures


class AskForTime(Step):
    """Go on at once. A clean-up under way may take until `duration` ns from now, if that extends its time."""

    __slots__ = ("duration",)

    def __init__(self, duration: Time) -> None:
        self.duration = duration


Procedure: TypeAlias = Generator[Step, Any, T]


def act(function: Callable[[Time], T]) -> Procedure[T]:
    """Call function(now) at once and return what it returns."""
    result: T = yield Act(function)
    return result


def current_time() -> Procedure[Time]:
    """Return the driver's present time, in ns."""
    return (yield from act(lambda now: now))


def sleep(duration: Time) -> Procedure[None]:
    """Wait for `duration` ns."""
    yield Wait(duration)


def ask_for_time(duration: Time) -> Procedure[None]:
    """Let the clean-up under way, if this is one, take `duration` ns from now.

    Call it when the clean-up has just made progress: so a drive that answers and brakes is awaited, a silent one is not.
    """
    yield AskForTime(duration)


def wait_for_event(
    source: Machine, kind: type[E], timeout: Time, what: str, match: Callable[[E], bool] | None = None
) -> Procedure[E]:
    """Wait for an event of this kind from source's network; return it. After `timeout` ns, StepTimeoutError names `what`. match:
    which of these events; None: any."""
    result = yield Wait(timeout, source, lambda report: isinstance(report, kind) and (match is None or match(report)))
    if not isinstance(result, kind):
        raise StepTimeoutError(f"{what} did not come within {timeout / 1e9:g} s")
    return result


def all_of(*procedures: Procedure[T]) -> Procedure[list[T]]:
    """Run procedures side by side; return their results in order. The first failure cancels the rest, which clean up; then it is
    raised."""
    results: list[T] = yield AllOf(procedures)
    return results


def upload(client: SdoClient, index: int, subindex: int = 0, *, block: Block = False) -> Procedure[bytes]:
    """Read an object by SDO; return its bytes. Raises SdoTransferError. block: see `Block`. For very large objects use
    streams.py. client: of the node's channel."""
    outcome: Outcome = yield Request(client, lambda now, urgent: client.upload(index, subindex, now, urgent=urgent, block=block))
    if isinstance(outcome, SdoUploaded):
        return outcome.data
    assert isinstance(outcome, SdoAborted)
    raise SdoTransferError(outcome, "reading")


def download(client: SdoClient, index: int, subindex: int, data: Buffer, *, block: Block = False) -> Procedure[None]:
    """Write an object by SDO; return when the node has confirmed it. Raises SdoTransferError. block: see `Block`. data: the
    value's bytes, little-endian."""
    outcome: Outcome = yield Request(
        client, lambda now, urgent: client.download(index, subindex, data, now, urgent=urgent, block=block)
    )
    if not isinstance(outcome, SdoDownloaded):
        assert isinstance(outcome, SdoAborted)
        raise SdoTransferError(outcome, "writing")
