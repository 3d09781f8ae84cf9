"""Devices by which a network runs: their dictionaries, PDO mappings that fit, how drives behave, whole small networks."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Final

from hypothesis import strategies as st
from hypothesis.errors import InvalidArgument
from hypothesis.strategies import SearchStrategy

from canopen_proto import frame as ids
from canopen_proto import indices
from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import DataType, bit_length_of
from canopen_proto.dictionary import Access, Direction, Object, ObjectDictionary, Variable
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.drives.cia402.states import State
from canopen_proto.frame import COB_ID_INVALID
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import MILLISECOND, Outbox
from canopen_proto.multiplexer import Mux, mux
from canopen_proto.pdo.mapping import MAX_BITS, MAX_ENTRIES, MappedEntry, Mapping, may_have_width
from canopen_proto.pdo.multiplexed import MAPPABLE
from canopen_proto.simulation.drive.answers import Answer
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.settings import DriveSettings, Shape
from canopen_testing.strategies.identifiers import node_ids
from canopen_testing.strategies.objects import data_types, values

_USUAL_ENTRIES: Final = 8
_TIMES: Final = (DataType.TIME_OF_DAY, DataType.TIME_DIFFERENCE)


@st.composite
def pdo_mappings(
    draw: st.DrawFn,
    dictionary: ObjectDictionary | None = None,
    direction: Direction | None = None,
    *,
    min_size: int = 1,
    max_bits: int = MAX_BITS,
    dummies: bool = True,
    whole: bool = False,
) -> Mapping:
    """Return a strategy for PDO mappings of at most max_bits bits.

    dictionary: only its objects that a PDO may carry, in their full width; None = objects from 0x2000 on, of any type and width.
    direction: which of them, those that a TPDO or an RPDO may carry; None = both. dummies: places that nobody
    reads too. whole: without a dictionary, only types of fixed width, whole.
    Bounds: min_size (0 or 1) to 64 entries, 64 bits. Shrinks towards one UNSIGNED8.
    """
    if not 0 <= max_bits <= MAX_BITS or min_size not in (0, 1):
        raise InvalidArgument(
            f"a PDO has 0..{MAX_BITS} bits and min_size is 0 or 1, not max_bits={max_bits}, min_size={min_size}"
        )
    accesses = MAPPABLE[direction] if direction else Access
    carried = dictionary and [each for each in dictionary if each.pdo_mappable and each.bit_length and each.access in accesses]
    entries: list[MappedEntry] = []
    free = max_bits
    for number in range(draw(st.integers(min_size, _USUAL_ENTRIES) | st.integers(min_size, MAX_ENTRIES))):
        if carried is not None:
            fitting = [MappedEntry.of(each) for each in carried if (each.bit_length or 0) <= free]
        else:
            fitting = draw(_of_any_type(number, free, dummies, whole)) if free else []
        if not fitting:
            break
        entries.append(draw(st.sampled_from(fitting)))
        free -= entries[-1].bit_length
    return Mapping(entries)


@st.composite
def _of_any_type(draw: st.DrawFn, number: int, free: int, dummies: bool, whole: bool) -> list[MappedEntry]:
    """The entries that a variable of its own could have, of full width first; none if none fits."""
    data_type = draw(data_types(mappable=whole).filter(lambda each: each not in _TIMES))
    full = bit_length_of(data_type)
    widths = [bits for bits in range(1, free + 1) if may_have_width(data_type, bits) and not (whole and bits != full)]
    is_dummy = draw(st.integers(0, 4)) == 4 and dummies and full is not None
    index = int(data_type) if is_dummy else 0x2000 + number
    return [MappedEntry(index, 0, bits, data_type, f"v{number}") for bits in sorted(widths, key=lambda bits: bits != full)]


_PDOS: Final = {Direction.TPDO: (0x1800, 0x1A00, ids.TPDO1, ids.TPDO2), Direction.RPDO: (0x1400, 0x1600, ids.RPDO1, ids.RPDO2)}
"""Parameters, mappings and COB-IDs of the first two PDOs of each direction."""
_HEARTBEATS: Final = (0, 1000, 500, 100, 20)
_OWN: Final = 0x2000


@st.composite
def device_dictionaries(
    draw: st.DrawFn, *, max_size: int = 4, heartbeats: Collection[int] = _HEARTBEATS, pdos: bool = True
) -> ObjectDictionary:
    """Return a strategy for object dictionaries by which a device runs (`LocalNode`), whatever node-ID it has.

    It has the mandatory objects, SYNC, EMCY, a heartbeat, some variables from 0x2000 on, and PDOs that carry some of these, on
    the COB-IDs of the predefined connection set. heartbeats: the periods to choose from, in ms; 0 = none. pdos: False = none.
    Bounds: max_size variables of fixed width, two TPDOs, two RPDOs. Shrinks towards the mandatory objects, without heartbeat,
    variables and PDOs.
    """
    fixed = data_types(mappable=True)
    own: list[Object] = []
    for index in range(_OWN, _OWN + draw(st.integers(0, max_size))):
        data_type = draw(fixed)
        access = draw(st.sampled_from((Access.RW, Access.RO)))
        default = draw(st.none() | values(data_type, in_file=True))
        name = f"value_{index - _OWN + 1}"
        own.append(Object.of(name, [Variable(index, 0, name, data_type, access, default, pdo_mappable=True)]))
    dictionary = ObjectDictionary(
        [
            standard_object(indices.DEVICE_TYPE, 0),
            standard_object(indices.ERROR_REGISTER),
            standard_object(indices.COB_ID_SYNC),
            standard_object(indices.COB_ID_EMERGENCY),
            standard_object(indices.CONSUMER_HEARTBEAT_TIME, highest=4),
            standard_object(indices.PRODUCER_HEARTBEAT_TIME, draw(st.sampled_from(tuple(heartbeats)))),
            standard_object(indices.IDENTITY_OBJECT, highest=4, defaults={1: 0x1, 2: draw(st.integers(1, 3)), 3: 0, 4: 0}),
            *own,
        ]
    )
    if not pdos or not own:
        return dictionary
    described: list[Object] = []
    for direction, (parameter, mapping, *cob_ids) in _PDOS.items():
        for number, cob_id in enumerate(cob_ids[: draw(st.integers(0, len(cob_ids)))]):
            entries = draw(pdo_mappings(dictionary, direction, min_size=0)).parameters
            described.append(_communication(parameter + number, cob_id, draw(_TRANSMISSION_TYPES), bool(entries)))
            described.append(standard_object(mapping + number, highest=8, defaults=dict(enumerate((len(entries), *entries[:8])))))
    return dictionary.with_objects(described)


_TRANSMISSION_TYPES: Final = st.sampled_from((255, 254, 1, 3, 0))


def _communication(index: int, cob_id: int, transmission_type: int, is_valid: bool) -> Object:
    plain = standard_object(index, highest=5, defaults={2: transmission_type})
    of_node = replace(plain.variables[1], default=cob_id | (0 if is_valid else COB_ID_INVALID), adds_node_id=True)
    return Object.of(plain.name, [of_node if each.subindex == 1 else each for each in plain.variables.values()])


_READ_BY_MASTERS: Final = (mux(0x1018, 1), mux(0x6041), mux(0x6061), mux(0x6064), mux(0x1000))
_WRITTEN_BY_MASTERS: Final = (mux(0x6040), mux(0x6060), mux(0x607A), mux(0x1017))
_REFUSALS: Final = (AbortCode.DEVICE_STATE, AbortCode.NO_SUCH_OBJECT, AbortCode.GENERAL_ERROR, AbortCode.TIMED_OUT)


@st.composite
def _answers(draw: st.DrawFn) -> tuple[Mux, Answer]:
    """One object that is answered late, with an abort, or, of those that a master reads, with another value."""
    place = draw(st.sampled_from(_READ_BY_MASTERS + _WRITTEN_BY_MASTERS))
    late = st.sampled_from((20, 200, 2000)).map(lambda delay: Answer(delay=delay * MILLISECOND))
    refused = st.sampled_from(_REFUSALS).map(lambda code: Answer(abort=code))
    other = st.integers(0, 0xFF).map(lambda value: Answer(value=value))
    return place, draw(late | refused | other if place in _READ_BY_MASTERS else late | refused)


def drive_behaviours(*, answers: bool = True) -> SearchStrategy[DriveSettings]:
    """Return a strategy for the habits of simulated CiA 402 drives: `DriveSettings`.

    Each habit is one that a real drive has: it acts late, is slow to start, waits for SYNC, takes modes only in some states, has
    STO at power-on. answers: some objects are answered late, wrongly, or with an abort, too (two at most).
    Bounds: no drive that could not be moved at all, but by answers or STO. Shrinks towards `DriveSettings()`, habit by habit.
    """
    wrong = st.lists(_answers(), max_size=2, unique_by=lambda each: each[0]).map(tuple) if answers else st.just(())
    return st.builds(
        DriveSettings,
        shape=st.sampled_from(Shape),
        position=st.just(3_000.0) | st.integers(-150_000, 150_000).map(float),
        lag=_times(5, 0, 50),
        waits_for_sync=st.booleans(),
        self_test=_times(0, 100, 1500),
        reaction=_times(0, 1, 30, 500),
        set_points=st.sampled_from((1, 0, 4)),
        mode_change_state=st.sampled_from((State.OPERATION_ENABLED, State.SWITCHED_ON, State.READY_TO_SWITCH_ON)),
        changes_mode_halted=st.booleans().map(lambda refuses: not refuses),
        torque_is_off=st.booleans(),
        stops_at_switches=st.booleans().map(lambda passes: not passes),
        answers=wrong,
    )


def _times(*milliseconds: int) -> SearchStrategy[int]:
    return st.sampled_from([each * MILLISECOND for each in milliseconds])


@dataclass(frozen=True)
class PlannedDevice:
    """A device of a network: its node-ID and its objects. drive: it is a simulated drive with these habits; None = plain."""

    node_id: int
    dictionary: ObjectDictionary
    drive: DriveSettings | None = None

    def make(self, out: Outbox) -> LocalNode:
        """Return the device: to be attached to a Network, or for `World.device(planned.make)`. It is not booted."""
        if self.drive is not None:
            return DriveNode(out, self.node_id, self.drive)
        return LocalNode(out, self.node_id, self.dictionary)


@st.composite
def networks(
    draw: st.DrawFn,
    *,
    min_size: int = 1,
    max_size: int = 3,
    nodes: SearchStrategy[int] | None = None,
    dictionaries: SearchStrategy[ObjectDictionary] | None = None,
    drives: SearchStrategy[DriveSettings] | None = None,
) -> tuple[PlannedDevice, ...]:
    """Return a strategy for small networks: some devices with different node-IDs, sorted by them.

    nodes: the node-IDs; None = `node_ids()`. dictionaries: of the plain devices; None = `device_dictionaries()`. drives: habits
    of drives, of which there are some too; None = no drives. Bounds: min_size to max_size devices. Shrinks towards min_size
    plain devices with node-IDs 1, 2 ...
    """
    if not 0 <= min_size <= max_size <= ids.MAX_NODE_ID:
        raise InvalidArgument(f"no network has {min_size} to {max_size} devices: 0 <= min_size <= max_size <= {ids.MAX_NODE_ID}")
    places = draw(st.lists(node_ids() if nodes is None else nodes, min_size=min_size, max_size=max_size, unique=True))
    plain = device_dictionaries() if dictionaries is None else dictionaries
    planned = []
    for node_id in sorted(places):
        settings = draw(drives) if drives is not None and draw(st.booleans()) else None
        dictionary = draw(plain) if settings is None else drive_dictionary(settings.shape)
        planned.append(PlannedDevice(node_id, dictionary, settings))
    return tuple(planned)
