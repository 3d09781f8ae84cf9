"""In which order settings go to a device, and which never do."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.datatypes import DataType, Value
from canopen_proto.dictionary import Access, Object, ObjectDictionary, ObjectNotFoundError, ObjectType, Variable
from canopen_proto.dictionary.concise import from_concise, pack_concise
from canopen_proto.dictionary.download_order import DownloadOrder, download_order, settings_of
from canopen_proto.dictionary.objects import Object as Node
from canopen_proto.multiplexer import mux
from tests.examples import examples

U8, U16, U32 = DataType.UNSIGNED8, DataType.UNSIGNED16, DataType.UNSIGNED32
NODE_ID = 5
INVALID = 1 << 31


def variable(index: int, subindex: int, data_type: DataType, default: Value | None = None, **more: object) -> Variable:
    return Variable(index, subindex, f"{index:04X}_{subindex}", data_type, default=default, **more)  # type: ignore[arg-type]


def pdo(communication: int, cob_id: int = INVALID) -> list[Object]:
    parameters = [(1, U32), (2, U8), (3, U16), (4, U8), (5, U16), (6, U8)]
    record = [variable(communication, subindex, data_type) for subindex, data_type in parameters]
    record[0] = variable(communication, 1, U32, cob_id, adds_node_id=True)
    mapping = [variable(communication + 0x200, subindex, U32, 0) for subindex in range(1, 5)]
    count = variable(communication + 0x200, 0, U8, 0)
    return [Object.of("communication", record), Object.of("mapping", [count, *mapping])]


def dictionary(*extra: Object) -> ObjectDictionary:
    single = [
        (0x1005, U32),
        (0x1006, U32),
        (0x1012, U32),
        (0x1014, U32),
        (0x1017, U16),
        (0x1019, U8),
        (0x2000, U32),
        (0x6081, U32),
    ]
    simple = [Object.of("simple", [variable(index, 0, data_type)]) for index, data_type in single]
    monitors = Object.of("monitors", [variable(0x1016, subindex, U32, 0) for subindex in (1, 2)], ObjectType.ARRAY)
    channel = Object.of("channel", [variable(0x1280, subindex, U32, INVALID) for subindex in (1, 2)] + [variable(0x1280, 3, U8)])
    return ObjectDictionary([*simple, monitors, channel, *pdo(0x1400, 0x200), *pdo(0x1800), *pdo(0x1801), *extra])


def order(values: dict[tuple[int, int], Value], *extra: Object, **more: object) -> DownloadOrder:
    by_mux = {mux(*place): value for place, value in values.items()}
    return download_order(dictionary(*extra), by_mux, NODE_ID, **more)  # type: ignore[arg-type]


def shown(result: DownloadOrder) -> list[str]:
    return [f"{index:04X}:{subindex} {int.from_bytes(data, 'little'):X}" for index, subindex, data in result.writes]


def test_a_pdo_is_destroyed_first_and_created_last() -> None:
    result = order(
        {
            (0x1800, 1): 0x185,
            (0x1800, 2): 1,
            (0x1800, 3): 100,
            (0x1800, 5): 10,
            (0x1800, 6): 2,
            (0x1A00, 0): 2,
            (0x1A00, 1): 0x60410010,
            (0x1A00, 2): 0x60640020,
            (0x2000, 0): 7,
        }
    )
    assert shown(result) == [
        "1800:1 80000185",
        "1A00:0 0",
        "1800:2 1",
        "1800:3 64",
        "1800:5 A",
        "1800:6 2",
        "1A00:1 60410010",
        "1A00:2 60640020",
        "1A00:0 2",
        "2000:0 7",
        "1800:1 185",
    ]
    assert result.left_out == {}


def test_all_pdos_are_destroyed_before_one_takes_the_can_id_of_another() -> None:
    result = order({(0x1801, 1): 0x185, (0x1800, 1): 0x285, (0x6081, 0): 1, (0x1017, 0): 500})
    assert shown(result) == [
        "1800:1 80000285",
        "1801:1 80000185",
        "1017:0 1F4",
        "6081:0 1",
        "1800:1 285",
        "1801:1 185",
    ]


def test_a_pdo_that_stays_destroyed_is_not_created() -> None:
    assert shown(order({(0x1800, 1): INVALID | 0x185, (0x1800, 2): 255})) == ["1800:1 80000185", "1800:2 FF"]


def test_the_standing_cob_id_destroys_where_it_is_known() -> None:
    present = {mux(0x1800, 1): 0x199}
    assert shown(order({(0x1800, 1): 0x185}, present=present)) == ["1800:1 80000199", "1800:1 185"]
    assert shown(order({(0x1800, 1): INVALID | 0x185}, present=present)) == ["1800:1 80000199", "1800:1 80000185"]


def test_a_mapping_without_its_cob_id_gets_back_what_stands() -> None:
    mapping: dict[tuple[int, int], Value] = {(0x1600, 0): 1, (0x1600, 1): 0x60400010}
    in_between = ["1600:0 0", "1600:1 60400010", "1600:0 1"]
    assert shown(order(mapping)) == ["1400:1 80000205", *in_between, "1400:1 205"]
    assert shown(order(mapping, present={mux(0x1400, 1): 0x222})) == ["1400:1 80000222", *in_between, "1400:1 222"]


def test_a_cob_id_that_nobody_knows_is_left_alone() -> None:
    unknown = Object.of("communication", [variable(0x1402, 1, U32)])
    entries = Object.of("mapping", [variable(0x1602, 0, U8), variable(0x1602, 1, U32)])
    assert shown(order({(0x1602, 1): 0x60400010}, unknown, entries)) == ["1602:1 60400010"]


def test_a_cob_id_that_cannot_be_written_is_left_alone() -> None:
    fixed = Object.of("communication", [variable(0x1402, 1, U32, 0x405, access=Access.RO), variable(0x1402, 2, U8)])
    result = order({(0x1402, 2): 1, (0x1402, 1): 0x405}, fixed)
    assert shown(result) == ["1402:2 1"]
    assert result.left_out == {mux(0x1402, 1): "read-only"}


def test_entries_beyond_the_count_are_left_out() -> None:
    result = order({(0x1A00, 0): 1, (0x1A00, 1): 0x60410010, (0x1A00, 2): 0, (0x1A00, 3): 0x60640020, (0x1800, 1): 0x185})
    assert shown(result) == ["1800:1 80000185", "1A00:0 0", "1A00:1 60410010", "1A00:0 1", "1800:1 185"]
    assert result.left_out == dict.fromkeys([mux(0x1A00, 2), mux(0x1A00, 3)], "beyond the number of mapped objects")


def test_a_multiplexed_pdo_has_one_entry() -> None:
    result = order({(0x1A00, 0): 0xFF, (0x1A00, 1): 0x20000020, (0x1A00, 2): 0, (0x1800, 1): 0x185, (0x1800, 2): 254})
    assert shown(result) == ["1800:1 80000185", "1A00:0 0", "1800:2 FE", "1A00:1 20000020", "1A00:0 FF", "1800:1 185"]


def test_services_are_off_while_they_are_set() -> None:
    result = order(
        {
            (0x1005, 0): 0x40000080,
            (0x1006, 0): 10_000,
            (0x1012, 0): 0xC0000100,
            (0x1014, 0): 0x85,
            (0x1016, 1): 0x000301F4,
            (0x1016, 2): 0,
            (0x1019, 0): 10,
        }
    )
    assert shown(result) == [
        "1005:0 80",
        "1006:0 0",
        "1012:0 100",
        "1014:0 80000085",
        "1016:1 0",
        "1016:2 0",
        "1019:0 A",
        "1005:0 40000080",
        "1006:0 2710",
        "1012:0 C0000100",
        "1014:0 85",
        "1016:1 301F4",
    ]


def test_the_date_of_the_configuration_comes_last() -> None:
    date = Object.of("date", [variable(0x1020, subindex, U32) for subindex in (1, 2)])
    result = order({(0x1020, 2): 7, (0x1020, 1): 42, (0x1800, 1): 0x185, (0x2000, 0): 5}, date)
    assert shown(result) == ["1800:1 80000185", "2000:0 5", "1800:1 185", "1020:1 2A", "1020:2 7"]


def test_what_must_be_off_for_another_object() -> None:
    assert shown(order({(0x1019, 0): 10}, present={mux(0x1006): 1000})) == ["1006:0 0", "1019:0 A", "1006:0 3E8"]
    assert shown(order({(0x1280, 3): 9})) == ["1280:1 80000000", "1280:2 80000000", "1280:3 9"]


@pytest.mark.parametrize(
    ("index", "subindex", "reason"),
    [
        (0x1003, 0, "a history"),
        (0x1010, 1, "a command: store"),
        (0x1011, 1, "a command: restore"),
        (0x1200, 1, "the SDO channel of this very download"),
        (0x6040, 0, "a command: control word"),
        (0x7041, 0, ""),
        (0x6840, 0, "a command: control word"),
        (0x1802, 4, "reserved"),
    ],
)
def test_what_is_no_setting_is_left_out(index: int, subindex: int, reason: str) -> None:
    result = order({(index, subindex): 1}, Object.of("extra", [variable(index, subindex, U32)]))
    assert result.left_out == ({mux(index, subindex): reason} if reason else {})
    assert bool(result.writes) is not bool(reason)


def test_flag_0_forbids_a_download() -> None:
    by_itself = Object.of("flagged", [variable(0x2100, 0, U8, object_flags=1)])
    whole = Node(0x2101, "flagged", ObjectType.VAR, {0: variable(0x2101, 0, U8)}, object_flags=3)
    other = Object.of("flagged", [variable(0x2102, 0, U8, object_flags=2)])
    result = order({(0x2100, 0): 1, (0x2101, 0): 1, (0x2102, 0): 1}, by_itself, whole, other)
    assert shown(result) == ["2102:0 1"]
    assert result.left_out == dict.fromkeys([mux(0x2100), mux(0x2101)], "its ObjFlags forbid a download")


def test_objects_of_a_wrong_type_are_written_once() -> None:
    """An EDS that gives a COB-ID 16 bits, or makes the count a text: nothing can be switched off there."""
    narrow = Object.of("communication", [variable(0x1402, 1, U16, 0x405), variable(0x1402, 2, U8)])
    text = Object.of("mapping", [variable(0x1602, 0, DataType.VISIBLE_STRING, "2"), variable(0x1602, 1, U32)])
    result = order({(0x1402, 1): 0x405, (0x1602, 0): "", (0x1602, 1): 0x20000008}, narrow, text)
    assert shown(result) == ["1602:0 0", "1402:1 405", "1602:1 20000008"]


def test_a_signed_cob_id_is_its_two_s_complement() -> None:
    signed = Object.of("communication", [variable(0x1402, 1, DataType.INTEGER32)])
    assert shown(order({(0x1402, 1): 0x405}, signed)) == ["1402:1 80000405", "1402:1 405"]


def test_an_unknown_object_is_the_callers_fault() -> None:
    with pytest.raises(ObjectNotFoundError, match="0x3000:01"):
        order({(0x3000, 1): 1})


def test_settings_are_what_a_dcf_configured() -> None:
    variables = [
        variable(0x2000, 1, U8, 3),
        variable(0x2000, 2, U8, 3, configured=4),
        variable(0x2000, 3, U32, configured=0x180, configured_adds_node_id=True),
        variable(0x2000, 4, U8),
    ]
    described = ObjectDictionary([Object.of("record", variables)])
    assert settings_of(described, NODE_ID) == {mux(0x2000, 2): 4, mux(0x2000, 3): 0x185}
    assert settings_of(described, NODE_ID, defaults=True) == {mux(0x2000, 1): 3, mux(0x2000, 2): 4, mux(0x2000, 3): 0x185}


WHOLE = dictionary()
BITS = st.integers(0, 0xFFFF_FFFF)


@given(st.dictionaries(st.sampled_from([each.mux for each in WHOLE]), BITS), st.dictionaries(st.just(mux(0x1400, 1)), BITS))
@examples(60)
def test_after_all_writes_the_device_holds_the_values(wanted: dict[int, int], present: dict[int, Value]) -> None:
    values: dict[int, Value] = {
        key: value & ((1 << 8 * (WHOLE.variable((key >> 8, key & 0xFF)).size or 1)) - 1) for key, value in wanted.items()
    }
    result = download_order(WHOLE, values, NODE_ID, present=present)
    after = {mux(index, subindex): WHOLE.variable((index, subindex)).decode(data) for index, subindex, data in result.writes}
    assert {key: value for key, value in values.items() if key not in result.left_out}.items() <= after.items()
    assert not result.left_out.keys() & after.keys()
    alive: set[int] = set()
    for index, subindex, data in result.writes:  # no PDO is touched while it exists
        if index in (0x1400, 0x1800, 0x1801) and subindex == 1:
            (alive.discard if data[3] & 0x80 else alive.add)(index)
        else:
            assert index & ~0x200 not in alive
    assert from_concise(pack_concise(result.writes)) == list(result.writes)
