"""scan: who is on the bus, by listening and by asking, without ever flooding it."""

from __future__ import annotations

import pytest

from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.frame import Frame
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import MILLISECOND, SECOND, LocalProtocolError, Outbox
from canopen_proto.manager.scan import AT_ONCE, LISTEN, NodeFound, Scanner, duration_of, scan
from canopen_proto.network import Network
from canopen_proto.nmt import NmtState
from canopen_proto.procedures.runner import ProcedureCancelled, ProcedureFailed, ProcedureFinished
from canopen_proto.procedures.steps import Procedure
from tests.core.bus import Bus
from tests.core.devices import io_device


class Scene:
    """A master with a Scanner, and devices."""

    def __init__(self) -> None:
        self.bus = Bus()
        self.master = self.bus.attach(Network())
        self.scanner = Scanner(self.master.out)
        self.master.attach(self.scanner)

    def device(self, node_id: int, heartbeat_ms: int = 0, dictionary: ObjectDictionary | None = None) -> LocalNode:
        network = self.bus.attach(Network())
        node = LocalNode(network.out, node_id, dictionary or io_device(node_id, heartbeat_ms))
        network.attach(node)
        node.boot(self.bus.now)
        self.bus.run(MILLISECOND)
        return node

    def run(self, procedure: Procedure[list[NodeFound]]) -> list[NodeFound]:
        self.master.run(procedure, self.bus.now)
        self.bus.run_until(lambda: any(isinstance(each, ProcedureFinished) for each in self.bus.events))
        (finished,) = self.bus.take_events(ProcedureFinished)
        result = finished.result
        assert isinstance(result, list)
        return result


def bare(**objects: int) -> ObjectDictionary:
    return ObjectDictionary([standard_object(int(index[1:], 16), value) for index, value in objects.items()])


def test_listening_alone_sends_nothing_and_finds_those_with_a_heartbeat() -> None:
    scene = Scene()
    scene.device(5, heartbeat_ms=500)
    scene.device(6)  # its boot-up frame is heard
    scene.bus.sent.clear()
    rows = scene.run(scan(scene.scanner, []))
    assert rows == [NodeFound(5, NmtState.PRE_OPERATIONAL), NodeFound(6, NmtState.PRE_OPERATIONAL)]
    assert all(frame.can_id == 0x705 for _, frame in scene.bus.sent)
    assert scene.bus.now >= LISTEN


def test_asking_finds_device_type_identity_and_name() -> None:
    scene = Scene()
    scene.device(5)
    dictionary = io_device(9).with_objects([standard_object(0x1008, "Test device")])
    scene.device(9, dictionary=dictionary)
    scene.scanner.heard.clear()  # as if they had booted before we came
    rows = scene.run(scan(scene.scanner, listen=0))
    assert rows == [
        NodeFound(5, None, 0x191, (0x29C, 7, 0, 0)),
        NodeFound(9, None, 0x191, (0x29C, 7, 0, 0), "Test device"),
    ]
    assert sorted(scene.bus.take_events(NodeFound), key=lambda row: row.node_id) == rows  # and each was reported


def test_an_object_that_a_device_lacks_is_none_and_a_refusal_is_a_sign_of_life() -> None:
    scene = Scene()
    scene.device(7, dictionary=bare(x1001=0))
    scene.scanner.heard.clear()
    (row,) = scene.run(scan(scene.scanner, [7], listen=0))
    assert (row.device_type, row.identity, row.name) == (None, (None, None, None, None), "")
    assert "0x06020000" in row.remark


def test_a_stopped_node_is_not_asked() -> None:
    scene = Scene()
    scene.bus.send("705#04")
    scene.bus.run(MILLISECOND)
    rows = scene.run(scan(scene.scanner, [5], listen=0))
    assert rows == [NodeFound(5, NmtState.STOPPED, remark="Stopped: no SDO in this state")]
    assert scene.bus.trace() == ["705#04"]


def test_a_node_that_is_heard_but_does_not_answer_gets_the_full_time() -> None:
    scene = Scene()
    scene.bus.send("705#05")
    scene.bus.run(MILLISECOND)
    start = scene.bus.now
    rows = scene.run(scan(scene.scanner, [5], listen=0, probe_timeout=10 * MILLISECOND, answer_timeout=300 * MILLISECOND))
    assert rows == [NodeFound(5, NmtState.OPERATIONAL, remark="heard, but does not answer SDO")]
    assert scene.bus.now - start >= 300 * MILLISECOND


def test_nodes_that_were_heard_are_asked_first() -> None:
    scene = Scene()
    scene.bus.send("77F#05")
    scene.bus.run(MILLISECOND)
    scene.run(scan(scene.scanner, listen=0))
    assert scene.bus.trace()[1] == "67F#4000100000000000"


@pytest.mark.parametrize("frame", ["705#", "705#0505", "705#42", "780#05", "700#05", "705#R1"])
def test_nonsense_is_nobody(frame: str) -> None:
    scene = Scene()
    scene.bus.send(frame)
    scene.bus.run(MILLISECOND)
    assert scene.run(scan(scene.scanner, [], listen=MILLISECOND)) == []


def test_an_empty_bus_takes_a_bounded_time_and_never_more_than_a_few_requests_at_once() -> None:
    scene = Scene()
    assert scene.run(scan(scene.scanner)) == []
    assert scene.bus.now <= duration_of(127) <= 5 * SECOND
    asked: set[int] = set()
    most = 0
    for _, frame in scene.bus.sent:
        if frame.data[0] == 0x40:
            asked.add(frame.can_id)
        else:
            assert frame.data[0] == 0x80  # the abort after a timeout
            asked.discard(frame.can_id)
        most = max(most, len(asked))
    assert most == AT_ONCE
    assert len(scene.bus.sent) == 2 * 127


def test_only_the_given_node_ids_are_asked_but_all_are_heard() -> None:
    scene = Scene()
    scene.device(5)
    scene.device(6)
    scene.bus.sent.clear()
    rows = scene.run(scan(scene.scanner, [6, 6], listen=0))
    assert [(row.node_id, row.device_type) for row in rows] == [(5, None), (6, 0x191)]
    assert not any(frame.can_id == 0x605 for _, frame in scene.bus.sent)


@pytest.mark.parametrize("node_id", [0, 128, -1])
def test_an_impossible_node_id_fails_before_anything_is_sent(node_id: int) -> None:
    scene = Scene()
    scene.master.run(scan(scene.scanner, [5, node_id]), scene.bus.now)
    scene.bus.settle()
    (failed,) = scene.bus.take_events(ProcedureFailed)
    assert isinstance(failed.error, LocalProtocolError)
    assert scene.bus.sent == []


def test_a_cancelled_scan_aborts_what_is_on_the_way_and_asks_no_more() -> None:
    scene = Scene()
    request = scene.master.run(scan(scene.scanner, listen=0), scene.bus.now)
    scene.bus.run(30 * MILLISECOND)
    scene.master.cancel(request, scene.bus.now)
    scene.bus.settle()
    assert scene.bus.take_events(ProcedureCancelled)[0].clean_up_error is None
    commands = [frame.data[0] for _, frame in scene.bus.sent]
    assert commands == [0x40] * AT_ONCE + [0x80] * AT_ONCE


def test_a_second_scan_uses_the_same_scanner() -> None:
    scene = Scene()
    scene.device(5)
    first = scene.run(scan(scene.scanner, [5], listen=0))
    assert scene.run(scan(scene.scanner, [5], listen=0)) == first
    scene.master.detach(scene.scanner)
    scene.bus.send(Frame.parse("706#05"))
    scene.bus.run(MILLISECOND)
    assert 6 not in scene.scanner.heard


def test_it_works_alone() -> None:
    scanner = Scanner(Outbox())
    scanner.receive(Frame.parse("703#05"), 0)
    assert scanner.heard == {3: NmtState.OPERATIONAL}
