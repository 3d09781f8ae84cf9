"""What `canopen demo` shows: a line or a picture for each step, and at its end the tables."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from typing import Any, Final

import trio

from canopen_cli.motion.view import DemoView, JointView, ViewStep
from canopen_cli.shared.failures import problem_of
from canopen_cli.shared.problem import ExitCode, usage
from canopen_cli.shared.running import all_stand
from canopen_cli.shared.screen import Screen, counted, escape
from canopen_master.demonstration import run as events
from canopen_master.demonstration.run import CycleCounts, Demonstration, DemonstrationEvent, JointResult
from canopen_master.demonstration.task import CHAINS, DemonstrationTask
from canopen_master.errors import CHAIN_FAULT
from canopen_master.motion.chain import Chain
from canopen_proto.drives.cia402.modes import mode_name
from canopen_proto.machine import MILLISECOND, SECOND, Time
from canopen_transports.loop.beside import beside

REFRESH: Final = 0.08
"""Seconds between two redraws on a terminal."""
NEXT: Final = """Try next:
  [bold]canopen scan -b demo[/]                  who is on the bus
  [bold]canopen read 3 statusword -b demo[/]     an object of a drive
  [bold]canopen demo --plot arm.png[/]           a picture of this
  [bold]canopen demo --fault 5@2.0[/]            what a breakdown looks like"""
NEXT_OF_OTHERS: Final = """Try next:
  the same with [bold]--plot arm.png[/]          a picture of this
  the same with [bold]--fault {node}@{time:g}[/]         what a breakdown looks like"""
"""For an arm of the user's: `-b demo` is another one."""
COLUMNS: Final = "joint", "node", "state", "homed", "largest\nfollowing\nerror", "SDO\nround\ntrips"
CYCLE_COLUMNS: Final = "SYNC cycles", "missed", "skipped", "late"


class ShownDemonstration:
    """One run of the command. record: records what the chain does while its block runs."""

    def __init__(
        self, screen: Screen, task: DemonstrationTask, record: Callable[[Chain], AbstractAsyncContextManager[object]]
    ) -> None:
        self.screen = screen
        self.task = task
        self._record = record
        _check_fault(task)
        self.demonstration = Demonstration(task, self._tell, self._around)
        self._view: DemoView | None = None
        self._step: ViewStep | None = None
        self._refresh = max(1, round(REFRESH * SECOND / task.cycle))
        """Cycles between two redraws."""

    async def run(self) -> None:
        """Run the whole demonstration. Raises a CommandError if it fails; then every drive that still listens was halted."""
        try:
            await self.demonstration.run()
        except Exception as error:
            if _nobody_reads(error):
                raise BrokenPipeError from error
            problem = problem_of(error)
            problem.also += self.demonstration.story()
            if problem.code == CHAIN_FAULT:
                problem.tries = self._after_fault(problem.node)
            raise problem from error

    def _after_fault(self, node_id: int | None) -> tuple[str, ...]:
        if self.task.bus is None:
            return ("canopen demo    (the same without the fault)",)
        bus = f" -b {self.task.bus}" if self.task.machine is None else ""  # else with -m, which is added to all advice
        return f"canopen info {node_id}{bus}    (what the drive remembers)", f"canopen home {node_id} --reset-fault{bus}"

    @asynccontextmanager
    async def _around(self, arm: Chain) -> AsyncIterator[None]:
        with DemoView(self.screen, self.titles()[1], range=2 * self.task.swing) as self._view:
            async with self._record(arm), beside(trio.open_nursery()) as nursery:
                nursery.start_soon(self._draw)
                yield

    async def _draw(self) -> None:
        """Keep the picture up to date while no cycles run. Ends the demonstration if the reader of stdout has gone."""
        while True:
            self.screen.check_reader()
            if not self.demonstration.recording.joints:
                self._redraw()
            await trio.sleep(REFRESH)

    def _redraw(self) -> None:
        assert self._view is not None
        for joint, place in zip(self._view.joints, self.demonstration.places, strict=False):
            joint.state, joint.position = place
        self._view.refresh()

    # ---- the steps ----

    def _begin(self, name: str, text: str, progress: float | None = None) -> None:
        assert self._view is not None
        self._step = self._view.begin(name, text, progress)

    def _done(self, text: str) -> None:
        assert self._view is not None
        assert self._step is not None
        self._view.done(self._step, text)
        self._step = None

    def _tell(self, event: DemonstrationEvent) -> None:
        match event:
            case events.BootBegun(devices=devices):
                assert self._view is not None
                self._view.joints = [JointView(device.name, device.node.node_id) for device in devices]
                self._begin("boot", "NMT, PDOs, fault reset, enable")
            case events.JointsEnabled(count=count, seconds=seconds, modes=modes):
                self._done(f"{counted(count, 'drive')} in operation enabled after {seconds:.2f} s")
                for text, names in modes.items():
                    self._begin("mode", "")
                    self._done(f"{text} ({counted(len(names), 'joint')}: {', '.join(names)})")
            case events.MovesSoon(seconds=seconds):
                self._begin("wait", f"the arm is going to move in {seconds:g} s; Ctrl-C stops it")
            case events.HomingBegun():
                if self._step is not None:
                    self._done("the arm moves now; Ctrl-C stops it")
                self._begin("home", "the joints look for their reference")
            case events.HomingDone(count=count, without=without, seconds=seconds):
                told = f"{counted(count, 'joint')} homed after {seconds:.2f} s"
                self._done(told + (f"; {counted(without, 'joint')} without homing" if without else ""))
            case events.SwingCycle():
                self._tell_cycle(event)
            case events.SwingDone(cycles=cycles):
                missed = "none missed or skipped"
                if cycles.late_share:
                    missed = f"{cycles.missed} missed, {cycles.skipped} skipped: {_percent(cycles.late_share)} late"
                path = f"{self.task.seconds:g} s along a smooth path"
                self._done(f"{path}, {cycles.sent} SYNC cycles of {_ms(self.task.cycle)}, {missed}")
            case events.PlannedMoveBegun():
                self._begin("plan", "out and back, within the limits of all joints")
            case events.PlannedMoveDone(seconds=seconds, was_cut=was_cut):
                how = "stopped on the path: this computer is too busy" if was_cut else "all joints arrived together"
                self._done(f"out and back within {seconds:.2f} s, {how}")

    def _tell_cycle(self, cycle: events.SwingCycle) -> None:
        if self._step is None:
            self._begin("move", "", 0.0)
            return
        seconds = self.task.seconds
        self._step.progress = min(1.0, cycle.time / seconds)
        self._step.text = f"{min(cycle.time, seconds):.1f} of {seconds:g} s, SYNC {cycle.sync_cycles}"
        if cycle.number % self._refresh == 0:  # drawing takes 3 ms
            self._redraw()

    # ---- the report ----

    def titles(self) -> tuple[str, str]:
        """Return title and subtitle of the picture."""
        task, description = self.task, self.demonstration.description
        count = len(description.joints)
        drives = counted(count, "simulated drive") if task.bus is None else f"{counted(count, 'drive')} on {task.bus}"
        modes = dict.fromkeys(mode_name(device.plan.mode) for device in self.demonstration.devices if device.plan is not None)
        how = f" in {', '.join(modes)}" if modes else "" if task.files else " in interpolated position mode"
        title = f"{description.name}: {counted(count, 'joint')}{how}"
        source = f"{description.name} of {description.source}"
        files = ", ".join(dict.fromkeys(file.source for file in (*task.files.values(), *task.drives.values())))
        drives += f" made of {files}" if files and task.bus is None else ""
        return title, f"{source}, {drives}, one SYNC each {_ms(task.cycle)}"

    def show_result(self) -> ExitCode:
        """Print the tables and what to try next. Return the exit status."""
        screen, task, cycles, results = self.screen, self.task, self.demonstration.cycles, self.demonstration.results
        if screen.json_output:
            screen.json(self._as_json())
        else:
            screen.table(COLUMNS, [_joint_row(result) for result in results], right=("node", *COLUMNS[4:]))
            screen.table(CYCLE_COLUMNS, [_cycle_row(cycles)], right=CYCLE_COLUMNS)
        if self.demonstration.was_busy:
            stood_still = self.demonstration.stood_still
            screen.say(f"[dim]this computer was busy: the simulated world stood still for {stood_still:.1f} s in all[/]")
        if not cycles.was_kept:
            late, cycle = _percent(cycles.late_share), _ms(task.cycle)
            screen.say(f"[yellow]this computer could not keep a cycle of {cycle}: {late} of the periods were late[/]")
            screen.say("  seen:  all was done: the path waits for a late computer, and no joint was sent faster than it may go")
            screen.say("  try:   canopen doctor, a longer --cycle, or a computer that does less besides")
        elif task.bus is None and not screen.json_output:
            is_own = task.machine is not None or task.files or task.chains != CHAINS
            screen.say(NEXT_OF_OTHERS.format(node=results[-1].node_id, time=task.seconds / 2) if is_own else NEXT)
        return ExitCode.OK

    def _as_json(self) -> dict[str, Any]:
        cycles = self.demonstration.cycles
        return {
            "chain": self.demonstration.description.name,
            "simulated": self.task.bus is None,
            "cycle_ms": self.task.cycle / MILLISECOND,
            "sync_cycles": cycles.sent,
            "missed_cycles": cycles.missed,
            "skipped_cycles": cycles.skipped,
            "late_share": round(cycles.late_share, 6),
            "stood_still_seconds": round(self.demonstration.stood_still, 3),
            "joints": [
                {
                    "joint": result.name,
                    "node": result.node_id,
                    "state": result.state,
                    "homed": result.homed,
                    "largest_following_error_degrees": round(result.error, 6),
                    "sdo_round_trips": result.round_trips,
                }
                for result in self.demonstration.results
            ],
        }


def _check_fault(task: DemonstrationTask) -> None:
    """Raise a CommandError for a fault of a node that is not in the chain."""
    description = task.chosen_chain()
    nodes = [joint.node_id for joint in description.joints]
    if task.fault is not None and task.fault[0] not in nodes:
        raise usage(
            "CO123",
            f"--fault: {description.name} has no node {task.fault[0]}",
            seen=f"its nodes are {', '.join(map(str, nodes))}",
            tries=(f"--fault {nodes[0]}@{task.fault[1]:g}",),
        )


def _joint_row(result: JointResult) -> tuple[str, ...]:
    homed = "[green]yes[/]" if result.homed else "[red]no[/]"
    node, error = f"{result.node_id} (0x{result.node_id:02X})", f"{result.error:.3f}°"
    return escape(result.name), node, escape(result.state), homed, error, str(result.round_trips)


def _cycle_row(cycles: CycleCounts) -> tuple[str, ...]:
    return str(cycles.sent), str(cycles.missed), str(cycles.skipped), _percent(cycles.late_share)


def _nobody_reads(error: Exception) -> bool:
    """Return whether the run ended only because its reader went away (`canopen demo | head`), and all drives stand."""
    rest = error.split(BrokenPipeError)[1] if isinstance(error, ExceptionGroup) else error
    return (rest is None or isinstance(rest, BrokenPipeError)) and all_stand(error)


def _percent(share: float) -> str:
    return f"{share:.1%}".replace("%", " %")


def _ms(time: Time) -> str:
    return f"{time / MILLISECOND:g} ms"
