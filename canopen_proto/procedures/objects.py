"""Procedures that read and write the objects of one node by name and value; `steps.upload` and `steps.download` use bytes. And
`urgent_request`, which waits for no other transfer of the node."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any, Final, Protocol, TypeVar, overload

from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.datatypes import Value, ValueRangeError
from canopen_proto.dictionary import Key, ObjectDictionary, ObjectNotFoundError, Variable
from canopen_proto.dictionary.typed import Readable, Writable
from canopen_proto.machine import MILLISECOND, Outbox, Outcome, RequestId, Time
from canopen_proto.procedures.steps import Cancelled, Procedure, ProcedureError, Request, SdoTransferError, Wait, act
from canopen_proto.sdo.client import Block, SdoAborted, SdoDownloaded, SdoUploaded

T = TypeVar("T", bound=Value)
R = TypeVar("R")

ABSENT: Final = (AbortCode.NO_SUCH_OBJECT, AbortCode.NO_SUCH_SUBINDEX)
"""The abort codes of a device that does not have an object."""
GIVES_WAY: Final = 50 * MILLISECOND
"""How long an urgent request waits for the transfer under way: one of a few frames is over by then."""


class ObjectAccess(Protocol):
    """A node whose objects can be read and written: a RemoteNode, or a view of one."""

    out: Outbox
    node_id: int

    @property
    def dictionary(self) -> ObjectDictionary:
        """See RemoteNode."""

    def read(self, key: Key, now: Time, *, urgent: bool = False, block: Block = False) -> RequestId:
        """See RemoteNode."""

    def write(self, key: Key, value: Value, now: Time, *, urgent: bool = False, block: Block = False) -> RequestId:
        """See RemoteNode."""

    def value_of(self, uploaded: SdoUploaded, variable: Variable) -> Value:
        """See RemoteNode."""

    def cancel(self, request_id: RequestId, now: Time) -> bool:
        """See RemoteNode."""

    def make_way(self, now: Time) -> None:
        """See RemoteNode."""


class UnexpectedLengthError(ProcedureError):
    """A node sent an object whose length does not fit its type."""


@overload
def read(node: ObjectAccess, key: Readable[T]) -> Procedure[T]: ...
@overload
def read(node: ObjectAccess, key: Key) -> Procedure[Value]: ...
def read(node: ObjectAccess, key: Any) -> Procedure[Any]:
    """Read an object by SDO; return its value, and keep it in `node.values`. Raises SdoTransferError, UnexpectedLengthError. key:
    see `Key`, or a typed one (dictionary/typed.py)."""
    variable = node.dictionary.variable(key)
    outcome: Outcome = yield Request(node, lambda now, urgent: node.read(variable, now, urgent=urgent))
    if isinstance(outcome, SdoUploaded):
        return value_of(node, variable, outcome)
    assert isinstance(outcome, SdoAborted)
    raise SdoTransferError(outcome, "reading")


def value_of(node: ObjectAccess, variable: Variable, uploaded: SdoUploaded) -> Value:
    """Return the value that an upload of this object brought. Raises UnexpectedLengthError."""
    try:
        return node.value_of(uploaded, variable)
    except ValueRangeError as error:
        raise UnexpectedLengthError(f"node {node.node_id}: {error}; is it described by another device's dictionary?") from error


def read_int(node: ObjectAccess, key: Key) -> Procedure[int]:
    """Read an object that holds an integer, and return it. key: see `Key`. Raises as `read`."""
    value = yield from read(node, key)
    assert isinstance(value, int)
    return value


def read_if_present(node: ObjectAccess, key: Key) -> Procedure[Value | None]:
    """Read an object; return None if the dictionary or the device does not have it. Raises SdoTransferError for any other
    abort."""
    try:
        variable = node.dictionary.variable(key)
    except ObjectNotFoundError:
        return None
    return (yield from unless_refused(read(node, variable), ABSENT))


def unless_refused(procedure: Procedure[R], codes: Collection[int] = ()) -> Procedure[R | None]:
    """Carry out a procedure; return None if the device refuses what it asks for. Raises SdoTransferError for any other end of a
    transfer. codes: the abort codes that count as a refusal, such as ABSENT; without any, all that the device sends."""
    try:
        return (yield from procedure)
    except SdoTransferError as failed:
        if failed.abort_code in codes if codes else failed.origin is AbortOrigin.PEER:
            return None
        raise


@overload
def write(node: ObjectAccess, key: Writable[T], value: T, *, urgent: bool = False) -> Procedure[None]: ...
@overload
def write(node: ObjectAccess, key: Key, value: Value, *, urgent: bool = False) -> Procedure[None]: ...
def write(node: ObjectAccess, key: Any, value: Value, *, urgent: bool = False) -> Procedure[None]:
    """Write a value, or a constant by its name, by SDO; returns when the node has confirmed it. Raises SdoTransferError. key: as
    of `read`.

    urgent: it goes before all queued requests of the node, and does not wait for a late answer; the writes of a clean-up always
    do. Raises LocalProtocolError or ValueRangeError, with nothing sent, if the dictionary forbids the write.
    """
    outcome: Outcome = yield Request(node, lambda now, is_urgent: node.write(key, value, now, urgent=urgent or is_urgent))
    if not isinstance(outcome, SdoDownloaded):
        assert isinstance(outcome, SdoAborted)
        raise SdoTransferError(outcome, "writing")


def urgent_request(node: ObjectAccess, submit: Callable[[Time], RequestId]) -> Procedure[Outcome]:
    """Make an urgent request, as a stop has to, and return its outcome. The transfer that it waits for is ended if it is not over
    within GIVES_WAY. submit: makes the request, with urgent=True.

    An SDO channel carries one transfer at a time (CiA 301 v4.2.0, 7.2.4). One of a long object takes minutes on a slow bus, and
    one whose answer is lost takes its whole time-out, which its caller has chosen.
    """
    request_id = yield from act(submit)
    try:
        while True:
            outcome = yield Wait(GIVES_WAY, node, lambda each: isinstance(each, Outcome) and each.request_id == request_id)
            if isinstance(outcome, Outcome):
                return outcome
            yield from act(node.make_way)
    except Cancelled:
        yield from act(lambda now: node.cancel(request_id, now))
        raise
