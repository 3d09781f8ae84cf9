"""Store and restore: signatures, groups, what the host keeps, and values at power-on (CiA 301 v4.2.0, 7.5.2.13 and 7.5.2.14)."""

from __future__ import annotations

import pytest

from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Access, Object, ObjectDictionary, Variable
from canopen_proto.dictionary.standard import standard_object, standard_variable
from canopen_proto.parameter_storage import ParameterStorage
from canopen_proto.sdo.server import ObjectAccessPending, ObjectWritten
from tests.core.device_bench import RESET_COMMUNICATION, RESET_NODE, START, STOP, DeviceBench
from tests.core.devices import INPUT, LIMITED, OUTPUT, TEXT, io_device

SAVE, LOAD = b"save", b"load"
PROFILE = 0x6200


def storing_device(*more: Object) -> ObjectDictionary:
    own = Object.of("output_8", [Variable(PROFILE, 0, "output_8", DataType.UNSIGNED8, default=1)])
    blob = Object.of("blob", [Variable(0x2200, 0, "blob", DataType.DOMAIN)])
    secret = Object.of("secret", [Variable(0x2201, 0, "secret", DataType.UNSIGNED8, Access.WO)])
    storage = [standard_object(0x1010, highest=4), standard_object(0x1011, highest=4)]
    return io_device().with_objects([*storage, own, blob, secret, *more])


class Host:
    """A device's host with something that outlives it: `kept`."""

    def __init__(self, kept: dict[int, bytes] | None = None, dictionary: ObjectDictionary | None = None) -> None:
        self.bench = DeviceBench(dictionary or storing_device(), boot=False)
        self.kept = dict(kept or {})
        self.left_out = [] if kept is None else self.bench.node.storage.load(self.kept)
        self.bench.node.boot(0)
        self.bench.take()
        self.bench.events.clear()

    def ask(self, index: int, subindex: int, signature: bytes) -> ObjectAccessPending | str:
        """A client writes a signature: what the host has to do, or the answer."""
        sent = self.bench.tell(f"605#23{index & 0xFF:02X}{index >> 8:02X}{subindex:02X}{signature.hex()}")
        if sent:
            return sent[0]
        (access,) = self.bench.seen(ObjectAccessPending)
        return access

    def do(self, index: int, subindex: int, signature: bytes) -> None:
        """A client stores or restores, and the host does it."""
        access = self.ask(index, subindex, signature)
        assert isinstance(access, ObjectAccessPending)
        assert (access.index, access.subindex, access.data) == (index, subindex, signature)
        self.kept = self.bench.node.storage.to_keep(index, subindex)
        self.bench.node.complete(access.access_id, None, self.bench.now)
        answer = self.bench.take()
        assert answer == [f"585#60{index & 0xFF:02X}{index >> 8:02X}{subindex:02X}00000000"]

    def after_power_off(self) -> Host:
        return Host(self.kept)

    def values(self) -> tuple[int, int, int]:
        """One value of each group: communication, manufacturer, profile."""
        return self.bench.number(0x1017), self.bench.number(LIMITED), self.bench.number(PROFILE)

    def change(self, heartbeat: int, limited: int, profile: int) -> None:
        for index, value, size in ((0x1017, heartbeat, 2), (LIMITED, limited, 1), (PROFILE, profile, 1)):
            assert self.bench.write(index, 0, value, size) is None


DEFAULTS = (0, 10, 1)
CHANGED = (500, 15, 7)


def changed(kept: dict[int, bytes] | None = None) -> Host:
    host = Host(kept)
    host.change(*CHANGED)
    return host


# ---- what may be written, what is read ----


def test_reading_tells_that_it_is_done_on_command() -> None:
    bench = Host().bench
    for index in (0x1010, 0x1011):
        assert bench.number(index) == 4
        assert [bench.number(index, subindex) for subindex in (1, 2, 3, 4)] == [1, 1, 1, 1]
        assert bench.read(index, 5) == AbortCode.NO_SUCH_SUBINDEX


@pytest.mark.parametrize("index", [0x1010, 0x1011])
@pytest.mark.parametrize("capability", [0, 1, 2, 3])
def test_the_dictionary_says_what_the_device_can_do(index: int, capability: int) -> None:
    own = Object.of("own", [standard_variable(index, 1, default=capability)])
    host = Host(dictionary=storing_device(own))
    signature = SAVE if index == 0x1010 else LOAD
    assert host.bench.number(index, 1) == capability
    assert isinstance(host.ask(index, 1, signature), ObjectAccessPending if capability & 1 else str)


@pytest.mark.parametrize(
    ("index", "signature"), [(0x1010, b"evas"), (0x1010, LOAD), (0x1010, bytes(4)), (0x1011, SAVE), (0x1011, b"daol")]
)
def test_another_signature_is_refused(index: int, signature: bytes) -> None:
    host = changed()
    assert host.ask(index, 1, signature) == f"585#80{index & 0xFF:02X}100120000008"
    assert host.bench.number(index, 1) == 1
    assert host.bench.seen(ObjectAccessPending) == []


def test_the_signatures_on_the_wire() -> None:
    bench = Host().bench
    assert bench.tell("605#2310100173617665") == []
    (access,) = bench.seen(ObjectAccessPending)
    bench.node.complete(access.access_id, None, bench.now)
    assert bench.take() == ["585#6010100100000000"]
    assert bench.tell("605#231110016C6F6164") == []
    assert bench.tell("605#2F10100073000000") == ["585#8010100002000106"]  # subindex 0 is constant
    assert bench.tell("605#2B10100173610000") == ["585#8010100113000706"]


# ---- store ----


def test_what_was_stored_is_there_after_power_off_and_after_a_reset() -> None:
    host = changed()
    host.do(0x1010, 1, SAVE)
    assert host.values() == CHANGED
    host.change(600, 16, 8)
    host.bench.tell(RESET_COMMUNICATION)
    assert host.values() == (500, 16, 8)
    host.bench.tell(RESET_NODE)
    assert host.values() == CHANGED
    assert host.after_power_off().values() == CHANGED


def test_without_storing_nothing_is_there() -> None:
    host = changed()
    assert host.after_power_off().values() == DEFAULTS
    host.bench.tell(RESET_NODE)
    assert host.values() == DEFAULTS


@pytest.mark.parametrize(("subindex", "values"), [(1, (500, 15, 7)), (2, (500, 10, 1)), (3, (0, 10, 7)), (4, (0, 15, 1))])
def test_each_group(subindex: int, values: tuple[int, int, int]) -> None:
    host = changed()
    host.do(0x1010, subindex, SAVE)
    assert host.after_power_off().values() == values
    host.bench.tell(RESET_NODE)
    assert host.values() == values


def test_groups_add_up_and_the_host_keeps_them_all() -> None:
    host = changed()
    host.do(0x1010, 2, SAVE)
    host.do(0x1010, 4, SAVE)
    host.change(600, 16, 8)
    host.do(0x1010, 4, SAVE)
    assert host.after_power_off().values() == (500, 16, 1)


def test_a_manufacturer_says_what_its_groups_are() -> None:
    host = changed()
    host.bench.node.storage.groups[4] = {TEXT}
    host.bench.node.storage.excluded.add(OUTPUT)
    host.do(0x1010, 4, SAVE)
    assert list(host.kept) == [TEXT << 8]
    host.do(0x1010, 1, SAVE)
    assert OUTPUT << 8 not in host.kept
    assert LIMITED << 8 in host.kept


def test_what_is_no_parameter() -> None:
    host = changed()
    host.bench.node.raise_error(0x1000, 0, b"", host.bench.now)
    host.bench.take()
    host.do(0x1010, 1, SAVE)
    kept = {key >> 8 for key in host.kept}
    assert kept.isdisjoint({0x1000, 0x1001, 0x1003, 0x1010, 0x1011, 0x1018, INPUT, 0x2200, 0x2201})
    assert kept >= {0x1005, 0x1016, 0x1017, 0x1400, 0x1A00, OUTPUT, LIMITED, TEXT, PROFILE}


def test_the_values_of_the_moment_of_the_request_are_kept() -> None:
    host = changed()
    access = host.ask(0x1010, 1, SAVE)
    assert isinstance(access, ObjectAccessPending)
    host.bench.node.set_value(LIMITED, 0, 20, host.bench.now)
    host.kept = host.bench.node.storage.to_keep(0x1010, 1)
    host.bench.node.complete(access.access_id, None, host.bench.now)
    host.bench.tell(RESET_NODE)
    assert host.values() == CHANGED
    assert host.after_power_off().values() == CHANGED


def test_a_value_that_the_device_itself_spoiled_is_left_out() -> None:
    host = changed()
    host.bench.node.values.store[PROFILE << 8] = 1000
    host.do(0x1010, 1, SAVE)
    assert PROFILE << 8 not in host.kept
    assert host.after_power_off().values() == (500, 15, 1)


def test_a_stored_configuration_acts_from_the_boot_on() -> None:
    host = changed()
    assert host.bench.write(0x1800, 1, 0x80000185, 4) is None
    assert host.bench.write(0x1800, 1, 0x40000190, 4) is None
    host.do(0x1010, 2, SAVE)
    again = host.after_power_off().bench
    assert again.wait(600) == ["500 705#7F"]
    again.tell(START)
    again.node.set_value(INPUT, 0, 5, again.now)
    assert again.take() == ["190#0500"]


# ---- the host ----


def test_a_host_that_could_not_store() -> None:
    host = changed()
    access = host.ask(0x1010, 1, SAVE)
    assert isinstance(access, ObjectAccessPending)
    host.bench.node.complete(access.access_id, AbortCode.HARDWARE_ERROR, host.bench.now)
    assert host.bench.take() == ["585#8010100100000606"]
    assert host.bench.node.storage.to_keep(0x1010, 1) == {}
    host.bench.tell(RESET_NODE)
    assert host.values() == DEFAULTS


@pytest.mark.parametrize("interruption", ["605#8010100100000008", STOP, RESET_NODE, None])
def test_a_request_that_came_to_nothing(interruption: str | None) -> None:
    host = changed()
    access = host.ask(0x1010, 1, SAVE)
    assert isinstance(access, ObjectAccessPending)
    if interruption is None:
        assert "5000 585#8010100120000008" in host.bench.wait(6000)  # the host is silent
    else:
        host.bench.tell(interruption)
    host.bench.node.complete(access.access_id, None, host.bench.now)
    host.bench.take()
    assert [each for each in host.bench.seen(ObjectWritten) if each.index == 0x1010] == []
    assert host.bench.node.storage.saved == {}
    assert host.bench.node.storage.to_keep(0x1010, 1) == {}


def test_a_client_that_begins_again_gets_the_values_of_its_second_request() -> None:
    host = changed()
    first = host.ask(0x1010, 1, SAVE)
    assert isinstance(first, ObjectAccessPending)
    host.bench.node.set_value(LIMITED, 0, 20, host.bench.now)
    host.bench.tell("605#4000100000000000")  # another request takes the first one's place
    host.do(0x1010, 1, SAVE)
    assert host.after_power_off().values() == (500, 20, 7)
    host.bench.node.complete(first.access_id, None, host.bench.now)
    assert host.bench.take() == []


def test_a_host_may_serve_these_objects_itself() -> None:
    bench = Host().bench
    bench.node.deferred |= {0x1010}
    bench.tell("605#2310100112345678")
    (access,) = bench.seen(ObjectAccessPending)
    bench.node.complete(access.access_id, None, bench.now)
    assert bench.take() == ["585#6010100100000000"]
    assert bench.node.storage.saved == {}


def test_what_was_kept_by_another_version() -> None:
    kept = {
        0x101700: (500).to_bytes(2, "little"),
        LIMITED << 8: b"\x63",  # 99 is beyond its limits
        0x200000: b"\x01\x00",  # it is read-only now
        0x2FFF00: b"\x01",  # it is gone
        PROFILE << 8: b"\x01\x02",  # it had two bytes
        0x101001: b"save",
    }
    host = Host(kept)
    assert host.left_out == [LIMITED << 8, 0x200000, 0x2FFF00, PROFILE << 8, 0x101001]
    assert host.values() == (500, 10, 1)


def test_text_is_kept_too() -> None:
    host = Host()
    host.bench.node.set_value(TEXT, 0, "another", 0)
    host.do(0x1010, 1, SAVE)
    assert host.after_power_off().bench.node.values.read("text") == "another"


# ---- restore ----


def test_restored_defaults_act_at_the_next_reset() -> None:
    host = changed()
    host.do(0x1010, 1, SAVE)
    host.do(0x1011, 1, LOAD)
    assert host.kept == {}
    assert host.values() == CHANGED  # not before
    assert host.after_power_off().values() == DEFAULTS
    host.bench.tell(RESET_NODE)
    assert host.values() == DEFAULTS


@pytest.mark.parametrize(("subindex", "values"), [(1, (0, 10, 1)), (2, (0, 15, 7)), (3, (500, 15, 1)), (4, (500, 10, 7))])
def test_each_group_is_restored(subindex: int, values: tuple[int, int, int]) -> None:
    host = changed()
    host.do(0x1010, 1, SAVE)
    host.do(0x1011, subindex, LOAD)
    assert host.after_power_off().values() == values
    host.bench.tell(RESET_NODE)
    assert host.values() == values


def test_restored_communication_acts_at_a_reset_of_communication() -> None:
    host = changed()
    host.do(0x1010, 1, SAVE)
    host.do(0x1011, 2, LOAD)
    host.bench.tell(RESET_COMMUNICATION)
    assert host.values() == (0, 15, 7)


def test_storing_behind_a_restore_stores_what_is() -> None:
    host = changed()
    host.do(0x1010, 1, SAVE)
    host.do(0x1011, 1, LOAD)
    host.do(0x1010, 1, SAVE)
    assert host.after_power_off().values() == CHANGED


# ---- without the objects ----


def test_a_device_without_storage() -> None:
    bench = DeviceBench()
    assert bench.read(0x1010, 1) == AbortCode.NO_SUCH_OBJECT
    storage = ParameterStorage(bench.node.values)
    assert storage.capability(0x1010, 1) is None
    assert storage.check_write(0x1010, 1, 0x65766173) == AbortCode.CANNOT_TRANSFER
    assert storage.to_keep(0x1010, 1) == {}


CONFIGURED = Object.of("ratio", [Variable(0x2202, 0, "ratio", DataType.UNSIGNED16, default=10, configured=70)])
SERIAL = Object.of("serial", [Variable(0x2203, 0, "serial", DataType.UNSIGNED16, Access.RO, default=0, configured=9)])


def test_what_a_dcf_configured_counts_as_stored() -> None:
    dictionary = storing_device(CONFIGURED, SERIAL)
    host = Host(dictionary=dictionary)
    store = host.bench.node.values.store
    assert (store[0x220200], store[0x220300]) == (70, 9)
    host.bench.node.set_value(0x2202, 0, 71, host.bench.now)
    host.bench.tell(RESET_NODE)
    assert (store[0x220200], store[0x220300]) == (70, 9)
    host.do(0x1011, 1, LOAD)
    assert store[0x220200] == 70  # until the reset
    host.bench.tell(RESET_NODE)
    assert (store[0x220200], store[0x220300]) == (10, 9)  # what no client can write is no setting


def test_what_was_kept_takes_the_place_of_what_a_dcf_configured() -> None:
    dictionary = storing_device(CONFIGURED)
    host = Host(dictionary=dictionary)
    host.do(0x1010, 1, SAVE)
    assert host.kept[0x220200] == b"\x46\x00"
    assert Host(host.kept, dictionary).bench.node.values.store[0x220200] == 70
    host.do(0x1011, 1, LOAD)
    assert host.kept == {}
    assert Host({0x101700: b"\xf4\x01"}, dictionary).bench.node.values.store[0x220200] == 10


def test_a_default_that_does_not_fit_counts_as_zero_after_load() -> None:
    odd = Object.of("odd", [Variable(0x2204, 0, "odd", DataType.UNSIGNED8, default=300, configured=5)])
    host = Host(dictionary=storing_device(odd))
    host.do(0x1011, 1, LOAD)
    host.bench.tell(RESET_NODE)
    assert host.bench.read(0x2204) == b"\x00"


@pytest.mark.parametrize("data_type", [DataType.VISIBLE_STRING, DataType.UNSIGNED8, DataType.REAL32])
def test_storage_objects_of_another_type_are_plain_memory(data_type: DataType) -> None:
    fields = [Variable(0x1010, 0, "n", DataType.UNSIGNED8), Variable(0x1010, 1, "all", data_type)]
    host = Host(dictionary=storing_device(Object.of("store", fields)))
    assert host.bench.tell("605#4010100100000000")[0][4] != "8"  # it can be read
    assert host.bench.write(0x1010, 1, 1, 1) == (AbortCode.CANNOT_TRANSFER if data_type != DataType.REAL32 else 0x06070013)


def test_a_capability_beyond_its_type_counts_as_none_given() -> None:
    host = Host(dictionary=storing_device(standard_object(0x1010, highest=1, defaults={1: 1 << 40})))
    assert host.bench.read(0x1010, 1) == b"\x01\x00\x00\x00"


# ---- 0x1020 ----


def test_a_changed_setting_clears_the_date_of_the_configuration() -> None:
    bench = DeviceBench(storing_device(standard_object(0x1020, highest=2)))

    def dated() -> bool:
        return (bench.read(0x1020, 1), bench.read(0x1020, 2)) == (b"\x2a\0\0\0", b"\x07\0\0\0")

    def date() -> None:
        assert bench.write(0x1020, 1, 42, 4) is None
        assert bench.write(0x1020, 2, 7, 4) is None

    date()
    assert dated()
    assert bench.write(0x1017, 0, int.from_bytes(bench.read(0x1017), "little"), 2) is None  # type: ignore[arg-type]
    assert bench.write(PROFILE, 0, 5, 1) is None  # an output
    assert bench.write(0x1017, 0, 0xFFFFFF, 3) is not None  # refused
    assert dated()
    assert bench.write(0x1017, 0, 123, 2) is None
    assert (bench.read(0x1020, 1), bench.read(0x1020, 2)) == (bytes(4), bytes(4))
    date()
    bench.tell(RESET_COMMUNICATION)
    assert not dated()  # it was not stored
