"""Listening only, and what a queue does with reports when nobody takes them."""

from __future__ import annotations

import can
import pytest
import trio

from canopen_proto.frame import Frame
from canopen_transports import BusState, BusStateChanged, ReceiveOverrun, TransportError, open_transport, parse_locator
from canopen_transports.diagnosis import queue_is_full
from canopen_transports.listen_only import backend_options, can_listen_only
from canopen_transports.receive_queue import MAX_EXTRA, ReceiveQueue

SYNC = Frame.parse("080#")


@pytest.mark.parametrize(
    ("interface", "options"),
    [
        ("pcan", {"state": can.BusState.PASSIVE}),
        ("systec", {"state": can.BusState.PASSIVE}),
        ("slcan", {"listen_only": True}),
        ("vector", {"listen_only": True}),
        ("nixnet", {"listen_only": True}),
        ("seeedstudio", {"operation_mode": "silent"}),
        ("kvaser", {"driver_mode": False}),
        ("cantact", {"monitor": True}),
        ("udp_multicast", {}),
    ],
)
def test_each_backend_has_its_own_word_for_it(interface: str, options: dict[str, object]) -> None:
    locator = parse_locator(f"{interface}:x?listen_only=true&more=1")
    assert can_listen_only(locator)
    assert backend_options(locator) == {"more": 1, **options}
    assert backend_options(parse_locator(f"{interface}:x?listen_only=false")) == {}


@pytest.mark.parametrize(
    ("text", "seen", "step"),
    [
        ("gs_usb:0?listen_only=true", "cannot make gs_usb listen only", "leave the option out"),
        ("pcan:PCAN_USBBUS1?listen_only=2", "true or false, not 2", "?listen_only=true"),
        (
            "can0@250k?listen_only=true",
            "the kernel sets listen-only mode",
            "sudo ip link set can0 down && sudo ip link set can0 up type can",
        ),
        ("pythoncan:socketcan:can0?listen_only=true", "the kernel sets listen-only mode", "bitrate 500000 listen-only on"),
    ],
)
def test_where_it_cannot_be_it_is_refused(text: str, seen: str, step: str) -> None:
    with pytest.raises(TransportError, match="CO100") as caught:
        trio.run(open_transport, text)
    assert seen in caught.value.seen
    assert step in caught.value.tries[0]


@pytest.mark.parametrize(
    ("text", "full"),
    [
        ("Failed to send: The transmit queue is full", True),
        ("xlCanTransmit failed (XL_ERR_QUEUE_IS_FULL)", True),
        ("Function canWrite failed - Transmit buffer overflow [Error Code -13]", True),
        ("The receive queue was read too late", False),
    ],
)
def test_each_driver_has_its_own_word_for_want_of_room(text: str, full: bool) -> None:
    assert queue_is_full(can.CanOperationError(text)) == full


def report(number: int) -> BusStateChanged:
    return BusStateChanged("here", BusState.FAULT, str(number))


async def _all_of(queue: ReceiveQueue) -> list[str]:
    taken = []
    while not queue.is_empty():
        match await queue.get():
            case ReceiveOverrun(lost=lost):
                taken.append(f"{lost} lost")
            case BusStateChanged(seen=seen):
                taken.append(seen)
            case frame, _:
                taken.append(str(frame))
    return taken


def test_reports_stand_at_their_place() -> None:
    queue = ReceiveQueue("here", 2)
    queue.report(report(1))
    queue.put((SYNC, None))
    queue.report(report(2))
    queue.put((SYNC, None))
    queue.put((SYNC, None))
    assert trio.run(_all_of, queue) == ["1", "080#", "2", "2 lost"]  # a report takes a frame's place


def test_a_queue_that_nobody_empties_stays_small() -> None:
    queue = ReceiveQueue("here", 1)
    queue.put((SYNC, None))
    for number in range(1000):
        queue.report(report(number))
        queue.put((SYNC, None))
    taken = trio.run(_all_of, queue)
    assert len(taken) <= 1 + MAX_EXTRA
    assert taken[0] == "080#"
    assert sum(int(each.split()[0]) for each in taken if each.endswith("lost")) == 1000
    assert [each for each in taken if each.isdecimal()][-1] == "999"


def test_overruns_that_the_driver_reports_add_up_where_nobody_takes_them() -> None:
    queue = ReceiveQueue("here", 1)
    queue.put((SYNC, None))
    for number in range(1000):
        queue.report(ReceiveOverrun("here", 3, "the adapter's buffer was full"))
        queue.report(report(number))
    taken = trio.run(_all_of, queue)
    assert len(taken) <= 3 + MAX_EXTRA
    assert sum(int(each.split()[0]) for each in taken if each.endswith("lost")) == 3000
    assert [each for each in taken if each.isdecimal()][-1] == "999"


def test_a_queue_holds_something() -> None:
    with pytest.raises(ValueError, match="can hold nothing"):
        ReceiveQueue("here", 0)
