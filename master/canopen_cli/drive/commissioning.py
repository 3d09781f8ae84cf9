"""The work of `canopen drive NODE commission`: from the box to the first move, in the order of docs/first-move.md.

Nothing has power while a question waits: each motion gives power, moves, and takes the power away. The profile velocity (0x6081)
of these motions is slow; the drive's own value is written back behind each.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, TypeVar

from canopen_cli.drive.session import COUNTS, ends_unpowered, look_at_drive
from canopen_cli.node.backup import bit_rate_of, write_dcf
from canopen_cli.node.backup_reading import counts_text, read_all, tell_unread
from canopen_cli.node.info import identity_facts
from canopen_cli.shared.options import Settings
from canopen_cli.shared.problem import ExitCode, Problem
from canopen_cli.shared.questions import Questions
from canopen_cli.shared.screen import Screen, escape
from canopen_cli.shared.session import Session
from canopen_master.motion.device import Device
from canopen_master.motion.joint_procedures import awake
from canopen_proto.drives import axis as procedures
from canopen_proto.drives.axis.axis import Axis
from canopen_proto.drives.axis.identity import identify, learn_units
from canopen_proto.drives.axis.limits import read_limits
from canopen_proto.drives.axis.reasons import reasons
from canopen_proto.drives.axis.settings import AxisSettings, HomingStyle
from canopen_proto.drives.axis.units import Unit
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.homing_methods import homing_name
from canopen_proto.drives.cia402.modes import Mode, mode_name
from canopen_proto.drives.cia402.states import FAULT_STATES
from canopen_proto.machine import SECOND
from canopen_proto.procedures.objects import read_if_present, write
from canopen_proto.procedures.steps import Cancelled, Procedure, ProcedureError

T = TypeVar("T")

LONGEST: Final = 300 * SECOND
"""For one of these moves, which are slow."""
SMALL_MOVE_TIME: Final = 2.0
"""Seconds that the small move takes at its speed: long enough to see which way it goes, and to stop it."""
SMALL_MOVES: Final = {Unit.DEGREE: 5.0, Unit.RADIAN: 0.1, Unit.TURN: 0.02, Unit.MILLIMETRE: 2.0, None: 1000.0}
"""The small move by default: far enough to be seen, and hardly enough to hit something. For counts it is anybody's guess."""


@dataclass
class Result:
    """What was done. settings: of the joint, as they go into the machine file. dcf: the file that was written."""

    settings: AxisSettings
    has_moved: bool = False
    is_confirmed: bool = False
    is_homed: bool = False
    dcf: str = ""


class Commissioning:
    """One run. done: what was done so far, for people."""

    def __init__(
        self, settings: Settings, screen: Screen, questions: Questions, session: Session, node_id: int, done: list[str]
    ) -> None:
        self.settings, self.screen, self.questions = settings, screen, questions
        self.session = session
        self.node = session.node(node_id)
        joint = session.files.settings.joint(node_id)
        self.result = Result(AxisSettings() if joint is None else joint.settings)
        self.done = done
        self._device: Device | None = None
        self._unit: Unit | None = None

    @property
    def _axis(self) -> Axis:
        assert self._device is not None
        return self._device.axis

    @property
    def _name(self) -> str:
        return COUNTS if self._unit is None else f"{self._unit.value}s"

    async def run(self, dcf: str) -> Result:
        """Go through all steps, as far as the answers allow. dcf: the file for the drive as it is delivered."""
        await self._identity()
        await self._way_back(dcf)
        await self._state()
        await self._units()
        await self._limits()
        if await self._small_move():
            await self._homing()
            await self._first_move()
        return self.result

    def _heading(self, text: str) -> None:
        self.screen.say(f"\n[bold]{escape(text)}[/]")

    async def _procedure(self, procedure: Procedure[T]) -> T:
        return await self.session.master.run(procedure)

    def _set(self, **changes: object) -> None:
        """Change the settings of the joint, now and for the machine file."""
        self.result.settings = replace(self.result.settings, **changes)  # type: ignore[arg-type]
        self._axis.settings = replace(self._axis.settings, **changes)  # type: ignore[arg-type]

    # ---- nothing moves ----

    async def _identity(self) -> None:
        self._heading("1. The drive")
        facts = await identity_facts(self.session, self.node)
        for name, (_, text) in facts.items():
            self.screen.fact(name, text)
        await self._procedure(look_at_drive(self.node.remote))  # a Problem for what is no drive
        file = facts.get("file")
        if file is None:
            self.screen.say("[yellow]no file of it was named (-e FILE.eds): names and PDOs are those of the data files[/]")
        elif file[0]["matches"] is False and not await self.questions.may("The file is another device's. Go on with it?"):
            raise Problem(ExitCode.INTERRUPTED, "CO132", "by you: nothing was changed", tries=("-e with the drive's own file",))

    async def _way_back(self, dcf: str) -> None:
        self._heading("2. A way back")
        found = await read_all(self.session, self.screen, self.node.node_id, None, False)
        description = self.session.description_of(self.node.node_id)
        tell_unread(self.screen, found, write_dcf(dcf, found, description, bit_rate_of(self.settings)))
        self.result.dcf = dcf
        self.done.append(f"its values, as they were, are in {dcf}")
        self.screen.say(f"{escape(dcf)}: {counts_text(found)}; `canopen restore` writes them back")

    async def _state(self) -> None:
        self._heading("3. Its state")
        # Its scale is asked for below, so that it is not refused for lack of one
        given = replace(self.result.settings, counts_per_unit=self.result.settings.counts_per_unit or 1.0)
        self._device = self.session.master.device(self.node, settings=given)
        view = await self._procedure(look_at_drive(self.node.remote, self.result.settings))
        if view.state in FAULT_STATES and await self.questions.may("Reset its fault? Nothing moves."):
            await self._procedure(awake(self.node))
            await self._procedure(procedures.reset_fault(self._axis))
            self.done.append("its fault was reset")
            view = await self._procedure(look_at_drive(self.node.remote, self.result.settings))
        self.screen.fact("state", str(view.state))
        if view.mode is not None:
            self.screen.fact("mode", mode_name(view.mode))
        for each in reasons(view):
            self.screen.fact("", f"{each.what}. Try: {each.remedy}")

    async def _units(self) -> None:
        self._heading("4. Units")
        await self._procedure(awake(self.node))
        await self._procedure(identify(self._axis))
        told = await self._procedure(learn_units(self._axis))
        for conflict in told.conflicts:
            self.screen.say(f"[yellow]the drive contradicts itself:[/] {escape(conflict)}")
        if self._axis.settings.homing is HomingStyle.SCHUNK and told.per_turn is None:
            self.screen.say("[dim]Schunk's joints count millidegrees[/]")
        known = [unit for unit in (Unit.DEGREE, Unit.MILLIMETRE) if told.counts_per(unit)]
        default = self.result.settings.unit or (known[0] if known else COUNTS)
        word = await self.questions.choice("Its positions are to be in", [COUNTS, *(each.value for each in Unit)], default)
        scale: float | None = 1.0
        if word != COUNTS:
            unit = Unit(word)
            before = self.result.settings.counts_per_unit if self.result.settings.unit is unit else None
            scale = await self.questions.number(f"Counts in one {word}", before or told.counts_per(unit), above_zero=True)
            if scale is None:
                self.screen.say("[yellow]the drive does not tell it, and its manual does: counts until then[/]")
            else:
                self._unit = unit
        self._set(unit=self._unit, counts_per_unit=scale or 1.0)
        self.done.append(f"its positions are in {self._name}, {scale or 1.0:.10g} counts each")

    async def _limits(self) -> None:
        self._heading("5. Limits")
        limits = await self._procedure(read_limits(self._axis, Mode.PROFILE_POSITION))
        position = await self._procedure(procedures.read_position(self._axis))
        self.screen.fact("position", f"{position:.10g} {self._name}")
        for name, limit in (("lowest", limits.lowest), ("highest", limits.highest), ("fastest", limits.speed)):
            per = " per second" if name == "fastest" else ""
            self.screen.fact(name, "none" if limit is None else f"{limit.value:.10g} {self._name}{per}: {limit.source}")
        settings = self.result.settings
        while True:
            lowest = await self.questions.number("Lowest position", settings.min_position, self._name)
            highest = await self.questions.number("Highest position", settings.max_position, self._name)
            if lowest is None or highest is None or lowest < highest:
                break
            self.screen.say("[yellow]the lowest has to be below the highest[/]")
        speed = await self.questions.number("Greatest speed", limits.speed.value, f"{self._name} per second", above_zero=True)
        self._set(min_position=lowest, max_position=highest, max_speed=speed)
        if (lowest is not None and position < lowest) or (highest is not None and position > highest):
            self.screen.say("[yellow]it stands beyond these limits: it may only come back, until it is homed[/]")
        self.done.append("its limits are asked for")

    # ---- it moves ----

    async def _motion(self, name: str, procedure: Procedure[None], speed: float | None = None) -> float:
        """Run a procedure that moves the drive, and take its power away. Return where it stands then. speed: of its profile."""
        self.done.append(f"{name} was begun")
        motion = ends_unpowered(self._axis, procedure)
        await self._procedure(motion if speed is None else self._slowly(speed, motion))
        position = await self._procedure(procedures.read_position(self._axis))
        self.done[-1] = f"{name}: done, and it stands at {position:.6g} {self._name}"
        return position

    async def _small_move(self) -> bool:
        """Move a little way; return whether it went as it should."""
        self._heading("6. A small move")
        self.screen.say("Clear the workspace. Put a hand on the emergency stop. Ctrl-C halts it, too.")
        most = self.result.settings.max_speed
        assert most is not None  # asked for
        while True:
            usual = SMALL_MOVES[self._unit]
            way = await self.questions.number("How far, from where it stands", usual, self._name) or usual
            speed = min(abs(way) / SMALL_MOVE_TIME, most)
            told = await self._procedure(self._profile_speed(speed))
            if not await self.questions.may(f"It moves by {way:.6g} {self._name}, {told}. Move it?"):
                self.screen.say("It was not moved, so nothing else will be.")
                return False
            before = await self._procedure(procedures.read_position(self._axis))
            after = await self._motion("the small move", self._move(way, relative=True), speed)
            self.result.has_moved = True
            self.screen.fact("moved", f"from {before:.10g} to {after:.10g} {self._name}")
            meant = f"by {way:.6g} {self._name}, the way that you call {'positive' if way > 0 else 'negative'}"
            answer = await self.questions.choice(f"Did it go {meant}? r: the other way round", ("y", "r", "n"), self._agreed("n"))
            if answer != "r":
                break
            self._set(direction=-self.result.settings.direction)
            self.screen.say("Its direction is reversed now. Once more:")
        self.result.is_confirmed = answer == "y"
        if not self.result.is_confirmed:
            self.screen.say("Its scale is wrong then: mend it in step 4 first. Nothing else is moved.")
        return self.result.is_confirmed

    def _agreed(self, default: str) -> str:
        return "y" if self.questions.agrees else default

    async def _homing(self) -> None:
        self._heading("7. Homing")
        axis = self._axis
        if axis.settings.homing is HomingStyle.SCHUNK:
            what = "It homes as Schunk's joints do, without a method"
        else:
            method = await self._method()
            if method is None:
                self.screen.say("It was not homed.")
                return
            self._set(homing_method=method)
            what = f"It homes by method {method}: {homing_name(method)}"
        if not await self.questions.may(f"{what}. Home it?"):
            self.screen.say("It was not homed.")
            return
        position = await self._motion("homing", procedures.home(axis))
        self.result.is_homed = True
        self.screen.fact("homed", f"it stands at {position:.10g} {self._name}")

    async def _method(self) -> int | None:
        listed = await self._procedure(procedures.read_homing_methods(self.node.remote))
        present = await self._procedure(read_if_present(self.node.remote, objects.HOMING_METHOD))
        for method in listed or ():
            self.screen.fact(str(method), homing_name(method))
        if listed is None:
            self.screen.say("[dim]the drive does not list its methods: its manual does; 35 takes the place where it stands[/]")
        own = f"; the drive has {present}" if isinstance(present, int) and present else ""
        while True:
            settings = self.result.settings
            default = None if settings.homing_method is None else float(settings.homing_method)
            answer = await self.questions.number(f"Homing method (none: do not home{own})", default)
            if answer is None or (answer.is_integer() and -128 <= answer <= 127):
                return None if answer is None else int(answer)
            self.screen.say("[yellow]a method is a whole number from -128 to 127[/]")

    async def _first_move(self) -> None:
        self._heading("8. The first move")
        most = self.result.settings.max_speed
        assert most is not None  # asked for
        target = await self.questions.number("To which position (none: do not move)", None, self._name)
        if target is None:
            return
        usual = min(SMALL_MOVES[self._unit], most)
        speed = await self.questions.number("How fast", usual, f"{self._name} per second", above_zero=True) or usual
        told = await self._procedure(self._profile_speed(min(speed, most)))
        if await self.questions.may(f"It moves to {target:.6g} {self._name}, {told}. Move it?"):
            position = await self._motion("the first move", self._move(target, relative=False), min(speed, most))
            self.screen.fact("moved", f"to {position:.10g} {self._name}")

    def _move(self, position: float, *, relative: bool) -> Procedure[None]:
        return procedures.move_to(self._axis, position, timeout=LONGEST, relative=relative)

    def _profile_speed(self, speed: float) -> Procedure[str]:
        """Return in words how fast a move is going to be, wherever that is known."""
        if self._axis.scale.velocity_unit is not None:
            return f"at {speed:.6g} {self._name} per second"
        own = yield from read_if_present(self.node.remote, objects.PROFILE_VELOCITY)
        return f"at its own profile velocity (0x6081 = {own}), whose unit it does not tell"

    def _slowly(self, speed: float, procedure: Procedure[None]) -> Procedure[None]:
        """Run a procedure with a profile velocity (0x6081), and write the drive's own back. Where its unit is not known, that
        stays."""
        axis, node = self._axis, self.node.remote
        own = yield from read_if_present(node, objects.PROFILE_VELOCITY)
        if axis.scale.velocity_unit is None or not isinstance(own, int):
            yield from procedure
            return
        yield from write(node, objects.PROFILE_VELOCITY, max(1, axis.scale.speed_to_wire(speed)))
        try:
            yield from procedure
        except (Cancelled, Exception) as cause:
            try:
                yield from write(node, objects.PROFILE_VELOCITY, own)
            except ProcedureError as error:
                if not isinstance(cause, Cancelled):
                    cause.add_note(f"and its profile velocity (0x6081) was {own} before, and is slow now: {error}")
            raise
        yield from write(node, objects.PROFILE_VELOCITY, own)
