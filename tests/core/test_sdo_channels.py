"""A device with several SDO channels: further servers (0x1201..) and clients (0x1280..), set up by SDO."""

from __future__ import annotations

import pytest

from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Access, Object, ObjectDictionary, Variable
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.frame import EXTENDED, KEY_EXTENDED, Frame
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import LocalProtocolError
from canopen_proto.network import Network
from canopen_proto.procedures.steps import upload
from canopen_proto.sdo.client import SdoAborted, SdoClient, SdoDownloaded, SdoUploaded
from canopen_proto.sdo.events import ObjectAccessPending, ObjectWritten, SdoServerAborted
from tests.core.bus import Bus
from tests.core.device_bench import PRE_OPERATIONAL, RESET_COMMUNICATION, RESET_NODE, START, STOP, DeviceBench
from tests.core.devices import OUTPUT, TEXT, io_device

INVALID = 0x8000_0000
FIRMWARE = 0x1F50
READ_TYPE = "4000100000000000"
DEVICE_TYPE = "4300100091010000"


def several_channels(*more: Object) -> ObjectDictionary:
    """An I/O device with two further servers and two clients."""
    objects = [
        standard_object(0x1200),
        *(standard_object(index) for index in (0x1201, 0x1202, 0x1280, 0x1281)),
        *(standard_object(index, highest=2) for index in (0x1010, 0x1011)),
        Object.of("firmware", [Variable(FIRMWARE, 0, "firmware", DataType.DOMAIN, Access.RW)]),
        *more,
    ]
    return io_device().with_objects(objects)


def set_up(bench: DeviceBench, index: int, to_server: int, to_client: int, other: int = 0) -> None:
    for subindex, cob_id in ((1, to_server), (2, to_client)):
        assert bench.write(index, subindex, cob_id, 4) is None
    if other:
        assert bench.write(index, 3, other, 1) is None


@pytest.fixture
def bench() -> DeviceBench:
    return DeviceBench(several_channels())


# ---- servers ----


def test_a_server_answers_while_both_cob_ids_are_valid(bench: DeviceBench) -> None:
    assert bench.tell(f"6A1#{READ_TYPE}") == []
    assert bench.write(0x1201, 1, 0x6A1, 4) is None
    assert bench.tell(f"6A1#{READ_TYPE}") == []  # the other one is not valid yet
    assert bench.write(0x1201, 2, 0x6A2, 4) is None
    assert bench.tell(f"6A1#{READ_TYPE}") == [f"6A2#{DEVICE_TYPE}"]
    assert bench.tell(f"605#{READ_TYPE}") == [f"585#{DEVICE_TYPE}"]
    assert bench.node.channels.servers[2].channel == (0x6A1, 0x6A2)
    assert bench.write(0x1201, 2, INVALID | 0x6A2, 4) is None
    assert bench.tell(f"6A1#{READ_TYPE}") == []
    assert bench.node.channels.servers[2].channel is None


def test_segments_go_out_on_the_channel_that_asked(bench: DeviceBench) -> None:
    set_up(bench, 0x1201, 0x6A1, 0x6A2)
    assert bench.tell("6A1#2103200003000000", "6A1#0961626300000000") == ["6A2#6003200000000000", "6A2#2000000000000000"]
    assert bench.node.values.store[TEXT << 8] == "abc"


def test_the_same_read_again_brings_the_value_of_now_on_the_channel_of_now(bench: DeviceBench) -> None:
    """Also where the server asked that way has answered it already, and whichever object came between."""
    set_up(bench, 0x1201, 0x6A1, 0x6A2)
    heartbeat = "6A1#4017100000000000"  # the time is as long as the other value, and is the same at first
    for value in (0, 0, 2):
        bench.node.set_value(OUTPUT, 0, value, 0)
        answer = f"6A2#4B012000{value:02X}000000"
        read = ["6A1#4001200000000000", heartbeat, "6A1#4001200000000000"]
        assert bench.tell(*read) == [answer, "6A2#4B17100000000000", answer]
    assert bench.write(0x1201, 2, INVALID | 0x6A2, 4) is None
    assert bench.write(0x1201, 2, 0x6A3, 4) is None
    assert bench.tell("6A1#4001200000000000") == ["6A3#4B01200002000000"]


def test_29_bit_channels(bench: DeviceBench) -> None:
    set_up(bench, 0x1202, 0x38FF_0001, 0x38FF_0002)
    bench.network.receive(Frame(0x18FF_0001, bytes.fromhex(READ_TYPE), EXTENDED), 0)
    assert bench.take() == [f"18FF0002#{DEVICE_TYPE}"]
    assert bench.node.channels.servers[3].channel == (0x18FF_0001 | KEY_EXTENDED, 0x18FF_0002 | KEY_EXTENDED)


@pytest.mark.parametrize(
    ("standing", "written", "refusal"),
    [
        (INVALID, 0x6A1, None),
        (INVALID, 0x600, None),
        (INVALID, 0x601, AbortCode.INVALID_VALUE),
        (INVALID, 0x67F, AbortCode.INVALID_VALUE),
        (INVALID, 0x5FF, AbortCode.INVALID_VALUE),
        (INVALID, 0x701, AbortCode.INVALID_VALUE),
        (INVALID, 0x000, AbortCode.INVALID_VALUE),
        (INVALID, 0x800, AbortCode.INVALID_VALUE),  # more than 11 bits, and no frame bit
        (INVALID, 0x2000_0800, None),
        (INVALID, 0x4000_06A1, None),
        (INVALID, INVALID | 0x601, None),
        (0x6A1, 0x6A1, None),
        (0x6A1, 0x6A3, AbortCode.DEVICE_STATE),
        (0x6A1, 0x2000_06A1, AbortCode.DEVICE_STATE),
        (0x6A1, 0x4000_06A1, None),  # the dynamic bit may change
        (0x6A1, INVALID, None),
    ],
)
@pytest.mark.parametrize(("index", "subindex"), [(0x1201, 1), (0x1202, 2), (0x1280, 2), (0x1281, 1)])
def test_which_cob_ids_may_be_written(index: int, subindex: int, standing: int, written: int, refusal: AbortCode | None) -> None:
    bench = DeviceBench(several_channels())
    bench.node.set_value(index, subindex, standing, 0)
    if index >= 0x1280 and written in ((0x601, 0x67F) if subindex == 1 else (0x5FF,)):
        refusal = None  # the channel of another node's first server
    assert bench.write(index, subindex, written, 4) == refusal
    assert bench.number(index, subindex) == (standing if refusal else written)


def test_an_empty_record_is_no_channel() -> None:
    """A description without defaults holds zeros there: CAN-ID 0 is NMT."""
    empty = {1: 0, 2: 0}
    dictionary = several_channels(standard_object(0x1201, defaults=empty), standard_object(0x1280, defaults=empty))
    bench = DeviceBench(dictionary)
    assert bench.node.channels.servers[2].channel is None
    assert bench.node.sdo_client(1).can_ids() == ()
    set_up(bench, 0x1201, 0x6A1, 0x6A2)
    assert bench.tell(f"6A1#{READ_TYPE}") == [f"6A2#{DEVICE_TYPE}"]


def test_a_channel_stands_by_default_where_the_description_says_so() -> None:
    bench = DeviceBench(several_channels(standard_object(0x1201, defaults={1: 0x6A1, 2: 0x6A2})))
    assert bench.tell(f"6A1#{READ_TYPE}") == [f"6A2#{DEVICE_TYPE}"]


def test_the_node_id_of_the_client(bench: DeviceBench) -> None:
    assert bench.write(0x1201, 3, 127, 1) is None
    assert bench.write(0x1201, 3, 128, 1) == AbortCode.INVALID_VALUE
    assert bench.write(0x1201, 0, 2, 1) == AbortCode.READ_ONLY
    assert bench.number(0x1201, 3) == 127
    with pytest.raises(LocalProtocolError, match="node_id_of_client"):
        bench.node.set_value(0x1201, 3, 200, 0)


def test_a_number_of_fields_that_can_be_written() -> None:
    count = Variable(0x1201, 0, "record:count", DataType.UNSIGNED8, Access.RW, 3)
    record = standard_object(0x1201)
    bench = DeviceBench(several_channels(Object.of(record.name, [count, *(record.variables[sub] for sub in (1, 2, 3))])))
    assert bench.write(0x1201, 0, 2, 1) is None


def test_a_channel_may_be_closed_over_itself(bench: DeviceBench) -> None:
    """The confirmation still goes out on it; so does that of a segmented download."""
    set_up(bench, 0x1201, 0x6A1, 0x6A2)
    assert bench.tell("6A1#2301120100000080") == ["6A2#6001120100000000"]
    assert bench.tell(f"6A1#{READ_TYPE}") == []
    assert bench.write(0x1201, 1, 0x6A1, 4) is None
    assert bench.tell("6A1#2101120204000000", "6A1#0700000080000000") == ["6A2#6001120200000000", "6A2#2000000000000000"]
    assert bench.tell(f"6A1#{READ_TYPE}") == []
    assert bench.seen(SdoServerAborted) == []


def test_a_transfer_of_a_channel_that_is_closed_is_aborted(bench: DeviceBench) -> None:
    set_up(bench, 0x1201, 0x6A1, 0x6A2)
    bench.tell("6A1#2103200003000000")
    assert bench.write(0x1201, 1, INVALID, 4) is None
    assert bench.others == ["6A2#8003200022000008"]
    (aborted,) = bench.seen(SdoServerAborted)
    assert (aborted.index, aborted.abort_code, aborted.origin) == (TEXT, AbortCode.DEVICE_STATE, AbortOrigin.LOCAL)


def test_each_server_has_its_own_transfer(bench: DeviceBench) -> None:
    set_up(bench, 0x1201, 0x6A1, 0x6A2)
    bench.tell("6A1#2103200003000000", "605#2103200002000000")
    assert bench.tell("605#0B58590000000000", "6A1#0961626300000000") == ["585#2000000000000000", "6A2#2000000000000000"]
    assert bench.node.values.store[TEXT << 8] == "abc"  # the last one that was confirmed


def test_the_nmt_state_opens_and_shuts_all(bench: DeviceBench) -> None:
    set_up(bench, 0x1201, 0x6A1, 0x6A2)
    bench.tell("6A1#2103200003000000", STOP)
    assert bench.tell(f"6A1#{READ_TYPE}") == []
    assert bench.tell(START, f"6A1#{READ_TYPE}") == [f"6A2#{DEVICE_TYPE}"]
    (aborted,) = bench.seen(SdoServerAborted)
    assert aborted.origin is AbortOrigin.CANCELLED


@pytest.mark.parametrize("reset", [RESET_COMMUNICATION, RESET_NODE])
def test_a_reset_puts_the_channels_back(reset: str) -> None:
    bench = DeviceBench(several_channels(standard_object(0x1202, defaults={1: 0x6B1, 2: 0x6B2})))
    set_up(bench, 0x1201, 0x6A1, 0x6A2)
    assert bench.write(0x1202, 1, INVALID, 4) is None
    bench.tell("6A1#2103200003000000")  # under way when it comes
    assert bench.tell(reset) == ["705#00"]
    assert bench.tell(f"6A1#{READ_TYPE}", f"6B1#{READ_TYPE}") == [f"6B2#{DEVICE_TYPE}"]
    assert bench.number(0x1201, 1) == INVALID


def test_saved_channels_are_there_after_a_reset_and_dynamic_ones_are_not(bench: DeviceBench) -> None:
    set_up(bench, 0x1201, 0x6A1, 0x6A2)
    set_up(bench, 0x1280, 0x4000_06C1, 0x4000_06C2, 9)
    bench.tell("605#2310100173617665")
    (access,) = bench.seen(ObjectAccessPending)
    bench.node.complete(access.access_id, None, bench.now)
    assert bench.take() == ["585#6010100100000000"]
    bench.tell(RESET_NODE)
    assert bench.tell(f"6A1#{READ_TYPE}") == [f"6A2#{DEVICE_TYPE}"]
    assert (bench.number(0x1280, 1), bench.number(0x1280, 3)) == (INVALID, 9)
    assert not bench.node.channels.clients[1].is_open


# ---- the host ----


def pending(bench: DeviceBench) -> ObjectAccessPending:
    (access,) = bench.seen(ObjectAccessPending)
    return access


def test_the_host_serves_each_channel_by_itself(bench: DeviceBench) -> None:
    set_up(bench, 0x1201, 0x6A1, 0x6A2)
    bench.node.deferred.add(OUTPUT)
    bench.tell("605#4001200000000000")
    first = pending(bench)
    bench.tell("6A1#2B01200007000000")
    second = pending(bench)
    assert first.access_id != second.access_id
    with pytest.raises(LocalProtocolError, match="None expected|None or"):
        bench.node.complete(second.access_id, b"\x00", bench.now)
    bench.node.complete(second.access_id, None, bench.now)
    assert bench.take() == ["6A2#6001200000000000"]
    bench.node.complete(first.access_id, b"\x05\x00", bench.now)
    assert bench.take() == ["585#4B01200005000000"]
    bench.node.complete(first.access_id, b"\x05\x00", bench.now)  # nobody waits for it any more
    assert bench.take() == []


def test_one_client_at_a_time_stores(bench: DeviceBench) -> None:
    set_up(bench, 0x1201, 0x6A1, 0x6A2)
    bench.tell("605#2310100173617665")
    access = pending(bench)
    assert bench.tell("6A1#2310100273617665") == ["6A2#8010100222000008"]
    assert bench.tell("6A1#231110016C6F6164") == ["6A2#8011100122000008"]
    assert bench.tell("6A1#2310100100000000") == ["6A2#8010100120000008"]  # no signature
    bench.node.complete(access.access_id, None, bench.now)
    assert bench.take() == ["585#6010100100000000"]
    assert bench.node.storage.saved[0x120101] == 0x6A1  # what the others were refused has not spoilt it
    bench.tell("6A1#2310100273617665")
    assert pending(bench).subindex == 2


def test_a_request_to_store_may_be_repeated_on_its_channel(bench: DeviceBench) -> None:
    bench.tell("605#2310100173617665")
    first = pending(bench)
    bench.tell("605#2110100104000000", "605#0773617665000000")
    second = pending(bench)
    bench.node.complete(first.access_id, None, bench.now)
    assert bench.take()[1:] == []
    bench.node.complete(second.access_id, None, bench.now)
    assert bench.take() == ["585#2000000000000000"]
    assert bench.node.storage.saved


def test_pieces_of_two_downloads_do_not_mix(bench: DeviceBench) -> None:
    set_up(bench, 0x1201, 0x6A1, 0x6A2)
    bench.node.deferred.add(FIRMWARE)
    bench.node.in_pieces.add(FIRMWARE)
    assert bench.tell("6A1#21501F0008000000") == ["6A2#60501F0000000000"]
    busy = "80501F0022000008"
    assert bench.tell("605#21501F0008000000") == [f"585#{busy}"]
    assert bench.tell("605#C2501F0008000000") == [f"585#{busy}"]
    assert bench.tell("605#23501F0001020304") == [f"585#{busy}"]
    assert bench.tell("6A1#0001020304050607", "6A1#1D08000000000000") == ["6A2#2000000000000000"]
    access = pending(bench)
    assert (access.data, access.more) == (bytes(range(1, 9)), False)
    assert bench.tell("605#21501F0008000000") == [f"585#{busy}"]
    bench.node.complete(access.access_id, None, bench.now)
    assert bench.take() == ["6A2#3000000000000000"]
    assert bench.tell("605#23501F0001020304") == []
    assert pending(bench).data == b"\x01\x02\x03\x04"


# ---- clients ----


class Two:
    """Node 5, which is SDO client, and node 9, an I/O device, on a bus."""

    def __init__(self) -> None:
        self.bus = Bus()
        self.master = self.bus.attach(Network())
        self.sdo = SdoClient(self.master.out, 5)
        self.master.attach(self.sdo)
        self.network = self.bus.attach(Network())
        self.node = LocalNode(self.network.out, 5, several_channels())
        self.network.attach(self.node)
        self.other_network = self.bus.attach(Network())
        self.other = LocalNode(self.other_network.out, 9, several_channels())
        self.other_network.attach(self.other)
        for node in (self.node, self.other):
            node.boot(0)
        self.write(0x1280, 1, 0x609)
        self.write(0x1280, 2, 0x589)
        self.sdo.download(0x1280, 3, b"\x09", self.bus.now)
        self.bus.run(10_000_000)
        self.bus.events.clear()
        self.bus.sent.clear()

    def write(self, index: int, subindex: int, value: int) -> None:
        self.sdo.download(index, subindex, value.to_bytes(4, "little"), self.bus.now)

    def outcomes(self) -> list[SdoUploaded | SdoDownloaded | SdoAborted]:
        """Of node 5's own requests, all of them."""
        self.bus.run(2_000_000_000)
        found = [each for each in self.bus.events if isinstance(each, SdoUploaded | SdoDownloaded | SdoAborted)]
        self.bus.events.clear()
        return [each for each in found if each.node_id != 5]


def test_a_device_reads_and_writes_another_one() -> None:
    two = Two()
    client = two.node.sdo_client(1)
    assert client is two.node.channels.clients[1]
    read = client.upload(TEXT, 0, two.bus.now)
    written = client.download(OUTPUT, 0, b"\x07\x00", two.bus.now)
    uploaded, downloaded = two.outcomes()
    text = two.other.values.store[TEXT << 8]
    assert isinstance(text, str)
    assert uploaded == SdoUploaded(9, read, TEXT, 0, text.encode())
    assert downloaded == SdoDownloaded(9, written, OUTPUT, 0)
    assert two.other.values.store[OUTPUT << 8] == 7


def test_a_procedure_may_use_it() -> None:
    two = Two()
    request_id = two.network.run(upload(two.node.sdo_client(1), 0x1000, 0), two.bus.now)
    two.bus.run(10_000_000)
    (finished,) = [each for each in two.bus.events if getattr(each, "request_id", None) == request_id]
    assert finished.result == b"\x91\x01\x00\x00"  # type: ignore[attr-defined]


def test_requests_end_when_the_record_becomes_invalid() -> None:
    """And the client follows the record: the next request goes where it says."""
    two = Two()
    two.write(0x1280, 1, INVALID)
    client = two.node.sdo_client(1)
    two.bus.detach(two.other_network)
    requests = [client.upload(TEXT, 0, two.bus.now), client.upload(OUTPUT, 0, two.bus.now)]
    aborted = two.outcomes()
    assert [each.request_id for each in aborted] == requests
    for each in aborted:
        assert isinstance(each, SdoAborted)
        assert (each.abort_code, each.origin, each.node_id) == (AbortCode.DEVICE_STATE, AbortOrigin.LOCAL, 9)
    assert [str(frame) for _, frame in two.bus.sent if frame.can_id == 0x609] == ["609#4003200000000000", "609#8003200022000008"]
    with pytest.raises(LocalProtocolError, match=r"upload 0x1000:00: 0x1280 holds no channel"):
        client.upload(0x1000, 0, two.bus.now)

    two.write(0x1280, 2, INVALID)
    two.write(0x1280, 1, 0x38FF_0001)
    two.write(0x1280, 2, 0x6C2)
    two.bus.run(10_000_000)
    two.bus.sent.clear()
    client.upload(TEXT, 0, two.bus.now)
    two.bus.run(1_000_000)
    two.bus.send("6C2#4103200008000000")
    two.bus.run(1_000_000)
    assert two.bus.trace() == ["18FF0001#4003200000000000", "6C2#4103200008000000", "18FF0001#6000000000000000"]


def test_a_stopped_device_is_no_client() -> None:
    two = Two()
    client = two.node.sdo_client(1)
    request = client.upload(TEXT, 0, two.bus.now)
    two.bus.detach(two.other_network)
    two.bus.pump()
    two.bus.send(STOP)
    (aborted,) = two.outcomes()
    assert isinstance(aborted, SdoAborted)
    assert (aborted.request_id, aborted.abort_code, aborted.origin) == (request, AbortCode.DEVICE_STATE, AbortOrigin.LOCAL)
    assert two.bus.trace() == ["609#4003200000000000", STOP]  # no abort: it may not send any
    with pytest.raises(LocalProtocolError, match="SDO does not live"):
        client.upload(TEXT, 0, two.bus.now)
    two.bus.send("589#4103200008000000")
    two.bus.send(PRE_OPERATIONAL)
    two.bus.run(1_000_000)
    assert client.upload(TEXT, 0, two.bus.now) > request


def test_a_reset_closes_a_client() -> None:
    two = Two()
    client = two.node.sdo_client(1)
    client.upload(TEXT, 0, two.bus.now)
    two.bus.send(RESET_COMMUNICATION)
    (aborted,) = two.outcomes()
    assert isinstance(aborted, SdoAborted)
    assert "609#8003200022000008" not in two.bus.trace()
    assert (client.is_open, client.channel) == (False, None)


def test_a_client_that_is_not_there() -> None:
    with pytest.raises(LocalProtocolError, match="SDO client 3: the dictionary has no record for it.* It has: 1, 2"):
        DeviceBench(several_channels()).node.sdo_client(3)
    with pytest.raises(LocalProtocolError, match="It has: none"):
        DeviceBench().node.sdo_client(1)


def test_the_record_names_the_server(bench: DeviceBench) -> None:
    set_up(bench, 0x1281, 0x60C, 0x58C)
    client = bench.node.sdo_client(2)
    assert client.node_id == 5  # as long as it does not say
    assert bench.write(0x1281, 3, 12, 1) is None
    assert client.node_id == 12
    assert bench.write(0x1281, 3, 0, 1) is None
    assert client.node_id == 12
    assert [each.index for each in bench.seen(ObjectWritten)] == [0x1281] * 4
