"""The master's side of canopen 2.4.1 (`RemoteNode`) against our device."""

from __future__ import annotations

from collections.abc import Iterator

import canopen
import pytest

from canopen_proto.abort import AbortCode
from canopen_proto.dictionary import Access
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import Time
from canopen_proto.nmt import NmtState
from canopen_proto.sdo.server import ObjectAccessPending
from tests.core.devices import INPUT, LIMITED, OUTPUT, TEXT, io_device
from tests.interop.device_rig import NODE, Rig
from tests.interop.driver import Driver
from tests.interop.peer import new_channel, peer_network


@pytest.fixture
def rig() -> Iterator[Rig]:
    channel = new_channel()
    driver = Driver(channel)
    with peer_network(channel) as peer, driver:
        yield Rig(driver, peer, lambda out: LocalNode(out, NODE, io_device(NODE)), canopen.RemoteNode)


# ---- SDO ----


def test_every_readable_object_of_the_device(rig: Rig) -> None:
    """What the peer reads is what the device holds; an empty history entry is refused as the standard says."""
    for variable in rig.device.dictionary:
        if variable.access is Access.WO:
            continue
        if variable.index == 0x1003 and variable.subindex:
            with pytest.raises(canopen.SdoAbortedError) as caught:
                rig.remote.sdo.upload(variable.index, variable.subindex)
            assert caught.value.code == AbortCode.NO_DATA
            continue
        data = rig.remote.sdo.upload(variable.index, variable.subindex)
        assert data == rig.device.values.raw(variable.index, variable.subindex)


@pytest.mark.parametrize("text", ["", "a", "abcd", "abcde", "abcdefg", "x" * 8, "y" * 1000])
def test_texts_down_and_up(rig: Rig, text: str) -> None:
    if text:  # the peer cannot download nothing
        rig.remote.sdo.download(TEXT, 0, text.encode())
        assert rig.device.values.store[TEXT << 8] == text
    else:
        rig.device.values.store[TEXT << 8] = ""
    assert rig.remote.sdo.upload(TEXT, 0) == text.encode()


def test_numbers(rig: Rig) -> None:
    rig.remote.sdo[OUTPUT].raw = -1234
    assert rig.device.values.store[OUTPUT << 8] == -1234
    assert rig.remote.sdo[OUTPUT].raw == -1234
    rig.remote.sdo.download(OUTPUT, 0, b"\x01\x02", force_segment=True)
    assert rig.remote.sdo[OUTPUT].raw == 0x0201


@pytest.mark.parametrize(
    ("index", "subindex", "data", "abort_code"),
    [
        (0x2FFF, 0, None, AbortCode.NO_SUCH_OBJECT),
        (0x1018, 9, None, AbortCode.NO_SUCH_SUBINDEX),
        (INPUT, 0, b"\x00\x00", AbortCode.READ_ONLY),
        (LIMITED, 0, b"\x00", AbortCode.VALUE_TOO_LOW),
        (LIMITED, 0, b"\xff", AbortCode.VALUE_TOO_HIGH),
        (LIMITED, 0, b"\x0c\x00", AbortCode.LENGTH_TOO_HIGH),
        (0x1600, 0, b"\x00", AbortCode.DEVICE_STATE),
        (0x1019, 0, b"\x01", AbortCode.INVALID_VALUE),
    ],
)
def test_aborts(rig: Rig, index: int, subindex: int, data: bytes | None, abort_code: AbortCode) -> None:
    sdo = rig.remote.sdo
    with pytest.raises(canopen.SdoAbortedError) as caught:
        sdo.upload(index, subindex) if data is None else sdo.download(index, subindex, data)
    assert caught.value.code == abort_code


BLOCK_SIZES = [1, 6, 7, 8, 127 * 7, 127 * 7 + 1, 3000, 20_000]


@pytest.mark.thorough(3)
@pytest.mark.parametrize("crc", [True, False], ids=["crc", "no crc"])
@pytest.mark.parametrize("size", BLOCK_SIZES)
def test_blocks_down_and_up(rig: Rig, size: int, crc: bool) -> None:
    text = bytes(0x41 + number * 7 % 53 for number in range(size))
    rig.device.sdo.crc = crc  # the peer checks a CRC wherever the server can, even where it has said that it cannot itself
    with rig.remote.sdo.open(TEXT, 0, "wb", size=size, block_transfer=True, request_crc_support=crc) as stream:
        for offset in range(0, size, 7):  # its own write() takes no other pieces
            stream.write(text[offset : offset + 7])
    assert rig.device.values.store[TEXT << 8] == text.decode()
    with rig.remote.sdo.open(TEXT, 0, "rb", block_transfer=True, request_crc_support=crc) as stream:
        assert stream.read() == text
    assert rig.remote.sdo[LIMITED].raw == 10  # and the server goes on


def test_blocks_are_refused_where_there_is_no_object(rig: Rig) -> None:
    for mode in ("rb", "wb"):
        with pytest.raises(canopen.SdoAbortedError) as caught:
            rig.remote.sdo.open(0x2FFF, 0, mode, size=10, block_transfer=True)
        assert caught.value.code == AbortCode.NO_SUCH_OBJECT


def test_an_object_that_the_host_serves(rig: Rig) -> None:
    rig.device.deferred.add(LIMITED)

    def answer(now: Time) -> None:
        for report in rig.driver.events:
            if isinstance(report, ObjectAccessPending):
                rig.device.complete(report.access_id, b"\x11", now)

    rig.driver.on_events = lambda: rig.driver.do(answer)
    assert rig.remote.sdo[LIMITED].raw == 0x11


# ---- NMT, heartbeat, EMCY, SYNC ----


@pytest.mark.parametrize(
    ("name", "state"),
    [
        ("OPERATIONAL", NmtState.OPERATIONAL),
        ("STOPPED", NmtState.STOPPED),
        ("RESET", NmtState.PRE_OPERATIONAL),
        ("RESET COMMUNICATION", NmtState.PRE_OPERATIONAL),
    ],
)
def test_nmt_and_heartbeat(rig: Rig, name: str, state: NmtState) -> None:
    rig.remote.sdo[LIMITED].raw = 15
    rig.remote.sdo[0x1017].raw = 10
    rig.wait(lambda: rig.device.communication.heartbeat.period > 0)
    rig.remote.nmt.wait_for_heartbeat(timeout=20)
    assert rig.remote.nmt.state == "PRE-OPERATIONAL"
    rig.remote.nmt.state = name
    if name.startswith("RESET"):
        rig.wait(lambda: rig.device.communication.heartbeat.period == 0)
        assert rig.device.values.store[LIMITED << 8] == (10 if name == "RESET" else 15)
    rig.wait(lambda: rig.device.state is state)
    wanted = state.name.replace("_", "-")
    rig.wait(lambda: rig.remote.nmt.state == wanted)


def test_emergencies(rig: Rig) -> None:
    rig.driver.do(lambda now: rig.device.raise_error(0x2310, 0x02, b"\x01\x02", now))
    rig.wait(lambda: len(rig.remote.emcy.log) == 1)
    (error,) = rig.remote.emcy.active
    assert (error.code, error.register, error.data) == (0x2310, 3, b"\x01\x02\x00\x00\x00")
    assert rig.remote.sdo[0x1003][1].raw == 0x2310
    rig.driver.do(lambda now: rig.device.clear_error(0x2310, now))
    rig.wait(lambda: not rig.remote.emcy.active)


def test_our_device_as_the_sync_producer(rig: Rig) -> None:
    heard: list[bytes] = []
    rig.peer.subscribe(0x80, lambda can_id, data, timestamp: heard.append(bytes(data)))
    rig.remote.sdo[0x1019].raw = 4
    rig.remote.sdo[0x1006].raw = 5000
    rig.remote.sdo[0x1005].raw = 0x40000080
    rig.wait(lambda: len(heard) >= 6)
    assert heard[:6] == [b"\x01", b"\x02", b"\x03", b"\x04", b"\x01", b"\x02"]
    rig.remote.sdo[0x1006].raw = 0


# ---- PDO ----


def test_pdos_as_the_device_has_them(rig: Rig) -> None:
    remote = rig.remote
    remote.tpdo.read()
    remote.rpdo.read()
    assert [entry.index for entry in remote.tpdo[1]] == [INPUT]
    rig.start()
    heard: list[int] = []
    remote.tpdo[1].add_callback(lambda pdo: heard.append(pdo[INPUT].raw))
    rig.driver.do(lambda now: rig.device.set_value(INPUT, 0, -77, now))
    rig.wait(lambda: heard == [-77])
    remote.rpdo[1][OUTPUT].raw = 99
    remote.rpdo[1].transmit()
    rig.wait(lambda: rig.device.values.store[OUTPUT << 8] == 99)


def test_synchronous_pdos(rig: Rig) -> None:
    remote = rig.remote
    remote.tpdo.read()
    remote.rpdo.read()
    rig.start()
    heard: list[int] = []
    remote.tpdo[2].add_callback(lambda pdo: heard.append(pdo[INPUT].raw))
    remote.rpdo[2][OUTPUT].raw = 7
    remote.rpdo[2].transmit()
    rig.driver.do(lambda now: rig.device.set_value(INPUT, 0, 5, now))
    assert heard == []
    rig.peer.sync.transmit()
    rig.wait(lambda: heard == [5])
    rig.wait(lambda: rig.device.values.store[OUTPUT << 8] == 7)


def test_the_peers_way_of_remapping_is_ours_too(rig: Rig) -> None:
    remote = rig.remote
    remote.rpdo.read()
    remote.tpdo.read()
    pdo = remote.rpdo[1]
    pdo.clear()
    pdo.add_variable(LIMITED)
    pdo.add_variable(OUTPUT)
    pdo.trans_type = 254
    pdo.save()
    back = remote.tpdo[1]
    back.clear()
    back.add_variable(OUTPUT)
    back.event_timer = 10
    back.save()
    assert rig.device.pdos.consumers[1].mapping.parameters == (LIMITED << 16 | 8, OUTPUT << 16 | 16)
    heard: list[int] = []
    back.add_callback(lambda mapped: heard.append(mapped[OUTPUT].raw))
    rig.start()
    pdo[LIMITED].raw, pdo[OUTPUT].raw = 13, -3
    pdo.transmit()
    rig.wait(lambda: rig.device.values.store[LIMITED << 8] == 13)
    rig.wait(lambda: -3 in heard)


def test_a_mapping_that_can_not_be_is_refused_to_the_peer(rig: Rig) -> None:
    remote = rig.remote
    remote.rpdo.read()
    pdo = remote.rpdo[1]
    pdo.clear()
    pdo.add_variable(INPUT)  # an input cannot be received
    with pytest.raises(canopen.SdoAbortedError) as caught:
        pdo.save()
    assert caught.value.code == AbortCode.CANNOT_BE_MAPPED
