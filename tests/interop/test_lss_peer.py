"""Our LSS slave under the LSS master of canopen 2.4.1, without threads and real time: answers come before it waits."""

from __future__ import annotations

import canopen.lss
import pytest

from canopen_proto.frame import Frame
from canopen_proto.local_node import LocalNode
from canopen_proto.lss.messages import UNCONFIGURED, LssAddress, LssState
from canopen_proto.lss.slave import LssSlave, LssStoreRequested
from canopen_proto.machine import Outbox
from canopen_proto.nmt import NmtState
from tests.lss.lss_bench import device_dictionary, random_addresses


class Rig:
    """Our devices, and the peer's master, which talks to them directly."""

    def __init__(self, *addresses: LssAddress) -> None:
        self.nodes = [LocalNode(Outbox(), UNCONFIGURED, device_dictionary(address)) for address in addresses]
        for node in self.nodes:
            node.boot(0)
        self.booted: list[str] = []
        self.master = canopen.lss.LssMaster()
        self.master.network = self
        self.master.RESPONSE_TIMEOUT = 0

    def send_message(self, can_id: int, data: bytes) -> None:
        for node in self.nodes:
            node.receive(Frame(can_id, bytes(data)), 0)
            if any(isinstance(event, LssStoreRequested) for event in node.out.events):
                node.lss.complete_store(0, 0)
            node.out.events.clear()
            for frame in node.out.frames:
                if frame.can_id == self.master.LSS_RX_COBID:
                    self.master.on_message_received(frame.can_id, frame.data, 0)
                else:
                    self.booted.append(str(frame))
            node.out.frames.clear()


@pytest.fixture(autouse=True)
def no_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(canopen.lss.time, "sleep", lambda seconds: None)


@pytest.mark.parametrize("seed", range(5))
def test_its_fastscan_finds_the_lowest_of_our_devices_and_gives_it_a_node_id(seed: int) -> None:
    addresses = sorted(random_addresses(3, seed))
    rig = Rig(*addresses[::-1])
    for node_id, address in enumerate(addresses, start=10):
        found, numbers = rig.master.fast_scan()
        assert found
        assert tuple(numbers) == address
        assert rig.master.inquire_lss_address(canopen.lss.CS_INQUIRE_SERIAL_NUMBER) == address.serial
        rig.master.configure_node_id(node_id)
        rig.master.store_configuration()
        rig.master.send_switch_state_global(rig.master.WAITING_STATE)
        assert rig.booted.pop() == f"7{node_id:02X}#00"
    assert rig.master.fast_scan()[0] is False
    assert [node.lss.persistent.node_id for node in rig.nodes] == [12, 11, 10]
    assert {node.state for node in rig.nodes} == {NmtState.PRE_OPERATIONAL}


def test_it_selects_inquires_and_configures() -> None:
    rig = Rig(LssAddress(1, 2, 3, 4), LssAddress(1, 2, 3, 5))
    assert rig.master.send_switch_state_selective(1, 2, 3, 5)
    assert [node.lss.state for node in rig.nodes] == [LssState.WAITING, LssState.CONFIGURATION]
    assert rig.master.inquire_node_id() == UNCONFIGURED
    rig.master.configure_bit_timing(2)
    with pytest.raises(canopen.lss.LssError, match="LSS Error: 1"):
        rig.master.configure_bit_timing(5)
    with pytest.raises(canopen.lss.LssError, match="LSS Error: 1"):
        rig.master.configure_node_id(128)
    assert rig.nodes[1].lss.pending == (UNCONFIGURED, 500)
    rig.master.activate_bit_timing(100)
    assert rig.nodes[1].lss.is_silent
    assert not rig.nodes[0].lss.is_silent


def test_it_identifies_our_devices() -> None:
    rig = Rig(LssAddress(1, 2, 3, 4))
    rig.master.send_identify_remote_slave(1, 2, 0, 9, 4, 4)
    assert rig.master.responses.get_nowait()[0] == canopen.lss.CS_IDENTIFY_SLAVE
    rig.master.send_identify_non_configured_remote_slave()
    assert rig.master.responses.get_nowait()[0] == canopen.lss.CS_IDENTIFY_NON_CONFIGURED_SLAVE
    assert isinstance(rig.nodes[0].lss, LssSlave)
