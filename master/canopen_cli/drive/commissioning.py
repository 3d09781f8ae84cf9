"""The dialogue of `canopen drive commission NODE`: what is shown and asked between the steps of `DriveCommissioning`.

Nothing has power while a question waits.
"""

from __future__ import annotations

from canopen_cli.node.backup import bit_rate_of, write_dcf
from canopen_cli.node.backup_reading import counts_text, read_all, tell_unread
from canopen_cli.node.info import identity_facts
from canopen_cli.shared.options import Settings
from canopen_cli.shared.problem import CommandError, ExitCode
from canopen_cli.shared.questions import Questions
from canopen_cli.shared.screen import Screen, escape
from canopen_cli.shared.session import BusSession
from canopen_master.commissioning import SMALL_MOVES, DriveCommissioning
from canopen_proto.drives.axis.reasons import reasons
from canopen_proto.drives.axis.settings import AxisSettings, HomingStyle
from canopen_proto.drives.axis.units import COUNTS, Unit
from canopen_proto.drives.cia402.homing_methods import homing_name
from canopen_proto.drives.cia402.modes import mode_name
from canopen_proto.drives.cia402.states import FAULT_STATES


class CommissioningDialogue:
    """One run. work: the steps, with their results. is_confirmed: the small move went as it should."""

    def __init__(
        self, settings: Settings, screen: Screen, questions: Questions, session: BusSession, node_id: int, done: list[str]
    ) -> None:
        self.settings, self.screen, self.questions = settings, screen, questions
        self.session = session
        self.node = session.node(node_id)
        joint = session.files.settings.joint(node_id)
        self.work = DriveCommissioning(session.master, self.node, AxisSettings() if joint is None else joint.settings, done)
        self.is_confirmed = False

    async def run(self, dcf: str) -> None:
        """Go through all steps, as far as the answers allow. dcf: the file for the drive as it is delivered."""
        await self._identity()
        await self._way_back(dcf)
        await self._state()
        await self._units()
        await self._limits()
        if await self._small_move():
            await self._homing()
            await self._first_move()

    def _heading(self, text: str) -> None:
        self.screen.say(f"\n[bold]{escape(text)}[/]")

    # ---- nothing moves ----

    async def _identity(self) -> None:
        self._heading("1. The drive")
        facts = await identity_facts(self.session, self.node)
        for name, (_, text) in facts.items():
            self.screen.fact(name, text)
        await self.work.look()  # an error for what is no drive
        file = facts.get("file")
        if file is None:
            self.screen.say("[yellow]no file of it was named (-e FILE.eds): names and PDOs are those of the data files[/]")
        elif file[0]["matches"] is False and not await self.questions.may("The file is another device's. Go on with it?"):
            raise CommandError(
                ExitCode.INTERRUPTED, "CO132", "by you: nothing was changed", tries=("-e with the drive's own file",)
            )

    async def _way_back(self, dcf: str) -> None:
        self._heading("2. A way back")
        found = await read_all(self.session, self.screen, self.node.node_id, None, False)
        description = self.session.description_of(self.node.node_id)
        tell_unread(self.screen, found, write_dcf(dcf, found, description, bit_rate_of(self.settings)))
        self.work.done.append(f"its values, as they were, are in {dcf}")
        self.screen.say(f"{escape(dcf)}: {counts_text(found)}; `canopen restore` writes them back")

    async def _state(self) -> None:
        self._heading("3. Its state")
        view = await self.work.look()
        if view.state in FAULT_STATES and await self.questions.may("Reset its fault? Nothing moves."):
            view = await self.work.reset_fault()
        self.screen.fact("state", str(view.state))
        if view.mode is not None:
            self.screen.fact("mode", mode_name(view.mode))
        for each in reasons(view):
            self.screen.fact("", f"{each.what}. Try: {each.remedy}")

    async def _units(self) -> None:
        self._heading("4. Units")
        told = await self.work.read_units()
        for conflict in told.conflicts:
            self.screen.say(f"[yellow]the drive contradicts itself:[/] {escape(conflict)}")
        if self.work.axis.settings.homing is HomingStyle.SCHUNK and told.per_turn is None:
            self.screen.say("[dim]Schunk's joints count millidegrees[/]")
        settings = self.work.settings
        known = [unit for unit in (Unit.DEGREE, Unit.MILLIMETRE) if told.counts_per(unit)]
        default = settings.unit or (known[0] if known else COUNTS)
        word = await self.questions.choice("Its positions are to be in", [COUNTS, *(each.value for each in Unit)], default)
        unit, scale = None, None
        if word != COUNTS:
            unit = Unit(word)
            before = settings.counts_per_unit if settings.unit is unit else None
            scale = await self.questions.number(f"Counts in one {word}", before or told.counts_per(unit), above_zero=True)
            if scale is None:
                self.screen.say("[yellow]the drive does not tell it, and its manual does: counts until then[/]")
                unit = None
        self.work.set_unit(unit, scale)

    async def _limits(self) -> None:
        self._heading("5. Limits")
        limits, position = await self.work.read_limits()
        unit = self.work.unit_name
        self.screen.fact("position", f"{position:.10g} {unit}")
        for name, limit in (("lowest", limits.lowest), ("highest", limits.highest), ("fastest", limits.speed)):
            per = " per second" if name == "fastest" else ""
            self.screen.fact(name, "none" if limit is None else f"{limit.value:.10g} {unit}{per}: {limit.source}")
        settings = self.work.settings
        while True:
            lowest = await self.questions.number("Lowest position", settings.min_position, unit)
            highest = await self.questions.number("Highest position", settings.max_position, unit)
            if lowest is None or highest is None or lowest < highest:
                break
            self.screen.say("[yellow]the lowest has to be below the highest[/]")
        speed = await self.questions.number("Greatest speed", limits.speed.value, f"{unit} per second", above_zero=True)
        if (lowest is not None and position < lowest) or (highest is not None and position > highest):
            self.screen.say("[yellow]it stands beyond these limits: it may only come back, until it is homed[/]")
        self.work.set_limits(lowest, highest, speed)

    # ---- it moves ----

    async def _small_move(self) -> bool:
        """Move a little way; return whether it went as it should."""
        self._heading("6. A small move")
        self.screen.say("Clear the workspace. Put a hand on the emergency stop. Ctrl-C halts it, too.")
        work, unit = self.work, self.work.unit_name
        while True:
            usual = SMALL_MOVES[work.settings.unit]
            way = await self.questions.number("How far, from where it stands", usual, unit) or usual
            told = await work.speed_text(work.small_speed(way))
            if not await self.questions.may(f"It moves by {way:.6g} {unit}, {told}. Move it?"):
                self.screen.say("It was not moved, so nothing else will be.")
                return False
            before, after = await work.small_move(way)
            self.screen.fact("moved", f"from {before:.10g} to {after:.10g} {unit}")
            meant = f"by {way:.6g} {unit}, the way that you call {'positive' if way > 0 else 'negative'}"
            answer = await self.questions.choice(f"Did it go {meant}? r: the other way round", ("y", "r", "n"), self._agreed("n"))
            if answer != "r":
                break
            work.reverse()
            self.screen.say("Its direction is reversed now. Once more:")
        self.is_confirmed = answer == "y"
        if not self.is_confirmed:
            self.screen.say("Its scale is wrong then: mend it in step 4 first. Nothing else is moved.")
        return self.is_confirmed

    def _agreed(self, default: str) -> str:
        return "y" if self.questions.agrees else default

    async def _homing(self) -> None:
        self._heading("7. Homing")
        if self.work.axis.settings.homing is HomingStyle.SCHUNK:
            what = "It homes as Schunk's joints do, without a method"
        else:
            method = await self._method()
            if method is None:
                self.screen.say("It was not homed.")
                return
            self.work.set_homing_method(method)
            what = f"It homes by method {method}: {homing_name(method)}"
        if not await self.questions.may(f"{what}. Home it?"):
            self.screen.say("It was not homed.")
            return
        position = await self.work.home()
        self.screen.fact("homed", f"it stands at {position:.10g} {self.work.unit_name}")

    async def _method(self) -> int | None:
        listed, present = await self.work.read_homing_methods()
        for method in listed or ():
            self.screen.fact(str(method), homing_name(method))
        if listed is None:
            self.screen.say("[dim]the drive does not list its methods: its manual does; 35 takes the place where it stands[/]")
        own = f"; the drive has {present}" if present else ""
        chosen = self.work.settings.homing_method
        while True:
            default = None if chosen is None else float(chosen)
            answer = await self.questions.number(f"Homing method (none: do not home{own})", default)
            if answer is None or (answer.is_integer() and -128 <= answer <= 127):
                return None if answer is None else int(answer)
            self.screen.say("[yellow]a method is a whole number from -128 to 127[/]")

    async def _first_move(self) -> None:
        self._heading("8. The first move")
        work, unit = self.work, self.work.unit_name
        target = await self.questions.number("To which position (none: do not move)", None, unit)
        if target is None:
            return
        usual = work.usual_speed()
        speed = await self.questions.number("How fast", usual, f"{unit} per second", above_zero=True) or usual
        if await self.questions.may(f"It moves to {target:.6g} {unit}, {await work.speed_text(speed)}. Move it?"):
            position = await work.move_to(target, speed)
            self.screen.fact("moved", f"to {position:.10g} {unit}")
