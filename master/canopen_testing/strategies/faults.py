"""What goes wrong: plans of faults for a World."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any, Final

from hypothesis import strategies as st
from hypothesis.errors import InvalidArgument
from hypothesis.strategies import SearchStrategy

from canopen_proto.abort import AbortCode
from canopen_proto.machine import MICROSECOND, MILLISECOND, SECOND
from canopen_proto.testing.faults import (
    BusOff,
    Copy,
    Corrupt,
    Delay,
    Fault,
    Lie,
    Lose,
    NodeFault,
    Pause,
    Refuse,
    Reorder,
    Replace,
    Reset,
    SecondMaster,
)
from canopen_proto.testing.patterns import Pattern, boot_up, emcy, heartbeat, nmt, sdo_answer, sdo_request, tpdo

CAN_FAULTS: Final = (Lose, Copy, Delay, Refuse, Pause, Reset, BusOff)
"""What happens on a CAN bus without gateways, and to right devices."""
ALL_FAULTS: Final = (*CAN_FAULTS, Reorder, Corrupt, Replace, Lie, SecondMaster)

_TIMES: Final = st.sampled_from([each * MILLISECOND for each in (0, 10, 100, 1000)]) | st.integers(
    0, 5 * SECOND // MICROSECOND
).map(lambda time: time * MICROSECOND)
_LATE: Final = st.sampled_from([each * MILLISECOND for each in (1, 20, 400, 2000)])
_LONG: Final = st.sampled_from([each * MILLISECOND for each in (50, 500, 5000)])
_NTH: Final = st.integers(1, 5)
_REFUSALS: Final = st.sampled_from(
    (AbortCode.GENERAL_ERROR, AbortCode.DEVICE_STATE, AbortCode.NO_SUCH_OBJECT, AbortCode.TIMED_OUT)
)
_OBJECTS: Final = st.sampled_from(((0x1018, 1), (0x1000, 0), (0x1018, 2), (0x1017, 0), (0x6041, 0)))
_FRAMES_OF_MASTERS: Final = ("000#0100", "000#0200", "000#8100", "080#")


def fault_plans(
    nodes: Collection[int], *, kinds: Collection[type[Fault]] = CAN_FAULTS, min_size: int = 0, max_size: int = 3
) -> SearchStrategy[list[Fault]]:
    """Return a strategy for what goes wrong in a World with these nodes: `World(faults=...)`.

    kinds: which faults, such as `Lose` and `Pause`; by default those of a CAN bus without gateways and of devices that keep to
    the standard; `ALL_FAULTS` has all. Each hits one frame, the first to the fifth of a service of one node, or happens once: a
    plan says exactly what went wrong. Bounds: min_size to max_size faults, in the first five seconds or on one of the first five
    frames. Shrinks towards none; one of them towards the loss of the first SDO answer of the lowest node.
    """
    wanted = [each for each in ALL_FAULTS if each in kinds]
    if not wanted or not nodes:
        raise InvalidArgument(f"no faults of {list(kinds)} for the nodes {list(nodes)}: name kinds, such as Lose, and nodes")
    return st.lists(_fault(sorted(nodes), wanted), min_size=min_size, max_size=max_size)


@st.composite
def _fault(draw: st.DrawFn, nodes: Sequence[int], kinds: Sequence[type[Fault]]) -> Fault:
    kind = draw(st.sampled_from(kinds))
    node_id = draw(st.sampled_from(nodes))
    if kind is SecondMaster:
        return SecondMaster(
            at=draw(_TIMES), frames=tuple(draw(st.lists(st.sampled_from(_FRAMES_OF_MASTERS), min_size=1, max_size=2)))
        )
    if kind is Lie:
        return Lie(node_id, draw(_OBJECTS), draw(st.integers(0, 0xFF)), nth=draw(_NTH))
    if kind is Refuse:
        return Refuse(node_id, code=draw(_REFUSALS), nth=draw(_NTH))
    if issubclass(kind, NodeFault):
        moment: dict[str, Any] = (
            {"at": draw(_TIMES)} if draw(st.booleans()) else {"on": draw(_services(node_id)), "nth": draw(_NTH)}
        )
        more: dict[str, Any] = {} if kind is Reset else {"lasts": draw(_LONG)}
        return kind(node_id, **moment, **more)
    met: dict[str, Any] = {"on": draw(_services(node_id)), "nth": draw(_NTH)}
    if kind in (Delay, Reorder):
        met["by"] = draw(_LATE)
    if kind is Reorder:
        met["gateway"] = "gateway"
    if kind is Corrupt:
        met["flip"] = bytes((1 << draw(st.integers(0, 7)),)).rjust(1 + draw(st.integers(0, 7)), b"\0")
    if kind is Replace:
        met["data"] = draw(st.binary(max_size=8))
    return kind(**met)


def _services(node_id: int) -> SearchStrategy[Pattern]:
    """The frames of a node, and to it."""
    services = (sdo_answer, sdo_request, heartbeat, boot_up, tpdo, emcy)
    return st.sampled_from([*(service(node_id) for service in services), nmt(node_id=node_id)])
