"""Network: the driver's handle on everything that one participant runs on one bus."""

from __future__ import annotations

import pytest

from canopen_proto.abort import AbortCode
from canopen_proto.follower import Follower
from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, NEVER, SECOND, Event, LocalProtocolError, Machine, Outbox, Outcome, Time
from canopen_proto.network import MAX_UNDRAINED_EVENTS, EventsDropped, Network
from canopen_proto.nmt import NmtCommand, NmtCommandSent, NmtMaster
from canopen_proto.procedures.objects import read
from canopen_proto.procedures.runner import ProcedureCancelled, ProcedureFailed, ProcedureFinished
from canopen_proto.procedures.steps import Procedure, Request, StepTimeoutError, Wait, act, sleep, wait_for_event
from canopen_proto.remote_node import RemoteNode
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.sync import SyncConsumer, SyncProducer, SyncReceived, SyncSent
from tests.core.machines import Alarm, Answered, Box, Clerk, Heard, Rang, Withdrawn


class Followed(Event):
    """What a follower was told."""

    __slots__ = ("what",)
    __match_args__ = ("node_id", "what")

    def __init__(self, node_id: int, what: str) -> None:
        self.node_id = node_id
        self.what = what


class Shadow(Machine):
    """A follower that tells what it is told, as a RemoteNode would send PDOs."""

    def __init__(self, out: Outbox, node_id: int) -> None:
        super().__init__(out)
        self.node_id = node_id

    def on_sync(self, counter: int | None, now: Time, *, heard: bool = False) -> None:
        self.out.frames.append(Frame(0x200 + self.node_id))
        self.out.events.append(Followed(self.node_id, f"SYNC {counter} at {now}"))

    def on_nmt_command(self, command: NmtCommand, now: Time) -> None:
        self.out.events.append(Followed(self.node_id, command.name))


def attached_alarm(network: Network, name: str = "a", keys: tuple[int, ...] = (), deadline: Time = NEVER) -> Alarm:
    alarm = Alarm(network.out, name, keys, deadline)
    network.attach(alarm)
    return alarm


def ask(clerk: Clerk, name: str) -> Procedure[object]:
    return (yield Request(clerk, lambda now, urgent: clerk.ask(name, urgent)))


# ---- the driver loop ----


def test_a_new_network_wants_nothing() -> None:
    network = Network()
    assert network.can_ids() == ()
    assert network.next_deadline() == NEVER
    network.receive(Frame.parse("705#00"), 0)
    network.handle_timeout(5)
    assert network.drain(5) == ([], [])


def test_frames_and_wakes_reach_the_machines_and_drain_hands_out_once() -> None:
    network = Network()
    attached_alarm(network, "a", (0x705,), deadline=10)
    attached_alarm(network, "b", (0x705, 0x706))
    assert network.can_ids() == (0x705, 0x706)
    frame = Frame.parse("705#05")
    network.receive(frame, 1)
    assert network.next_deadline() == 10
    network.handle_timeout(9)
    network.handle_timeout(10)
    assert network.drain(10) == ([], [Heard(0, "a", frame, None), Heard(0, "b", frame, None), Rang(0, "a", 10)])
    assert network.drain(10) == ([], [])


def test_what_drain_hands_out_is_the_drivers() -> None:
    network = Network()
    master = NmtMaster(network.out)
    network.attach(master)
    master.start(5, 0)
    frames, events = network.drain(0)
    master.stop(5, 0)
    assert [str(frame) for frame in frames] == ["000#0105"]
    assert events == [NmtCommandSent(5, NmtCommand.START)]
    assert [str(frame) for frame in network.drain(0)[0]] == ["000#0205"]


def test_frames_that_come_before_the_driver_drains_find_the_new_routes() -> None:
    network = Network()
    box = Box(network.out)
    network.attach(box)
    alarm, deep = attached_alarm(network), Alarm(box.inner, "deep")
    box.put(deep)
    alarm.listen(1)
    deep.listen(2)
    network.receive(Frame(1), 0)
    network.receive(Frame(2), 0)
    alarm.listen(2)
    network.receive(Frame(1), 0)
    network.receive(Frame(2), 0)
    assert [report.name for report in network.drain(0)[1] if isinstance(report, Heard)] == ["a", "deep", "deep", "a"]
    deep.listen(7)
    assert network.can_ids() == (2, 7)


def test_detached_means_no_frame_no_wake_and_no_news() -> None:
    network = Network()
    alarm, shadow = attached_alarm(network, "a", (1,), 10), Shadow(network.out, 5)
    network.attach(shadow)
    network.detach(alarm)
    network.detach(shadow)
    network.detach(shadow)
    NmtMaster(network.out).start(5, 0)
    network.receive(Frame(1), 0)
    network.handle_timeout(20)
    assert network.drain(20)[1] == [NmtCommandSent(5, NmtCommand.START)]


def test_a_machine_of_another_network_is_refused() -> None:
    network = Network()
    with pytest.raises(LocalProtocolError, match="another Outbox"):
        network.attach(Shadow(Network().out, 5))
    assert network.drain(0) == ([], [])


# ---- time ----


def test_a_clock_that_runs_back_counts_as_the_last_time_seen() -> None:
    network = Network()
    alarm = attached_alarm(network, "a", (1,), 100)
    network.receive(Frame(1), 100)
    network.handle_timeout(50)
    assert alarm.rang_at == [100]
    request_id = network.run(sleep(10), 40)
    assert network.next_deadline() == 110
    network.cancel(request_id, 30)
    network.drain(20)
    alarm.set(100)
    network.handle_timeout(0)
    assert alarm.rang_at == [100, 100]
    network.receive(Frame(1), 0)
    network.handle_timeout(120)
    alarm.set(110)
    network.receive(Frame(1), 0)
    network.handle_timeout(0)
    assert alarm.rang_at == [100, 100, 120]


def test_a_clock_may_begin_below_zero() -> None:
    network = Network()
    network.run(sleep(10), -100)
    assert network.next_deadline() == -90
    network.handle_timeout(-90)
    assert [type(report) for report in network.drain(-90)[1]] == [ProcedureFinished]


def test_the_timestamp_belongs_to_the_frame() -> None:
    network = Network()
    network.attach(SyncConsumer(network.out))
    attached_alarm(network, "a", (1,))
    network.receive(Frame.parse("080#"), 5, timestamp=1_700_000_000_000_000_000)
    network.receive(Frame(1), 5)
    assert network.out.timestamp is None
    assert network.drain(5)[1] == [SyncReceived(0, None, 1_700_000_000_000_000_000), Heard(0, "a", Frame(1), None)]
    network.receive(Frame(1), 5, timestamp=0)
    assert network.out.timestamp is None
    assert network.drain(5)[1] == [Heard(0, "a", Frame(1), 0)]


# ---- what one participant's machines tell each other ----


def test_a_sync_that_is_sent_or_heard_reaches_each_follower() -> None:
    network = Network()
    producer, consumer = SyncProducer(network.out), SyncConsumer(network.out)
    for machine in (producer, consumer, Shadow(network.out, 5), Shadow(network.out, 6)):
        network.attach(machine)
    assert isinstance(Shadow(network.out, 7), Follower)
    producer.send(1)  # a command: nothing but drain sees it
    frames, events = network.drain(1)
    assert [str(frame) for frame in frames] == ["080#", "205#", "206#"]  # the PDOs right behind SYNC
    assert events == [SyncSent(0, None, 0), Followed(5, "SYNC None at 1"), Followed(6, "SYNC None at 1")]
    network.receive(Frame.parse("080#"), 2)
    assert network.drain(2)[1][1:] == [Followed(5, "SYNC None at 2"), Followed(6, "SYNC None at 2")]
    producer.start(MILLISECOND, 10, 2)
    network.drain(10)
    assert network.next_deadline() == 10 + MILLISECOND
    network.handle_timeout(10 + MILLISECOND)
    assert Followed(5, f"SYNC 2 at {10 + MILLISECOND}") in network.drain(10 + MILLISECOND)[1]


def test_an_nmt_command_that_we_send_reaches_the_followers_whom_it_is_for() -> None:
    network = Network()
    master = NmtMaster(network.out)
    for machine in (master, Shadow(network.out, 5), Shadow(network.out, 6)):
        network.attach(machine)
    master.start(5, 0)
    master.stop(0, 0)
    assert network.drain(0)[1] == [
        NmtCommandSent(5, NmtCommand.START), NmtCommandSent(0, NmtCommand.STOP),
        Followed(5, "START"), Followed(5, "STOP"), Followed(6, "STOP"),
    ]  # fmt: skip


def test_news_is_followed_once_however_often_the_driver_looks() -> None:
    network = Network()
    network.attach(Shadow(network.out, 5))
    attached_alarm(network, "a", (1,), deadline=3)
    SyncProducer(network.out).send(0)
    network.receive(Frame(1), 1)
    network.receive(Frame(1), 2)
    network.handle_timeout(3)
    network.run(sleep(1), 3)
    events = network.drain(4)[1]
    assert [report for report in events if isinstance(report, Followed)] == [Followed(5, "SYNC None at 1")]


# ---- a driver that does not drain ----


def test_the_oldest_notifications_are_dropped_and_counted() -> None:
    network = Network()
    attached_alarm(network, "a", (1,))
    sent = MAX_UNDRAINED_EVENTS * 2 + 7
    for number in range(sent):
        network.receive(Frame(1), number, timestamp=number)
        assert len(network.out.events) <= MAX_UNDRAINED_EVENTS
    events = network.drain(sent)[1]
    dropped = events[0]
    assert isinstance(dropped, EventsDropped)
    assert dropped.count + len(events) - 1 == sent
    assert [report.timestamp for report in events[1:] if isinstance(report, Heard)] == list(range(dropped.count, sent))
    assert network.drain(sent)[1] == []  # it is told once


def test_outcomes_are_never_dropped() -> None:
    network = Network()
    clerk = Clerk(network.out)
    network.attach(clerk)
    attached_alarm(network, "a", (1,))
    requests = [clerk.ask(str(number), False) for number in range(MAX_UNDRAINED_EVENTS + 50)]
    for number in range(len(requests)):
        network.receive(Frame(1), number)
        clerk.answer(str(number))
    events = network.drain(0)[1]
    assert [report.request_id for report in events if isinstance(report, Outcome)] == requests
    heard = sum(isinstance(report, Heard) for report in events)
    assert isinstance(events[0], EventsDropped)
    assert events[0].count + heard == len(requests)


def test_shedding_forgets_no_reaction() -> None:
    network = Network()
    network.attach(Shadow(network.out, 5))
    alarm = attached_alarm(network, "a", deadline=1)
    producer = SyncProducer(network.out)
    for _ in range(MAX_UNDRAINED_EVENTS + 1):
        producer.send(0)
    network.handle_timeout(1)
    events = network.drain(1)[1]
    assert alarm.rang_at == [1]
    # All were followed before any was dropped: a PDO for each SYNC.
    assert isinstance(events[0], EventsDropped)
    assert events[0].count + len(events) - 1 == 2 * (MAX_UNDRAINED_EVENTS + 1) + 1


def test_a_flood_that_procedures_make_while_they_are_fed_is_handed_out_whole() -> None:
    network = Network()
    clerk, alarm = Clerk(network.out), attached_alarm(network)
    network.attach(clerk)

    def loud() -> Procedure[object]:
        yield from ask(clerk, "a")
        for _ in range(MAX_UNDRAINED_EVENTS + 1):
            yield from act(lambda now: alarm.receive(Frame(1), now))
        return (yield from ask(clerk, "b"))

    network.run(loud(), 0)
    clerk.answer("a")
    events = network.drain(0)[1]
    assert len(events) == MAX_UNDRAINED_EVENTS + 2
    clerk.answer("b")
    assert isinstance(network.drain(0)[1][-1], ProcedureFinished)


# ---- procedures ----


def test_a_procedures_next_request_leaves_in_the_turn_of_the_answer() -> None:
    network = Network()
    clerk = Clerk(network.out)
    network.attach(clerk)

    def both() -> Procedure[str]:
        yield from ask(clerk, "a")
        yield from ask(clerk, "b")
        return "done"

    request_id = network.run(both(), 0)
    assert clerk.log == ["a"]
    clerk.answer("a")
    network.drain(0)
    assert clerk.log == ["a", "b"]
    clerk.answer("b")
    assert network.drain(0)[1][-1] == ProcedureFinished(0, request_id, "done")


def test_events_that_procedures_cause_feed_procedures_in_the_same_turn() -> None:
    network = Network()
    clerk, alarm = Clerk(network.out), attached_alarm(network, "a", (1,))
    network.attach(clerk)

    def first() -> Procedure[None]:
        yield from ask(clerk, "a")
        yield from act(lambda now: alarm.receive(Frame(1), now))

    def second() -> Procedure[Heard]:
        return (yield from wait_for_event(alarm, Heard, SECOND, "a frame"))

    network.run(first(), 0)
    network.run(second(), 0)
    clerk.answer("a")
    events = network.drain(0)[1]
    assert [type(report) for report in events] == [Answered, Heard, ProcedureFinished, ProcedureFinished]


def test_run_and_cancel_say_what_follows() -> None:
    network = Network()
    clerk = Clerk(network.out)
    network.attach(clerk)
    first = network.run(ask(clerk, "a"), 0)
    network.cancel(first, 1)
    network.cancel(first, 2)
    network.cancel(9999, 2)
    assert network.drain(2)[1] == [Withdrawn(1, first + 1, "a"), ProcedureCancelled(0, first, None)]


def test_one_runner_over_two_networks() -> None:
    left = Network()
    right = Network(left.runner)
    clerks = [Clerk(left.out), Clerk(right.out)]
    alarm = attached_alarm(right, "a", (1,))
    left.attach(clerks[0])
    right.attach(clerks[1])
    # The same numbers of requests on both: an answer on one bus is none on the other.
    left_id, right_id = clerks[0].ask("x", False), clerks[1].ask("x", False)
    assert left_id == right_id

    def across() -> Procedure[object]:
        yield from ask(clerks[1], "a")
        yield from ask(clerks[0], "b")
        yield Wait(None, alarm, lambda report: isinstance(report, Rang))
        return (yield from ask(clerks[1], "c"))

    request_id = right.run(across(), 0)
    clerks[0].answer("x")
    left.drain(0)
    clerks[1].answer("x")
    right.drain(0)
    assert clerks[0].log == ["x"]
    clerks[1].answer("a")
    left.drain(0)
    assert clerks[0].log == ["x"]
    right.drain(0)
    assert clerks[0].log == ["x", "b"]
    clerks[0].answer("b")
    left.out.events.append(Rang(0, "of another bus", 0))
    left.drain(0)
    assert left.drain(0)[1] == []
    alarm.set(5)
    assert right.next_deadline() == 5
    right.handle_timeout(5)
    right.drain(5)
    clerks[1].answer("c")
    assert [type(report) for report in right.drain(5)[1]] == [Answered]
    (finished,) = left.drain(5)[1]  # outcomes of procedures leave by the network whose runner it is
    assert isinstance(finished, ProcedureFinished)
    assert finished.request_id == request_id


def test_cancelled_from_the_other_network() -> None:
    left = Network()
    right = Network(left.runner)
    request_id = right.run(sleep(SECOND), 0)
    right.cancel(request_id, 1)
    assert right.drain(1)[1] == []
    assert left.drain(1)[1] == [ProcedureCancelled(0, request_id, None)]


def test_a_procedure_times_out_by_the_networks_deadline() -> None:
    network = Network()
    alarm = attached_alarm(network)
    network.run(wait_for_event(alarm, Heard, 5 * MILLISECOND, "the frame"), 0)
    assert network.next_deadline() == 5 * MILLISECOND
    network.handle_timeout(5 * MILLISECOND - 1)
    assert network.drain(5 * MILLISECOND - 1)[1] == []
    network.handle_timeout(5 * MILLISECOND)
    (failed,) = network.drain(5 * MILLISECOND)[1]
    assert isinstance(failed, ProcedureFailed)
    assert isinstance(failed.error, StepTimeoutError)
    assert str(failed.error) == "the frame did not come within 0.005 s"


# ---- what is attached ----


def test_a_request_to_a_node_that_is_not_attached_never_stays_without_an_outcome() -> None:
    network = Network()
    node = RemoteNode(network.out, 9, drive_dictionary())

    def failure(requester: RemoteNode) -> tuple[str, list[Frame]]:
        request_id = network.run(read(requester, "statusword"), 0)
        frames, events = network.drain(0)
        (ended,) = events
        assert isinstance(ended, ProcedureFailed)
        assert ended.request_id == request_id
        assert isinstance(ended.error, LocalProtocolError)
        return str(ended.error), frames

    told = "the RemoteNode of node 9 is not attached, so no answer would reach it: network.attach(...) comes first"
    assert failure(node) == (told, [])
    network.attach(node)
    network.run(read(node, "statusword"), 0)
    frames, events = network.drain(0)
    assert (len(frames), events) == (1, [])
    assert network.next_deadline() < NEVER
    node.sdo.abort_all(AbortCode.GENERAL_ERROR, 0)
    network.detach(node)
    network.drain(0)
    assert failure(node) == (told, [])


def test_a_machine_is_attached_once_and_each_node_has_one_view() -> None:
    network, other = Network(), Network()
    node = RemoteNode(network.out, 9, drive_dictionary())
    network.attach(node)
    with pytest.raises(LocalProtocolError, match="the RemoteNode is attached already"):
        network.attach(node)
    second = RemoteNode(network.out, 9, drive_dictionary())
    with pytest.raises(LocalProtocolError, match="there is a RemoteNode of node 9 in this network already"):
        network.attach(second)
    network.attach(RemoteNode(network.out, 10, drive_dictionary()))
    other.attach(RemoteNode(other.out, 9, drive_dictionary()))
    network.detach(node)
    network.attach(second)
