"""`OpenRequest`: a command with an outcome, until the outcome has come or the request is taken back."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from canopen_master.participant.dispatch import Dispatcher
from canopen_proto.machine import Outcome, RequestId, Time
from canopen_proto.remote_node import RemoteNode
from canopen_proto.sdo.events import SdoProgress
from canopen_transports.loop import CancelScope, current_loop, protected

if TYPE_CHECKING:
    from canopen_master.participant.bus import Bus
    from canopen_master.participant.pump import Pump


class OpenRequest:
    """A request to a node, sent when this object is made. `outcome` waits for its end, `take_back` gives it up."""

    @protected
    def __init__(
        self, pump: Pump, dispatcher: Dispatcher, bus: Bus, remote: RemoteNode, submit: Callable[[Time], RequestId]
    ) -> None:
        self._pump = pump
        self._dispatcher = dispatcher
        self._root = bus.network.out.root
        self._remote = remote
        now = pump.now()
        self.request_id = submit(now)
        self._waiter = dispatcher.expect(self._root, self.request_id, remote)
        pump.pump(now)

    @protected
    async def outcome(self) -> Outcome:
        """Wait for the outcome. A cancelled wait takes the request back. Raises BusError or MasterClosedError if there is
        none."""
        try:
            await self._waiter.wait()
        except BaseException:  # Cancelled or KeyboardInterrupt: the caller no longer wants the outcome
            self.take_back()
            raise
        return self._waiter.result()

    async def news(self) -> SdoProgress | None:
        """Wait for the next report of a stream; None once it has ended. A cancelled wait does not end the stream: `take_back`."""
        return await self._waiter.next_news()

    @contextmanager
    def while_open(self) -> Iterator[CancelScope]:
        """Return a scope that is cancelled when the outcome comes."""
        with current_loop().cancel_scope() as scope:
            self._waiter.ends = scope
            if self._waiter.is_done:
                scope.cancel()
            try:
                yield scope
            finally:
                self._waiter.ends = None

    @protected
    def take_back(self) -> None:
        """Give the request up: a transfer under way is aborted on the wire. Does nothing if the outcome has come."""
        if self._dispatcher.forget(self._root, self.request_id):
            self._remote.cancel(self.request_id, self._pump.now())
            self._pump.pump()

    @protected
    def pump(self) -> None:
        """Send what was just fed or asked for."""
        self._pump.pump()
