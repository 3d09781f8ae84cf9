"""Bugs that people write, planted in small functions: what Hypothesis shows of each is what a person would write.

docs/strategies.md has the table; here it is held to it.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from typing import Any, NamedTuple

import pytest
from hypothesis import find
from hypothesis.strategies import SearchStrategy

from canopen_data.eds.reader import read_eds
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Object
from canopen_proto.dictionary.concise import from_concise
from canopen_proto.frame import Frame
from canopen_proto.machine import SECOND, Outbox
from canopen_proto.nmt import NmtCommand, NmtState, Service, target_of
from canopen_proto.pdo.mapping import Mapping
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.settings import DriveSettings
from canopen_proto.testing import World
from canopen_proto.testing.faults import Fault
from canopen_testing.strategies import (
    NmtOrder,
    PlannedDevice,
    SdoConversation,
    concise_dcfs,
    drive_behaviours,
    eds_texts,
    fault_plans,
    frames,
    near_valid_frames,
    networks,
    nmt_sequences,
    object_dictionaries,
    objects,
    pdo_mappings,
    sdo_conversations,
    values,
)
from tests.core.devices import io_device
from tests.docs_build import DOCS
from tests.examples import examples


class Planted(NamedTuple):
    """A bug: what is drawn, whether an example shows the bug, how the example is written, its size."""

    drawn: SearchStrategy[Any]
    shows: Callable[[Any], bool]
    text: Callable[[Any], str]
    size: Callable[[Any], int]


# ---- the bugs ----


def counter_of(sync: Frame) -> int:
    """Believes that each SYNC has a counter."""
    return sync.data[0]


def state_of(heartbeat: Frame) -> str:
    """Believes that a node that lives is operational or not yet."""
    return {5: "operational", 127: "pre-operational"}[heartbeat.data[0]]


def told_dead(heartbeat: Frame) -> bool:
    """Looks at the first byte of whatever comes as a heartbeat."""
    return heartbeat.data[0] not in (0, 4, 5, 127)


def as_bytes(value: int) -> bytes:
    """Has the wrong byte order."""
    return value.to_bytes(2, "big")


def from_bytes(data: bytes) -> int:
    """Has lost the sign."""
    return int.from_bytes(data, "little")


def read_segments(conversation: SdoConversation) -> bytes:
    """Sorts out copies of segments by the toggle bit, and has it the wrong way round after the second one."""
    content, toggle = b"", 0
    for answer in conversation.answers[1:]:
        command = answer.data[0]
        if command & 0x10 == toggle:
            content += answer.data[1 : 8 - (command >> 1 & 7)]
            toggle = 0x10
    return content


def in_segments(conversation: SdoConversation) -> bool:
    return conversation.is_upload and not conversation.in_blocks and not conversation.refusal and len(conversation.data) > 4


def offsets(mapping: Mapping) -> list[int]:
    """Believes that each object of a PDO begins with a byte."""
    places, place = [], 0
    for entry in mapping.entries:
        places.append(place)
        place += (entry.bit_length + 7) // 8 * 8
    return places


def true_offsets(mapping: Mapping) -> list[int]:
    return [sum(each.bit_length for each in mapping.entries[:number]) for number in range(len(mapping.entries))]


def subindices(described: Object) -> list[int]:
    """Believes that the subindices of an object have no gaps."""
    return [*range(len(described.variables))]


def state_after(orders: list[NmtOrder]) -> NmtState:
    """Believes that only three commands change the state of node 1."""
    state = NmtState.PRE_OPERATIONAL
    for order in orders:
        if order.node_id in (0, 1) and order.command < NmtCommand.RESET_NODE:
            state = target_of(order.command)
    return state


def true_state_after(orders: list[NmtOrder]) -> NmtState:
    state = NmtState.PRE_OPERATIONAL
    for order in orders:
        if order.node_id in (0, 1):
            target = target_of(order.command)
            state = NmtState.PRE_OPERATIONAL if target is NmtState.INITIALISING else target
    return state


def entries_of(data: bytes) -> int:
    """Takes an entry without bytes for the end."""
    count, place = 0, 4
    while place < len(data) and int.from_bytes(data[place + 3 : place + 7], "little"):
        place += 7 + int.from_bytes(data[place + 3 : place + 7], "little")
        count += 1
    return count


def names_in(eds: str) -> list[str]:
    """Takes a semicolon in a line for the beginning of a comment."""
    lines = [line.partition(";")[0] for line in eds.splitlines()]
    return [line.partition("=")[2] for line in lines if line.startswith("ParameterName=")]


def supervised(network: tuple[PlannedDevice, ...]) -> set[int]:
    """Supervises the first device."""
    return {network[0].node_id}


def enabled_at_once(settings: DriveSettings) -> bool:
    """Believes that a drive has done what it was told when the write is answered."""
    drive = DriveNode(Outbox(), 5, settings)
    drive.boot(0)
    for word in (0x06, 0x07, 0x0F):
        drive.write(0x6040, 0, word.to_bytes(2, "little"), 0)
    status = drive.read(0x6041, 0, 0)
    return isinstance(status, bytes) and status[0] & 0x6F == 0x27


def hangs(plan: list[Fault]) -> bool:
    """Reads an object of node 5 by hand, and waits for the answer as long as it takes."""
    world, heard = World(faults=plan), list[str]()
    reader = world.listener(lambda frame, now: heard.append(str(frame)))
    world.device(io_device(), 5)
    world.advance(6 * SECOND)
    world.send(reader, Frame.parse("605#4000100000000000"))
    world.advance(6 * SECOND)
    return not any(each.startswith("585#") for each in heard)


def raises(call: Callable[[Any], object]) -> Callable[[Any], bool]:
    def shows(example: Any) -> bool:
        try:
            call(example)
        except (LookupError, ValueError):
            return True
        return False

    return shows


def entries_text(mapping: Mapping) -> str:
    return ", ".join(entry.data_type.name for entry in mapping.entries)


FIELDS = [each.name for each in dataclasses.fields(DriveSettings)]


def changed(settings: DriveSettings) -> dict[str, Any]:
    plain = DriveSettings()
    return {name: getattr(settings, name) for name in FIELDS if getattr(settings, name) != getattr(plain, name)}


HEARTBEAT = [Service.ERROR_CONTROL]
PLANTED = {
    "each SYNC has a counter": Planted(frames([Service.SYNC]), raises(counter_of), str, lambda frame: len(frame.data)),
    "no node is ever stopped": Planted(frames(HEARTBEAT), raises(state_of), str, lambda frame: len(frame.data)),
    "each heartbeat has a byte": Planted(near_valid_frames(HEARTBEAT), raises(told_dead), str, lambda frame: len(frame.data)),
    "wrong byte order": Planted(
        values(DataType.UNSIGNED16), lambda value: as_bytes(value) != value.to_bytes(2, "little"), str, lambda value: value
    ),
    "the sign is lost": Planted(
        values(DataType.INTEGER16),
        lambda value: from_bytes(value.to_bytes(2, "little", signed=True)) != value,
        str,
        lambda value: abs(value),
    ),
    "the toggle bit toggles once": Planted(
        sdo_conversations().filter(in_segments),
        lambda conversation: read_segments(conversation) != conversation.data,
        lambda conversation: f"an upload of {len(conversation.data)} bytes: {len(conversation.answers) - 1} segments",
        lambda conversation: len(conversation.answers) - 1,
    ),
    "PDOs are made of bytes": Planted(
        pdo_mappings(whole=True),
        lambda mapping: offsets(mapping) != true_offsets(mapping),
        entries_text,
        lambda mapping: len(mapping.entries),
    ),
    "subindices have no gaps": Planted(
        objects(),
        lambda described: subindices(described) != [*described.variables],
        lambda described: ", ".join(f"{described.index:04X}:{each:02X}" for each in described.variables),
        lambda described: len(described.variables),
    ),
    "a reset changes no state": Planted(
        nmt_sequences(),
        lambda orders: state_after(orders) != true_state_after(orders),
        lambda orders: ", ".join(f"{order.command.name} to {order.node_id}" for order in orders),
        len,
    ),
    "an empty entry ends a concise DCF": Planted(
        concise_dcfs(), lambda data: entries_of(data) != len(from_concise(data)), lambda data: data.hex(" "), len
    ),
    "a semicolon begins a comment": Planted(
        eds_texts(dictionaries=object_dictionaries(max_size=1)),
        lambda text: any(each.name not in names_in(text) for each in read_eds(text).dictionary.objects.values()),
        lambda text: next(line for line in text.splitlines() if ";" in line),
        lambda text: len(read_eds(text).dictionary.objects),
    ),
    "one device is supervised": Planted(
        networks(),
        lambda network: supervised(network) != {each.node_id for each in network},
        lambda network: "devices " + " and ".join(str(each.node_id) for each in network),
        len,
    ),
    "an answer always comes": Planted(
        fault_plans([5]),
        hangs,
        lambda plan: " and ".join(map(str, plan)),
        len,
    ),
    "a drive acts at once": Planted(
        drive_behaviours(answers=False),
        lambda settings: not enabled_at_once(settings),
        lambda settings: ", ".join(f"{name}={value}" for name, value in changed(settings).items()),
        lambda settings: len(changed(settings)),
    ),
}

PAGE = (DOCS / "strategies.md").read_text(encoding="utf-8") if (DOCS / "strategies.md").exists() else ""
ROWS = dict(re.findall(r"^\| ([^|]+?) \| [^|]+ \| ([^|]+ \| \d+) ", PAGE, re.MULTILINE))


@pytest.mark.thorough(7)
@pytest.mark.parametrize("name", PLANTED)
def test_the_smallest_example_is_the_one_that_a_person_would_write(name: str) -> None:
    planted = PLANTED[name]
    example = find(planted.drawn, planted.shows, settings=examples(1000, least=1000, explain=False))
    text, size = ROWS[name].split(" | ")
    assert planted.size(example) <= int(size)
    assert planted.text(example) == text.strip("`")


def test_the_page_has_each_of_them() -> None:
    assert ROWS.keys() == PLANTED.keys()
    assert len(PLANTED) >= 10
