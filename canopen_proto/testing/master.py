"""`WorldMaster`: a master of a World for tests without async: the core's machines, and calls that let the world run."""

from __future__ import annotations

from collections.abc import Callable
from types import TracebackType
from typing import Any, TypeAlias, TypeVar

from canopen_proto.datatypes import Value
from canopen_proto.dictionary import Key, ObjectDictionary
from canopen_proto.machine import SECOND, Event, LocalProtocolError, RequestId, Time
from canopen_proto.network import Network
from canopen_proto.nmt import NmtCommand, NmtMaster
from canopen_proto.procedures.objects import read, write
from canopen_proto.procedures.runner import ProcedureCancelled, ProcedureFailed, ProcedureFinished
from canopen_proto.procedures.steps import Procedure
from canopen_proto.remote_node import RemoteNode
from canopen_proto.testing.member import WorldMember
from canopen_proto.testing.patterns import Names

T = TypeVar("T")


RunUntil: TypeAlias = Callable[[Callable[[], object], Time], None]
"""`World.run_until`."""


class WorldMaster(WorldMember):
    """See this module's text; made by `World.master`. runs: its network. nmt: the NMT commands.

    events: what its network has reported, in order.
    """

    def __init__(self, run_until: RunUntil, clock: Callable[[], Time], names: Names, network: Network | None = None) -> None:
        self.runs = Network() if network is None else network
        super().__init__("master", network=self.runs, on_event=self._on_event)
        self.nmt = NmtMaster(self.runs.out)
        self.runs.attach(self.nmt)
        self._run_until = run_until
        self._clock = clock
        self._names = names
        self._nodes: dict[int, RemoteNode] = {}
        self._on_end: dict[RequestId, Callable[[], object]] = {}
        self._ended: dict[RequestId, ProcedureFinished | ProcedureFailed | ProcedureCancelled] = {}

    def node(self, node_id: int, dictionary: ObjectDictionary | None = None) -> RemoteNode:
        """Return the view of a node. dictionary: by default that of the world's device. The first call for a node decides.

        Raises LocalProtocolError if there is none.
        """
        __tracebackhide__ = True
        if node_id not in self._nodes:
            known = self._names(node_id) if dictionary is None else dictionary
            if known is None:
                raise LocalProtocolError(f"the world has no node {node_id}: give its dictionary, or make the device first")
            node = RemoteNode(self.runs.out, node_id, known)
            self.runs.attach(node)
            self._nodes[node_id] = node
        return self._nodes[node_id]

    def read(self, node_id: int, key: Key) -> Value:
        """Read an object by SDO; return its value. Raises SdoTransferError, UnexpectedLengthError."""
        __tracebackhide__ = True
        return self.run(read(self.node(node_id), key))

    def write(self, node_id: int, key: Key, value: Value) -> None:
        """Write an object by SDO. Raises SdoTransferError."""
        __tracebackhide__ = True
        self.run(write(self.node(node_id), key, value))

    def command(self, command: NmtCommand, node_id: int = 0) -> None:
        """Send an NMT command. node_id: 0: to all nodes. It is on the bus as soon as time passes."""
        self.nmt.send(command, node_id, self._clock())

    def run(self, procedure: Procedure[T], limit: Time = 3600 * SECOND) -> T:
        """Let the world run until a procedure is over; return its result, or raise its error.

        Raises DidNotHappenError, and cancels the procedure, if it takes longer than `limit` (ns).
        """
        __tracebackhide__ = True
        request_id = self.start(procedure)
        try:
            self._run_until(lambda: request_id in self._ended, limit)
        except AssertionError:
            self.runs.cancel(request_id, self._clock())
            raise
        result: T = self.result(request_id)
        return result

    def start(self, procedure: Procedure[T], on_end: Callable[[], object] | None = None) -> RequestId:
        """Start a procedure; it runs as time passes. `has_ended` and `result` ask for its end, and on_end is called then."""
        request_id = self.runs.run(procedure, self._clock())
        if on_end is not None:
            self._on_end[request_id] = on_end
        return request_id

    def has_ended(self, request_id: RequestId) -> bool:
        """Whether a procedure is over."""
        return request_id in self._ended

    def result(self, request_id: RequestId) -> Any:
        """Return the result of a procedure that is over, or raise its error."""
        __tracebackhide__ = True
        ended = self._ended.pop(request_id)
        if isinstance(ended, ProcedureFailed):
            raise ended.error.with_traceback(_of_users(ended.error.__traceback__))
        assert isinstance(ended, ProcedureFinished), f"{ended} was cancelled"
        return ended.result

    def _on_event(self, event: Event) -> None:
        if isinstance(event, ProcedureFinished | ProcedureFailed | ProcedureCancelled):
            self._ended[event.request_id] = event
            self._on_end.pop(event.request_id, lambda: None)()


def _of_users(traceback: TracebackType | None) -> TracebackType | None:
    """Return a traceback without the frames of this package: a procedure of the test's own stays in it."""
    if traceback is None:
        return None
    inner = _of_users(traceback.tb_next)
    if traceback.tb_frame.f_globals.get("__name__", "").startswith("canopen_proto."):
        return inner
    return TracebackType(inner, traceback.tb_frame, traceback.tb_lasti, traceback.tb_lineno)
