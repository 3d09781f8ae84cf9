"""A network, as a master's own dictionary has it: 0x1F80 to 0x1F8A, 0x1F22, 0x1F26, 0x1F27, 0x1F55, 0x1016, 0x102A."""

from __future__ import annotations

from typing import Any

import pytest

from canopen_proto.datatypes import DataType, Value
from canopen_proto.dictionary import Object, ObjectDictionary, Values, Variable
from canopen_proto.dictionary.concise import pack_concise
from canopen_proto.machine import MICROSECOND, MILLISECOND, LocalProtocolError, Outbox
from canopen_proto.manager.boot.assignment import Assignment, Startup
from canopen_proto.manager.boot.entry import BootEntry, NetworkEntry, entries_of
from canopen_proto.manager.boot.node_boot import NmtCommands
from canopen_proto.nmt import NmtMaster

DCFGEN = bytes.fromhex("02000000 1710 00 02000000 C800 0220 00 02000000 3412")
"""0x1017:00 = 200 and 0x2002:00 = 0x1234, as dcfgen packs them."""
WRITES = ((0x1017, 0, b"\xc8\0"), (0x2002, 0, b"\x34\x12"))


def test_the_startup_has_seven_bits() -> None:
    for value in range(0x80):
        if value & 0x20:
            with pytest.raises(LocalProtocolError, match="flying master"):
                Startup.from_value(value)
        else:
            assert Startup.from_value(value).value == value
    assert Startup.from_value(1) == Startup()
    bits = ("is_master", "start_all", "waits", "application_starts", "reset_all_on_loss", "", "stop_all_on_loss")
    for bit, name in enumerate(bits):
        if name:
            assert Startup.from_value(1 << bit) == Startup(**{"is_master": False, name: True})
    for value in (0x80, 1 << 31, 1 << 32, -1):
        with pytest.raises(LocalProtocolError):
            Startup.from_value(value)


def test_the_assignment_has_all_bits_but_one() -> None:
    for value in range(0x100):
        if value & 2:
            with pytest.raises(LocalProtocolError, match="0x2 of"):
                Assignment.from_value(value)
        else:
            assert Assignment.from_value(value).value == value
    told = Assignment.from_value(0x0064_030D)
    assert told == Assignment(is_mandatory=True, retry_factor=3, guard_time=100 * MILLISECOND)
    assert told.value == 0x0064_030D
    assert [Assignment.from_value(value).guards for value in (0x0064_0305, 0x0064_0005, 0x0305)] == [True, False, False]
    names = ("is_listed", "", "boots", "is_mandatory", "keep_alive", "check_software", "update_software", "restore")
    for bit, name in enumerate(names):
        if name:
            assert Assignment.from_value(1 << bit) == Assignment(**{"is_listed": False, "boots": False, name: True})


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: Assignment.from_value(1 << 32),
        lambda: Assignment.from_value(-1),
        lambda: Assignment(retry_factor=256),
        lambda: Assignment(guard_time=MILLISECOND // 2),
        lambda: Assignment(guard_time=65536 * MILLISECOND),
        lambda: BootEntry(0),
        lambda: BootEntry(128),
        lambda: BootEntry(5, restore_subindex=128),
        lambda: BootEntry(5, consumer_time=MICROSECOND),
        lambda: NmtCommands(NmtMaster(Outbox()), -1),
    ],
)
def test_numbers_that_cannot_be(wrong: Any) -> None:
    with pytest.raises(LocalProtocolError):
        wrong()


def master(objects: dict[tuple[int, int], Value]) -> Values:
    """The dictionary of a master that has these objects."""
    indices = dict.fromkeys(index for index, _ in objects)
    made = [
        Object.of(f"object_{index:x}", [
            Variable(
                index, subindex, f"object_{index:x}_{subindex}",
                DataType.DOMAIN if isinstance(value, bytes) else DataType.UNSIGNED32, default=value,
            )
            for (each, subindex), value in objects.items() if each == index
        ])
        for index in indices
    ]  # fmt: skip
    return Values(ObjectDictionary(made), 1)


def test_all_of_it() -> None:
    values = master(
        {
            (0x1016, 1): 6 << 16 | 500, (0x1016, 2): 0, (0x102A, 0): 20, (0x1F80, 0): 3, (0x1F89, 0): 5000,
            (0x1F81, 6): 0x0064_038D, (0x1F84, 6): 0x191, (0x1F85, 6): 0x360, (0x1F86, 6): 1, (0x1F87, 6): 2, (0x1F88, 6): 3,
            (0x1F22, 6): DCFGEN, (0x1F26, 6): 9, (0x1F27, 6): 8, (0x1F55, 6): 7, (0x1F8A, 6): 2, (0x1F81, 7): 1, (0x1F88, 7): 0,
            (0x1F81, 8): 0, (0x1F88, 8): 4, (0x1F53, 7): 12, (0x1F54, 7): 0,
        }
    )  # fmt: skip
    six = BootEntry(
        6, Assignment.from_value(0x0064_038D), 0x191, 0x360, 1, 2, 3, 500 * MILLISECOND, 2, WRITES, (9, 8), 7
    )  # fmt: skip
    seven = BootEntry(7, Assignment(boots=False), software_date=(12, 0))
    told = entries_of(values)
    assert told == NetworkEntry(Startup(start_all=True), {6: six, 7: seven}, 5000 * MILLISECOND, 2 * MILLISECOND)
    assert six.identity == (0x360, 1, 2, 3)


def test_a_dictionary_without_a_network() -> None:
    assert entries_of(master({(0x1000, 0): 0})) == NetworkEntry(Startup(is_master=False), {})


def test_one_number_of_a_date_is_none() -> None:
    told = entries_of(master({(0x1F81, 6): 5, (0x1F26, 6): 9, (0x1F27, 6): 0}))
    assert told.nodes[6].date is None


def test_a_concise_dcf_in_a_file() -> None:
    told = entries_of(master({(0x1F81, 6): 5, (0x1F22, 6): b""}), {(0x1F22, 6): DCFGEN})
    assert told.nodes[6].configuration == WRITES
    assert pack_concise(WRITES) == DCFGEN


@pytest.mark.parametrize("length", range(1, len(DCFGEN)))
def test_a_concise_dcf_that_was_cut_is_refused_before_anything_is_written(length: int) -> None:
    with pytest.raises(LocalProtocolError, match="0x1F22:06: "):
        entries_of(master({(0x1F81, 6): 5, (0x1F22, 6): DCFGEN[:length]}))


def test_an_empty_concise_dcf_configures_nothing() -> None:
    assert entries_of(master({(0x1F81, 6): 5, (0x1F22, 6): b""})).nodes[6].configuration == ()


def test_a_dcf_as_text_is_refused() -> None:
    with pytest.raises(LocalProtocolError, match="0x1F20:06 holds a DCF as text. Try: "):
        entries_of(master({(0x1F81, 6): 5, (0x1F20, 6): b"[FileInfo]"}))
