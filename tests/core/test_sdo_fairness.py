"""Any number of tasks on one channel: they take turns, and none starves."""

from __future__ import annotations

import itertools
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, SECOND, Event, Outbox, RequestId, Time
from canopen_proto.procedures.objects import read
from canopen_proto.procedures.steps import Procedure, current_time, sleep
from canopen_proto.remote_node import RemoteNode
from canopen_proto.sdo.client import SdoAborted, SdoClient, SdoDownloaded, SdoUploaded
from canopen_proto.sdo.request_queue import MAX_URGENT_RUN
from canopen_proto.sdo.server import SdoServer
from canopen_proto.testing import World, WorldMaster
from tests.core.bus import Bus

NODE = 12
TASKS = range(1, 9)


class Memory:
    """An object for each task, of as many bytes as its number."""

    def read(self, index: int, subindex: int, now: Time) -> bytes:
        return bytes(index - 0x2000 if index > 0x2000 else 4)  # 0x1000: the client's questions

    def check_write(self, index: int, subindex: int, size: int | None) -> None:
        return None

    def write(self, index: int, subindex: int, data: bytes, now: Time) -> None:
        return None


class Office:
    """Tasks that ask, wait for the outcome, and ask again at once, each for an object of its own."""

    def __init__(self, urgent: frozenset[int], seed: int, loss: float = 0.0) -> None:
        self.bus = Bus(seed, loss=loss)
        self.client = self.bus.attach(SdoClient(Outbox(), NODE, timeout=5 * MILLISECOND, late_guard=0))
        self.bus.attach(SdoServer(Outbox(), NODE, Memory()))
        self.bus.on_event = self.hear
        self.urgent = urgent
        self.waiting: dict[RequestId, int] = {}
        self.served: list[int] = []

    def ask(self, task: int) -> None:
        is_urgent = task in self.urgent
        if task % 3:
            request_id = self.client.upload(0x2000 + task, 0, self.bus.now, urgent=is_urgent)
        else:
            request_id = self.client.download(0x2000 + task, 0, bytes(task), self.bus.now, urgent=is_urgent)
        self.waiting[request_id] = task

    def hear(self, report: Event) -> None:
        if isinstance(report, SdoUploaded | SdoDownloaded | SdoAborted):
            task = self.waiting.pop(report.request_id)
            self.served.append(task)
            if len(self.served) < 40:
                self.ask(task)


tasks = st.lists(st.sampled_from(TASKS), min_size=1, unique=True)


@given(tasks, st.integers(0, 1000), st.sampled_from([0.0, 0.1]))
def test_tasks_take_turns(order: list[int], seed: int, loss: float) -> None:
    """Round and round, in the order in which they came, whatever becomes of their requests."""
    office = Office(frozenset(), seed, loss)
    for task in order:
        office.ask(task)
    office.bus.settle()
    assert office.waiting == {}
    assert len(office.served) >= 40
    assert office.served == [order[turn % len(order)] for turn in range(len(office.served))]


@given(tasks, st.sets(st.sampled_from(TASKS)))
def test_urgent_tasks_take_turns_too_and_leave_some_to_the_others(order: list[int], urgent: set[int]) -> None:
    client, served = SdoClient(Outbox(), NODE, late_guard=0), []
    names: dict[RequestId, int] = {}

    def ask(task: int) -> None:
        names[client.upload(0x2000 + task, 0, 0, urgent=task in urgent)] = task

    for task in order:
        ask(task)
    for _ in range(3 * (MAX_URGENT_RUN + 1) * len(order)):
        request = client.out.frames.pop()
        client.receive(Frame(0x580 + NODE, b"\x4f" + request.data[1:4] + bytes(4)), 0)
        (uploaded,) = client.out.events
        client.out.events.clear()
        assert isinstance(uploaded, SdoUploaded)
        task = names.pop(uploaded.request_id)
        served.append(task)
        ask(task)
    hurried = [task for task in order if task in urgent]
    patient = [task for task in order if task not in urgent]
    for group in (hurried, patient):
        turns = [task for task in served if task in group]
        first = turns[: len(group)]
        assert sorted(first) == sorted(group)
        assert turns == [first[turn % len(first)] for turn in range(len(turns))]
    if hurried and patient:
        turns = [turn for turn, task in enumerate(served) if task in patient]
        assert turns[0] <= MAX_URGENT_RUN + 1
        # A single task has not asked again yet when the transfer after its own begins.
        gap = 2 if len(hurried) == 1 else MAX_URGENT_RUN + (2 if len(patient) == 1 else 1)
        assert {later - earlier for earlier, later in itertools.pairwise(turns[1:])} == {gap}


@pytest.mark.parametrize("pause", [1, 3, 10])
@pytest.mark.parametrize("seed", range(3))
def test_two_programs_that_ask_for_one_object_again_and_again_both_get_it(pause: int, seed: int) -> None:
    """Each hears the other one's requests. Once they have met, neither waits for as long as the other one goes on asking."""
    world = World(seed=seed)
    world.drive(NODE)
    draws = Random(seed)
    waits: list[Time] = []

    def asks(node: RemoteNode) -> Procedure[None]:
        for _ in range(60):
            began = yield from current_time()
            yield from read(node, "statusword")
            waits.append((yield from current_time()) - began)
            yield from sleep(draws.randrange(1, 2 * pause * MILLISECOND))

    masters = [world.master(), world.master()]
    requests = [master.start(asks(master.node(NODE))) for master in masters]
    world.run_until(lambda: all(map(WorldMaster.has_ended, masters, requests)), 60 * SECOND)
    for master, request in zip(masters, requests, strict=True):
        master.result(request)
    assert max(waits) < 2 * SECOND


def test_one_that_is_held_does_not_hold_the_urgent_ones() -> None:
    """Its turn has come, but its object's late answer is still waited for."""
    client = SdoClient(Outbox(), NODE, timeout=MILLISECOND, late_guard=500 * MILLISECOND)
    client.upload(0x2000, 0, 0)
    client.upload(0x2000, 0, 0)
    for _ in range(MAX_URGENT_RUN + 2):
        client.upload(0x2001, 0, 0, urgent=True)
    while client.waiting > 1:
        client.handle_timeout(client.deadline)
        assert str(client.out.frames[-1]) == "60C#4001200000000000"
    client.handle_timeout(client.deadline)
    assert (client.waiting, client.deadline) == (1, 501 * MILLISECOND)
    client.handle_timeout(client.deadline)
    assert str(client.out.frames[-1]) == "60C#4000200000000000"
