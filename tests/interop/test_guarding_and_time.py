"""Node guarding, TIME, remote requests and EMCY between canopen 2.4.1 and our device."""

from __future__ import annotations

from collections.abc import Iterator

import canopen
import pytest

from canopen_proto.dictionary.standard import standard_object
from canopen_proto.emcy import EmcyReceived
from canopen_proto.guarding import LifeGuardingLost
from canopen_proto.local_node import LocalNode
from canopen_proto.nmt import NmtState
from canopen_proto.time_stamp import TimeReceived
from tests.core.devices import INPUT, io_device
from tests.interop.driver import Driver
from tests.interop.peer import new_channel, peer_dictionary, peer_network

NODE, OTHER = 5, 9


class Rig:
    """Our device with guarding, TIME and an EMCY consumer; the peer's view of it, and a device of the peer's beside it."""

    def __init__(self, driver: Driver, peer: canopen.Network) -> None:
        own = [
            standard_object(0x100C, 500),
            standard_object(0x100D, 4),
            standard_object(0x1012, 0xC0000100),
            standard_object(0x1028, highest=OTHER, defaults={OTHER: 0x80 + OTHER}),
        ]
        self.driver, self.peer = driver, peer
        self.device = driver.add(lambda out: LocalNode(out, NODE, io_device(NODE).with_objects(own)))
        dictionary = peer_dictionary(self.device.dictionary, NODE)
        self.remote = peer.add_node(canopen.RemoteNode(NODE, dictionary))
        self.other = peer.create_node(OTHER, peer_dictionary(io_device(OTHER), OTHER))
        driver.do(self.device.boot)
        driver.wait(lambda: self.remote.nmt.state == "PRE-OPERATIONAL")


@pytest.fixture
def rig() -> Iterator[Rig]:
    channel = new_channel()
    driver = Driver(channel)
    with peer_network(channel) as peer, driver:
        yield Rig(driver, peer)


def test_the_peer_guards_our_device(rig: Rig) -> None:
    states = []
    rig.remote.nmt.add_heartbeat_callback(states.append)
    rig.remote.nmt.start_node_guarding(0.02)
    rig.driver.wait(lambda: len(states) >= 3)
    assert set(states) == {NmtState.PRE_OPERATIONAL}  # the peer takes off the toggle bit and does not look at it
    rig.remote.nmt.state = "OPERATIONAL"
    rig.driver.wait(lambda: rig.remote.nmt.state == "OPERATIONAL" and states[-1] == NmtState.OPERATIONAL)
    rig.remote.nmt.stop_node_guarding()
    assert rig.driver.event(LifeGuardingLost).node_id == NODE
    rig.driver.wait(lambda: rig.device.state is NmtState.PRE_OPERATIONAL)
    rig.driver.wait(lambda: [error.code for error in rig.remote.emcy.log] == [0x8130])


def test_the_peer_tells_our_device_the_time(rig: Rig) -> None:
    moment = 1_769_343_258.112  # seconds since 1970
    rig.peer.time.transmit(moment)
    heard = rig.driver.event(TimeReceived)
    assert abs(heard.time.timestamp() - moment) < 0.002


def test_the_peer_asks_for_a_tpdo(rig: Rig) -> None:
    rig.remote.tpdo.read()
    rig.remote.nmt.state = "OPERATIONAL"
    rig.driver.wait(lambda: rig.device.state is NmtState.OPERATIONAL)
    rig.device.values.store[INPUT << 8] = -1234
    before = rig.remote.tpdo[1].timestamp
    rig.remote.tpdo[1].remote_request()
    rig.driver.wait(lambda: rig.remote.tpdo[1].timestamp != before)
    assert rig.remote.tpdo[1][0].raw == -1234


def test_our_device_hears_the_emcy_of_the_peers_device(rig: Rig) -> None:
    rig.other.emcy.send(0x2310, 0x03, b"\x01\x02\x03\x04\x05")
    heard = rig.driver.event(EmcyReceived)
    assert (heard.node_id, heard.code, heard.error_register, heard.vendor_data) == (OTHER, 0x2310, 3, b"\x01\x02\x03\x04\x05")
