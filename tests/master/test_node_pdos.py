"""A node that is made with its file: its PDOs are exchanged as the device has them, and what its machines are told goes out."""

from __future__ import annotations

import logging
from dataclasses import replace

import pytest

from canopen_data.configured import configure
from canopen_data.descriptions import load_description_with_names
from canopen_master import DeviceModel, PdoDiffers, open_master
from canopen_proto.dictionary import Direction, ObjectDictionary
from canopen_proto.heartbeat import HeartbeatReceived
from canopen_proto.machine import LocalProtocolError
from canopen_proto.nmt import NmtCommand, NmtState
from canopen_proto.pdo.configure import configure_pdo, read_pdo
from canopen_proto.pdo.consumer import PdoReceived
from canopen_proto.procedures.steps import SdoTransferError
from tests.loops import fail_after, loop
from tests.master.world import BUS, simulated, virtual_time

FILE = "sample_io.eds"


def sample(**values: int) -> ObjectDictionary:
    """The sample's dictionary, with other values at power-on: x1A00_01=..."""
    dictionary = load_description_with_names(FILE).dictionary
    numbers = {int(name[1:5], 16) << 8 | int(name[6:], 16): value for name, value in values.items()}
    return configure(dictionary, numbers, 5)


@virtual_time
async def test_pdos_flow_by_name() -> None:
    async with simulated(makers=[DeviceModel(sample(), 5)]) as host, open_master(BUS) as master:
        node = master.node(5, FILE)
        assert master.node(5, FILE) is node
        with node.events(PdoReceived) as pdos:
            await node.start()
            first = await pdos.receive()
            assert first.number == 1
            assert len(first.values) == len(first.components) > 1
            device = host.nodes[0]
            key = first.mapping.muxes[0]
            device.values.store[key] = 0x5A
            device.pdos.trigger(key, host.now())
            host.pump()
            while (pdo := await pdos.receive()).number != 1 or pdo.values == first.values:
                pass
            assert pdo.values == first.values | {first.mapping.labels[0]: 0x5A}
        assert await node.exchange_pdos() == ()
        assert set(node.remote.tpdos) == set(device.pdos.producers)


@virtual_time
async def test_the_devices_own_mapping_counts_and_the_difference_is_told(caplog: pytest.LogCaptureFixture) -> None:
    dictionary = sample(x1A00_01=0x6200_0108)  # an output in place of an input
    async with simulated(makers=[DeviceModel(dictionary, 5)]), open_master(BUS) as master:
        with master.events(PdoDiffers) as told, caplog.at_level(logging.WARNING):
            node = master.node(5, FILE)
            report = await told.receive()
        (difference,) = await node.exchange_pdos()
        assert report.difference == difference
        assert (difference.direction, difference.number) == (Direction.TPDO, 1)
        assert "6200:01/8" in str(difference).partition("; the file says ")[0]
        assert "6000:01/8" in str(difference).partition("; the file says ")[2]
        assert str(difference) in caplog.text
        assert node.remote.tpdos[1].mapping.parameters[0] == 0x6200_0108


@virtual_time
async def test_a_device_that_comes_later_and_one_that_boots_again() -> None:
    async with open_master(BUS) as master:
        node = master.node(5, FILE)
        with pytest.raises(SdoTransferError):
            await node.start()
        async with simulated(makers=[DeviceModel(sample(x1A00_01=0x6200_0108), 5)]):
            await loop.sleep(1)
            assert len(await node.exchange_pdos()) == 1
            assert node.remote.tpdos[1].mapping.parameters[0] == 0x6200_0108
            await node.write_bytes(0x1800, 1, (0x8000_0185).to_bytes(4, "little"))
            await node.reset()
            assert len(await node.exchange_pdos()) == 1  # asked again: the reset has put the settings back
            assert node.remote.tpdos[1].mapping.parameters[0] == 0x6200_0108


@virtual_time
async def test_a_stopped_device_is_asked_once_it_is_heard_in_another_state() -> None:
    """A Stopped device answers no SDO, and it does not boot when it is started."""
    async with simulated(makers=[DeviceModel(sample(x1017_00=100, x1A00_01=0x6200_0108), 5)]), open_master(BUS) as master:
        await master.nmt_stop(5)
        node = master.node(5, FILE)
        with pytest.raises(SdoTransferError):
            await node.exchange_pdos()
        with pytest.raises(SdoTransferError):
            await node.exchange_pdos()  # and it is not asked while it is Stopped
        await master.nmt_start(5)
        await loop.sleep(0.2)
        assert len(await node.exchange_pdos()) == 1
        assert node.remote.tpdos[1].mapping.parameters[0] == 0x6200_0108


@virtual_time
async def test_nothing_is_sent_where_that_is_not_wished() -> None:
    async with simulated(makers=[DeviceModel(sample(), 5)]), open_master(BUS) as master:
        node = master.node(5, FILE, pdos=False)
        await loop.sleep(1)
        assert not node.remote.tpdos
        await node.start()
        with pytest.raises(LocalProtocolError, match="in use with another dictionary"):
            master.node(5, "sample_drive.eds")


@virtual_time
async def test_rpdos_send_what_the_device_holds_until_told_otherwise() -> None:
    async with simulated(makers=[DeviceModel(sample(), 5)]) as host, open_master(BUS) as master:
        node = master.node(5, FILE)
        device = host.nodes[0]
        number, consumer = next(iter(device.pdos.consumers.items()))
        for key in consumer.mapping.muxes:
            device.values.store[key] = 7
        await node.start()
        master.sync_start(0.01)
        node.enable_rpdo(number)
        await loop.sleep(0.1)
        assert [device.values.store[key] for key in consumer.mapping.muxes] == [7] * len(consumer.mapping.muxes)
        node.remote.values.store[consumer.mapping.muxes[0]] = 9
        await loop.sleep(0.1)
        assert device.values.store[consumer.mapping.muxes[0]] == 9
        node.enable_rpdo(number, False)
        node.remote.values.store[consumer.mapping.muxes[0]] = 11
        await loop.sleep(0.1)
        assert device.values.store[consumer.mapping.muxes[0]] == 9


@virtual_time
async def test_reads_by_type() -> None:
    dictionary = load_description_with_names("sample_drive.eds").dictionary
    async with simulated(makers=[DeviceModel(dictionary, 5)]), open_master(BUS) as master:
        node = master.node(5, dictionary)
        number: int = await node.read_int("device_type")
        text: str = await node.read_str((0x1008, 0))
        assert number == dictionary.variable(0x1000).initial_of(5)
        assert text == dictionary.variable(0x1008).initial_of(5)
        assert await node.read_bytes("device_type") == number.to_bytes(4, "little")
        assert await node.read_bytes(0x1018, 1) == await node.read_bytes((0x1018, 1)) == await node.read_bytes(0x101801)
        for read, key, wanted in (
            (node.read_int, 0x1008, "VISIBLE_STRING, not an integer"),
            (node.read_str, 0x1000, "UNSIGNED32, not text"),
            (node.read_float, 0x1000, "UNSIGNED32, not a real number"),
        ):
            with pytest.raises(LocalProtocolError, match=wanted):
                await read(key)
        with pytest.raises(LocalProtocolError, match="a subindex goes with an index alone"):
            await node.read_bytes("device_type", 1)


@pytest.mark.parametrize("by_machine", [True, False])
@virtual_time
async def test_a_machine_that_anybody_commands_says_so_at_once(by_machine: bool) -> None:
    async with simulated(12), open_master(BUS) as master:
        node = master.node(12)
        with node.events(HeartbeatReceived) as heard:
            if by_machine:
                node.remote.start_guarding(10**8, 3, master.now())
            else:
                node.start_guarding(0.1)
            with fail_after(0.05):
                assert (await heard.receive()).state is NmtState.PRE_OPERATIONAL
        node.stop_guarding()
        node.remote.sdo.upload(0x1000, 0, master.now())
        await loop.sleep(0.05)
        assert 0x1000_00 in node.remote.heard_at


@virtual_time
@pytest.mark.parametrize("by_hand", [False, True])
async def test_a_pdo_that_is_mapped_anew_is_decoded_by_its_new_mapping(by_hand: bool) -> None:
    async with simulated(makers=[DeviceModel(sample(), 5)]), open_master(BUS) as master:
        node = master.node(5, FILE)
        with node.events(PdoReceived) as pdos:
            if by_hand:
                await node.exchange_pdos()
                await node.write_bytes(0x1800, 1, (0xC000_0185).to_bytes(4, "little"))
                await node.write_bytes(0x1A00, 0, b"\0")
                await node.write_bytes(0x1A00, 1, (0x6401_0210).to_bytes(4, "little"))
                await node.write_bytes(0x1A00, 0, b"\1")
                await node.write_bytes(0x1800, 1, (0x4000_0185).to_bytes(4, "little"))
                assert 1 not in node.remote.tpdos
            else:  # while the first exchange is on its way
                settings = await master.run(read_pdo(node.remote, Direction.TPDO, 1))
                await master.run(configure_pdo(node.remote, replace(settings, entries=(0x6401_0210,))))
            await node.start()
            first = await pdos.receive()
        assert (first.number, first.mapping.parameters) == (1, (0x6401_0210,))
        (difference,) = await node.exchange_pdos()
        assert "6401:02/16" in str(difference).partition("; the file says ")[0]


@virtual_time
async def test_tpdos_go_on_where_a_node_is_configured_after_its_boot_up_and_started_by_nmt() -> None:
    """As the boot of a network does. RPDOs that are sent go on."""
    async with simulated(makers=[DeviceModel(sample(), 5)]), open_master(BUS) as master:
        node = master.node(5, FILE)
        await node.exchange_pdos()
        node.enable_rpdo(1)
        for index, subindex, data in (
            (0x1800, 1, (0xC000_0185).to_bytes(4, "little")),
            (0x1A00, 0, b"\0"),
            (0x1A00, 0, b"\2"),
            (0x1800, 1, (0x4000_0195).to_bytes(4, "little")),
            (0x1017, 0, (100).to_bytes(2, "little")),
        ):
            await node.write_bytes(index, subindex, data)
        assert not node.remote.tpdos
        await node.nmt(NmtCommand.START)
        await loop.sleep(0.5)
        received = node.remote.tpdos[1]
        assert (received.key, len(received.mapping.entries)) == (0x195, 2)
        assert node.remote.rpdos[1].is_live
        assert not node.remote.unread_pdos


@virtual_time
async def test_a_cob_id_that_is_written_anew_as_it_is_changes_nothing() -> None:
    """Also as bytes, as a text gateway or a page writes it: a chain that moves would be silent."""
    async with simulated(makers=[DeviceModel(sample(), 5)]), open_master(BUS) as master:
        node = master.node(5, FILE)
        await node.start()
        same = await node.read_bytes(0x1800, 1)
        await node.write_bytes(0x1800, 1, same)
        assert 1 in node.remote.tpdos
        assert not node.remote.unread_pdos
        await node.write_bytes(0x1800, 1, (0xC000_0185).to_bytes(4, "little"))  # destroyed: it is received, if it comes
        assert not node.remote.unread_pdos
        await node.write_bytes(0x1800, 1, (0x4000_0195).to_bytes(4, "little"))
        assert node.remote.unread_pdos == {(Direction.TPDO, 1)}
