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

With `feed_forward` one more RPDO carries what is fed forward beside the set-points. A set-point and its controlword leave 16 bits
of their PDO, and a velocity has 32: so it needs a PDO of its own.

    csp    the offsets of velocity and torque (0x60B1, 0x60B2); they are 0 until somebody feeds something forward
    ip     the velocity of a data record (0x60C1:02), for drives whose records have one (sub_modes.py)

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

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

from canopen_proto.datatypes import range_of
from canopen_proto.dictionary import Direction, ObjectDictionary
from canopen_proto.dictionary.download_order import Write
from canopen_proto.drives.axis.axis_node import AxisNode
from canopen_proto.drives.axis.set_points import SET_POINT_OF
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.axes import axes_of, axis_of, dictionary_of_axis, swapped, swapped_entry, usual_axis_of_pdo
from canopen_proto.drives.cia402.modes import Mode, mode_name, short_name, supported, supported_modes
from canopen_proto.machine import MILLISECOND, Time
from canopen_proto.multiplexer import Mux, mux_text, split_mux
from canopen_proto.pdo.configure import exchange_pdos, read_commanded, steps_to, steps_to_destroy
from canopen_proto.pdo.settings import (
    COB_ID,
    CYCLIC_TYPES,
    EACH_SYNC,
    EVENT_DRIVEN,
    PdoSettings,
    carried_by,
    cob_id_step,
    communication_index,
    cyclic_objects,
    muxes_of,
)
from canopen_proto.pdo.slots import (
    PdoSlots,
    as_fit,
    choose_pdos,
    entry_of,
    has_sync,
    is_ours,
    number_in,
    shown_entries,
    spare_tpdos,
)
from canopen_proto.procedures.objects import read_if_present, unless_refused
from canopen_proto.procedures.steps import Procedure, ProcedureError, download
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

FED: Final = {
    Mode.CYCLIC_SYNCHRONOUS_POSITION: (objects.VELOCITY_OFFSET, objects.TORQUE_OFFSET),
    Mode.INTERPOLATED_POSITION: (objects.INTERPOLATION_VELOCITY,),
}
"""Mode -> the objects that are fed forward beside its set-points, as far as the drive has them."""


class Obstacle(NamedTuple):
    """A mode that was not chosen, and why."""

    mode: Mode
    reason: str


class NoMotionPlanError(ProcedureError):
    """No mode can be used to give a drive set-points. obstacles: each mode that was tried, and its obstacle. message: for
    people."""

    def __init__(self, message: str, obstacles: Sequence[Obstacle]) -> None:
        super().__init__(message)
        self.obstacles = tuple(obstacles)


@dataclass(frozen=True, slots=True)
class MotionPlan:
    """The mode in which a drive follows set-points, and the PDOs for it; see this module's text.

    axis: of the node. reason: why this mode. pdos: to be exchanged. written: those of them whose settings differ from the file's.
    destroyed: PDOs with another node's CAN-ID, as they shall be. spare: TPDOs that are switched off, as they shall be. rejected:
    the modes that come before this one, and why not. notes: problems that stay.
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
        carried = carried_by(self.pdos, Direction.RPDO)
        commands = self._places((objects.CONTROLWORD, self.set_point, objects.MODES_OF_OPERATION))
        return tuple(key for key in commands if key not in carried)

    @property
    def extras(self) -> tuple[Mux, ...]:
        """Other objects that its RPDOs carry: they are read first, and sent back as the drive shows them."""
        ours = self._places((objects.CONTROLWORD, *SET_POINT_OF.values()))
        return tuple(sorted(carried_by(self.pdos, Direction.RPDO).difference(ours)))

    @property
    def watched_by_sdo(self) -> tuple[Mux, ...]:
        """The watched values that no TPDO brings at SYNCs: they are read beside the cycle."""
        cyclic = cyclic_objects(self.pdos)
        return tuple(key for key in self._places(WATCHED) if key not in cyclic and split_mux(key) in self.dictionary)

    @property
    def steps(self) -> list[Write]:
        """The writes that lead from the file's settings to these, in order."""
        steps = [cob_id_step(pdo) for pdo in (*self.destroyed, *self.spare)]
        for pdo in self.written:
            steps += pdo.steps(number_in(self.dictionary, communication_index(*pdo.place), COB_ID, self.node_id))
        return steps

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
            facts.append((pdo.name, f"on {pdo.can_id_text}, {_when(pdo.transmission_type)}{comes}: {entries}"))
        facts += [(pdo.name, "is to be destroyed: its CAN-ID is another node's") for pdo in self.destroyed]
        facts += [(pdo.name, "is to be switched off: the others tell all that is needed") for pdo in self.spare]
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
    axis: of the node, 0 for the first one. lean: as few TPDOs as possible. feed_forward:
    the velocity offset (0x60B1) goes along, where the drive has room for it. Raises NoMotionPlanError, which names each mode and
    its obstacle.
    """
    wish = wish if wish is None else Mode(wish)  # a plain number is as good
    choice = _PdoChoice(dictionary, node_id, axis)
    told = _told_modes(choice.dictionary, modes)
    rejected: list[Obstacle] = []
    for mode in MODES if wish is None else (wish,):
        obstacle = _mode_obstacle(choice.dictionary, mode, told, cycle_time, is_wished=wish is not None)
        if not obstacle:
            pdos = choice.pdos_for(mode)
            if isinstance(pdos, list):
                notes = choice.add_feed_forward(pdos, mode) if feed_forward else []
                return choice.plan(pdos, mode, _reason(mode, wish, told), rejected, notes, lean=lean)
            obstacle = pdos
        rejected.append(Obstacle(mode, obstacle))
    source = dictionary.source or "its dictionary"
    told_obstacles = "; ".join(f"{short_name(each.mode)}: {each.reason}" for each in rejected)
    raise NoMotionPlanError(
        f"{_title(node_id, axis)} cannot follow set-points by {source}: {told_obstacles}. "
        "Try: the file of this very drive and firmware; its manual on modes (0x6502) and PDO mapping",
        rejected,
    )


def exchange_planned(node: RemoteNode, plan: MotionPlan) -> Procedure[None]:
    """Exchange the PDOs of a plan with its node; the node's settings are written where they differ.

    A PDO that shall be destroyed is left alone if the node itself has another CAN-ID than the file. A spare TPDO that the node
    refuses to switch off goes on. An event-driven RPDO is sent at each SYNC, but for a slow plan. The node should be
    Pre-operational. Raises as `exchange_pdos`.
    """
    for step in (yield from _steps_to_destroy(node, plan)):
        yield from download(node.sdo, *step)
    for step in (yield from steps_to_destroy(node, plan.spare)):
        yield from unless_refused(download(node.sdo, *step))  # refused, it goes on to send what nobody needs
    yield from read_commanded(node, plan.extras)
    yield from exchange_pdos(node, plan.pdos, sends_at_sync=not plan.is_slow)


def pending_steps(node: RemoteNode, plan: MotionPlan) -> Procedure[list[Write]]:
    """Return the writes that `exchange_planned` would make in the node now, in order; the node is only read. Raises
    SdoTransferError, InvalidPdoError, UnexpectedLengthError. plan: as `plan_motion` made it."""
    steps = yield from _steps_to_destroy(node, plan)
    steps += yield from steps_to_destroy(node, plan.spare)
    for pdo in plan.pdos:
        steps += yield from steps_to(node, pdo)
    return steps


def _steps_to_destroy(node: RemoteNode, plan: MotionPlan) -> Procedure[list[Write]]:
    return (yield from steps_to_destroy(node, plan.destroyed, lambda cob_id: not is_ours(cob_id, node.node_id)))


def read_modes(node: AxisNode) -> Procedure[int | None]:
    """Return the supported modes that the drive shows (0x6502), for `plan_motion`; None if it shows none. Raises
    SdoTransferError."""
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
    if not selected.may_be(mode):
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
    if mode is Mode.INTERPOLATED_POSITION and sub_mode is not None and not sub_mode.may_be(0):
        return f"{sub_mode.label} takes {sub_mode.low_limit} to {sub_mode.high_limit}: only the maker's own interpolation"
    units, index = (
        dictionary.get(*split_mux(key)) for key in (objects.INTERPOLATION_TIME_UNITS, objects.INTERPOLATION_TIME_INDEX)
    )
    if units is None or index is None:
        return ""
    exponent = -4 if cycle_time % MILLISECOND else -3
    count = cycle_time // 10 ** (9 + exponent)
    if not (units.may_be(count) and index.may_be(exponent) and units.access.writable and index.access.writable):
        return f"0x60C2 cannot be set to a cycle of {cycle_time / MILLISECOND:g} ms"
    return ""


class _PdoChoice:
    """Chooses the PDOs of one axis. dictionary: as the axis sees it: everything here has the numbers of the first axis.

    On a device with several axes, only PDOs that are this axis's alone are remapped.
    """

    def __init__(self, dictionary: ObjectDictionary, node_id: int, axis: int) -> None:
        self._whole = dictionary
        self._node_id = node_id
        self._axis = axis
        self.dictionary = dictionary_of_axis(dictionary, axis)
        self._slots = PdoSlots(self.dictionary, node_id)
        several = len(axes_of(dictionary)) > 1
        self._own = [slot for slot in self._slots.all if not several or self._belongs(slot.pdo)]

    def _belongs(self, pdo: PdoSettings) -> bool:
        """Return whether a PDO of a device with several axes is this axis's alone; see this module's text."""
        carried = {place for key in pdo.muxes if (place := axis_of(key)) is not None}
        return carried == {0} or (not carried and usual_axis_of_pdo(pdo.number) == self._axis)

    def pdos_for(self, mode: Mode) -> list[PdoSettings] | str:
        """Return the PDOs for a mode, or why no RPDO can carry its set-points."""
        rpdos = self._rpdos_for(mode)
        return rpdos if isinstance(rpdos, str) else rpdos + self._tpdos_beside(rpdos)

    def _rpdos_for(self, mode: Mode) -> list[PdoSettings] | str:
        commands = (objects.CONTROLWORD, SET_POINT_OF[mode])
        is_cyclic = mode is not Mode.PROFILE_POSITION
        present = self._slots.existing(Direction.RPDO)
        if is_cyclic:  # one set-point each SYNC; an event-driven RPDO can be sent at each SYNC
            present = [pdo for pdo in present if pdo.transmission_type in (EACH_SYNC, *EVENT_DRIVEN)]
        chosen, missing = choose_pdos(present, commands, ())
        takes_at_sync = all(pdo.transmission_type == EACH_SYNC for pdo in chosen)
        if not missing and (takes_at_sync or not is_cyclic):
            return chosen
        wanted, lacking = self._entries(commands, Direction.RPDO)
        carries_set_point = SET_POINT_OF[mode] in muxes_of(wanted)
        if carries_set_point or (wanted and not is_cyclic and objects.CONTROLWORD in missing):
            settings, obstacles = self._slots.remapped(Direction.RPDO, wanted, self._own, is_synchronous=is_cyclic)
            if settings is not None:
                return [settings]
        else:
            obstacles = [lacking.get(SET_POINT_OF[mode], "")]
        if is_cyclic and SET_POINT_OF[mode] in missing:
            return "; ".join(obstacles) or "it has no RPDO"
        return chosen

    def _tpdos_beside(self, rpdos: list[PdoSettings]) -> list[PdoSettings]:
        """Return the TPDOs that tell something; one gets another mapping if statusword and position are not among them at
        SYNCs."""
        present, _ = choose_pdos(self._slots.existing(Direction.TPDO), (), FEEDBACK)
        at_syncs = [pdo for pdo in present if not self._slots.listens or pdo.transmission_type in CYCLIC_TYPES]
        wanted, _ = self._entries(FEEDBACK, Direction.TPDO)
        missing = set(NEEDED) - carried_by(at_syncs, Direction.TPDO)
        if not missing & muxes_of(wanted):
            return present
        settings, _ = self._slots.remapped(Direction.TPDO, wanted, self._own, is_synchronous=self._slots.listens, beside=rpdos)
        return present if settings is None else [settings, *(pdo for pdo in present if pdo.number != settings.number)]

    def add_feed_forward(self, pdos: list[PdoSettings], mode: Mode) -> list[str]:
        """Add a PDO for what none of these carries, and return notes about what stays without."""
        if mode not in FED:
            return [f"{short_name(mode)} takes no feed-forward"]
        carried = carried_by(pdos, Direction.RPDO)
        wanted, lacking = self._entries([key for key in FED[mode] if key not in carried], Direction.RPDO)
        places = [pdo.place for pdo in pdos]
        free = [slot for slot in self._own if slot.pdo.place not in places]
        more, obstacles = self._slots.remapped(Direction.RPDO, wanted, free, is_synchronous=True, beside=pdos)
        if more is not None and wanted:
            pdos.append(more)
            obstacles = []
        elif wanted and not obstacles:
            obstacles = ["no RPDO is left"]
        return [f"no feed-forward: {why}" for why in (*lacking.values(), *(obstacles if wanted else ()))]

    def _entries(self, keys: Iterable[Mux], direction: Direction) -> tuple[tuple[int, ...], dict[Mux, str]]:
        """Return the mapping entries of objects, as far as one PDO has room for them, and why it cannot carry others."""
        entries = {key: entry_of(self.dictionary, key, direction) for key in keys}
        lacking = {key: why for key, (entry, why) in entries.items() if entry is None}
        return as_fit(entry for entry, _ in entries.values() if entry is not None), lacking

    def plan(
        self,
        pdos: list[PdoSettings],
        mode: Mode,
        reason: str,
        rejected: Sequence[Obstacle],
        notes: Sequence[str],
        *,
        lean: bool,
    ) -> MotionPlan:
        """Return the plan with these PDOs, but for those that a lean one switches off."""
        spare = spare_tpdos(pdos, self._own, WELCOME) if lean else []
        off = [pdo.place for pdo in spare]
        pdos = [pdo for pdo in pdos if pdo.place not in off]
        places = [pdo.place for pdo in pdos]
        described = [slot.pdo for slot in self._slots.all if slot.is_described]
        unwanted = [slot for slot in self._slots.foreign() if slot.pdo.place not in places]
        stuck = [slot.pdo for slot in unwanted if not slot.can_move]
        stays = [f"{pdo.name} has CAN-ID {pdo.can_id_text} of another node, and cannot change it" for pdo in stuck]
        return MotionPlan(
            self._whole,
            self._node_id,
            self._axis,
            mode,
            reason,
            self._of_device(pdos),
            self._of_device(pdo for pdo in pdos if pdo not in described),
            self._of_device(slot.pdo.destroyed for slot in unwanted if slot.can_move),
            self._of_device(pdo.destroyed for pdo in spare),
            tuple(rejected),
            (*stays, *notes),
        )

    def _of_device(self, pdos: Iterable[PdoSettings]) -> tuple[PdoSettings, ...]:
        """Return settings that the axis sees as the device has them."""
        return tuple(replace(pdo, entries=tuple(swapped_entry(each, self._axis) for each in pdo.entries)) for pdo in pdos)


def _title(node_id: int, axis: int) -> str:
    return f"node {node_id}" + (f", axis {axis}" if axis else "")


def _when(transmission_type: int) -> str:
    if transmission_type in EVENT_DRIVEN:
        return "event-driven"
    return "at each SYNC" if transmission_type == EACH_SYNC else f"transmission type {transmission_type}"
