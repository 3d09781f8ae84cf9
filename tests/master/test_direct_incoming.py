"""The bounded queue of the PDOs that came."""

import threading
import time

from canopen_master.direct import IncomingPdos
from canopen_proto.pdo.consumer import PdoReceived
from canopen_proto.pdo.mapping import Mapping


def pdo(number: int) -> PdoReceived:
    return PdoReceived(12, number, 0x18C, Mapping(()), b"", (), None)


def test_first_in_first_out() -> None:
    queue = IncomingPdos()
    for number in range(3):
        queue.put(pdo(number))
    assert len(queue) == 3
    assert [each.number for each in queue] == [0, 1, 2]
    assert len(queue) == 0
    assert queue.dropped == 0


def test_what_nobody_takes_is_dropped_oldest_first_and_counted() -> None:
    queue = IncomingPdos(size=4)
    for number in range(10):
        queue.put(pdo(number))
    assert [each.number for each in queue] == [6, 7, 8, 9]
    assert queue.dropped == 6


def test_get_waits_no_longer_than_it_is_told() -> None:
    queue = IncomingPdos()
    before = time.monotonic()
    assert queue.get(0) is None
    assert queue.get(0.02) is None
    assert time.monotonic() - before >= 0.02


def test_get_waits_for_the_next_one() -> None:
    queue = IncomingPdos()
    thread = threading.Timer(0.02, queue.put, (pdo(7),))
    thread.start()
    received = queue.get()
    assert received is not None
    assert received.number == 7
    thread.join()


def test_clear() -> None:
    queue = IncomingPdos()
    queue.put(pdo(1))
    queue.clear()
    assert queue.get(0) is None
