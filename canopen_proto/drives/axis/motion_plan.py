"""Plan how a drive follows set-points: its mode, its PDOs, and what goes by SDO, from its dictionary alone. Nothing is sent.

The mode is the first one of csp, ip and pp that the drive has and that its PDOs allow:

    csp, ip   one set-point a SYNC. An RPDO must carry the set-point (0x607A, 0x60C1:01), and the drive must listen to SYNC.
    pp        slow: a set-point is a target of the drive's own profile, with a handshake (bits 4 and 12). Target, controlword and
              all that is watched may go by SDO too, so every drive with profile position can do it.

The drive has a mode if 0x6502 lists it: the value that the drive shows (`modes`), else the file's. If neither is known, only pp
is assumed; `wish` tries another one. Either way the drive has the last word: 0x6061 must show the mode.

The PDOs are those that the file describes, if they carry controlword and set-point, statusword and position. Else one RPDO, one
TPDO, or both get another mapping (`configure_pdo` writes it): controlword and set-point; statusword, position, and what else has
room. The modes of operation (0x6060) stay out of it: a mode changes only between motions, by confirmed SDO.

With `feed_forward` one more RPDO carries what is fed forward: see feed_forward_pdo.py.

A `lean` plan is for a bus without room: TPDOs that bring nothing of WATCHED at SYNCs, or only what others bring, are switched
off. A TPDO that carries something else stays as it is.

    plan = plan_motion(dictionary, node_id, cycle_time)
    print(plan.describe())
    yield from exchange_planned(node, plan)

**Several axes on one node** (`axis`): a PDO belongs to the axes whose objects it carries; an empty one to the axis that its
number says (64 to an axis). Each axis uses any PDO that carries its objects, and remaps only those that are its own alone.

Source: IEC 61800-7-201 (CiA 402-2): supported drive modes, cyclic synchronous position, interpolated position, profile position;
CiA 301 v4.2.0, 7.5.2.35 to 7.5.2.38.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

from canopen_proto.abort import AbortOrigin
from canopen_proto.datatypes import range_of
from canopen_proto.dictionary import Direction, ObjectDictionary, Variable
from canopen_proto.drives.axis.axis_node import AxisNode
from canopen_proto.drives.axis.feed_forward_pdo import FED, with_feed_forward
from canopen_proto.drives.axis.set_points import SET_POINT_OF
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.axes import axes_of, axis_of, dictionary_of_axis, swapped, swapped_entry, usual_axis_of_pdo
from canopen_proto.drives.cia402.modes import Mode, mode_name, short_name, supported, supported_modes
from canopen_proto.frame import COB_ID_INVALID
from canopen_proto.machine import MILLISECOND, Time
from canopen_proto.multiplexer import Mux, mux_text, split_mux
from canopen_proto.pdo.configure import read_pdo
from canopen_proto.pdo.described import (
    CYCLIC_TYPES,
    EACH_SYNC,
    choose_pdos,
    cyclic_objects,
    exchange_pdos,
    has_settings,
    muxes_of,
    read_commanded,
)
from canopen_proto.pdo.settings import COB_ID, PdoSettings, RemapStep, communication_index
from canopen_proto.pdo.slots import (
    EVENT_DRIVEN,
    Slot,
    as_fit,
    destroying,
    entry_of,
    existing,
    foreign,
    has_sync,
    is_ours,
    key_text,
    remapped,
    shown_entries,
    slots_of,
    spare_tpdos,
)
from canopen_proto.procedures.objects import ABSENT, read_if_present
from canopen_proto.procedures.steps import Procedure, ProcedureError, SdoFailed, download, upload
from canopen_proto.remote_node import RemoteNode

MODES: Final = (Mode.CYCLIC_SYNCHRONOUS_POSITION, Mode.INTERPOLATED_POSITION, Mode.PROFILE_POSITION)
"""The modes in which a drive can follow positions, the best first."""

FEEDBACK: Final = (
    objects.STATUSWORD, objects.POSITION_ACTUAL_VALUE, objects.MODES_OF_OPERATION_DISPLAY, objects.VELOCITY_ACTUAL_VALUE,
    objects.ERROR_CODE, objects.TORQUE_ACTUAL_VALUE,
)  # fmt: skip
"""The objects that a master wants to hear, the most wanted first."""
NEEDED: Final = FEEDBACK[:2]
"""Without these by PDO, a TPDO gets another mapping."""
WATCHED: Final = FEEDBACK[:3]
"""These are read by SDO if no PDO brings them at SYNCs; see following.py."""
WELCOME: Final = frozenset(FEEDBACK[3:])
"""These are left out where the bus has no room."""


class Obstacle(NamedTuple):
    """A mode that was not chosen, and why."""

    mode: Mode
    reason: str


class NoMotionPlan(ProcedureError):
    """No mode can be used to give a drive set-points. obstacles: each mode that was tried, and its obstacle."""

    def __init__(self, message: str, obstacles: Sequence[Obstacle]) -> None:
        super().__init__(message)
        self.obstacles = tuple(obstacles)


@dataclass(frozen=True, slots=True)
class MotionPlan:
    """See this module's text. axis: of the node. reason: why this mode. pdos: to be exchanged. written: those of them whose
    settings differ from the file's. destroyed: PDOs with another node's CAN-ID, as they shall be. spare: TPDOs that are switched
    off, as they shall be. rejected: the modes that come before this one, and why not. notes: problems that stay.
    """

    dictionary: ObjectDictionary
    node_id: int
    axis: int
    mode: Mode
    reason: str
    pdos: tuple[PdoSettings, ...]
    written: tuple[PdoSettings, ...]
    destroyed: tuple[PdoSettings, ...]
    spare: tuple[PdoSettings, ...]
    rejected: tuple[Obstacle, ...]
    notes: tuple[str, ...]

    @property
    def set_point(self) -> Mux:
        """The object that takes the set-points."""
        return SET_POINT_OF[self.mode]

    @property
    def is_slow(self) -> bool:
        """Whether each set-point is a target with a handshake: profile position."""
        return self.mode is Mode.PROFILE_POSITION

    @property
    def cyclic(self) -> dict[Mux, int]:
        """The objects that the drive sends at SYNCs, as its axis sees them (axis_node.py): mux -> n for "at every n-th SYNC"."""
        return {swapped(key, self.axis): every for key, every in cyclic_objects(self.pdos).items()}

    @property
    def commands_by_sdo(self) -> tuple[Mux, ...]:
        """The commands that no RPDO carries."""
        carried = self._carried(Direction.RPDO)
        commands = self._places((objects.CONTROLWORD, self.set_point, objects.MODES_OF_OPERATION))
        return tuple(key for key in commands if key not in carried)

    @property
    def extras(self) -> tuple[Mux, ...]:
        """Other objects that its RPDOs carry: they are read first, and sent back as the drive shows them."""
        ours = self._places((objects.CONTROLWORD, *SET_POINT_OF.values()))
        return tuple(sorted(self._carried(Direction.RPDO).difference(ours)))

    @property
    def watched_by_sdo(self) -> tuple[Mux, ...]:
        """The watched values that no TPDO brings at SYNCs: they are read beside the cycle."""
        cyclic = cyclic_objects(self.pdos)
        return tuple(key for key in self._places(WATCHED) if key not in cyclic and split_mux(key) in self.dictionary)

    @property
    def steps(self) -> list[RemapStep]:
        """The writes that lead from the file's settings to these, in order."""
        places = ((communication_index(pdo.direction, pdo.number), pdo.cob_id) for pdo in (*self.destroyed, *self.spare))
        steps = [(index, COB_ID, cob_id.to_bytes(4, "little")) for index, cob_id in places]
        for pdo in self.written:
            standing = self.dictionary.at(communication_index(pdo.direction, pdo.number), COB_ID).initial_of(self.node_id)
            steps += pdo.steps(standing if isinstance(standing, int) else None)
        return steps

    def _carried(self, direction: Direction) -> set[Mux]:
        return {key for pdo in self.pdos if pdo.direction is direction for key in muxes_of(pdo.entries)}

    def _places(self, keys: Iterable[Mux]) -> list[Mux]:
        """Return where the device has objects of the axis."""
        return [swapped(key, self.axis) for key in keys]

    @property
    def facts(self) -> list[tuple[str, str]]:
        """The plan without its mode for people: names and texts, as ("RPDO 1", "on 0x203, at each SYNC: controlword ...")."""
        facts = []
        for pdo in self.pdos:
            entries = shown_entries(self.dictionary, pdo.entries)
            comes = "" if pdo in self.written else ", as in the file"
            facts.append((_name(pdo), f"on {key_text(pdo.cob_id)}, {_when(pdo.transmission_type)}{comes}: {entries}"))
        facts += [(_name(pdo), "is to be destroyed: its CAN-ID is another node's") for pdo in self.destroyed]
        facts += [(_name(pdo), "is to be switched off: the others tell all that is needed") for pdo in self.spare]
        for keys, name in ((self.commands_by_sdo, "written by SDO"), (self.watched_by_sdo, "read by SDO")):
            if keys:
                facts.append((name, ", ".join(map(self._label, keys))))
        fed = self._places(FED.get(self.mode, ()))
        if fed_forward := [key for key in self.extras if key in fed]:
            facts.append(("fed forward", ", ".join(map(self._label, fed_forward))))
        if others := [key for key in self.extras if key not in fed]:
            facts.append(("carried besides", f"{', '.join(map(self._label, others))}: sent back as the drive shows it"))
        return facts + [("note", note) for note in self.notes]

    def describe(self) -> str:
        """Return the plan for people, a line for each fact."""
        lines = [f"{_title(self.node_id, self.axis)}: {mode_name(self.mode)}: {self.reason}"]
        lines += [f"  not {short_name(each.mode)}: {each.reason}" for each in self.rejected]
        return "\n".join([*lines, *(f"  {name}: {text}" for name, text in self.facts)])

    def _label(self, key: Mux) -> str:
        variable = self.dictionary.get(*split_mux(key))
        return mux_text(key) if variable is None else variable.label


def plan_motion(
    dictionary: ObjectDictionary,
    node_id: int,
    cycle_time: Time,
    *,
    modes: int | None = None,
    wish: Mode | None = None,
    axis: int = 0,
    lean: bool = False,
    feed_forward: bool = False,
) -> MotionPlan:
    """Return how a drive with this dictionary follows set-points; see this module's text.

    cycle_time: ns between two SYNCs. modes: 0x6502 as the drive shows it; None: not read. wish: the only mode to be considered.
    axis: of the node, 0 for the first one. lean: as few TPDOs as possible. Raises NoMotionPlan, which names each mode and its
    obstacle.
    """
    wish = wish if wish is None else Mode(wish)  # a plain number is as good
    whole, several = dictionary, len(axes_of(dictionary)) > 1
    dictionary = dictionary_of_axis(dictionary, axis)  # everything down to `_plan` has the numbers of the first axis
    told = _told_modes(dictionary, modes)
    slots = slots_of(dictionary, node_id)
    rejected: list[Obstacle] = []
    for mode in MODES if wish is None else (wish,):
        obstacle = _mode_obstacle(dictionary, mode, told, cycle_time, is_wished=wish is not None)
        if not obstacle:
            own = [slot for slot in slots if not several or _belongs(slot, axis)]
            chosen = _pdos_for(dictionary, node_id, mode, slots, own)
            if isinstance(chosen, list):
                reason = _reason(mode, wish, told)
                notes: list[str] = []
                if feed_forward:
                    chosen, notes = with_feed_forward(dictionary, node_id, mode, slots, own, chosen)
                spare = spare_tpdos(chosen, own, WELCOME) if lean else []
                return _plan(whole, node_id, axis, mode, chosen, slots, spare, rejected, reason, notes)
            obstacle = chosen
        rejected.append(Obstacle(mode, obstacle))
    source = dictionary.source or "its dictionary"
    told_obstacles = "; ".join(f"{short_name(each.mode)}: {each.reason}" for each in rejected)
    raise NoMotionPlan(
        f"{_title(node_id, axis)} cannot follow set-points by {source}: {told_obstacles}. "
        "Try: the file of this very drive and firmware; its manual on modes (0x6502) and PDO mapping",
        rejected,
    )


def exchange_planned(node: RemoteNode, plan: MotionPlan) -> Procedure[None]:
    """Exchange the PDOs of a plan with its node; the node's settings are written where they differ.

    A PDO that shall be destroyed is left alone if the node itself has another CAN-ID than the file. A spare TPDO that the node
    refuses to switch off goes on. An event-driven RPDO is sent
    at each SYNC, but for a slow plan. The node should be Pre-operational. Raises as `exchange_pdos`.
    """
    for index, subindex, data in (yield from _destroying(node, plan.destroyed, lambda cob_id: not is_ours(cob_id, node.node_id))):
        yield from download(node.sdo, index, subindex, data)
    for index, subindex, data in (yield from _destroying(node, plan.spare)):
        try:
            yield from download(node.sdo, index, subindex, data)
        except SdoFailed as failed:
            if failed.origin is not AbortOrigin.PEER:
                raise  # else it goes on to send what nobody needs
    yield from read_commanded(node, plan.extras)
    yield from exchange_pdos(node, plan.pdos, sends_at_sync=not plan.is_slow)


def pending_steps(node: RemoteNode, plan: MotionPlan) -> Procedure[list[RemapStep]]:
    """Return the writes that `exchange_planned` would make in the node now, in order; the node is only read. Raises SdoFailed,
    StrangePdo, UnexpectedLength."""
    steps = yield from _destroying(node, plan.destroyed, lambda cob_id: not is_ours(cob_id, node.node_id))
    steps += yield from _destroying(node, plan.spare)
    for pdo in plan.pdos:
        present = yield from read_pdo(node, pdo.direction, pdo.number)
        if not has_settings(present, pdo):
            steps += pdo.steps(present.cob_id)
    return steps


def _destroying(
    node: RemoteNode, pdos: Iterable[PdoSettings], which: Callable[[int], bool] = lambda cob_id: True
) -> Procedure[list[RemapStep]]:
    """Return the writes that destroy those of these PDOs that are valid in the node itself. which: by their COB-IDs there."""
    steps: list[RemapStep] = []
    for pdo in pdos:
        index = communication_index(pdo.direction, pdo.number)
        try:
            cob_id = int.from_bytes((yield from upload(node.sdo, index, COB_ID)), "little")
        except SdoFailed as failed:
            if failed.abort_code not in ABSENT:
                raise
            continue
        if not cob_id & COB_ID_INVALID and which(cob_id):
            steps.append((index, COB_ID, (cob_id | COB_ID_INVALID).to_bytes(4, "little")))
    return steps


def read_modes(node: AxisNode) -> Procedure[int | None]:
    """Return the supported modes that the drive shows (0x6502), for `plan_motion`; None if it shows none. Raises SdoFailed."""
    modes = yield from read_if_present(node, objects.SUPPORTED_DRIVE_MODES)
    return modes if isinstance(modes, int) and modes else None


class _Told(NamedTuple):
    """The modes of a drive. modes: as in 0x6502; None: not known. source: of the value."""

    modes: int | None
    source: str


def _told_modes(dictionary: ObjectDictionary, modes: int | None) -> _Told:
    if modes is not None:
        return _Told(modes, "the drive")
    variable = dictionary.get(*split_mux(objects.SUPPORTED_DRIVE_MODES))
    said = None if variable is None else variable.default if variable.configured is None else variable.configured
    return _Told(said, "the file") if isinstance(said, int) and said else _Told(None, "")


def _reason(mode: Mode, wish: Mode | None, told: _Told) -> str:
    if wish is not None:
        return "as asked for"
    if told.modes is None:
        return "the first of csp, ip and pp that may work: no 0x6502 tells its modes, and nearly every drive has this one"
    return f"the first of csp, ip and pp that works; 0x6502 of {told.source} lists {_short_names(told.modes)}"


def _short_names(modes: int) -> str:
    return ", ".join(short_name(mode) for mode in supported_modes(modes)) or "no mode"


def _mode_obstacle(dictionary: ObjectDictionary, mode: Mode, told: _Told, cycle_time: Time, *, is_wished: bool) -> str:
    """Return why a drive cannot be in a mode; empty if it can, as far as its dictionary tells."""
    if mode not in MODES:
        return "it takes no positions as set-points"
    if told.modes is not None and not supported(told.modes, mode):
        return f"0x6502 of {told.source} lists {_short_names(told.modes)}"
    for key in (objects.CONTROLWORD, objects.STATUSWORD, objects.MODES_OF_OPERATION, SET_POINT_OF[mode]):
        if split_mux(key) not in dictionary:
            return f"it has no {mux_text(key)}"
    selected, set_point = (dictionary.at(*split_mux(key)) for key in (objects.MODES_OF_OPERATION, SET_POINT_OF[mode]))
    if not _may_be(selected, mode):
        return f"{selected.label} takes {selected.low_limit} to {selected.high_limit}, not {int(mode)}"
    if range_of(set_point.data_type) is None or not set_point.access.writable:
        return f"{set_point.label} is {set_point.data_type.name}, {set_point.access}: it takes no set-points"
    if mode is Mode.PROFILE_POSITION:
        return ""
    is_doubtful = told.modes is None and not is_wished
    unknown = "nothing says that it has this mode: 0x6502 is not known" if is_doubtful else ""
    return _cycle_obstacle(dictionary, mode, cycle_time) or unknown


def _cycle_obstacle(dictionary: ObjectDictionary, mode: Mode, cycle_time: Time) -> str:
    """Return why a drive cannot follow one set-point a SYNC; empty if it can."""
    if not has_sync(dictionary):
        return "it has no 0x1005, so it does not listen to SYNC"
    sub_mode = dictionary.get(*split_mux(objects.INTERPOLATION_SUB_MODE_SELECT))
    if mode is Mode.INTERPOLATED_POSITION and sub_mode is not None and not _may_be(sub_mode, 0):
        return f"{sub_mode.label} takes {sub_mode.low_limit} to {sub_mode.high_limit}: only the maker's own interpolation"
    units, index = (
        dictionary.get(*split_mux(key)) for key in (objects.INTERPOLATION_TIME_UNITS, objects.INTERPOLATION_TIME_INDEX)
    )
    if units is None or index is None:
        return ""
    exponent = -4 if cycle_time % MILLISECOND else -3
    count = cycle_time // 10 ** (9 + exponent)
    if not (_may_be(units, count) and _may_be(index, exponent) and units.access.writable and index.access.writable):
        return f"0x60C2 cannot be set to a cycle of {cycle_time / MILLISECOND:g} ms"
    return ""


def _may_be(variable: Variable, value: int) -> bool:
    """Return whether a value is within the limits of an object. Limits that exclude each other are no limits."""
    low, high = variable.low_limit, variable.high_limit
    if low is not None and high is not None and low > high:
        return True
    return (low is None or low <= value) and (high is None or value <= high)


def _belongs(slot: Slot, axis: int) -> bool:
    """Return whether a PDO of a device with several axes is this axis's alone; see this module's text."""
    carried = {place for key in slot.muxes if (place := axis_of(key)) is not None}
    return carried == {0} or (not carried and usual_axis_of_pdo(slot.number) == axis)


def _pdos_for(
    dictionary: ObjectDictionary, node_id: int, mode: Mode, slots: list[Slot], own: list[Slot]
) -> list[PdoSettings] | str:
    """Return the PDOs for a mode, or why no RPDO can carry its set-points. own: those that may be remapped."""
    rpdos = _rpdos_for(dictionary, node_id, mode, slots, own)
    return rpdos if isinstance(rpdos, str) else rpdos + _tpdos_for(dictionary, node_id, slots, own, rpdos)


def _rpdos_for(
    dictionary: ObjectDictionary, node_id: int, mode: Mode, slots: list[Slot], own: list[Slot]
) -> list[PdoSettings] | str:
    commands = (objects.CONTROLWORD, SET_POINT_OF[mode])
    is_cyclic = mode is not Mode.PROFILE_POSITION
    present = existing(slots, Direction.RPDO, has_sync=has_sync(dictionary))
    if is_cyclic:  # one set-point each SYNC; an event-driven RPDO can be sent at each SYNC
        present = [pdo for pdo in present if pdo.transmission_type in (EACH_SYNC, *EVENT_DRIVEN)]
    chosen, missing = choose_pdos(present, commands, ())
    takes_at_sync = all(pdo.transmission_type == EACH_SYNC for pdo in chosen)
    if not missing and (takes_at_sync or not is_cyclic):
        return chosen
    entries = {key: entry_of(dictionary, key, Direction.RPDO) for key in commands}
    wanted = as_fit(entry for entry, _ in entries.values() if entry is not None)
    carries_set_point = SET_POINT_OF[mode] in muxes_of(wanted)
    if carries_set_point or (wanted and not is_cyclic and objects.CONTROLWORD in missing):
        settings, obstacles = remapped(slots, Direction.RPDO, node_id, wanted, is_synchronous=is_cyclic, among=own)
        if settings is not None:
            return [settings]
    else:
        obstacles = [entries[SET_POINT_OF[mode]][1]]
    if is_cyclic and SET_POINT_OF[mode] in missing:
        return "; ".join(obstacles) or "it has no RPDO"
    return chosen


def _tpdos_for(
    dictionary: ObjectDictionary, node_id: int, slots: list[Slot], own: list[Slot], rpdos: list[PdoSettings]
) -> list[PdoSettings]:
    """Return the TPDOs that tell something; one gets another mapping if statusword and position are not among them at SYNCs."""
    listens = has_sync(dictionary)
    present, _ = choose_pdos(existing(slots, Direction.TPDO, has_sync=listens), (), FEEDBACK)
    told = {key for pdo in present if not listens or pdo.transmission_type in CYCLIC_TYPES for key in muxes_of(pdo.entries)}
    entries = [entry for key in FEEDBACK if (entry := entry_of(dictionary, key, Direction.TPDO)[0]) is not None]
    wanted = as_fit(entries)
    missing = set(NEEDED) - told
    if not missing & muxes_of(wanted):
        return present
    settings, _ = remapped(slots, Direction.TPDO, node_id, wanted, is_synchronous=listens, beside=rpdos, among=own)
    if settings is None:
        return present
    return [settings, *(pdo for pdo in present if pdo.number != settings.number)]


def _plan(
    dictionary: ObjectDictionary,
    node_id: int,
    axis: int,
    mode: Mode,
    pdos: list[PdoSettings],
    slots: list[Slot],
    spare: Collection[Slot],
    rejected: Sequence[Obstacle],
    reason: str,
    more_notes: Sequence[str],
) -> MotionPlan:
    leaves = {(slot.direction, slot.number) for slot in spare}
    pdos = [pdo for pdo in pdos if (pdo.direction, pdo.number) not in leaves]
    places = {(pdo.direction, pdo.number) for pdo in pdos}
    described = [slot.settings for slot in slots if slot.is_described]
    unwanted = [slot for slot in foreign(slots) if (slot.direction, slot.number) not in places]
    stuck = [slot for slot in unwanted if not slot.can_move]
    notes = [f"{slot.name} has CAN-ID {key_text(slot.cob_id)} of another node, and cannot change it" for slot in stuck]
    return MotionPlan(
        dictionary,
        node_id,
        axis,
        mode,
        reason,
        tuple(_of_device(pdo, axis) for pdo in pdos),
        tuple(_of_device(pdo, axis) for pdo in pdos if pdo not in described),
        tuple(_of_device(destroying(slot), axis) for slot in unwanted if slot.can_move),
        tuple(_of_device(destroying(slot), axis) for slot in spare),
        tuple(rejected),
        (*notes, *more_notes),
    )


def _of_device(pdo: PdoSettings, axis: int) -> PdoSettings:
    """Return settings that an axis sees as the device has them."""
    return replace(pdo, entries=tuple(swapped_entry(entry, axis) for entry in pdo.entries)) if axis else pdo


def _title(node_id: int, axis: int) -> str:
    return f"node {node_id}" + (f", axis {axis}" if axis else "")


def _name(pdo: PdoSettings) -> str:
    return f"{pdo.direction} {pdo.number}"


def _when(transmission_type: int) -> str:
    if transmission_type in EVENT_DRIVEN:
        return "event-driven"
    return "at each SYNC" if transmission_type == EACH_SYNC else f"transmission type {transmission_type}"
