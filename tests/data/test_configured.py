"""From the description of a type of device to that of one device, and back."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_data.configured import (
    configure,
    moved_to,
    with_configured,
    without_configured,
    without_configured_values,
)
from canopen_data.description import Commissioning, DeviceDescription, FileInfo, FileKind
from canopen_proto.datatypes import DataType, ValueRangeError
from canopen_proto.dictionary import Constant, Object, ObjectDictionary, ObjectNotFoundError, ObjectType, Variable
from canopen_proto.dictionary.download_order import settings_of
from canopen_proto.frame import COB_ID_EXTENDED, COB_ID_INVALID, COB_ID_NO_RTR, EMCY
from canopen_proto.machine import LocalProtocolError
from canopen_proto.multiplexer import mux
from tests.examples import examples

COB_ID = Variable(0x1800, 1, "COB-ID", DataType.UNSIGNED32, default=0x180, adds_node_id=True)
TYPE = Variable(0x1800, 2, "transmission type", DataType.UNSIGNED8, default=255)
HEARTBEAT = Variable(0x1017, 0, "heartbeat", DataType.UNSIGNED16, high_limit=1000)
DICTIONARY = ObjectDictionary(
    [Object.of("TPDO", [COB_ID, TYPE]), Object.of("heartbeat", [HEARTBEAT])],
    constants={mux(0x1017): [Constant("off", 0xFFFF, 0)]},
)
EDS = DeviceDescription(DICTIONARY, FileKind.EDS, file_info=FileInfo("drive.eds", created_by="maker"))
NODE_5 = Commissioning(node_id=5, bit_rate=500)


def test_a_dcf_holds_the_values_and_the_node_id() -> None:
    dcf = with_configured(EDS, {mux(0x1017): 2000, mux(0x1800, 1): 0x185}, NODE_5)
    assert dcf.kind is FileKind.DCF
    assert dcf.commissioning == NODE_5
    assert dcf.file_info == FileInfo("drive.eds", created_by="maker", last_eds="drive.eds")
    assert dcf.dictionary.variable(0x1017).configured == 2000  # limits are the device's affair
    assert dcf.dictionary.variable((0x1800, 2)).configured is None
    assert dcf.dictionary.names_of(0x1017, 0) == ("off",)
    assert EDS.dictionary.variable(0x1017).configured is None


def test_what_is_configured_already_keeps_its_form() -> None:
    relative = Variable(0x1800, 1, "COB-ID", DataType.UNSIGNED32, configured=0x180, configured_adds_node_id=True)
    dcf = DeviceDescription(ObjectDictionary([Object.of("TPDO", [relative, TYPE])]), FileKind.DCF, commissioning=NODE_5)
    same = with_configured(dcf, {mux(0x1800, 1): 0x185, mux(0x1800, 2): 1})
    assert same.dictionary.variable((0x1800, 1)) == relative
    assert same.dictionary.variable((0x1800, 2)).configured == 1
    other = with_configured(dcf, {mux(0x1800, 1): 0x186}).dictionary.variable((0x1800, 1))
    assert (other.configured, other.configured_adds_node_id) == (0x186, False)


def test_the_callers_file_info_is_taken() -> None:
    info = FileInfo("arm.dcf", last_eds="drive.eds", modification_date="05-23-2026")
    assert with_configured(EDS, {}, NODE_5, file_info=info).file_info == info
    dcf = with_configured(EDS, {}, NODE_5, file_info=info)
    assert with_configured(dcf, {}).file_info == info


def test_the_way_back() -> None:
    dcf = with_configured(EDS, {mux(0x1017): 100, mux(0x1800, 2): 1}, NODE_5)
    back = without_configured(dcf)
    assert (back.kind, back.commissioning, back.file_info) == (FileKind.EDS, None, EDS.file_info)
    assert list(back.dictionary) == list(DICTIONARY)
    assert list(without_configured_values(DICTIONARY)) == list(DICTIONARY)


def test_denotations_and_files_are_of_one_device() -> None:
    domain = Variable(0x2000, 0, "program", DataType.DOMAIN, denotation="mine", upload_file="a", download_file="b")
    whole = Object(0x2000, "program", ObjectType.DOMAIN, {0: domain}, denotation="mine")
    (plain,) = without_configured_values(ObjectDictionary([whole])).objects.values()
    assert (plain.denotation, plain.variables[0]) == ("", Variable(0x2000, 0, "program", DataType.DOMAIN))


def test_callers_faults() -> None:
    with pytest.raises(LocalProtocolError, match="node-ID"):
        with_configured(EDS, {})
    with pytest.raises(LocalProtocolError, match="128"):
        with_configured(EDS, {}, Commissioning(node_id=128))
    with pytest.raises(ObjectNotFoundError, match="0x2000:00"):
        with_configured(EDS, {mux(0x2000): 1}, NODE_5)
    with pytest.raises(ValueRangeError, match="heartbeat"):
        with_configured(EDS, {mux(0x1017): 0x10000}, NODE_5)


@examples(100)
@given(
    old=st.integers(1, 127),
    new=st.integers(1, 127),
    place=st.sampled_from([0x1014_00, 0x1400_01, 0x1401_01, 0x1800_01, 0x19FF_01]),
    flags=st.sampled_from([0, COB_ID_INVALID, COB_ID_NO_RTR]),
    can_id=st.sampled_from(["own", "other", "extended"]),
)
def test_own_cob_ids_move_with_the_node_id_and_no_others(old: int, new: int, place: int, flags: int, can_id: str) -> None:
    base = EMCY if place == 0x1014_00 else 0x300
    foreign = base + 128 - old if old != 64 else 0x6A0
    before = flags | {"own": base + old, "other": foreign, "extended": COB_ID_EXTENDED | base + old}[can_id]
    consumer = 0x1016_01
    dictionary = ObjectDictionary(
        Object.of(f"{key:X}", [Variable(key >> 8, key & 0xFF, f"{key:X}", DataType.UNSIGNED32)]) for key in (place, consumer)
    )
    dcf = configure(dictionary, {place: before, consumer: base + old}, old)
    moved = settings_of(moved_to(dcf, old, new), new)
    assert moved == {place: before - old + new if can_id == "own" else before, consumer: base + old}


def test_what_depends_on_the_node_id_moves_by_itself() -> None:
    cob_id = Variable(0x1800, 1, "cob", DataType.UNSIGNED32, configured=0x180, configured_adds_node_id=True)
    dictionary = ObjectDictionary([Object.of("tpdo", [cob_id])])
    assert settings_of(moved_to(dictionary, 5, 6), 6) == {0x1800_01: 0x186}
    with pytest.raises(LocalProtocolError):
        moved_to(dictionary, 5, 128)
