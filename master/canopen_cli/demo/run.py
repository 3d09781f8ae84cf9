"""The work of `canopen demo`: boot, home, move, shut down; and what it tells about that.

The drives are those of a chain file. Without a bus, each bus name in that file becomes a virtual bus with simulated drives at the
node-IDs of the file; with a bus, all names mean that one. The rest is the same code: a simulated drive is a device on a CAN bus
like any other.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec
from typing import Any, Final

import trio

from canopen_cli.demo.path import Path
from canopen_cli.demo.plan import CHAINS, Plan
from canopen_cli.motion.view import DemoView, JointView
from canopen_cli.plot.recording import JointTrack, Recording
from canopen_cli.shared.failures import problem_of
from canopen_cli.shared.problem import ExitCode, usage
from canopen_cli.shared.running import all_stand
from canopen_cli.shared.screen import Screen, counted, escape
from canopen_master.errors import CHAIN_FAULT, ChainFileError
from canopen_master.master import SDO_TIMEOUT, Master
from canopen_master.motion.chain import Chain, ChainSettings, ChainState
from canopen_master.motion.chain_file import same_nodes
from canopen_master.motion.device import Device
from canopen_master.motion.halting import Halt
from canopen_master.participant.patient_clock import PatientClock
from canopen_master.session import open_master
from canopen_master.simulation.fleet import Fleet, drive_maker, simulated_fleet
from canopen_master.simulation.host import DeviceMaker, patient_cycles
from canopen_proto.drives.axis.limits import Limit
from canopen_proto.drives.axis.units import Unit
from canopen_proto.drives.cia402.modes import Mode, mode_name
from canopen_proto.machine import MILLISECOND, SECOND, Time
from canopen_proto.pdo.consumer import PdoReceived

REFRESH: Final = 0.08
"""Seconds between two redraws on a terminal."""
HARDWARE_DELAY: Final = 3
"""Seconds before real drives begin to move: time to take one's hands away, or to press Ctrl-C."""

SETTLING_TIME: Final = 0.1
"""Seconds during which the last set-point is held."""
MAX_LATE_SHARE: Final = 0.05
"""The greatest share of late periods. A computer with other work loses single ones, well below this. Beyond it the joints stand
still in every twentieth period, and the motion takes that much longer: the cycle is too short for this computer."""
LATE_SHARE: Final = 0.5
"""Of the speed at which a single late SYNC makes a joint lose all of its permitted following error."""
_RADIANS: Final = {Unit.RADIAN: 1.0, Unit.DEGREE: math.pi / 180, Unit.TURN: 2 * math.pi}
PLANNED_SHARE: Final = 0.5
"""Of the swing, for the planned motion."""
PLANNED_FROM: Final = 1.0
"""Seconds: a shorter demonstration has no planned motion."""
PLANNED_TIME: Final = 10.0
"""Seconds that the planned motion may take. A path waits for a late computer, so a busy one could take minutes."""
DEMO_FAULT: Final = 0x2310
"""Continuous over-current: the error code of a joint that hits something."""
NEXT: Final = """Try next:
  [bold]canopen scan -b demo[/]                  who is on the bus
  [bold]canopen read 3 statusword -b demo[/]     an object of a drive
  [bold]canopen demo --plot arm.png[/]           a picture of this
  [bold]canopen demo --fault 5@2.0[/]            what a breakdown looks like"""
NEXT_OF_OTHERS: Final = """Try next:
  the same with [bold]--plot arm.png[/]          a picture of this
  the same with [bold]--fault {node}@{time:g}[/]         what a breakdown looks like"""
"""For an arm of the user's: `-b demo` is another one."""


@dataclass
class JointResult:
    """The last line about one joint. error: degrees."""

    name: str
    node_id: int
    state: str
    homed: bool
    error: float
    round_trips: int

    def row(self) -> tuple[str, ...]:
        """Return the cells for the table."""
        homed = "[green]yes[/]" if self.homed else "[red]no[/]"
        node, error = f"{self.node_id} (0x{self.node_id:02X})", f"{self.error:.3f}°"
        return escape(self.name), node, escape(self.state), homed, error, str(self.round_trips)


COLUMNS: Final = "joint", "node", "state", "homed", "largest\nfollowing\nerror", "SDO\nround\ntrips"
CYCLE_COLUMNS: Final = "SYNC cycles", "missed", "skipped", "late"


@dataclass
class CycleCounts:
    """How well the cycle was kept. sent: SYNCs; missed: SYNCs without a new set-point; skipped: periods without a SYNC."""

    sent: int = 0
    missed: int = 0
    skipped: int = 0

    @property
    def late_share(self) -> float:
        """The share of all periods in which the path stood still, because this computer was late."""
        return (self.missed + self.skipped) / max(1, self.sent + self.skipped)

    @property
    def was_kept(self) -> bool:
        """Whether the share of late cycles is that of an ordinary computer, or less."""
        return self.late_share <= MAX_LATE_SHARE

    def row(self) -> tuple[str, ...]:
        """Return the cells for the table."""
        return str(self.sent), str(self.missed), str(self.skipped), _percent(self.late_share)


class Demonstration:
    """One run. recording: commanded and actual positions; it is filled while the joints move. stood_still: seconds for which the
    simulated world waited for this computer."""

    def __init__(
        self, screen: Screen, plan: Plan, record: Callable[[Chain], contextlib.AbstractAsyncContextManager[object]]
    ) -> None:
        """record: records what the chain does while its block runs."""
        self._record_chain = record
        self.screen = screen
        self.plan = plan
        self.recording = Recording([])
        self.results: list[JointResult] = []
        self.cycles = CycleCounts()
        self.stood_still = 0.0
        self.description = plan.chosen_chain()
        self._check_fault()
        self._stage = "the drives were booting, and nothing had moved"
        self._has_begun = False  # to move
        self._was_busy = False  # this computer was, with other work
        self._fleet: Fleet | None = None
        self._devices: tuple[Device, ...] = ()
        self._arm: Chain | None = None  # once it follows set-points
        self._halts: Sequence[Halt] = ()
        self._latest: list[tuple[float, float]] = []  # of each joint: actual and commanded position

    def _check_fault(self) -> None:
        nodes = [joint.node_id for joint in self.description.joints]
        if self.plan.fault is not None and self.plan.fault[0] not in nodes:
            raise usage(
                "CO123",
                f"--fault: {self.description.name} has no node {self.plan.fault[0]}",
                seen=f"its nodes are {', '.join(map(str, nodes))}",
                tries=(f"--fault {nodes[0]}@{self.plan.fault[1]:g}",),
            )

    # ---- the run ----

    async def run(self) -> None:
        """Run the whole demonstration. Raises a Problem if it fails; then every drive that still listens was halted."""
        locators = self.plan.locators(self.description)
        try:
            async with contextlib.AsyncExitStack() as stack:
                if self.plan.bus is None:
                    joints = [(locators[joint.bus], joint.node_id) for joint in self.description.joints]
                    self._fleet = await stack.enter_async_context(simulated_fleet(joints, make=self._maker))
                master = await stack.enter_async_context(self._open_master(locators))
                await self._demonstrate(self._chain(master, locators))
                clock = trio.lowlevel.current_clock()
                if isinstance(clock, PatientClock):
                    self.stood_still = clock.lost
                    self._was_busy = clock.lost > MAX_LATE_SHARE * (trio.current_time() + clock.lost)
        except Exception as error:
            if _nobody_reads(error):
                raise BrokenPipeError from error
            problem = problem_of(error)
            problem.also += self.story()
            if problem.code == CHAIN_FAULT:
                problem.tries = self._after_fault(problem.node)
            raise problem from error

    def _maker(self, number: int, node_id: int) -> DeviceMaker:
        """Return the maker of a simulated drive."""
        file = self.plan.file_of(self.description.joints[number])
        return drive_maker(number, node_id) if file is None else drive_maker(number, node_id, file.shape, file.dictionary)

    def _after_fault(self, node_id: int | None) -> tuple[str, ...]:
        if self.plan.bus is None:
            return ("canopen demo    (the same without the fault)",)
        bus = f" -b {self.plan.bus}" if self.plan.machine is None else ""  # else with -m, which is added to all advice
        return f"canopen info {node_id}{bus}    (what the drive remembers)", f"canopen home {node_id} --reset-fault{bus}"

    def _open_master(self, locators: dict[str, str]) -> contextlib.AbstractAsyncContextManager[Master]:
        timeout = SDO_TIMEOUT if self.plan.timeout is None else self.plan.timeout / SECOND
        heartbeat = 0 if self.plan.machine is None else self.plan.machine.master.heartbeat_timeout
        buses = dict.fromkeys(locators.values())
        return open_master(*buses, sdo_timeout=timeout, heartbeat_timeout=heartbeat / SECOND, watchdog=self.plan.watchdog)

    def _chain(self, master: Master, locators: dict[str, str]) -> Chain:
        joints = tuple(replace(joint, bus=locators[joint.bus]) for joint in self.description.joints)
        description = replace(self.description, joints=joints)
        doubles = same_nodes([description])
        if doubles:
            raise ChainFileError(description.source, doubles)
        axes = {}
        for joint in joints:
            axes[joint.name] = self.plan.axis_of(joint)
            if (file := self.plan.file_of(joint)) is not None:
                master.node(joint.node_id, file.dictionary, bus=joint.bus)
        machine = self.plan.machine
        settings = ChainSettings(mode=None) if self.plan.files else ChainSettings()
        if machine is not None:
            settings = machine.chains[description.name].settings
        settings = replace(settings, cycle_time=self.plan.cycle / SECOND)
        if self.plan.bus is None:
            settings = replace(settings, max_missed_cycles=patient_cycles(settings.cycle_time))
        chain = master.chain(description, settings, axes=axes)
        self._devices, self._halts = chain.devices, master.halts
        self._latest = [(0.0, 0.0)] * len(chain.devices)
        for number, device in enumerate(chain.devices):
            master.watch((PdoReceived,), partial(self._on_position, number), master.bus(device.node.bus), device.node.node_id)
        return chain

    async def _demonstrate(self, arm: Chain) -> None:
        with DemoView(self.screen, self.titles()[1], range=2 * self.plan.swing) as view:
            async with self._record_chain(arm), trio.open_nursery() as nursery:
                nursery.start_soon(self._draw, view)
                await self._boot(arm, view)
                await self._home(arm, view)
                await self._move(arm, view)
                self.cycles = CycleCounts(arm.sync_cycles, arm.missed_cycles, arm.skipped_cycles)
                await self._move_by_plan(arm, view)
                self._stage = "all was done, and the drives were being shut down"
                await arm.shut_down()
                nursery.cancel_scope.cancel()
        self.results = [
            JointResult(
                device.name,
                device.node.node_id,
                str(device.state),
                device.is_homed,
                math.degrees(_radians(device, device.largest_following_error)),
                device.sdo_round_trips,
            )
            for device in self._devices
        ]

    async def _boot(self, arm: Chain, view: DemoView) -> None:
        count = len(arm.devices)
        view.joints = [JointView(device.name, device.node.node_id) for device in arm.devices]
        step, start = view.begin("boot", "NMT, PDOs, fault reset, enable"), trio.current_time()
        await arm.initialise()
        for device in arm.devices:
            if device.axis.settings.counts_per_unit is None:
                seen, tries = "only Schunk's joints tell it", ("--counts-per-degree 1000, or whatever it is",)
                if self.plan.machine is not None:
                    tries = (f'unit = "degree" in [joints.{device.name}]',)
                raise usage("CO123", f"{device.where}: the scale of the drive is not known", seen=seen, tries=tries)
        view.done(step, f"{counted(count, 'drive')} in operation enabled after {trio.current_time() - start:.2f} s")
        for text, names in _plans(arm).items():
            view.done(view.begin("mode", ""), f"{text} ({counted(len(names), 'joint')}: {', '.join(names)})")

    async def _home(self, arm: Chain, view: DemoView) -> None:
        if self.plan.bus is not None:
            step = view.begin("wait", f"the arm is going to move in {HARDWARE_DELAY} s; Ctrl-C stops it")
            await trio.sleep(HARDWARE_DELAY)
            view.done(step, "the arm moves now; Ctrl-C stops it")
        self._stage, self._has_begun = "the joints were homing", True
        step, start = view.begin("home", "the joints look for their reference"), trio.current_time()
        without = [] if self.plan.bus is not None else [each for each in arm.devices if each.axis.settings.keeps_reference]
        await arm.home(if_needed=bool(without))
        told = f"{counted(len(arm.devices) - len(without), 'joint')} homed after {trio.current_time() - start:.2f} s"
        view.done(step, told + (f"; {counted(len(without), 'joint')} without homing" if without else ""))

    async def _move(self, arm: Chain, view: DemoView) -> None:
        """Send the path: one set-point for each joint in each cycle."""
        plan = self.plan
        await arm.follow()
        step = view.begin("move", "", progress=0.0)
        for device in arm.devices:
            device.following.largest_error = 0.0
        self.recording.joints = [JointTrack(device.name, device.node.node_id) for device in arm.devices]
        units = [1 / _radians(device, 1.0) for device in arm.devices]  # in a radian
        speeds = [_radians(device, _speed_of(device)) for device in arm.devices]
        accelerations = [limit and limit.value / unit for unit, limit in zip(units, map(_acceleration, arm.devices), strict=True)]
        start = [position / unit for unit, position in zip(units, arm.desired_positions, strict=True)]
        path = Path(start, math.radians(plan.swing), plan.seconds, speeds, accelerations)
        fault = plan.fault
        refresh = max(1, round(REFRESH * SECOND / plan.cycle))
        self._arm = arm
        async for cycle in arm.cycles():
            self._record(cycle.time)
            self._stage = f"the arm had been moving for {cycle.time:.1f} s"
            step.progress = min(1.0, cycle.time / plan.seconds)
            step.text = f"{min(cycle.time, plan.seconds):.1f} of {plan.seconds:g} s, SYNC {arm.sync_cycles}"
            if fault is not None and cycle.time >= fault[1]:
                self._break(fault[0])
                fault = None
            arm.set_positions([unit * position for unit, position in zip(units, path.at(cycle.time), strict=True)])
            if cycle.time > plan.seconds + SETTLING_TIME:
                break
            if cycle.number % refresh == 0:  # right after a SYNC: drawing takes 3 ms, and must not delay the next one
                self._redraw(view)
        counts = CycleCounts(arm.sync_cycles, arm.missed_cycles, arm.skipped_cycles)
        missed = "none missed or skipped"
        if counts.late_share:
            missed = f"{counts.missed} missed, {counts.skipped} skipped: {_percent(counts.late_share)} late"
        view.done(step, f"{plan.seconds:g} s along a smooth path, {counts.sent} SYNC cycles of {_ms(plan.cycle)}, {missed}")

    async def _move_by_plan(self, arm: Chain, view: DemoView) -> None:
        """Move simulated joints out and back, as fast as their limits allow; left out without ruckig, for slow joints, and in a
        short demonstration."""
        slow = any(device.plan is not None and device.plan.mode is Mode.PROFILE_POSITION for device in arm.devices)
        if self.plan.bus is not None or self.plan.seconds < PLANNED_FROM or slow or find_spec("ruckig") is None:
            return
        step, began = view.begin("plan", "out and back, within the limits of all joints"), trio.current_time()
        self._stage = "the arm was moving by a plan"
        self.recording.planned_from = self.recording.times[-1]
        start, way = arm.desired_positions, math.radians(self.plan.swing) * PLANNED_SHARE
        out = [at + way / _radians(device, 1.0) for at, device in zip(start, arm.devices, strict=True)]
        with trio.move_on_after(PLANNED_TIME) as scope:
            await self._move_to(arm, out)
            await self._move_to(arm, start)
        how = "stopped on the path: this computer is too busy" if scope.cancelled_caught else "all joints arrived together"
        view.done(step, f"out and back within {trio.current_time() - began:.2f} s, {how}")

    async def _move_to(self, arm: Chain, targets: Sequence[float]) -> None:
        """Move to a target by a plan, and record that behind what was recorded so far."""
        begin, failure = self.recording.times[-1], None

        async def record() -> None:
            async for progress in arm.progress():
                self._record(begin + progress.time)

        async with trio.open_nursery() as nursery:
            nursery.start_soon(record)
            try:
                await arm.move(targets)
            except Exception as error:  # noqa: BLE001 - raised below: the nursery would wrap it in a group
                failure = error
            nursery.cancel_scope.cancel()
        if failure is not None:
            raise failure

    def _break(self, node_id: int) -> None:
        assert self._fleet is not None
        self._fleet.raise_fault(node_id, DEMO_FAULT)

    def _record(self, time: float) -> None:
        self.recording.times.append(time)
        for track, (actual, commanded) in zip(self.recording.joints, self._latest, strict=True):
            track.actual.append(math.degrees(actual))
            track.commanded.append(math.degrees(commanded))

    def _on_position(self, number: int, report: PdoReceived) -> None:
        """Record a joint's position when its PDO comes in: only then position and command belong to the same instant."""
        device = self._devices[number]
        position = device.position
        if position is not None:
            self._latest[number] = _radians(device, position), _radians(device, position + device.following_error)
        if number == len(self._devices) - 1 and self._arm is not None and self._arm.state is ChainState.FAULT:
            self._record_stopping()

    def _record_stopping(self) -> None:
        """Record how the joints brake after a fault has stopped the chain. Nothing is commanded."""
        recording = self.recording
        if recording.broken is None:
            faulty = next((device.name for device in self._devices if device.has_fault), "")
            recording.broken = recording.times[-1], faulty
        self._latest = [(actual, math.nan) for actual, _ in self._latest]
        self._record(recording.times[-1] + self.plan.cycle / SECOND)

    async def _draw(self, view: DemoView) -> None:
        """Keep the picture up to date while no cycles run. Ends the demonstration if the reader of stdout has gone."""
        while True:
            self.screen.check_reader()
            if not self.recording.joints:
                self._redraw(view)
            await trio.sleep(REFRESH)

    def _redraw(self, view: DemoView) -> None:
        for joint, device in zip(view.joints, self._devices, strict=False):
            joint.state = str(device.state)
            joint.position = None if device.position is None else math.degrees(_radians(device, device.position))
        view.refresh()

    # ---- the report ----

    def titles(self) -> tuple[str, str]:
        """Return title and subtitle of the picture."""
        count = len(self.description.joints)
        drives = counted(count, "simulated drive") if self.plan.bus is None else f"{counted(count, 'drive')} on {self.plan.bus}"
        modes = dict.fromkeys(mode_name(device.plan.mode) for device in self._devices if device.plan is not None)
        how = f" in {', '.join(modes)}" if modes else "" if self.plan.files else " in interpolated position mode"
        title = f"{self.description.name}: {counted(count, 'joint')}{how}"
        source = f"{self.description.name} of {self.description.source}"
        files = ", ".join(dict.fromkeys(file.source for file in (*self.plan.files.values(), *self.plan.drives.values())))
        drives += f" made of {files}" if files and self.plan.bus is None else ""
        return title, f"{source}, {drives}, one SYNC each {_ms(self.plan.cycle)}"

    def story(self) -> list[str]:
        """Tell what happened to the drives if the run did not end as planned. Each joint is named once.

        For a simulated drive, what it really does counts more than what it confirmed.
        """
        if not self._devices:
            return []
        told = [self._stage]
        moving = () if self._fleet is None else self._fleet.moving
        unconfirmed = [halt.device for halt in self._halts if halt.problem]
        fates: dict[str, list[str]] = {"in fault, without power": [], "halted": [], "told to halt": [], "STILL MOVING": []}
        for device in self._devices:
            if device.node.node_id in moving:
                fate = "STILL MOVING"
            elif device.has_fault:
                fate = "in fault, without power"
            else:
                fate = "told to halt" if device in unconfirmed else "halted"
            fates[fate].append(device.name)
        if not self._has_begun:
            fates["halted"] = fates["told to halt"] = []
        return told + [f"{fate}: {', '.join(names)}" for fate, names in fates.items() if names]

    def show_result(self) -> ExitCode:
        """Print the tables and what to try next. Return the exit status."""
        screen, cycles = self.screen, self.cycles
        if screen.json_output:
            screen.json(self._as_json())
        else:
            screen.table(COLUMNS, [result.row() for result in self.results], right=("node", *COLUMNS[4:]))
            screen.table(CYCLE_COLUMNS, [cycles.row()], right=CYCLE_COLUMNS)
        if self._was_busy:
            screen.say(f"[dim]this computer was busy: the simulated world stood still for {self.stood_still:.1f} s in all[/]")
        if not cycles.was_kept:
            late, cycle = _percent(cycles.late_share), _ms(self.plan.cycle)
            screen.say(f"[yellow]this computer could not keep a cycle of {cycle}: {late} of the periods were late[/]")
            screen.say("  seen:  all was done: the path waits for a late computer, and no joint was sent faster than it may go")
            screen.say("  try:   canopen doctor, a longer --cycle, or a computer that does less besides")
        elif self.plan.bus is None and not screen.json_output:
            is_own = self.plan.machine is not None or self.plan.files or self.plan.chains != CHAINS
            node_id = self.results[-1].node_id
            screen.say(NEXT_OF_OTHERS.format(node=node_id, time=self.plan.seconds / 2) if is_own else NEXT)
        return ExitCode.OK

    def _as_json(self) -> dict[str, Any]:
        return {
            "chain": self.description.name,
            "simulated": self.plan.bus is None,
            "cycle_ms": self.plan.cycle / MILLISECOND,
            "sync_cycles": self.cycles.sent,
            "missed_cycles": self.cycles.missed,
            "skipped_cycles": self.cycles.skipped,
            "late_share": round(self.cycles.late_share, 6),
            "stood_still_seconds": round(self.stood_still, 3),
            "joints": [
                {
                    "joint": result.name,
                    "node": result.node_id,
                    "state": result.state,
                    "homed": result.homed,
                    "largest_following_error_degrees": round(result.error, 6),
                    "sdo_round_trips": result.round_trips,
                }
                for result in self.results
            ],
        }


def _plans(arm: Chain) -> dict[str, list[str]]:
    """Return each way in which joints follow set-points by their own files, and these joints."""
    plans: dict[str, list[str]] = {}
    for device in arm.devices:
        if device.plan is not None:
            changed = ", ".join(f"{pdo.direction} {pdo.number}" for pdo in (*device.plan.written, *device.plan.destroyed))
            text = f"{mode_name(device.plan.mode)}: {device.plan.reason}"
            text += f"; set up unlike the file: {changed}" if changed else ""
            plans.setdefault(text, []).append(device.name)
    return plans


def _radians(device: Device, amount: float) -> float:
    """Return a position or a speed of a joint in radians; without a named unit it is in radians already."""
    unit = device.axis.settings.unit
    return amount if unit is None else amount * _RADIANS[unit]


def _acceleration(device: Device) -> Limit | None:
    return device.limits.acceleration


def _speed_of(device: Device) -> float:
    """Return how fast a joint may go.

    After a late SYNC, a joint that limits its acceleration falls behind by v² / 2a, while it gathers speed again. That has to be
    well within the following error that it may have.
    """
    speed, acceleration = device.limits.speed.value, device.limits.acceleration
    if acceleration is None or not math.isfinite(device.following.limit.value):
        return speed
    return min(speed, LATE_SHARE * math.sqrt(2 * acceleration.value * device.following.limit.value))


def _nobody_reads(error: Exception) -> bool:
    """Return whether the run ended only because its reader went away (`canopen demo | head`), and all drives stand."""
    rest = error.split(BrokenPipeError)[1] if isinstance(error, ExceptionGroup) else error
    return (rest is None or isinstance(rest, BrokenPipeError)) and all_stand(error)


def _percent(share: float) -> str:
    return f"{share:.1%}".replace("%", " %")


def _ms(time: Time) -> str:
    return f"{time / MILLISECOND:g} ms"
