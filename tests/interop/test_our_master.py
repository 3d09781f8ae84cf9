"""Our master's side against the `LocalNode` of canopen 2.4.1, over python-can's virtual bus."""

from __future__ import annotations

from collections.abc import Iterator

import canopen
import pytest

from canopen_proto.abort import AbortCode, AbortOrigin
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Access, Direction, Object, ObjectDictionary, PdoDescription, Variable
from canopen_proto.emcy import EmcyReceived
from canopen_proto.heartbeat import HeartbeatLost, HeartbeatReceived, NodeBooted
from canopen_proto.machine import MILLISECOND, SECOND
from canopen_proto.nmt import NmtMaster, NmtState
from canopen_proto.pdo.configure import configure_pdo, define_pdo, use_device_pdo
from canopen_proto.pdo.consumer import PdoReceived
from canopen_proto.pdo.settings import PdoSettings
from canopen_proto.procedures.objects import read, read_if_present, write
from canopen_proto.remote_node import RemoteNode
from canopen_proto.sdo.client import SdoAborted, SdoDownloaded, SdoUploaded
from canopen_proto.sync import SyncConsumer, SyncProducer, SyncReceived
from tests.core.devices import INPUT, LIMITED, OUTPUT, io_device
from tests.interop.driver import Driver
from tests.interop.peer import new_channel, peer_dictionary, peer_network

NODE = 5
DOMAIN, WIDE, FLOAT = 0x2010, 0x2011, 0x2012


def described() -> ObjectDictionary:
    more = [
        Variable(DOMAIN, 0, "domain", DataType.DOMAIN, Access.RW, b""),
        Variable(WIDE, 0, "wide", DataType.UNSIGNED64, Access.RW),
        Variable(FLOAT, 0, "float", DataType.REAL32, Access.RW),
    ]
    return io_device(NODE).with_objects([Object.of(variable.name, [variable]) for variable in more])


class Rig:
    """Our master and the peer's device on one bus."""

    def __init__(self, driver: Driver, peer: canopen.Network) -> None:
        self.driver = driver
        self.peer = peer
        dictionary = described()
        self.remote = driver.add(lambda out: RemoteNode(out, NODE, dictionary, sdo_timeout=5 * SECOND))
        self.nmt = driver.add(NmtMaster)
        self.sync = driver.add(SyncProducer)
        driver.add(SyncConsumer)
        self.device = peer.create_node(NODE, peer_dictionary(dictionary, NODE))


@pytest.fixture
def rig() -> Iterator[Rig]:
    channel = new_channel()
    driver = Driver(channel)
    with peer_network(channel) as peer:
        rig = Rig(driver, peer)
        with driver:
            yield rig


VALUES = [("output", -1234), ("limited", 12), (0x1017, 0), ("wide", 2**63 + 1), ("float", 0.5), ("text", "ab")]


@pytest.mark.parametrize(("key", "value"), VALUES)
def test_numbers_and_texts(rig: Rig, key: str | int, value: float | str) -> None:
    driver, remote = rig.driver, rig.remote
    driver.run(write(remote, key, value))
    assert driver.run(read(remote, key)) == value
    assert rig.device.sdo[remote.dictionary.variable(key).index].raw == value


def test_a_field_of_an_array(rig: Rig) -> None:
    rig.driver.run(write(rig.remote, (0x1016, 2), 0x90064))
    assert rig.device.sdo[0x1016][2].raw == 0x90064


@pytest.mark.thorough(3)
@pytest.mark.parametrize("size", [1, 4, 5, 6, 7, 8, 14, 20, 889, 5000])
def test_segmented_transfers_of_any_size(rig: Rig, size: int) -> None:
    driver, sdo = rig.driver, rig.remote.sdo
    content = bytes(position * 7 & 0xFF for position in range(size))
    downloaded = driver.outcome(lambda now: sdo.download(DOMAIN, 0, content, now))
    assert isinstance(downloaded, SdoDownloaded)
    assert rig.device.data_store[DOMAIN][0] == content
    uploaded = driver.outcome(lambda now: sdo.upload(DOMAIN, 0, now))
    assert isinstance(uploaded, SdoUploaded)
    assert uploaded.data == content


@pytest.mark.parametrize(
    ("index", "subindex", "data", "abort_code"),
    [
        (0x2FFF, 0, None, AbortCode.NO_SUCH_OBJECT),
        (0x1018, 99, None, AbortCode.NO_SUCH_SUBINDEX),
        (INPUT, 0, b"\x01\x00", AbortCode.READ_ONLY),
        (OUTPUT, 0, b"\x01\x00\x00\x00", AbortCode.LENGTH_MISMATCH),
    ],
)
def test_aborts(rig: Rig, index: int, subindex: int, data: bytes | None, abort_code: AbortCode) -> None:
    sdo = rig.remote.sdo
    if data is None:
        outcome = rig.driver.outcome(lambda now: sdo.upload(index, subindex, now))
    else:
        outcome = rig.driver.outcome(lambda now: sdo.download(index, subindex, data, now))
    assert isinstance(outcome, SdoAborted)
    assert (outcome.abort_code, outcome.origin) == (abort_code, AbortOrigin.PEER)


def test_many_requests_at_once_are_answered_in_order(rig: Rig) -> None:
    driver, remote = rig.driver, rig.remote
    requests = driver.do(lambda now: [remote.write("output", value, now) for value in range(20)])
    assert [driver.event(SdoDownloaded).request_id for _ in requests] == requests
    assert rig.device.sdo[OUTPUT].raw == 19


def test_an_object_that_the_device_lacks(rig: Rig) -> None:
    del rig.device.object_dictionary[LIMITED]
    assert rig.driver.run(read_if_present(rig.remote, "limited")) is None


def test_nmt_commands_and_boot_up(rig: Rig) -> None:
    driver = rig.driver
    for command, state in [
        (rig.nmt.start, "OPERATIONAL"),
        (rig.nmt.stop, "STOPPED"),
        (rig.nmt.enter_pre_operational, "PRE-OPERATIONAL"),
    ]:
        driver.do(lambda now, command=command: command(NODE, now))  # type: ignore[misc]
        driver.wait(lambda state=state: rig.device.nmt.state == state)  # type: ignore[misc]
    rig.device.nmt.send_command(0x81)  # it resets itself: INITIALISING, and its boot-up frame
    driver.event(NodeBooted, lambda report: report.node_id == NODE)
    assert rig.remote.nmt_state is NmtState.PRE_OPERATIONAL


def test_heartbeat_comes_changes_and_is_lost(rig: Rig) -> None:
    driver, remote = rig.driver, rig.remote
    driver.do(lambda now: rig.nmt.enter_pre_operational(NODE, now))
    driver.wait(lambda: rig.device.nmt.state == "PRE-OPERATIONAL")
    driver.run(write(remote, 0x1017, 20))
    driver.event(HeartbeatReceived, lambda report: report.state is NmtState.PRE_OPERATIONAL)
    driver.do(lambda now: remote.heartbeat.set_timeout(2 * SECOND, now))
    driver.do(lambda now: rig.nmt.start(NODE, now))
    driver.event(HeartbeatReceived, lambda report: report.state is NmtState.OPERATIONAL)
    assert remote.is_operational
    driver.do(lambda now: remote.heartbeat.set_timeout(200 * MILLISECOND, now))
    rig.device.nmt.stop_heartbeat()
    driver.event(HeartbeatLost)


def test_emergencies(rig: Rig) -> None:
    rig.device.emcy.send(0x2310, 0x03, b"\x01\x02\x03\x04\x05")
    emcy = rig.driver.event(EmcyReceived)
    assert (emcy.node_id, emcy.code, emcy.error_register, emcy.vendor_data) == (NODE, 0x2310, 3, b"\x01\x02\x03\x04\x05")
    rig.device.emcy.reset()
    assert rig.driver.event(EmcyReceived).code == 0


def test_sync_of_the_peer_is_heard(rig: Rig) -> None:
    rig.peer.sync.transmit()
    assert rig.driver.event(SyncReceived).counter is None


def test_pdos_as_the_device_has_them(rig: Rig) -> None:
    driver, remote, device = rig.driver, rig.remote, rig.device
    device.tpdo.read()
    device.rpdo.read()
    assert driver.run(use_device_pdo(remote, Direction.TPDO, 1)).parameters == (0x20000010,)
    assert driver.run(use_device_pdo(remote, Direction.RPDO, 1)).parameters == (0x20010010,)

    device.tpdo[1][INPUT].raw = -321
    device.tpdo[1].transmit()
    assert driver.event(PdoReceived).components == (-321,)
    assert remote.values.store[INPUT << 8] == -321

    driver.do(lambda now: rig.nmt.start(NODE, now))
    driver.do(lambda now: remote.enable_rpdo(1, now))
    remote.values.store[OUTPUT << 8] = 77
    driver.do(remote.rpdos[1].trigger)
    driver.wait(lambda: device.rpdo[1].is_received)
    assert device.rpdo[1][OUTPUT].raw == 77


def test_a_pdo_defined_by_us_is_read_by_the_peer(rig: Rig) -> None:
    driver, remote, device = rig.driver, rig.remote, rig.device
    variables = remote.dictionary.variable(LIMITED), remote.dictionary.variable(OUTPUT)
    before = driver.run(define_pdo(remote, PdoDescription("out", 0x200, Direction.RPDO, 1, variables), transmission_type=255))
    assert before == PdoSettings(1, Direction.RPDO, 0x205, 255, (0x20010010,))
    device.rpdo[1].read()
    assert [(entry.index, entry.length) for entry in device.rpdo[1]] == [(LIMITED, 8), (OUTPUT, 16)]
    driver.do(lambda now: rig.nmt.start(NODE, now))
    driver.do(lambda now: remote.enable_rpdo(1, now))
    remote.values.store.update({LIMITED << 8: 17, OUTPUT << 8: -2})
    driver.do(remote.rpdos[1].trigger)
    driver.wait(lambda: device.rpdo[1].is_received)
    assert (device.rpdo[1][LIMITED].raw, device.rpdo[1][OUTPUT].raw) == (17, -2)


def test_old_settings_can_be_restored(rig: Rig) -> None:
    new = PdoSettings(1, Direction.TPDO, 0x40000195, 1, (0x20010010, 0x20020008))
    before = rig.driver.run(configure_pdo(rig.remote, new))
    assert rig.driver.run(configure_pdo(rig.remote, before)) == new


def test_a_synchronous_rpdo_leaves_behind_our_sync(rig: Rig) -> None:
    driver, remote, device = rig.driver, rig.remote, rig.device
    device.rpdo.read()
    syncs: list[int] = []
    rig.peer.subscribe(0x80, lambda can_id, data, timestamp: syncs.append(can_id))
    driver.run(use_device_pdo(remote, Direction.RPDO, 2))
    driver.do(lambda now: rig.nmt.start(NODE, now))
    remote.values.store[OUTPUT << 8] = 5
    driver.do(lambda now: remote.enable_rpdo(2, now))
    driver.do(rig.sync.send)
    driver.wait(lambda: device.rpdo[2].is_received)
    assert device.rpdo[2][OUTPUT].raw == 5
    assert syncs == [0x80]
