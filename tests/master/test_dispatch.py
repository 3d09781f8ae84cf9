"""The Dispatcher: a burst of events that is only queued is handed over at once, and each queue holds what it held before."""

from __future__ import annotations

from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from canopen_master import open_master
from canopen_master.participant.bus import Bus
from canopen_master.participant.dispatch import Dispatcher
from canopen_master.participant.subscription import Subscription
from canopen_proto.heartbeat import HeartbeatReceived, NodeBooted
from canopen_proto.machine import Event
from canopen_proto.network import EventsDropped, Network
from canopen_proto.nmt import NmtState
from canopen_proto.pdo.consumer import PdoReceived
from canopen_transports import open_transport
from tests.transports.support import run

SIZE = 4
KINDS: tuple[type[Event], ...] = (HeartbeatReceived, NodeBooted, Event)

events = st.one_of(
    st.builds(HeartbeatReceived, st.integers(1, 3), st.just(NmtState.OPERATIONAL), st.integers(0, 9)),
    st.builds(NodeBooted, st.integers(1, 3), st.integers(0, 9)),
)
watched = st.lists(st.tuples(st.sampled_from(KINDS), st.integers(0, 3)), min_size=1, max_size=4)


@given(st.lists(st.lists(events, max_size=9), max_size=4), watched, st.booleans())
def test_a_queue_holds_the_newest_events_in_order_and_counts_those_that_it_lost(
    bursts: list[list[Event]], wishes: list[tuple[type[Event], int]], also_called: bool
) -> None:
    async def main() -> None:
        async with await open_transport("virtual:dispatch") as transport:
            bus, dispatcher = Bus("bus", transport, Network()), Dispatcher()
            queues = []
            for kind, node_id in wishes:
                queue: Subscription[Any] = Subscription(lambda _: None, SIZE)
                dispatcher.watch((kind,), queue.put, None, node_id, queue.put_all)
                queues.append(queue)
            called: list[Event] = []
            if also_called:  # then each event is told to all, before the next one
                dispatcher.watch((NodeBooted,), called.append)
            for burst in bursts:
                dispatcher.dispatch(bus, burst)
            told = [event for burst in bursts for event in burst]
            for queue, (kind, node_id) in zip(queues, wishes, strict=True):
                meant = [each for each in told if isinstance(each, kind) and node_id in (0, each.node_id)]
                assert queue.dropped == max(0, len(meant) - SIZE)
                assert queue.take() == meant[-SIZE:]
            assert called == [each for each in told if also_called and isinstance(each, NodeBooted)]

    run(main)


@given(st.lists(st.tuples(st.integers(0, 1), events), max_size=9), st.integers(0, 1), st.integers(0, 3))
def test_whoever_watches_one_bus_never_is_told_what_its_namesake_on_another_one_sends(
    told: list[tuple[int, Event]], watched_bus: int, node_id: int
) -> None:
    async def main() -> None:
        async with await open_transport("virtual:one") as one, await open_transport("virtual:two") as two:
            buses = Bus("one", one, Network()), Bus("two", two, Network())
            dispatcher = Dispatcher()
            called: list[Event] = []
            queue: Subscription[Any] = Subscription(lambda _: None)
            dispatcher.watch((Event,), called.append, buses[watched_bus], node_id)
            dispatcher.watch((NodeBooted,), queue.put, buses[watched_bus], node_id, queue.put_all)
            for number, event in told:
                dispatcher.dispatch(buses[number], [event])
            meant = [event for number, event in told if number == watched_bus and node_id in (0, event.node_id)]
            assert called == meant
            assert queue.take() == [event for event in meant if isinstance(event, NodeBooted)]

    run(main)


def test_whoever_was_unwatched_by_what_an_event_caused_never_is_told_this_event() -> None:
    async def main() -> None:
        async with await open_transport("virtual:dispatch") as transport:
            bus, dispatcher = Bus("bus", transport, Network()), Dispatcher()
            told: list[Event] = []

            def end(event: Event) -> None:
                dispatcher.unwatch(first)
                dispatcher.unwatch(second)

            first = dispatcher.watch((NodeBooted,), end)
            second = dispatcher.watch((NodeBooted,), told.append)
            third: list[Event] = []
            dispatcher.watch((Event,), third.append)
            events = [NodeBooted(1, 0), NodeBooted(2, 0)]
            dispatcher.dispatch(bus, events)
            assert (told, third) == ([], events)

    run(main)


def test_whoever_begins_or_ends_to_watch_in_the_middle_of_a_burst_is_told_accordingly_of_the_rest() -> None:
    async def main() -> None:
        async with await open_transport("virtual:dispatch") as transport:
            bus, dispatcher = Bus("bus", transport, Network()), Dispatcher()
            told: list[Event] = []
            queue: Subscription[Any] = Subscription(lambda _: None)

            def change(event: Event) -> None:
                if event is second:
                    dispatcher.unwatch(watcher)
                    dispatcher.watch((NodeBooted,), told.append)
                    dispatcher.watch((Event,), queue.put, queue=queue.put_all)

            watcher = dispatcher.watch((NodeBooted,), change)
            first, second, third, other = NodeBooted(1, 0), NodeBooted(1, 1), NodeBooted(1, 2), EventsDropped(0, 1)
            dispatcher.dispatch(bus, [first, second, third, other])
            assert told == [third]
            assert queue.take() == [third, other]

    run(main)


def test_a_network_is_quiet_while_nobody_asks_for_pdos_and_heartbeats() -> None:
    async def main() -> None:
        async with open_master("virtual:quiet") as master:
            network = master.bus().network
            assert network.quiet
            with master.events(NodeBooted):
                assert network.quiet
            for kind in (HeartbeatReceived, PdoReceived, Event):
                with master.events(kind):
                    assert not network.quiet
                assert network.quiet

    run(main)
