"""Our device under the master's side of canopen 2.4.1, over python-can's virtual bus."""

from __future__ import annotations

import time
from collections.abc import Callable

import canopen

from canopen_proto.local_node import LocalNode
from canopen_proto.machine import Outbox
from canopen_proto.nmt import NmtState
from tests.interop.driver import LIMIT, Driver
from tests.interop.peer import peer_dictionary

NODE = 5


class Rig:
    """Our device, booted, and the peer's view of it, on one bus."""

    def __init__(
        self,
        driver: Driver,
        peer: canopen.Network,
        make: Callable[[Outbox], LocalNode],
        view: Callable[[int, canopen.ObjectDictionary], canopen.RemoteNode],
    ) -> None:
        self.driver = driver
        self.peer = peer
        self.device = driver.add(make)
        self.remote = peer.add_node(view(NODE, peer_dictionary(self.device.dictionary, NODE)))
        self.remote.sdo.RESPONSE_TIMEOUT = LIMIT
        driver.do(self.device.boot)
        self.wait(lambda: self.remote.nmt.state == "PRE-OPERATIONAL")

    def wait(self, condition: Callable[[], bool]) -> None:
        """Wait until the condition holds. It may ask the device by SDO, so the driver is not held meanwhile."""
        end = time.monotonic() + LIMIT
        while not condition():
            assert self.driver.failure is None
            assert time.monotonic() < end, f"not within {LIMIT} s"
            time.sleep(0.001)

    def stop_sync(self) -> None:
        """Stop the peer's periodic SYNC. Its thread may be on its way into the bus: no SYNC of it comes after this."""
        task = self.peer.sync._task
        task.stop()
        task._task.thread.join(LIMIT)
        assert not task._task.thread.is_alive()

    def start(self) -> None:
        self.remote.nmt.state = "OPERATIONAL"
        self.wait(lambda: self.device.state is NmtState.OPERATIONAL)
