"""The dialogue by which a person commissions a drive: what is shown and asked between the steps of `DriveCommissioning`.

`canopen drive commission` leads through it on a terminal, the page of the web door in a browser: a `Conversation` is either.
Nothing has power while a question waits.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from typing import Protocol

from canopen_data.description import DeviceDescription
from canopen_master.commissioning import SMALL_MOVES, DriveCommissioning
from canopen_master.identity_facts import identity_facts
from canopen_proto.drives.axis.reasons import reasons
from canopen_proto.drives.axis.settings import HomingStyle
from canopen_proto.drives.axis.units import COUNTS, Unit
from canopen_proto.drives.cia402.homing_methods import homing_name
from canopen_proto.drives.cia402.modes import mode_name
from canopen_proto.drives.cia402.states import FAULT_STATES


class Conversation(Protocol):
    """A person who is shown things, and asked. Texts are plain: whoever shows them makes them safe.

    agrees: nobody is asked; each default is taken, and whatever may move does. halted_by: what the person has at hand to halt it.
    """

    agrees: bool
    halted_by: str

    def heading(self, text: str) -> None:
        """Begin a step."""

    def fact(self, name: str, text: str) -> None:
        """Show a fact. name: "" for one that goes on with the one before."""

    def say(self, text: str) -> None:
        """Say something."""

    def remark(self, text: str) -> None:
        """Say something that matters less."""

    def warn(self, text: str, more: str = "") -> None:
        """Say something that needs attention. more: goes on plainly behind it."""

    async def may(self, question: str) -> bool:
        """Return whether something may be done. Anything but yes is no."""

    async def number(self, question: str, default: float | None, unit: str = "", *, above_zero: bool = False) -> float | None:
        """Return a finite number, or `default` for an empty answer. Ask again for what is none, and for one that is not above 0
        if it has to be. unit: shown behind the default."""

    async def choice(self, question: str, choices: Sequence[str], default: str) -> str:
        """Return one of the choices. Ask again for what is none."""


def renamed_text(asked: str, name: str) -> str:
    """Return what a person is told whose joint gets another name than was asked for; see `commissioned_name`."""
    return f"the joint is {name} in the machine file, not {asked}: that name is taken there, or the joint has one"


class CommissioningDialogue:
    """One run. work: the steps, with their results. is_confirmed: the small move went as it should. is_given_up: the person has
    ended it before anything was changed, because the file is another device's.

    talk: with whom. description: of the drive's own file; None: it has none. save: reads what the drive holds, and keeps it;
    returns where it is, and how much that was. no_file: said if it has no file.
    """

    no_file = "no file of it was named (-e FILE.eds): names and PDOs are those of the data files"

    def __init__(
        self,
        talk: Conversation,
        work: DriveCommissioning,
        description: DeviceDescription | None,
        save: Callable[[], Awaitable[tuple[str, str]]],
    ) -> None:
        self.talk, self.work = talk, work
        self.is_confirmed = self.is_given_up = False
        self._description = description
        self._save = save

    async def run(self) -> None:
        """Go through all steps, as far as the answers allow. Raises what the steps raise."""
        if not await self._identity():
            self.is_given_up = True
            return
        await self._way_back()
        await self._state()
        await self._units()
        await self._limits()
        if await self._small_move():
            await self._homing()
            await self._first_move()

    # ---- nothing moves ----

    async def _identity(self) -> bool:
        """Show what it is; return whether to go on."""
        self.talk.heading("1. The drive")
        facts = await identity_facts(self.work.node, self._description)
        for name, (_, text) in facts.items():
            self.talk.fact(name, text)
        await self.work.look()  # an error for what is no drive
        file = facts.get("file")
        if file is None:
            self.talk.warn(self.no_file)
        elif file[0]["matches"] is False and not await self.talk.may("The file is another device's. Go on with it?"):
            return False
        return True

    async def _way_back(self) -> None:
        self.talk.heading("2. A way back")
        name, counts = await self._save()
        self.work.done.append(f"its values, as they were, are in {name}")
        self.talk.say(f"{name}: {counts}; `canopen restore` writes them back")

    async def _state(self) -> None:
        self.talk.heading("3. Its state")
        view = await self.work.look()
        if view.state in FAULT_STATES and await self.talk.may("Reset its fault? Nothing moves."):
            view = await self.work.reset_fault()
        self.talk.fact("state", str(view.state))
        if view.mode is not None:
            self.talk.fact("mode", mode_name(view.mode))
        for each in reasons(view):
            self.talk.fact("", f"{each.what}. Try: {each.remedy}")

    async def _units(self) -> None:
        self.talk.heading("4. Units")
        told = await self.work.read_units()
        for conflict in told.conflicts:
            self.talk.warn("the drive contradicts itself:", conflict)
        if self.work.axis.settings.homing is HomingStyle.SCHUNK and told.per_turn is None:
            self.talk.remark("Schunk's joints count millidegrees")
        settings = self.work.settings
        known = [unit for unit in (Unit.DEGREE, Unit.MILLIMETRE) if told.counts_per(unit)]
        default = settings.unit or (known[0] if known else COUNTS)
        word = await self.talk.choice("Its positions are to be in", [COUNTS, *(each.value for each in Unit)], default)
        unit, scale = None, None
        if word != COUNTS:
            unit = Unit(word)
            before = settings.counts_per_unit if settings.unit is unit else None
            scale = await self.talk.number(f"Counts in one {word}", before or told.counts_per(unit), above_zero=True)
            if scale is None:
                self.talk.warn("the drive does not tell it, and its manual does: counts until then")
                unit = None
        self.work.set_unit(unit, scale)

    async def _limits(self) -> None:
        self.talk.heading("5. Limits")
        limits, position = await self.work.read_limits()
        unit = self.work.unit_name
        self.talk.fact("position", f"{position:.10g} {unit}")
        for name, limit in (("lowest", limits.lowest), ("highest", limits.highest), ("fastest", limits.speed)):
            per = " per second" if name == "fastest" else ""
            self.talk.fact(name, "none" if limit is None else f"{limit.value:.10g} {unit}{per}: {limit.source}")
        settings = self.work.settings
        while True:
            lowest = await self.talk.number("Lowest position", settings.min_position, unit)
            highest = await self.talk.number("Highest position", settings.max_position, unit)
            if lowest is None or highest is None or lowest < highest:
                break
            self.talk.warn("the lowest has to be below the highest")
        speed = await self.talk.number("Greatest speed", limits.speed.value, f"{unit} per second", above_zero=True)
        if (lowest is not None and position < lowest) or (highest is not None and position > highest):
            self.talk.warn("it stands beyond these limits: it may only come back, until it is homed")
        self.work.set_limits(lowest, highest, speed)

    # ---- it moves ----

    async def _small_move(self) -> bool:
        """Move a little way; return whether it went as it should."""
        self.talk.heading("6. A small move")
        self.talk.say(f"Clear the workspace. Put a hand on the emergency stop. {self.talk.halted_by} halts it, too.")
        work, unit = self.work, self.work.unit_name
        while True:
            usual = SMALL_MOVES[work.settings.unit]
            way = await self.talk.number("How far, from where it stands", usual, unit) or usual
            told = await work.speed_text(work.small_speed(way))
            if not await self.talk.may(f"It moves by {way:.6g} {unit}, {told}. Move it?"):
                self.talk.say("It was not moved, so nothing else will be.")
                return False
            before, after = await work.small_move(way)
            self.talk.fact("moved", f"from {before:.10g} to {after:.10g} {unit}")
            meant = f"by {way:.6g} {unit}, the way that you call {'positive' if way > 0 else 'negative'}"
            answer = await self.talk.choice(f"Did it go {meant}? r: the other way round", ("y", "r", "n"), self._agreed("n"))
            if answer != "r":
                break
            work.reverse()
            self.talk.say("Its direction is reversed now. Once more:")
        self.is_confirmed = answer == "y"
        if not self.is_confirmed:
            self.talk.say("Its scale is wrong then: mend it in step 4 first. Nothing else is moved.")
        return self.is_confirmed

    def _agreed(self, default: str) -> str:
        return "y" if self.talk.agrees else default

    async def _homing(self) -> None:
        self.talk.heading("7. Homing")
        if self.work.axis.settings.homing is HomingStyle.SCHUNK:
            what = "It homes as Schunk's joints do, without a method"
        else:
            method = await self._method()
            if method is None:
                self.talk.say("It was not homed.")
                return
            self.work.set_homing_method(method)
            what = f"It homes by method {method}: {homing_name(method)}"
        if not await self.talk.may(f"{what}. Home it?"):
            self.talk.say("It was not homed.")
            return
        position = await self.work.home()
        self.talk.fact("homed", f"it stands at {position:.10g} {self.work.unit_name}")

    async def _method(self) -> int | None:
        listed, present = await self.work.read_homing_methods()
        for method in listed or ():
            self.talk.fact(str(method), homing_name(method))
        if listed is None:
            self.talk.remark("the drive does not list its methods: its manual does; 35 takes the place where it stands")
        own = f"; the drive has {present}" if present else ""
        chosen = self.work.settings.homing_method
        while True:
            default = None if chosen is None else float(chosen)
            answer = await self.talk.number(f"Homing method (none: do not home{own})", default)
            if answer is None or (answer.is_integer() and -128 <= answer <= 127):
                return None if answer is None else int(answer)
            self.talk.warn("a method is a whole number from -128 to 127")

    async def _first_move(self) -> None:
        self.talk.heading("8. The first move")
        work, unit = self.work, self.work.unit_name
        target = await self.talk.number("To which position (none: do not move)", None, unit)
        if target is None:
            return
        usual = work.usual_speed()
        speed = await self.talk.number("How fast", usual, f"{unit} per second", above_zero=True) or usual
        if await self.talk.may(f"It moves to {target:.6g} {unit}, {await work.speed_text(speed)}. Move it?"):
            position = await work.move_to(target, speed)
            self.talk.fact("moved", f"to {position:.10g} {unit}")
