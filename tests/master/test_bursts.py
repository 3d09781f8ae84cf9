"""Bursts of frames in the master: what was commanded by hand before one is taken up, and who asks in one is told of its rest."""

from __future__ import annotations

import pytest

from canopen_master import open_master
from canopen_proto import EmcyReceived, HeartbeatLost, HeartbeatReceived, PdoReceived
from canopen_proto.datatypes import DataType
from canopen_proto.frame import Frame, routing_key
from canopen_proto.machine import MILLISECOND, Event
from canopen_proto.pdo.mapping import MappedEntry, Mapping
from tests.loops import loop
from tests.master.world import virtual_time

HEARTBEAT = Frame(0x705, b"\x05"), None
PDO = Frame(0x185, bytes(4)), None
EMCY = Frame(0x085, bytes.fromhex("1023010000000000")), None
MAPPING = Mapping((MappedEntry(0x2001, 0, 32, DataType.UNSIGNED32),))


@pytest.mark.parametrize("asks", [True, False])
@virtual_time
async def test_a_deadline_that_was_set_by_hand_is_kept_though_a_burst_comes_first(asks: bool) -> None:
    """asks: for what the burst reports, too."""
    async with open_master("virtual:bursts") as master:
        bus, node, pump = master.bus(), master.node(5), master.pump
        kinds = (HeartbeatLost, PdoReceived) if asks else (HeartbeatLost,)
        with master.events(*kinds) as events:
            pump._take_in(bus, [HEARTBEAT], pump.now())
            node.remote.heartbeat.set_timeout(100 * MILLISECOND, pump.now())
            node.remote.add_tpdo(1, routing_key(0x185), MAPPING, pump.now())  # routes change, too
            pump._take_in(bus, [HEARTBEAT, HEARTBEAT], pump.now())
            with loop.move_on_after(2):
                assert isinstance(await events.receive(), HeartbeatLost)
                return
    raise AssertionError("nobody noticed that the node is silent")


@virtual_time
async def test_who_begins_to_watch_in_a_burst_is_told_of_its_rest() -> None:
    told: list[type[Event]] = []
    async with open_master("virtual:bursts") as master:
        bus, node, pump = master.bus(), master.node(5), master.pump
        node.remote.add_tpdo(1, routing_key(0x185), MAPPING, pump.now())
        pump._take_in(bus, [HEARTBEAT], pump.now())
        master.watch(
            (EmcyReceived,), lambda _: master.watch((PdoReceived, HeartbeatReceived), lambda event: told.append(type(event)))
        )
        pump._take_in(bus, [PDO, EMCY, HEARTBEAT, PDO], pump.now())
    assert told == [HeartbeatReceived, PdoReceived]
