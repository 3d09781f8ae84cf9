"""`Network.receive_many`: many frames at once are the same as one after the other; and what a quiet network leaves out."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TypeAlias

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Object, ObjectDictionary, Variable
from canopen_proto.emcy import EmcyReceived
from canopen_proto.frame import Frame, routing_key
from canopen_proto.frame_bits import FRAME_BITS
from canopen_proto.heartbeat import HeartbeatLost, HeartbeatReceived, NodeBooted
from canopen_proto.machine import MILLISECOND, SECOND, Event, LocalProtocolError, Machine, Time
from canopen_proto.multiplexer import mux
from canopen_proto.network import MAX_UNDRAINED_EVENTS, EventsDropped, Network
from canopen_proto.nmt import NmtCommand, NmtState
from canopen_proto.pdo.consumer import PdoReceived
from canopen_proto.pdo.mapping import MappedEntry, Mapping
from canopen_proto.procedures.runner import ProcedureFailed
from canopen_proto.procedures.steps import Procedure, Wait, upload, wait_for_event
from canopen_proto.remote_node import RemoteNode
from canopen_proto.sdo.client import SdoAborted, SdoUploaded
from canopen_proto.sync import SyncConsumer

NODE = 12
TPDO = 0x180 + NODE
HEARTBEAT = 0x700 + NODE
LOW, HIGH = 0x2001, 0x2002
TIMEOUT = 500 * MILLISECOND
ENTRIES = tuple(MappedEntry(index, 0, 32, DataType.UNSIGNED32, "") for index in (LOW, HIGH))
DICTIONARY = ObjectDictionary(
    [Object.of(name, [Variable(index, 0, name, DataType.UNSIGNED32)]) for name, index in (("low", LOW), ("high", HIGH))]
)

frames = st.one_of(
    st.builds(Frame, st.just(TPDO), st.binary(min_size=7, max_size=8)),
    st.builds(
        Frame, st.just(HEARTBEAT), st.sampled_from([b"\x00", b"\x04", b"\x05", b"\x7f", b"\x85", b"\x33", b"", b"\x05\x05"])
    ),
    st.builds(Frame, st.sampled_from([0x000, 0x080, 0x7FF]), st.just(b"\x01")),
    st.builds(Frame, st.just(0x12345), st.just(b""), st.just(1)),
)
Take: TypeAlias = Callable[[Network, Iterator[tuple[Frame, int | None]], Time], None]

traffic = st.lists(st.tuples(frames, st.one_of(st.none(), st.integers(0, 1 << 40))), max_size=12)


def watched_node() -> tuple[Network, RemoteNode]:
    network = Network()
    node = RemoteNode(network.out, NODE, DICTIONARY, heartbeat_timeout=TIMEOUT)
    network.attach(node)
    node.add_tpdo(1, routing_key(TPDO), Mapping(ENTRIES), 0)
    return network, node


def known(network: Network, node: RemoteNode) -> object:
    """All that the frames have left behind."""
    heartbeat = node.heartbeat
    return (
        dict(node.values.store), node.heard_at, node.nmt_state, node.boots, network.heard(NODE), network.last_heard,
        heartbeat.state, heartbeat.last_heard, heartbeat.lost, heartbeat.deadline,
    )  # fmt: skip


@given(st.lists(traffic, max_size=5))
def test_many_frames_at_once_are_the_same_as_one_after_the_other(bursts: list[list[tuple[Frame, int | None]]]) -> None:
    (one, node), (many, other), (hushed, third) = watched_node(), watched_node(), watched_node()
    hushed.quiet = True
    for number, burst in enumerate(bursts):
        now = number * 300 * MILLISECOND
        for network in (one, many, hushed):
            network.handle_timeout(now)
        for frame, timestamp in burst:
            one.receive(frame, now, timestamp)
        assert many.receive_many(iter(burst), now) is None
        assert hushed.receive_many(iter(burst), now) is None
        assert known(one, node) == known(many, other) == known(hushed, third)
        told = one.drain(now)[1]
        assert told == many.drain(now)[1]
        left = hushed.drain(now)[1]
        assert [each for each in told if not isinstance(each, (PdoReceived, HeartbeatReceived))] == [
            each for each in left if not isinstance(each, (PdoReceived, HeartbeatReceived))
        ]
    assert many.bits == sum(FRAME_BITS[len(frame.data)] for burst in bursts for frame, _ in burst)


def burst(*payloads: bytes) -> Iterator[tuple[Frame, int | None]]:
    return iter([*((Frame(TPDO, each), None) for each in payloads), (Frame(HEARTBEAT, b"\x05"), None)])


def after(kind: type[Event], node: RemoteNode) -> Procedure[None]:
    """Wait for an event of exactly this kind, then for a PDO."""
    for each in (kind, PdoReceived):
        yield Wait(None, node, lambda event: True, (each,))


def at_once(network: Network, received: Iterator[tuple[Frame, int | None]], now: Time) -> None:
    network.receive_many(received, now)


def one_by_one(network: Network, received: Iterator[tuple[Frame, int | None]], now: Time) -> None:
    for frame, timestamp in received:
        network.receive(frame, now, timestamp)


both_ways = pytest.mark.parametrize("take", [at_once, one_by_one])


@both_ways
def test_a_quiet_network_makes_no_events_of_the_usual_traffic_and_knows_as_much(take: Take) -> None:
    network, node = watched_node()
    network.receive_many(burst(bytes(8)), 0)  # its first heartbeat tells a state that is new
    network.drain(0)
    network.quiet = True
    take(network, burst(bytes(8), bytes.fromhex("0100000002000000")), 1)
    assert network.drain(1) == ([], [])
    assert (node.values[LOW << 8], node.values[HIGH << 8]) == (1, 2)
    assert node.heard_at == {LOW << 8: 1, HIGH << 8: 1}
    network.handle_timeout(1 + TIMEOUT)
    assert network.drain(1 + TIMEOUT)[1] == [HeartbeatLost(NODE, NmtState.OPERATIONAL, 1, TIMEOUT)]


def test_a_quiet_network_tells_what_is_new() -> None:
    network, _ = watched_node()
    network.quiet = True
    network.receive_many(iter([(Frame(HEARTBEAT, b"\x00"), None), (Frame(TPDO, bytes(3)), None)]), 0)
    kinds = [type(each).__name__ for each in network.drain(0)[1]]
    assert kinds == [NodeBooted.__name__, "NmtStateReported", "PdoLengthUnexpected"]


@both_ways
def test_a_procedure_hears_what_nobody_else_asks_for(take: Take) -> None:
    network, node = watched_node()
    network.quiet = True
    procedures = [
        after(PdoReceived, node),
        wait_for_event(node, PdoReceived, SECOND, "a PDO"),
    ]  # the second one is asked about all
    for procedure in procedures:
        request_id = network.run(procedure, 0)
        take(network, burst(bytes(8), bytes(8)), 0)
        ended = [each for each in network.drain(0)[1] if getattr(each, "request_id", None) == request_id]
        assert [type(each).__name__ for each in ended] == ["ProcedureFinished"]


def kinds_told(network: Network, now: Time) -> list[str]:
    return [type(each).__name__ for each in network.drain(now)[1]]


@both_ways
def test_a_procedure_that_waits_for_something_else_makes_a_quiet_network_no_louder(take: Take) -> None:
    network, node = watched_node()
    network.receive_many(burst(bytes(8)), 0)
    network.drain(0)
    network.quiet = True
    network.run(after(EmcyReceived, node), 0)
    take(network, burst(bytes(8), bytes(8)), 1)
    assert kinds_told(network, 1) == []


@both_ways
@pytest.mark.parametrize("are_one_burst", [True, False])
def test_a_procedure_hears_the_pdo_behind_what_it_waited_for(are_one_burst: bool, take: Take) -> None:
    """It waits for PDOs only once it is told of the emergency, in the drain behind both frames."""
    network, node = watched_node()
    network.receive_many(burst(bytes(8)), 0)
    network.drain(0)
    network.quiet = True
    network.run(after(EmcyReceived, node), 0)
    emergency, pdo = Frame(0x080 + NODE, bytes.fromhex("1023010000000000")), Frame(TPDO, bytes(8))
    for frames in ([emergency, pdo],) if are_one_burst else ([emergency], [pdo]):
        take(network, iter([(frame, None) for frame in frames]), 1)
    assert kinds_told(network, 1) == ["EmcyReceived", "PdoReceived", "ProcedureFinished"]


@both_ways
def test_a_procedure_that_a_listener_starts_in_a_burst_hears_what_comes_behind(take: Take) -> None:
    network, node = watched_node()
    network.receive_many(burst(bytes(8)), 0)
    network.drain(0)
    network.quiet = True
    node.add_listener(lambda muxes, now: network.runner.busy or network.run(after(HeartbeatReceived, node), now))
    take(network, burst(bytes(8)), 1)
    assert kinds_told(network, 1) == ["HeartbeatReceived"]
    take(network, burst(bytes(8)), 2)
    assert kinds_told(network, 2) == ["PdoReceived", "HeartbeatReceived", "ProcedureFinished"]


def test_what_is_no_frame_is_handed_back_at_its_place() -> None:
    network, node = watched_node()
    report = object()
    left = iter([(Frame(TPDO, bytes(8)), None), report, (Frame(HEARTBEAT, b"\x05"), None)])
    assert network.receive_many(left, 0) is report
    assert node.nmt_state is None
    assert network.receive_many(left, 0) is None
    assert node.nmt_state is NmtState.OPERATIONAL


class Broken(Machine):
    """A machine with a bug."""

    def can_ids(self) -> tuple[int, ...]:
        return (routing_key(TPDO),)

    def receive(self, frame: Frame, now: Time) -> None:
        raise LocalProtocolError("a bug")


def test_after_a_bug_a_network_is_as_loud_as_before() -> None:
    network, _ = watched_node()
    broken = Broken(network.out)
    network.attach(broken)
    network.quiet = True
    with pytest.raises(LocalProtocolError):
        network.receive(Frame(TPDO, bytes(8)), 0)
    network.detach(broken)
    network.quiet = False
    network.receive(Frame(TPDO, bytes(8)), 1)
    assert kinds_told(network, 1) == ["PdoReceived"]


def test_after_a_bug_no_event_has_the_time_stamp_of_the_frame_that_caused_it() -> None:
    network, _ = watched_node()
    broken = Broken(network.out)
    network.attach(broken)
    with pytest.raises(LocalProtocolError):
        network.receive(Frame(TPDO, bytes(8)), 0, 77)
    network.detach(broken)
    network.drain(0)
    network.receive(Frame(TPDO, bytes(8)), 1)
    (told,) = network.drain(1)[1]
    assert isinstance(told, PdoReceived)
    assert told.timestamp is None


def test_after_a_bug_the_frames_behind_it_are_left() -> None:
    network = Network()
    network.attach(Broken(network.out))
    left = burst(bytes(8))
    with pytest.raises(LocalProtocolError):
        network.receive_many(left, 0)
    assert not network.out.root.quiet
    assert network.out.timestamp is None
    assert network.receive_many(left, 0) is None
    assert network.last_heard == 0


@both_ways
def test_behind_a_report_a_quiet_network_reports_all_that_comes(take: Take) -> None:
    """Whoever is told of it may ask for more from then on: what stands behind it in the same burst, too."""
    network, _ = watched_node()
    network.receive(Frame(HEARTBEAT, b"\x05"), 0)
    network.drain(0)
    network.quiet = True
    usual = [(Frame(HEARTBEAT, b"\x05"), None), (Frame(TPDO, bytes(8)), None)]
    take(network, iter([*usual, (Frame(0x080 + NODE, bytes.fromhex("1023010000000000")), None), *usual]), 1)
    assert [type(event) for event in network.drain(1)[1]] == [EmcyReceived, HeartbeatReceived, PdoReceived]
    take(network, iter(usual), 2)
    assert not network.drain(2)[1]


@pytest.mark.parametrize("length", [8, 9])
def test_what_a_listener_of_a_pdo_causes_is_settled_by_its_node(length: int) -> None:
    """length: 8 goes the short way, 9 the long one."""
    network, node = watched_node()
    node.keep_commanded(mux(LOW))
    node.write(LOW, 6, 0)
    network.drain(0)
    node.add_listener(lambda muxes, now: node.sdo.abort_all(AbortCode.GENERAL_ERROR, now))
    network.receive(Frame(TPDO, bytes(length)), 1)
    assert SdoAborted in [type(event) for event in network.drain(1)[1]]
    assert node.may_hold(mux(LOW)) == {0, 6}  # it may have been executed


def test_a_watch_that_begins_behind_a_boot_up_notices_silence() -> None:
    """The short way of a heartbeat counts as one, too, for `set_timeout`."""
    network, node = watched_node()
    node.heartbeat.set_timeout(0, 0)
    for byte in (b"\x00", b"\x7f", b"\x7f"):
        network.receive(Frame(HEARTBEAT, byte), 1)
    network.drain(1)
    node.heartbeat.set_timeout(TIMEOUT, 2)
    assert network.next_deadline() == 2 + TIMEOUT
    network.handle_timeout(2 + TIMEOUT)
    assert HeartbeatLost in [type(event) for event in network.drain(2 + TIMEOUT)[1]]


@both_ways
def test_behind_a_report_of_another_burst_a_quiet_network_reports_all_that_comes_until_it_is_drained(take: Take) -> None:
    """A report of the transport cuts a burst in two, and both are drained together."""
    network, _ = watched_node()
    network.receive(Frame(HEARTBEAT, b"\x05"), 0)
    network.drain(0)
    network.quiet = True
    take(network, iter([(Frame(0x080 + NODE, bytes.fromhex("1023010000000000")), None)]), 1)
    take(network, iter([(Frame(HEARTBEAT, b"\x05"), None), (Frame(TPDO, bytes(8)), None)]), 1)
    assert kinds_told(network, 1) == ["EmcyReceived", "HeartbeatReceived", "PdoReceived"]


SYNC = Frame(0x080, b"")


def with_sync() -> tuple[Network, RemoteNode]:
    network, node = watched_node()
    network.attach(SyncConsumer(network.out))
    return network, node


@both_ways
def test_a_procedure_that_a_sync_starts_does_not_make_it_two(take: Take) -> None:
    network, node = with_sync()
    node.add_rpdo(1, routing_key(0x200 + NODE), Mapping(ENTRIES), 1)
    node.on_nmt_command(NmtCommand.START, 0)
    node.enable_rpdo(1, 0)
    heard: list[Time] = []

    def on_sync(now: Time) -> None:
        heard.append(now)
        network.run(after(EmcyReceived, node), now)

    node.add_listener(on_sync=on_sync)
    take(network, iter([(SYNC, None), (SYNC, None)]), 1)
    assert heard == [1, 1]
    assert [frame.can_id for frame in network.drain(1)[0]] == [0x200 + NODE] * 2


@both_ways
def test_a_listener_of_the_sync_that_leaves_takes_no_sync_from_another_one(take: Take) -> None:
    network, node = with_sync()
    heard: list[str] = []

    def once(now: Time) -> None:
        heard.append("once")
        node.remove_sync_listener(once)
        node.remove_sync_listener(third)

    def second(now: Time) -> None:
        heard.append("second")

    def third(now: Time) -> None:
        heard.append("third")

    for each in (once, second, third):
        node.add_listener(on_sync=each)
    take(network, iter([(SYNC, None), (SYNC, None)]), 1)
    assert heard == ["once", "second", "second"]


@both_ways
def test_a_node_that_comes_or_goes_at_a_sync_takes_no_sync_from_another_one(take: Take) -> None:
    network, node = with_sync()
    gone, last, new = (RemoteNode(network.out, number, DICTIONARY) for number in (13, 14, 15))
    for each in (gone, last):
        network.attach(each)

    def on_sync(now: Time) -> None:
        if now == 1:
            network.detach(gone)
            network.attach(new)

    node.add_listener(on_sync=on_sync)
    take(network, iter([(SYNC, None)]), 1)
    assert [each.last_sync for each in (node, gone, last)] == [1, None, 1]
    take(network, iter([(SYNC, None)]), 2)
    assert [each.last_sync for each in (node, gone, last, new)] == [2, None, 2, 2]


def reading(node: RemoteNode, answers: list[bytes]) -> Procedure[None]:
    answers.append((yield from upload(node.sdo, LOW, 0)))
    answers.append((yield from upload(node.sdo, HIGH, 0)))


@both_ways
@pytest.mark.parametrize("boot_up", [b"\x00", b"\x80"])
def test_whatever_comes_in_a_burst_with_a_boot_up_never_does_a_procedure_go_on_over_the_boot(take: Take, boot_up: bytes) -> None:
    """Its next request is open when the boot-up is handled, as if there had been a drain between the two frames."""
    network, node = watched_node()
    answers: list[bytes] = []
    request_id = network.run(reading(node, answers), 0)
    assert [str(frame) for frame in network.drain(0)[0]] == ["60C#4001200000000000"]
    answer = Frame.parse("58C#4301200001000000")
    take(network, iter([(answer, 5), (Frame(HEARTBEAT, boot_up), 6), (Frame(HEARTBEAT, b"\x7f"), 7)]), 1)
    frames, events = network.drain(1)
    assert answers == [bytes.fromhex("01000000")]
    (ended,) = [event for event in events if isinstance(event, ProcedureFailed)]
    assert (ended.request_id, str(ended.error)) == (
        request_id,
        "reading 0x2002:00 of node 12 was given up: 0x060A0023, resource not available: SDO connection",
    )
    assert [str(frame) for frame in frames] == ["60C#4002200000000000", "60C#8002200023000A06"]
    assert [type(event) for event in events][:2] == [SdoUploaded, NodeBooted]
    assert [getattr(event, "timestamp", None) for event in events if isinstance(event, NodeBooted)] == [6]


def test_whatever_was_dropped_meanwhile_a_procedure_gets_each_event_once_that_is_left_behind_a_boot_up() -> None:
    network, node = watched_node()
    emergency = (Frame(0x080 + NODE, bytes.fromhex("1023010000000000")), None)
    counted: list[Event] = []

    def counting() -> Procedure[None]:
        while True:
            event = yield Wait(None, node, lambda each: True, (EmcyReceived,))
            assert isinstance(event, EmcyReceived)
            counted.append(event)

    network.run(counting(), 0)
    many = MAX_UNDRAINED_EVENTS
    node.read(LOW, 0)
    answer = (Frame.parse("58C#4301200001000000"), None)
    network.receive_many(iter([*[emergency] * 9, answer, emergency, (Frame(HEARTBEAT, b"\x00"), None)]), 0)
    assert len(counted) == 9
    network.receive_many(iter([emergency] * many), 0)
    dropped = next(event.count for event in network.drain(0)[1] if isinstance(event, EventsDropped))
    assert dropped > 11  # the nine that were fed, and the two events of the boot, among them
    assert len({id(event) for event in counted}) == len(counted) == many + 10 - (dropped - 11)
