"""Drivers that take their time, and such as never come back: opening, sending and closing come to their end all the same."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator

import can
import pytest
import trio
import trio.testing

from canopen_proto.frame import Frame
from canopen_transports import (
    BusState,
    BusStateChanged,
    FrameNotSentError,
    PythonCanTransport,
    driver_calls,
    open_transport,
    parse_locator,
    python_can,
)
from tests.transports.fake_bus import ScriptedBus
from tests.transports.support import LIMIT, reported, run, trio_test

SYNC = Frame.parse("080#")


class SlowBus(ScriptedBus):
    """Its driver hangs where it is told to, until `release`."""

    def __init__(self, hangs_in: str) -> None:
        super().__init__()
        self.hangs_in = hangs_in
        self.release = threading.Event()

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        if self.hangs_in == "send":
            self.release.wait(20)
        super().send(msg, timeout)

    def shutdown(self) -> None:
        if self.hangs_in == "shutdown":
            self.release.wait(20)
        super().shutdown()


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(driver_calls, "DRIVER_TIME", 0.02)
    monkeypatch.setattr(python_can, "REOPEN_PAUSE", 0.01)


@pytest.mark.usefixtures("impatient")
def test_a_driver_that_does_not_come_back_from_sending_is_lost_and_opened_again(monkeypatch: pytest.MonkeyPatch) -> None:
    @trio_test(real_time=True)
    async def body() -> None:
        stuck, fresh = SlowBus("send"), ScriptedBus()

        async def reopen() -> can.BusABC:
            await trio.lowlevel.checkpoint()
            return fresh

        async with PythonCanTransport(stuck, locator=parse_locator("gs_usb:0"), reopen=reopen) as transport:
            with pytest.raises(FrameNotSentError) as caught:
                await transport.send(SYNC)
            assert caught.value.seen == "the driver has not returned for 0.02 s"
            for state in (BusState.DOWN, BusState.UP):
                change = await reported(transport, BusStateChanged)
                assert change.state is state
            monkeypatch.setattr(driver_calls, "DRIVER_TIME", LIMIT)  # so that a slow computer is no slow driver
            await transport.send(SYNC)
            assert len(fresh.sent) == 1
        stuck.release.set()

    body()


@pytest.mark.usefixtures("impatient")
def test_a_driver_that_does_not_come_back_from_closing_is_left_behind() -> None:
    @trio_test(real_time=True)
    async def body() -> None:
        bus = SlowBus("shutdown")
        await PythonCanTransport(bus).aclose()
        assert not bus._is_shutdown
        bus.release.set()

    body()


@pytest.mark.usefixtures("impatient")
def test_the_thread_that_a_driver_keeps_is_not_missing_elsewhere() -> None:
    @trio_test(real_time=True)
    async def body() -> None:
        trio.to_thread.current_default_thread_limiter().total_tokens = 1
        bus = SlowBus("shutdown")
        await PythonCanTransport(bus).aclose()
        with trio.fail_after(15):  # and the driver keeps its thread for 20
            assert await trio.to_thread.run_sync(len, "abc") == 3
        bus.release.set()

    body()


class Opening:
    """Stands in for python-can's `can.Bus`: opens when it is released."""

    def __init__(self) -> None:
        self.started = threading.Event()
        self.release = threading.Event()
        self.bus = ScriptedBus()
        self.is_shut = threading.Event()
        shut_down = self.bus.shutdown

        def shutdown() -> None:
            shut_down()
            self.is_shut.set()

        self.bus.shutdown = shutdown  # type: ignore[method-assign]

    def __call__(self, **_: object) -> can.BusABC:
        self.started.set()
        self.release.wait(20)
        return self.bus


@pytest.fixture
def opening(monkeypatch: pytest.MonkeyPatch) -> Iterator[Opening]:
    opening = Opening()
    monkeypatch.setattr(can, "Bus", opening)
    yield opening
    opening.release.set()
    opening.bus.shutdown()


@pytest.mark.usefixtures("impatient")
def test_cancelled_while_a_driver_hangs_in_opening_what_it_opens_later_is_shut_down(opening: Opening) -> None:
    async def body() -> None:
        async with trio.open_nursery() as nursery:
            nursery.start_soon(open_transport, "vector:0")
            await trio.to_thread.run_sync(opening.started.wait)
            nursery.cancel_scope.cancel()
        assert not opening.is_shut.is_set()  # it still hangs; we do not

    run(body, real_time=True)
    opening.release.set()
    assert opening.is_shut.wait(10)


def test_ctrl_c_while_a_driver_opens_waits_for_it_and_leaves_nothing_open(opening: Opening) -> None:
    async def interrupt() -> None:
        await trio.to_thread.run_sync(opening.started.wait)
        try:
            signal.raise_signal(signal.SIGINT)
        finally:
            opening.release.set()

    async def main() -> None:
        async with trio.open_nursery() as nursery:
            nursery.start_soon(interrupt)
            async with await open_transport("vector:0") as transport:
                await transport.receive()

    with pytest.raises(BaseExceptionGroup) as caught:
        trio.run(main)
    assert caught.group_contains(KeyboardInterrupt)
    assert opening.is_shut.wait(10)


def test_closed_while_the_bus_is_opened_anew(opening: Opening, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(python_can, "REOPEN_PAUSE", 0)

    @trio_test(real_time=True)
    async def body() -> None:
        failing = ScriptedBus(received=[can.CanOperationError("unplugged")])
        locator = parse_locator("vector:0")

        async def reopen() -> can.BusABC:
            return await driver_calls.open_bus(opening)

        transport = PythonCanTransport(failing, locator=locator, reopen=reopen)
        await reported(transport, BusStateChanged, match="down")

        async def receive() -> None:
            with pytest.raises(trio.ClosedResourceError):
                await transport.receive()

        async with trio.open_nursery() as nursery:
            nursery.start_soon(receive)
            await trio.to_thread.run_sync(opening.started.wait)
            nursery.start_soon(transport.aclose)
            await trio.testing.wait_all_tasks_blocked()
            opening.release.set()
        assert opening.is_shut.wait(10)

    body()
