"""`canopen move`: chains move to a target, or along a path of a file, within the limits of its joints."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path as FilePath

import click
import trio

from canopen_cli.motion.chain_session import ChainGroup, ChosenChains, choose_chains, open_chains
from canopen_cli.motion.move_legs import Legs, check_before_power, legs_of, show_legs, smoothed_text, targets_of
from canopen_cli.motion.move_rehearsal import rehearse_move
from canopen_cli.motion.record_option import check_record, record_option, recorded
from canopen_cli.motion.view import DemoView, JointView, ViewStep
from canopen_cli.plot.curves import curves_of_record
from canopen_cli.plot.cycles import check_plot
from canopen_cli.plot.motion import write_motion_plot
from canopen_cli.shared.failures import problem_of
from canopen_cli.shared.new_files import check_new_file
from canopen_cli.shared.options import FiniteRange, Settings, command, commanding, enabling
from canopen_cli.shared.problem import CommandError, ExitCode, usage
from canopen_cli.shared.running import run
from canopen_cli.shared.screen import Screen, counted, escape
from canopen_data import text_of
from canopen_data.path_file import PathFile, read_path
from canopen_master.errors import MasterError, PlanRefusedError, SetPointRefusedError
from canopen_master.motion.record_files import RecordError
from canopen_master.motion.record_reader import read_record
from canopen_master.motion.recording import Recorder
from canopen_master.trajectories.scaled_joints import load_ruckig
from canopen_transports.loop.beside import beside

REFRESH = 0.1
"""Seconds between two updates of what is shown."""


@command()
@click.argument("files", metavar="[MACHINE.toml] [PATH.csv]", nargs=-1)
@click.option("--to", metavar="A,B,...", help="The target: a position for each joint, or JOINT=POSITION for some of them.")
@click.option("--chain", "chains", metavar="NAME", multiple=True, help="Which chain; several move as one.  [default: the first]")
@click.option("--home", is_flag=True, help="Home the joints first that have no reference.")
@click.option(
    "--override",
    type=FiniteRange(0.01, 1),
    default=1.0,
    show_default=True,
    help="The rate of the path: 0.3 is a third of its speed.",
)
@click.option("--plot", type=click.Path(dir_okay=False, path_type=FilePath), help="Draw what it did, as .png, .svg or .pdf.")
@record_option
@enabling
@commanding
def move(
    settings: Settings,
    screen: Screen,
    files: tuple[str, ...],
    to: str | None,
    chains: tuple[str, ...],
    home: bool,
    override: float,
    plot: FilePath | None,
    record: FilePath | None,
) -> None:
    """Move chains to a target, or along a path. IT MOVES. Ctrl-C brakes on the path; then it stands, with power.

    A target is planned: as fast as the limits of the joints allow, all arrive together (this needs ruckig). PATH.csv has a
    column `time` in seconds, and one for each joint; the chain first moves to its start. All of it is checked before it moves.
    Positions are in the units of the machine file. At the end the drives have no power.

    With --dry-run the drives are only read. Simulated ones with the same values move in their place, and the check and the
    frames of the first cycle are shown.

    \b
    canopen move -b demo --to 10,-20,30,0,0,0             a simulated arm, in degrees
    canopen move cell.toml --to elbow=30 --dry-run
    canopen move cell.toml path.csv --override 0.3 --plot run.png
    canopen move cell.toml --chain arm --chain leg --to elbow=30,knee=10
    """
    path_name = _take_files(settings, files)
    if to is not None and path_name is not None:
        raise usage("CO001", f"a target and a path at once: --to and {path_name}", tries=("one of them",))
    if to is None and path_name is None:
        raise usage("CO001", "where to? --to, or the CSV file of a path", tries=("--to 10,20,30", "path.csv"))
    chosen = choose_chains(settings, *chains)
    if len(chosen.names) > 1 and (record is not None or plot is not None):
        raise usage("CO123", "a recording, and a picture of it, is of one chain", tries=("the same without --record and --plot",))
    path = None if path_name is None else read_path(_text(path_name), path_name, joints=chosen.joints)
    if path is not None and (smoothed := smoothed_text(path)):
        screen.say(escape(smoothed))
    targets = None if to is None else targets_of(to, chosen.joints)
    if targets is not None:
        load_ruckig("planning a motion")  # told before anything has power
    if settings.dry_run:
        rehearse_move(settings, screen, chosen, targets, path, override)
        return
    if plot is not None:
        check_plot(plot)
        check_new_file(settings, screen, plot)
    check_record(settings, screen, record)
    with tempfile.TemporaryDirectory() as folder:
        moved = _Move(settings, screen, chosen, targets, path, home, override)
        moved.told = record is not None
        file = record if record is not None or plot is None else FilePath(folder) / "move.csv"
        try:
            run(settings, screen, lambda: moved.run(file), story=moved.story)
        finally:
            if plot is not None and file is not None:
                _draw(screen, plot, file, moved.recorder)
    moved.show()


def _take_files(settings: Settings, files: Sequence[str]) -> str | None:
    """Take the machine file among the arguments as if -m named it; return the other one, the file of a path."""
    machines = [name for name in files if name.lower().endswith(".toml")]
    others = [name for name in files if name not in machines]
    if len(machines) > 1 or len(others) > 1:
        raise usage("CO001", f"one machine file and one path, not {counted(len(files), 'file')}")
    if machines:
        settings.machine = FilePath(machines[0])
    return others[0] if others else None


def _text(name: str) -> str:
    text = text_of(FilePath(name), name)
    if text is None:
        raise CommandError(ExitCode.BAD_FILE, "CO330", f"there is no file {name}", tries=("its path",))
    return text


class _Move:
    """One run of the command."""

    def __init__(
        self,
        settings: Settings,
        screen: Screen,
        chosen: ChosenChains,
        targets: dict[str, float] | None,
        path: PathFile | None,
        home: bool,
        override: float,
    ) -> None:
        self.settings, self.screen, self.chosen = settings, screen, chosen
        self.targets, self.path, self.home, self.override = targets, path, home, override
        self.recorder: Recorder | None = None
        self.told = True  # that it is recorded
        self._told = "nothing had moved"
        self._result: list[tuple[str, float, float]] = []

    async def run(self, file: FilePath | None) -> None:
        """Open the machine, move its chain, and take the power away."""
        async with open_chains(self.settings, self.chosen) as (master, arm):
            await check_before_power(master, arm, self.targets, self.path)
            try:
                await self._run_with_power(arm, file)
            except (SetPointRefusedError, PlanRefusedError) as error:
                problem = problem_of(error)
                problem.exit_code = ExitCode.DRIVE_FAULT  # not the one for "nothing was sent"
                raise problem from error

    async def _run_with_power(self, arm: ChainGroup, file: FilePath | None) -> None:
        with DemoView(self.screen, f"{arm.name}: {counted(len(arm.devices), 'joint')}", range=180) as view:
            view.joints = [JointView(device.name, device.node.node_id) for device in arm.devices]
            step = view.begin("enable", "NMT, PDOs, fault reset, enable")
            await arm.initialise()
            view.done(step, f"{counted(len(arm.devices), 'drive')} in operation enabled")
            if self.home:
                self._told = "the joints were homing"
                step = view.begin("home", "the joints look for their reference")
                await arm.home()
                view.done(step, "all joints have their reference")
            await arm.moving.follow()
            try:
                legs = await legs_of(arm, self.targets, self.path)
            except MasterError:
                await arm.shut_down()  # nothing is going to move
                raise
            await show_legs(self.screen, arm, legs)
            arm.moving.override = self.override
            async with recorded(self.settings, self.screen, arm.chains[0], file, told=self.told) as self.recorder:
                await self._move(arm, legs, view)
            self._told = "it had arrived"
            self._result = [
                (device.name, position, device.largest_following_error)
                for device, position in zip(arm.devices, arm.positions, strict=True)
            ]
            await arm.shut_down()

    async def _move(self, arm: ChainGroup, legs: Legs, view: DemoView) -> None:
        for device in arm.devices:
            device.following.largest_error = 0.0
        for name, path in legs:
            step = view.begin("move", name, progress=0.0)
            began = trio.current_time()
            async with beside(trio.open_nursery()) as nursery:
                nursery.start_soon(self._show, arm, view, step, path.duration)
                await arm.moving.follow(path)
            took = f"{name} in {trio.current_time() - began:.2f} s; its plan has {path.duration:.2f} s"
            farthest = max(arm.devices, key=lambda device: abs(device.following_error))
            off = f"{abs(farthest.following_error):.3g} off, as its drive tells"
            view.done(
                step, f"{took}. The plan is at its end, which no window of a drive decides: {farthest.name} is farthest, {off}"
            )

    async def _show(self, arm: ChainGroup, view: DemoView, step: ViewStep, duration: float) -> None:
        between = max(1, round(REFRESH / arm.cycle_time))
        cycle = 0
        async for progress in arm.moving.progress():
            self._told = f"it had been moving for {progress.time:.1f} s, and stands on its path"
            step.progress = min(1.0, progress.time * self.override / duration) if duration else 1.0
            cycle += 1
            if cycle % between:
                continue
            for joint, device, position in zip(view.joints, arm.devices, progress.positions, strict=True):
                joint.state, joint.position = str(device.state), position
            view.refresh()  # right behind a SYNC: drawing must not delay the next one, for the path would begin again from rest

    def story(self, confirmed: bool) -> list[str]:
        """Tell what was done if it did not come to its end."""
        halted = "halted" if confirmed else "told to halt"
        return [self._told, f"the joints were {halted}; `canopen drive disable NODE` takes the power"]

    def show(self) -> None:
        """Show where the joints are."""
        columns = ("joint", "stands at", "largest following error")
        if self.settings.json:
            names = ("joint", "position", "largest_following_error")
            self.screen.json([dict(zip(names, row, strict=True)) for row in self._result])
        else:
            rows = [(escape(name), f"{position:.6g}", f"{error:.3g}") for name, position, error in self._result]
            self.screen.table(columns, rows, right=columns[1:])


def _draw(screen: Screen, picture: FilePath, file: FilePath, recorder: Recorder | None) -> None:
    """Draw what was recorded, also after a failure."""
    if recorder is None:
        return
    with suppress(RecordError):  # told already
        recorder.wait()
    record = read_record(file)
    if len(record):
        write_motion_plot(picture, curves_of_record(record))
        screen.say(f"Drawn: [bold]{escape(str(picture))}[/]")
