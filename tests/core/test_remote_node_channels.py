"""Further SDO channels of a remote node, and its multiplexed PDOs as a master exchanges them."""

from __future__ import annotations

import pytest

from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.dictionary import Direction
from canopen_proto.frame import KEY_EXTENDED
from canopen_proto.heartbeat import NodeBooted
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import SECOND, FrameIgnored, LocalProtocolError
from canopen_proto.network import Network
from canopen_proto.nmt import NmtMaster
from canopen_proto.pdo.consumer import PdoLengthUnexpected
from canopen_proto.pdo.multiplexed import MpdoReceived
from canopen_proto.remote_node import RemoteNode
from canopen_proto.sdo.client import SdoAborted, SdoDownloaded, SdoUploaded
from tests.core.bus import Bus
from tests.core.devices import INPUT, OUTPUT
from tests.core.test_mpdo import DAM, SECRET, TABLE, mpdo_device
from tests.core.test_remote_node import MasterBench

REQUESTS, RESPONSES = 0x640, 0x5C0


# ---- SDO channels ----


def test_a_channel_transfers_beside_the_first_one() -> None:
    bench = MasterBench()
    channel = bench.node.add_sdo_channel(REQUESTS, RESPONSES)
    long_one = bench.node.sdo.upload(0x1008, 0, bench.now)
    request = channel.upload(INPUT, 0, bench.now)
    assert bench.take() == ["605#4008100000000000", f"640#40{INPUT & 0xFF:02X}{INPUT >> 8:02X}0000000000"]
    assert bench.tell(f"5C0#4B{INPUT & 0xFF:02X}{INPUT >> 8:02X}0007000000") == []
    assert bench.seen(SdoUploaded) == [SdoUploaded(5, request, INPUT, 0, b"\x07\x00")]
    assert bench.node.values.store[INPUT << 8] == 7
    assert bench.node.heard_at[INPUT << 8] == bench.now
    assert bench.node.sdo.busy
    assert bench.node.cancel(long_one, bench.now)
    assert RESPONSES in bench.network.can_ids()
    assert bench.node.sdo_channels == [channel]


def test_requests_of_a_channel_are_cancelled_by_the_node() -> None:
    bench = MasterBench()
    channel = bench.node.add_sdo_channel(REQUESTS, RESPONSES)
    request = channel.upload(0x1000, 0, bench.now)
    assert bench.node.cancel(request, bench.now)
    assert not bench.node.cancel(request, bench.now)
    assert bench.take() == ["640#4000100000000000", "640#8000100000000008"]


def test_all_requests_move_to_another_channel_and_back() -> None:
    bench = MasterBench()
    other = bench.node.add_sdo_channel(0x641, 0x5C1)
    with pytest.raises(LocalProtocolError, match="another channel uses CAN-ID 0x5C1"):
        bench.node.move_sdo((REQUESTS, 0x5C1), bench.now)
    bench.node.remove_sdo_channel(other, bench.now)
    client, open_request = bench.node.sdo, bench.node.read(0x1000, bench.now)
    bench.take()
    bench.node.move_sdo((REQUESTS, RESPONSES), bench.now)
    assert bench.take() == ["605#8000100022000008"]
    assert [(each.request_id, each.origin) for each in bench.seen(SdoAborted)] == [(open_request, AbortOrigin.LOCAL)]
    assert bench.node.sdo is client
    bench.node.read(0x1000, bench.now)
    assert bench.take() == ["640#4000100000000000"]
    assert bench.tell("5C0#4300100091010000") == []
    assert bench.node.values.store[0x1000_00] == 0x191
    assert {0x585, 0x605}.isdisjoint(client.can_ids())
    bench.node.move_sdo(None, bench.now)
    bench.node.read(0x1000, bench.now)
    assert bench.take() == ["605#4000100000000000"]


def test_they_end_when_the_node_boots_or_is_lost() -> None:
    bench = MasterBench(heartbeat_timeout=SECOND)
    channel = bench.node.add_sdo_channel(REQUESTS | KEY_EXTENDED, RESPONSES | KEY_EXTENDED)
    boot = channel.download(0x1017, 0, b"\x01\x00", bench.now)
    bench.take()
    assert bench.tell("705#00") == ["00000640#8017100023000A06"]
    assert bench.seen(SdoAborted) == [
        SdoAborted(5, boot, 0x1017, 0, AbortCode.NO_SDO_CONNECTION, AbortOrigin.LOCAL, not_confirmed=True)
    ]
    assert bench.seen(NodeBooted)
    channel.timeout = 10 * SECOND
    lost = channel.upload(0x1000, 0, bench.now)
    bench.tell("705#7F")
    bench.wait(SECOND)
    assert [report.request_id for report in bench.seen(SdoAborted)] == [lost]


def test_a_channel_is_removed() -> None:
    bench = MasterBench()
    channel = bench.node.add_sdo_channel(REQUESTS, RESPONSES)
    request = channel.upload(0x1000, 0, bench.now)
    bench.node.remove_sdo_channel(channel, bench.now)
    bench.take()
    assert [report.request_id for report in bench.seen(SdoAborted)] == [request]
    assert RESPONSES not in bench.network.can_ids()
    assert bench.node.sdo_channels == []
    bench.node.add_sdo_channel(REQUESTS, RESPONSES)


@pytest.mark.parametrize(
    ("request_key", "response_key", "match"),
    [
        (0x640, 0x585, "another channel uses CAN-ID 0x585"),
        (0x640, 0x640, "another channel uses CAN-ID 0x640"),
        (0x640, 0x5C1, "another channel uses CAN-ID 0x5C1"),
        (0x800, 0x5C0, "more than 11 bits"),
        (0x640, 0x5C00, "more than 11 bits"),
    ],
)
def test_keys_that_are_none(request_key: int, response_key: int, match: str) -> None:
    bench = MasterBench()
    bench.node.add_sdo_channel(0x641, 0x5C1)
    with pytest.raises(LocalProtocolError, match=match):
        bench.node.add_sdo_channel(request_key, response_key)
    assert len(bench.node.sdo_channels) == 1


# ---- MPDOs ----


def listening() -> MasterBench:
    bench = MasterBench(mpdo_device()).operational()
    bench.node.add_mpdo(Direction.TPDO, 3, 0x1C5)
    bench.node.add_mpdo(Direction.RPDO, 4, 0x1C1)
    return bench


def test_what_a_node_says_by_mpdo_is_known() -> None:
    bench = listening()
    heard: list[object] = []
    bench.node.add_listener(lambda muxes, now: heard.append(tuple(muxes)))
    assert bench.tell("1C5#050021030700FFFF") == []
    assert bench.seen(MpdoReceived) == [MpdoReceived(5, 3, 0x1C5, 5, TABLE, 3, 7, None)]
    mux = TABLE << 8 | 3
    assert bench.node.values.store[mux] == 7
    assert bench.node.fresh(mux, bench.now) == 7
    assert heard == [(mux,)]


@pytest.mark.parametrize("frame", ["1C5#85002103070000", "1C5#"])
def test_a_short_one_is_reported(frame: str) -> None:
    bench = listening()
    bench.tell(frame)
    (report,) = bench.seen(PdoLengthUnexpected)
    assert (report.node_id, report.number) == (5, 3)


@pytest.mark.parametrize(
    ("frame", "reason"),
    [
        ("1C5#8500210307000000", "TPDO 3 is an MPDO in source address mode"),
        ("1C5#0500220307000000", "an MPDO with object 0x2200:03, which no TPDO can carry"),
        ("1C5#0504210007000000", f"an MPDO with object 0x{SECRET:04X}:00, which no TPDO can carry"),
    ],
)
def test_what_makes_no_sense_is_told(frame: str, reason: str) -> None:
    bench = listening()
    before = dict(bench.node.values.store)
    bench.tell(frame)
    assert [report.reason for report in bench.seen(FrameIgnored)] == [reason]
    assert dict(bench.node.values.store) == before


def test_another_producer_on_that_can_id_is_not_this_node() -> None:
    bench = listening()
    bench.events.clear()
    bench.tell("1C5#0600210307000000")
    assert bench.events == []


def test_objects_of_the_node_are_written_by_mpdo() -> None:
    bench = listening()
    assert bench.node.send_mpdo(4, (TABLE, 2), -2, bench.now)
    assert bench.take() == ["1C1#85002102FEFF0000"]
    assert bench.node.values.store[TABLE << 8 | 2] == -2
    bench.nmt.stop(5, bench.now)
    bench.take()
    assert not bench.node.send_mpdo(4, (TABLE, 2), 9, bench.now)
    assert bench.take() == []
    assert bench.node.values.store[TABLE << 8 | 2] == -2


def test_what_cannot_be_sent_raises() -> None:
    bench = listening()
    for number, key, match in (
        (3, (TABLE, 2), "add_mpdo"),
        (4, SECRET, "an MPDO cannot carry"),
        (4, INPUT, "cannot be written"),
    ):
        with pytest.raises(LocalProtocolError, match=match):
            bench.node.send_mpdo(number, key, 1, bench.now)
    with pytest.raises(LocalProtocolError, match="11 bits"):
        bench.node.add_mpdo(Direction.TPDO, 3, 0x800)
    with pytest.raises(LocalProtocolError, match="1..512"):
        bench.node.add_mpdo(Direction.TPDO, 513, 0x1C5)
    assert bench.take() == []


def test_they_are_removed() -> None:
    bench = listening()
    bench.node.remove_pdo(Direction.TPDO, 3)
    bench.node.remove_pdo(Direction.RPDO, 4)
    bench.events.clear()
    assert 0x1C5 not in bench.network.can_ids()
    assert bench.tell("1C5#0500210307000000") == []
    assert bench.events == []
    with pytest.raises(LocalProtocolError, match="add_mpdo"):
        bench.node.send_mpdo(4, (TABLE, 2), 1, bench.now)


def test_with_a_device_in_both_directions() -> None:
    bus = Bus()
    device = bus.attach(Network())
    local = LocalNode(device.out, 5, mpdo_device())
    device.attach(local)
    master = bus.attach(Network())
    remote, nmt = RemoteNode(master.out, 5, local.dictionary), NmtMaster(master.out)
    for machine in (remote, nmt):
        master.attach(machine)
    remote.add_mpdo(Direction.RPDO, 4, 0x1C1)
    remote.add_mpdo(Direction.TPDO, 3, 0x1C5)
    local.boot(bus.now)
    local.set_value(0x1FA0, 1, 1 << 24 | INPUT << 8, bus.now)
    bus.run(SECOND)
    nmt.start(0, bus.now)
    bus.run(SECOND)
    assert remote.send_mpdo(4, OUTPUT, 0x55, bus.now)
    local.set_value(INPUT, 0, 0x1234, bus.now)
    bus.run(SECOND)
    assert local.values.store[OUTPUT << 8] == 0x55
    assert remote.values.store[INPUT << 8] == 0x1234
    request = remote.write((0x1017, 0), 0, bus.now, block=True)
    bus.run(SECOND)
    assert SdoDownloaded(5, request, 0x1017, 0) in bus.events
    request = remote.read((0x1017, 0), bus.now, block="auto")
    bus.run(SECOND)
    assert SdoUploaded(5, request, 0x1017, 0, b"\x00\x00") in bus.events
    assert DAM == 0xFF
