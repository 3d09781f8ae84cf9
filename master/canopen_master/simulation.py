"""Simulated devices on a bus: the device's side of the same pump. For demonstrations and tests, without hardware.

    await nursery.start(simulate, await open_transport("virtual:demo"), powerballs(3, 4, 5, 6, 7, 8))

All devices of one call are one participant of the bus, as if they shared one CAN controller: they do not hear each other.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import TypeAlias

import trio

from canopen_master.bus import Bus, Pump
from canopen_master.errors import BusError
from canopen_proto.cia402.drive_node import DriveNode, powerball
from canopen_proto.cia402.servo import DriveSettings
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import Event, Outbox
from canopen_proto.network import Network
from canopen_transports import Transport, TransportError

DeviceMaker: TypeAlias = Callable[[Outbox], LocalNode]
"""Makes a device with the outbox of the network that it will be attached to."""


def powerballs(*node_ids: int) -> list[DeviceMaker]:
    """Joints of the Schunk Powerball arm, as the manual's library met it."""
    return [partial(powerball, node_id=node_id) for node_id in node_ids]


def standard_drives(*node_ids: int, settings: DriveSettings | None = None) -> list[DeviceMaker]:
    """Drives that have CiA 402 as it is written."""
    return [partial(DriveNode, node_id=node_id, settings=settings or DriveSettings()) for node_id in node_ids]


async def simulate(
    transport: Transport,
    devices: Iterable[DeviceMaker],
    *,
    on_event: Callable[[Event], object] | None = None,
    task_status: trio.TaskStatus[Host] = trio.TASK_STATUS_IGNORED,
) -> None:
    """Serve devices on a transport until cancelled; then close it. They boot at once, in the order given.

    Started with `nursery.start`, it gives the Host with its `nodes`, to look into or to break. on_event: is called with what they
    report; it must not block. Raises BusError when the bus fails.
    """
    try:
        await Host(transport, devices, on_event).serve(task_status)
    finally:
        with trio.CancelScope(shield=True):
            await transport.aclose()


class Host:
    """Devices on one transport. `pump()` after whatever is done to one of them by hand (`node.raise_error(...)`)."""

    def __init__(
        self, transport: Transport, devices: Iterable[DeviceMaker], on_event: Callable[[Event], object] | None = None
    ) -> None:
        network = Network()
        self._bus = Bus(getattr(transport, "locator", "bus"), transport, network)
        self._pump = Pump((self._bus,), self)
        self._on_event = on_event
        self._failure: Exception | None = None
        self._ended = trio.Event()
        self.nodes = tuple(make(network.out) for make in devices)
        for node in self.nodes:
            network.attach(node)

    def now(self) -> int:
        """The devices' time, in ns."""
        return self._pump.now()

    def pump(self) -> None:
        """Send and report what the devices have to say."""
        self._pump.pump()

    async def serve(self, task_status: trio.TaskStatus[Host] = trio.TASK_STATUS_IGNORED) -> None:
        """Boot the devices and serve them until cancelled. Raises BusError when the bus fails."""
        async with trio.open_nursery() as nursery:
            nursery.start_soon(self._pump.run)
            try:
                for node in self.nodes:
                    node.boot(self.now())
                self._pump.pump()
                await self._pump.flush()  # a master that opens now must not take these boot-ups for a reset behind its back
                task_status.started(self)
                await self._ended.wait()
            finally:
                self._pump.stop()
        if self._failure is not None:
            raise self._failure

    def on_event(self, bus: Bus, event: Event) -> None:
        if self._on_event is not None:
            self._on_event(event)

    def on_failure(self, bus: Bus | None, error: Exception) -> None:
        self._failure = BusError(bus.name, error) if bus is not None and isinstance(error, TransportError) else error
        self._ended.set()
