"""A procedure run against a device that is nothing but a table of numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TypeVar, cast

from canopen_proto.abort import AbortCode
from canopen_proto.frame import Frame
from canopen_proto.machine import SECOND
from canopen_proto.network import Network
from canopen_proto.procedures.runner import ProcedureFailed, ProcedureFinished
from canopen_proto.procedures.steps import Procedure
from canopen_proto.remote_node import RemoteNode
from canopen_proto.simulation.drive.dictionary import drive_dictionary

Result = TypeVar("Result")


def run_against(
    objects: Mapping[tuple[int, int], int],
    make: Callable[[RemoteNode], Procedure[Result]],
    abort: int | None = AbortCode.NO_SUCH_OBJECT,
) -> Result | Exception:
    """Return what a procedure gives, with a node that has these objects, of 4 bytes each, and answers `abort` for all others.

    abort: None: it does not answer at all.
    """
    network = Network()
    node = RemoteNode(network.out, 5, drive_dictionary())
    network.attach(node)
    network.run(make(node), 0)
    for _ in range(100):
        frames, events = network.drain(0)
        for event in events:
            if isinstance(event, ProcedureFinished):
                return cast(Result, event.result)
            if isinstance(event, ProcedureFailed):
                return event.error
        for frame in frames:
            key = int.from_bytes(frame.data[1:3], "little"), frame.data[3]
            answer = b"\x43" + frame.data[1:4] + (objects.get(key, 0) & 0xFFFF_FFFF).to_bytes(4, "little")
            if abort is None:
                continue
            if key not in objects:
                answer = b"\x80" + frame.data[1:4] + abort.to_bytes(4, "little")
            network.receive(Frame(0x585, answer), 0)
        if not frames:
            network.handle_timeout(SECOND)
    raise AssertionError("it reads on and on")
