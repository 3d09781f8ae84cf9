"""A device's PDO parameters: what may be written when, and what follows (CiA 301 v4.2.0, 7.5.2.35 to 7.5.2.38)."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.abort import AbortCode
from canopen_proto.cob_id import RESTRICTED_CAN_IDS
from canopen_proto.dictionary import Direction, ObjectDictionary, Values
from canopen_proto.frame import Frame
from canopen_proto.machine import MICROSECOND, MILLISECOND, NEVER, Machine, Outbox
from canopen_proto.pdo.consumer import PdoConsumer, PdoReceived
from canopen_proto.pdo.parameters import DevicePdos
from canopen_proto.pdo.producer import PdoProducer
from canopen_proto.pdo.settings import communication_index
from tests.core.pdo_device import NODE_ID, OFF, Device, communication, dictionary, mapping

RPDO, TPDO = Direction.RPDO, Direction.TPDO

INVALID_VALUE = AbortCode.INVALID_VALUE  # 0x06090030
DEVICE_STATE = AbortCode.DEVICE_STATE  # 0x08000022
ENABLED = AbortCode.UNSUPPORTED_ACCESS  # 0x06010000
NO_SUCH_OBJECT = AbortCode.NO_SUCH_OBJECT  # 0x06020000
CANNOT_BE_MAPPED = AbortCode.CANNOT_BE_MAPPED  # 0x06040041
LENGTH_EXCEEDED = AbortCode.PDO_LENGTH_EXCEEDED  # 0x06040042
INCOMPATIBLE = AbortCode.PARAMETER_INCOMPATIBLE  # 0x06040043


@pytest.fixture
def device() -> Device:
    return Device()


# ---- what the dictionary makes


def test_the_machines_of_a_dictionary(device: Device) -> None:
    pdos = device.pdos
    assert list(pdos.consumers) == [1, 2]
    assert list(pdos.producers) == [1, 2]
    multiplexed = [pdos.mpdo_consumer, pdos.mpdo_producer]
    assert list(pdos.machines) == [*pdos.consumers.values(), *pdos.producers.values(), *multiplexed]
    # 0x1400 is the RPDO and 0x1800 the TPDO: a peer had these the wrong way round
    assert [list(each.can_ids()) for each in pdos.consumers.values()] == [[0x20C], []]
    assert [each.key for each in pdos.producers.values()] == [0x18C, None]
    assert pdos.consumers[1].mapping.parameters == (0x60400010, 0x00060010, 0x607A0020)
    assert pdos.producers[1].mapping.parameters == (0x60410010, 0x60640020)
    assert pdos.faults == {}


def test_pdos_and_dictionary_are_one_memory(device: Device) -> None:
    pdos = device.pdos
    device.values.store[0x606400] = -5
    device.values.store[0x604100] = 0x27
    pdos.consumers[1].receive(Frame.parse("20C#0F00FFFF10270000"), 0)
    assert device.values.read("o607A") == 0
    pdos.on_sync(None, 1)
    assert device.sent() == ["18C#2700FBFFFFFF"]
    assert device.values.read("o6040") == 0x0F
    assert device.values.raw(0x607A) == bytes.fromhex("10270000")
    assert [type(each) for each in device.out.events] == [PdoReceived]
    pdos.set_enabled(False, 2)
    pdos.on_sync(None, 3)
    assert device.sent() == []


def test_the_tpdo_reports_the_state_at_the_sync_not_what_it_sets_off() -> None:
    device = Device()
    device.write_all((0x1400, 1, OFF), (0x1600, 0, 0), (0x1600, 1, 0x20000008), (0x1600, 0, 1), (0x1400, 1, 0x20C))
    device.write_all((0x1800, 1, OFF), (0x1A00, 0, 0), (0x1A00, 1, 0x20000008), (0x1A00, 0, 1), (0x1800, 1, 0x18C))
    device.pdos.consumers[1].receive(Frame.parse("20C#07"), 0)
    device.pdos.on_sync(None, 0)
    assert device.sent() == ["18C#00"]
    device.pdos.on_sync(None, 0)
    assert device.sent() == ["18C#07"]


def test_a_change_of_a_value_triggers_what_carries_it(device: Device) -> None:
    device.write_all((0x1A01, 1, 0x60410010), (0x1A01, 2, 0x60410010), (0x1A01, 0, 2), (0x1801, 1, 0x28C))
    device.values.store[0x604100] = 0x37
    device.pdos.trigger(0x604100, 0)
    assert device.sent() == ["28C#37003700"]  # once, though it is mapped twice
    device.pdos.trigger(0x606400, 0)
    assert device.sent() == []


def test_a_default_mapping_without_sense_disables_its_pdo_only() -> None:
    objects = [*dictionary().objects.values(), mapping(0x1A00, 0x60410010, 0x70000008), mapping(0x1601, *[0x60400010] * 5)]
    values = Values(ObjectDictionary(objects), NODE_ID)
    pdos = DevicePdos(Outbox(), NODE_ID, values)
    assert pdos.faults == {
        0x1A00: "object 0x7000:00 is not in the dictionary",
        0x1601: "a PDO has 64 bits at most, not 80 (o6040, o6040, o6040, o6040, o6040)",
    }
    pdos.set_enabled(True, 0)
    assert not pdos.producers[1].is_live
    assert pdos.consumers[1].is_live
    assert pdos.check_write(0x1401, 1, 0x30C) == INCOMPATIBLE  # it cannot be created so
    values[0x160100] = 0
    pdos.apply(0x1601, 0, 0)
    assert pdos.check_write(0x1401, 1, 0x30C) is None
    assert list(pdos.faults) == [0x1A00]


def test_records_without_their_other_half() -> None:
    values = Values(ObjectDictionary([communication(0x1400, 0x200, 255), mapping(0x1A00, 0x00050008)]), NODE_ID)
    pdos = DevicePdos(Outbox(), NODE_ID, values)
    assert list(pdos.consumers) == [1]
    assert pdos.consumers[1].key is None  # nothing is mapped
    pdos.apply(0x1A00, 0, 0)
    assert pdos.check_write(0x1A00, 1, 0x00060010) == ENABLED
    assert pdos.check_write(0x1A00, 0, 0) is None


def test_reload_takes_up_the_defaults_again(device: Device) -> None:
    device.write_all((0x1400, 1, OFF), (0x1400, 1, 0x222))
    assert list(device.pdos.consumers[1].can_ids()) == [0x222]
    device.out.rerouted.clear()
    device.pdos.consumers[1]._in_rerouted = False
    device.values.reset(0x1000, 0x1FFF)
    device.pdos.reload(0)
    assert list(device.pdos.consumers[1].can_ids()) == [0x20C]
    rerouted: list[Machine] = [device.pdos.consumers[1]]
    assert device.out.rerouted == rerouted


# ---- COB-ID


@pytest.mark.parametrize(("index", "standing"), [(0x1400, 0x20C), (0x1800, 0x4000018C)])
def test_the_can_id_of_a_valid_pdo_may_not_change(index: int, standing: int, device: Device) -> None:
    assert device.write(index, 1, 0x301) == DEVICE_STATE
    assert device.write(index, 1, standing | 1 << 29) == DEVICE_STATE
    assert device.write(index, 1, standing) is None  # nothing changes
    assert device.write(index, 1, standing ^ 1 << 30) is None  # bit 30 may change
    assert device.write(index, 1, standing | OFF) is None
    assert device.write(index, 1, 0x301) is None
    assert device.write(index, 1, OFF) is None  # a bare "not valid" is taken
    machine = (device.pdos.consumers if index == 0x1400 else device.pdos.producers)[1]
    assert machine.key is None


def test_every_11_bit_can_id(device: Device) -> None:
    restricted = {0x000, *range(0x001, 0x080), *range(0x101, 0x181), *range(0x581, 0x600), *range(0x601, 0x680)}
    restricted |= {*range(0x6E0, 0x700), *range(0x701, 0x800)}
    assert {can_id for each in RESTRICTED_CAN_IDS for can_id in each} == restricted
    for index in (0x1401, 0x1801):
        for can_id in range(0x800):
            expected = INVALID_VALUE if can_id in restricted else None
            assert device.pdos.check_write(index, 1, can_id) == expected
            assert device.pdos.check_write(index, 1, can_id | 1 << 30) == expected
            assert device.pdos.check_write(index, 1, can_id | OFF) is None


def test_frame_bit(device: Device) -> None:
    for can_id in (0x800, 0x1000, 0x1FFFFFFF):
        assert device.pdos.check_write(0x1801, 1, can_id) == INVALID_VALUE
        assert device.pdos.check_write(0x1801, 1, can_id | 1 << 29) is None
    assert device.pdos.check_write(0x1801, 1, 0x7E0 | 1 << 29) is None  # the restrictions are for 11 bits
    device.write_all((0x1A01, 1, 0x60410010), (0x1A01, 0, 1), (0x1801, 1, 0x18FF0001 | 1 << 29))
    device.pdos.producers[2].trigger(0)
    assert device.sent() == ["18FF0001#0000"]


# ---- transmission type, times, SYNC start value


@pytest.mark.parametrize("index", [0x1400, 0x1800])
def test_every_transmission_type(index: int, device: Device) -> None:
    for value in range(256):
        reserved = range(241, 254) if index == 0x1400 else range(241, 252)  # a TPDO may be sent on request
        expected = INVALID_VALUE if value in reserved else None
        assert device.pdos.check_write(index, 2, value) == expected


def test_a_transmission_type_takes_effect_at_once(device: Device) -> None:
    device.write_all((0x1800, 2, 255))
    device.pdos.on_sync(None, 0)
    assert device.sent() == []
    device.pdos.trigger(0x604100, 0)
    assert len(device.sent()) == 1
    device.write_all((0x1400, 2, 254))
    device.pdos.consumers[1].receive(Frame.parse("20C#0F00000000000000"), 0)
    assert device.values.read("o6040") == 0x0F


@pytest.mark.parametrize("index", [0x1400, 0x1800])
@pytest.mark.parametrize("subindex", [3, 6])
def test_what_may_change_only_while_the_pdo_is_not_valid(index: int, subindex: int, device: Device) -> None:
    assert device.write(index, subindex, 100) == DEVICE_STATE
    assert device.write(index, subindex, 0) is None  # nothing changes
    device.write_all((index, 1, OFF), (index, subindex, 100))


def test_sync_start_values(device: Device) -> None:
    for value in range(1, 256):
        assert device.pdos.check_write(0x1801, 6, value) == (None if value <= 240 else INVALID_VALUE)


def test_times_take_effect(device: Device) -> None:
    device.write_all((0x1A01, 1, 0x60410010), (0x1A01, 0, 1), (0x1801, 3, 5), (0x1801, 5, 20), (0x1801, 1, 0x28C))
    producer = device.pdos.producers[2]
    assert producer.inhibit_time == 500 * MICROSECOND
    assert producer.deadline == 20 * MILLISECOND
    assert device.write(0x1801, 5, 30, now=MILLISECOND) is None  # the event timer may change at any time
    assert producer.deadline == 31 * MILLISECOND
    assert device.write(0x1400, 5, 7) is None
    device.pdos.consumers[1].receive(Frame.parse("20C#0F00000000000000"), 0)
    assert device.pdos.consumers[1].deadline == 7 * MILLISECOND
    device.write_all((0x1800, 1, OFF), (0x1800, 6, 2), (0x1800, 1, 0x18C))
    device.pdos.on_sync(1, 0)
    assert device.sent() == []
    device.pdos.on_sync(2, 0)
    assert device.sent() == ["18C#000000000000"]


def test_the_event_timer_does_not_run_for_a_destroyed_pdo(device: Device) -> None:
    device.write_all((0x1A01, 1, 0x60410010), (0x1A01, 0, 1), (0x1801, 5, 20))
    assert device.pdos.producers[2].deadline == NEVER


# ---- mapping


@pytest.mark.parametrize(("communication_at", "mapping_at"), [(0x1400, 0x1600), (0x1800, 0x1A00)])
def test_a_mapping_changes_only_while_the_pdo_is_not_valid_and_sub_0_is_0(
    communication_at: int, mapping_at: int, device: Device
) -> None:
    entry = 0x20000008
    for value in (0, 1):
        assert device.write(mapping_at, 0, value) == DEVICE_STATE
    for _ in ("valid", "not valid"):
        for subindex in (1, 8):
            for value in (entry, device.values[mapping_at << 8 | subindex], 0):
                assert device.write(mapping_at, subindex, value) == ENABLED, "even its own value"
        device.write_all((communication_at, 1, OFF))
    device.write_all((mapping_at, 0, 0), (mapping_at, 1, entry), (mapping_at, 8, entry), (mapping_at, 8, 0), (mapping_at, 0, 1))
    machine = (device.pdos.consumers if mapping_at == 0x1600 else device.pdos.producers)[1]
    assert machine.mapping.parameters == (entry,)
    assert machine.key is None
    device.write_all((communication_at, 1, 0x333))
    assert machine.key == 0x333


MAPPABLE = {  # which access may be mapped where, by object
    0x6040: (True, False),  # rww
    0x607A: (True, True),  # rw
    0x6041: (False, True),  # ro
    0x2001: (False, True),  # rwr
    0x2002: (True, False),  # wo
    0x2003: (False, True),  # const
    0x2004: (False, False),  # not mappable
    0x2005: (False, False),  # DOMAIN
}
WIDTHS = {0x6040: 16, 0x607A: 32, 0x6041: 16}


@pytest.mark.parametrize("index", MAPPABLE)
def test_objects_are_mappable_by_direction(index: int, device: Device) -> None:
    entry = index << 16 | WIDTHS.get(index, 8)
    for mapping_at, possible in zip((0x1601, 0x1A01), MAPPABLE[index], strict=True):
        assert device.write(mapping_at, 1, entry) == (None if possible else CANNOT_BE_MAPPED)


@pytest.mark.parametrize(
    ("entry", "to_rpdo", "to_tpdo"),
    [
        (0x70000008, NO_SUCH_OBJECT, NO_SUCH_OBJECT),
        (0x20000108, NO_SUCH_OBJECT, NO_SUCH_OBJECT),
        (0x00000008, NO_SUCH_OBJECT, NO_SUCH_OBJECT),
        (0x10000020, CANNOT_BE_MAPPED, CANNOT_BE_MAPPED),  # of the communication profile
        (0x20000004, None, None),  # 4 bits of an UNSIGNED8
        (0x20000001, None, None),
        (0x20000000, CANNOT_BE_MAPPED, CANNOT_BE_MAPPED),
        (0x20000009, CANNOT_BE_MAPPED, CANNOT_BE_MAPPED),
        (0x20060020, None, None),
        (0x20060010, CANNOT_BE_MAPPED, CANNOT_BE_MAPPED),  # half a REAL32
        (0x20070040, None, None),  # 8 characters
        (0x20070044, LENGTH_EXCEEDED, LENGTH_EXCEEDED),
        (0x2007000C, CANNOT_BE_MAPPED, CANNOT_BE_MAPPED),
        (0x200000FF, LENGTH_EXCEEDED, LENGTH_EXCEEDED),
        (0x00010001, None, CANNOT_BE_MAPPED),  # dummies are for RPDOs
        (0x00050008, None, CANNOT_BE_MAPPED),
        (0x001B0040, None, CANNOT_BE_MAPPED),
        (0x00060011, CANNOT_BE_MAPPED, CANNOT_BE_MAPPED),
        (0x00090008, CANNOT_BE_MAPPED, CANNOT_BE_MAPPED),  # VISIBLE_STRING has no width
        (0x00170008, CANNOT_BE_MAPPED, CANNOT_BE_MAPPED),  # no data type
        (0x00050108, CANNOT_BE_MAPPED, CANNOT_BE_MAPPED),
    ],
)
def test_entries(entry: int, to_rpdo: AbortCode | None, to_tpdo: AbortCode | None, device: Device) -> None:
    for mapping_at, expected in ((0x1601, to_rpdo), (0x1A01, to_tpdo)):
        assert device.write(mapping_at, 1, entry) == expected
        assert device.values[mapping_at << 8 | 1] == (entry if expected is None else 0)


def test_an_entry_may_be_cleared_but_not_counted(device: Device) -> None:
    device.write_all((0x1A01, 1, 0x20000008), (0x1A01, 1, 0))
    assert device.write(0x1A01, 0, 1) == NO_SUCH_OBJECT
    device.write_all((0x1A01, 1, 0x20000008), (0x1A01, 0, 1))
    assert device.write(0x1A01, 0, 2) == NO_SUCH_OBJECT


def test_more_than_64_bits_are_refused_when_counted(device: Device) -> None:
    device.write_all((0x1A01, 1, 0x60640020), (0x1A01, 2, 0x60640020), (0x1A01, 3, 0x20000001))
    assert device.write(0x1A01, 0, 3) == LENGTH_EXCEEDED
    assert device.write(0x1A01, 0, 2) is None
    assert device.pdos.producers[2].mapping.bit_length == 64


@pytest.mark.parametrize("count", [5, 64, 65, 0xFD, 0xFE])
def test_more_entries_than_there_are(count: int, device: Device) -> None:
    for subindex in range(1, 5):
        device.write_all((0x1A01, subindex, 0x20000001))
    assert device.write(0x1A01, 0, count) == LENGTH_EXCEEDED
    assert device.write(0x1A01, 0, 4) is None


def test_other_objects_are_nobodys_business_here(device: Device) -> None:
    for index, subindex in ((0x13FF, 1), (0x1C00, 1), (0x6040, 0), (0x1400, 0), (0x1400, 4)):
        assert device.pdos.check_write(index, subindex, 5) is None
    assert device.pdos.check_write(0x1400, 1, "text") is None
    device.pdos.apply(0x6040, 0, 0)
    device.pdos.apply(0x1500, 1, 0)


# ---- any sequence of writes


@given(st.data())
def test_no_sequence_of_writes_raises_or_leaves_a_pdo_without_sense(data: st.DataObject) -> None:
    device = Device()
    entry = st.sampled_from([0, 0x60400010, 0x60410010, 0x607A0020, 0x60640020, 0x20000004, 0x00060010, 0x70000008, 0x20080040])
    cob_id = st.sampled_from([OFF, 0x20C, 0x301, OFF | 0x301, 0x4000018C, 0, 0x580, 0x701, 1 << 29 | 0x12345])
    for now in range(data.draw(st.integers(0, 25))):
        index = data.draw(st.sampled_from([0x1400, 0x1600, 0x1801, 0x1A01]))
        if index & 0x200:
            subindex = data.draw(st.integers(0, 4))
            value = data.draw(entry) if subindex else data.draw(st.integers(0, 9))
        else:
            subindex = data.draw(st.sampled_from([1, 1, 2, 3, 5, 6]))
            value = data.draw(cob_id) if subindex == 1 else data.draw(st.integers(0, 255))
        before = dict(device.values.store)
        refusal = device.write(index, subindex, value, now)
        if refusal is not None:
            assert device.values.store == before
        assert device.pdos.faults == {}
        device.pdos.on_sync(None, now)
        for machine in device.pdos.machines:
            machine.handle_timeout(now)
            for key in machine.can_ids():
                machine.receive(Frame(key & 0x1FFFFFFF, data.draw(st.binary(max_size=8))), now)
    every: list[PdoConsumer | PdoProducer] = [*device.pdos.consumers.values(), *device.pdos.producers.values()]
    for pdo in every:
        at = communication_index(RPDO if isinstance(pdo, PdoConsumer) else TPDO, pdo.number)
        valid = not int(device.values.read((at, 1))) & OFF  # type: ignore[arg-type]
        assert (pdo.key is not None) == (valid and pdo.mapping.entries != ())
