"""What a gateway's client hears of a bus: boot-ups, states, emergencies, PDOs; and the PDOs that it sends."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.frame import Frame
from canopen_proto.gateway import GatewayNews, NodeEar, NodeReport, PdoPort, PdoReport
from canopen_proto.machine import MILLISECOND, NEVER, Event, LocalProtocolError, Machine, Outbox
from canopen_proto.nmt import NmtState
from tests.examples import examples

NEWS = GatewayNews


def heard(machine: Machine) -> list[Event]:
    events = list(machine.out.events)
    machine.out.events.clear()
    return events


def report(node_id: int, kind: GatewayNews, *numbers: int) -> NodeReport:
    return NodeReport(node_id, 7, kind, numbers)


def test_nothing_is_reported_that_nobody_asked_for() -> None:
    ear = NodeEar(Outbox(), 7)
    for text in ("705#00", "705#05", "085#1023010000000000"):
        ear.receive(Frame.parse(text), 0)
    assert heard(ear) == []
    assert ear.out.frames == []


def test_boot_ups_and_emergencies_of_all_nodes_on_request() -> None:
    ear = NodeEar(Outbox(), 7)
    ear.hears_boot_ups = True
    ear.receive(Frame.parse("705#00"), 0)
    ear.receive(Frame.parse("705#05"), 0)
    ear.receive(Frame.parse("085#1023030102030405"), 0)
    ear.receive(Frame.parse("085#1023"), 0)
    assert heard(ear) == [
        report(5, NEWS.BOOT_UP),
        report(5, NEWS.EMCY, 0x2310, 3, 1, 2, 3, 4, 5),
        report(5, NEWS.EMCY, 0x2310, 0, 0, 0, 0, 0, 0),
    ]


def test_a_heartbeat_that_is_watched_begins_changes_is_lost_and_comes_back() -> None:
    ear = NodeEar(Outbox(), 7)
    ear.watch(5, 100 * MILLISECOND)
    assert ear.deadline == NEVER  # none has come
    ear.receive(Frame.parse("705#7F"), 0)
    ear.receive(Frame.parse("706#05"), 0)
    ear.receive(Frame.parse("705#7F"), 50 * MILLISECOND)
    ear.receive(Frame.parse("705#05"), 60 * MILLISECOND)
    assert heard(ear) == [
        report(5, NEWS.ERROR, 202),
        report(5, NEWS.STATE, int(NmtState.PRE_OPERATIONAL)),
        report(5, NEWS.STATE, int(NmtState.OPERATIONAL)),
    ]
    ear.handle_timeout(160 * MILLISECOND - 1)
    assert heard(ear) == []
    ear.handle_timeout(160 * MILLISECOND)
    assert heard(ear) == [report(5, NEWS.ERROR, 203)]
    ear.handle_timeout(1000 * MILLISECOND)
    ear.receive(Frame.parse("705#05"), 1000 * MILLISECOND)
    assert heard(ear) == [report(5, NEWS.ERROR, 202), report(5, NEWS.STATE, int(NmtState.OPERATIONAL))]
    ear.receive(Frame.parse("705#00"), 1050 * MILLISECOND)  # a boot-up gives it its full time again
    assert ear.deadline == 1150 * MILLISECOND
    ear.forget(5)
    assert (ear.deadline, ear.watched) == (NEVER, ())


def test_a_watch_needs_a_time_and_a_node() -> None:
    ear = NodeEar(Outbox(), 7)
    for node_id, time in ((0, MILLISECOND), (128, MILLISECOND), (5, 0)):
        with pytest.raises(LocalProtocolError):
            ear.watch(node_id, time)
    assert ear.watched == ()


@examples(200)
@given(st.lists(st.tuples(st.sampled_from([0x705, 0x085, 0x77F]), st.binary(max_size=8)), max_size=10))
def test_any_frame_is_heard_without_a_fault(frames: list[tuple[int, bytes]]) -> None:
    ear = NodeEar(Outbox(), 7)
    ear.watch(5, MILLISECOND)
    ear.hears_boot_ups = True
    for now, (can_id, data) in enumerate(frames):
        ear.receive(Frame(can_id, data), now)
    ear.handle_timeout(10 * MILLISECOND)
    assert all(isinstance(each, NodeReport) and 1 <= each.node_id <= 127 for each in heard(ear))


def test_a_pdo_is_taken_apart_and_put_together() -> None:
    port = PdoPort(Outbox(), 7, 1, 0x185, (16, 1, 7, 32), listens=True)
    assert list(port.can_ids()) == [0x185]
    port.receive(Frame.parse("185#37028100010000"), 0)
    assert port.values == (0x0237, 1, 0x40, 0x100)
    assert heard(port) == [PdoReport(0, 7, 1, (0x0237, 1, 0x40, 0x100))]
    port.receive(Frame.parse("185#3702"), 0)
    assert heard(port) == []
    sender = PdoPort(Outbox(), 7, 1, 0x205, (16, 1, 7, 32), listens=False)
    assert list(sender.can_ids()) == []
    sender.send((0x0237, 1, 0x40, 0x100), 0)
    assert [str(frame) for frame in sender.out.frames] == ["205#37028100010000"]


@pytest.mark.parametrize("values", [(1,), (1, 2, 3), (0x10000, 0), (-1, 0)])
def test_values_that_do_not_fit_send_nothing(values: tuple[int, ...]) -> None:
    port = PdoPort(Outbox(), 7, 1, 0x205, (16, 8), listens=False)
    with pytest.raises(LocalProtocolError):
        port.send(values, 0)
    assert port.out.frames == []


@pytest.mark.parametrize("cob_id", [0, 0x7F, 0x80, 0x85, 0x100, 0x180, 0x583, 0x603, 0x703, 0x7E5, 0x80000185])
def test_a_pdo_has_no_identifier_of_another_service(cob_id: int) -> None:
    with pytest.raises(LocalProtocolError, match="COB-ID"):
        PdoPort(Outbox(), 7, 1, cob_id, (8,), listens=False)


def test_a_pdo_has_64_bits() -> None:
    PdoPort(Outbox(), 7, 1, 0x205, (32, 32), listens=False)
    with pytest.raises(LocalProtocolError, match="65 bits"):
        PdoPort(Outbox(), 7, 1, 0x205, (32, 33), listens=False)
