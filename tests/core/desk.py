"""A desk to run procedures at: a network with a clerk who takes requests, an alarm for news, an SDO client, and a clock."""

from __future__ import annotations

from typing import Any

from canopen_proto.frame import Frame
from canopen_proto.machine import NEVER, Event, Outcome, RequestId, Time
from canopen_proto.network import Network
from canopen_proto.procedures.runner import ProcedureCancelled, ProcedureFailed, ProcedureFinished
from canopen_proto.procedures.steps import Cancelled, Procedure, Request
from canopen_proto.sdo.client import SdoClient
from tests.core.machines import Alarm, Answered, Clerk


class Desk:
    """See this module's text. sent: frames as text; outcomes: of procedures, by id."""

    def __init__(self) -> None:
        self.now: Time = 0
        self.network = Network()
        self.clerk = Clerk(self.network.out)
        self.alarm = Alarm(self.network.out, "alarm", [1])
        self.sdo = SdoClient(self.network.out, 12)
        for machine in (self.clerk, self.alarm, self.sdo):
            self.network.attach(machine)
        self.sent: list[str] = []
        self.outcomes: dict[int, Outcome] = {}

    def run(self, procedure: Procedure[Any]) -> int:
        request_id = self.network.run(procedure, self.now)
        self.drain()
        return request_id

    def drain(self) -> list[Event]:
        frames, events = self.network.drain(self.now)
        self.sent += map(str, frames)
        for report in events:
            if isinstance(report, ProcedureFinished | ProcedureFailed | ProcedureCancelled):
                assert report.request_id not in self.outcomes, "one outcome only"
                self.outcomes[report.request_id] = report
        return events

    def answer(self, *names: str) -> None:
        for name in names:
            self.clerk.answer(name)
            self.drain()

    def receive(self, text: str) -> None:
        self.network.receive(Frame.parse(text), self.now)
        self.drain()

    def wait(self, duration: Time) -> None:
        self.now += duration
        self.network.handle_timeout(self.now)
        self.drain()

    def ask(self, name: str) -> Procedure[Answered]:
        return (yield Request(self.clerk, lambda now, urgent: self.clerk.ask(name, urgent)))

    def result(self, request_id: int) -> object:
        """What a procedure has returned, or the error that it has raised."""
        outcome = self.outcomes[request_id]
        assert not self.network.runner.busy
        assert self.network.runner.deadline == NEVER
        if isinstance(outcome, ProcedureFailed):
            return outcome.error
        assert isinstance(outcome, ProcedureFinished)
        return outcome.result

    def result_of(self, procedure: Procedure[Any]) -> object:
        return self.result(self.run(procedure))


def steps(*steps: Any) -> Procedure[Any]:
    """A procedure of these steps; the result of the last one is its own."""
    result = None
    for step in steps:
        result = yield step
    return result


def cancel(desk: Desk, request_id: RequestId) -> None:
    """Cancel a procedure now."""
    desk.network.cancel(request_id, desk.now)
    desk.drain()


def cancelled(desk: Desk, request_id: RequestId) -> Exception | None:
    """The clean-up error of a procedure that has ended as cancelled, and left nothing behind."""
    outcome = desk.outcomes[request_id]
    assert isinstance(outcome, ProcedureCancelled)
    assert_idle(desk)
    return outcome.clean_up_error


def assert_idle(desk: Desk) -> None:
    """No procedure runs, and none has left anything behind."""
    runner = desk.network.runner
    assert not runner.busy
    assert runner._requests == {}
    assert not any(runner._waiting.values())
    assert runner.deadline == NEVER
    assert desk.clerk.open == {}


def careful(desk: Desk, name: str, *clean_up: str) -> Procedure[str]:
    """Asks for `name`, and if it is cancelled for each of `clean_up`."""
    try:
        return (yield from desk.ask(name)).name
    except Cancelled:
        for each in clean_up:
            yield from desk.ask(each)
        raise
