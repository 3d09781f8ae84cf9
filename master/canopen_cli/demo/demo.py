"""`canopen demo`: a six-joint arm boots, homes itself and follows a smooth path. run.py shows it."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path

import click
from click.core import ParameterSource

from canopen_cli.demo.run import ShownDemonstration
from canopen_cli.motion.record_option import check_record, record_option, recorded
from canopen_cli.plot.cycles import check_plot, write_plot
from canopen_cli.shared.device_files import read_device_files
from canopen_cli.shared.new_files import check_new_file
from canopen_cli.shared.options import DEMO, FILE, Breakdown, Duration, FiniteRange, Settings, command, enabling, lasting
from canopen_cli.shared.problem import ExitCode, usage
from canopen_cli.shared.running import run
from canopen_cli.shared.screen import Screen, escape
from canopen_data import load_dictionary
from canopen_master.demonstration.task import CHAINS, DemonstrationTask
from canopen_master.participant.patient_clock import PatientClock
from canopen_master.simulated_machine import drives_of_machine
from canopen_master.simulation.drive_files import drive_of
from canopen_proto.drives.axis.watchdog import DEFAULT_WATCHDOG
from canopen_proto.machine import MILLISECOND, Time

CYCLE = Duration(MILLISECOND, 255 * MILLISECOND)


@command()
@click.option("--chains", metavar="FILE", help=f"A chain file, yours or an installed one.  [default: {CHAINS}]")
@click.option("--chain", metavar="NAME", help="Which chain of that file.  [default: the first]")
@lasting("How long to move.  [default: 5s]", low=0.5, high=3600, default=5.0)
@click.option("--cycle", type=CYCLE, help="Time between two SYNCs.  [default: that of the machine file, else 10ms]")
@click.option(
    "--swing",
    type=FiniteRange(0.1, 60),
    default=15.0,
    show_default=True,
    help="How far, in degrees; less where the joints may not go as fast as that takes.",
)
@click.option(
    "--plot",
    type=FILE,
    help="Draw positions and following errors, as .png, .svg or .pdf (needs matplotlib).",
)
@record_option
@click.option(
    "--counts-per-degree",
    type=FiniteRange(1e-6, 1e9),
    metavar="N",
    help="What real drives count in; 1000 for millidegrees.  [default: Schunk's by their vendor-ID]",
)
@click.option("--fault", type=Breakdown(), help="Show a breakdown: 5@2.0 lets simulated drive 5 fail after 2 s of moving.")
@click.option("--web", is_flag=True, help="Show six simulated joints on a page in a browser, until Ctrl-C (extra `web`).")
@click.option("--port", type=click.IntRange(0, 65535), default=8402, show_default=True, help="Of --web; 0: any free one.")
@click.option("--defaults", is_flag=True, help="With --eds: the drives as they come, without what a DCF configures.")
@enabling
def demo(
    settings: Settings,
    screen: Screen,
    chains: str | None,
    chain: str | None,
    seconds: float,
    cycle: Time | None,
    swing: float,
    plot: Path | None,
    record: Path | None,
    counts_per_degree: float | None,
    fault: tuple[int, float] | None,
    web: bool,
    port: int,
    defaults: bool,
) -> int:
    """A six-joint arm boots, homes itself and moves. Needs no hardware.

    Without --bus the drives of the chain file are simulated, in this process (CANOPEN_BUS does not count here). With it they are
    real, and THEY MOVE. Ctrl-C halts every drive.

    Simulated joints then move out and back by a plan, as fast as their limits allow, if ruckig is there.

    With --eds the drives have the objects and PDOs of that file. It also decides the mode: csp, else ip, else profile position,
    which is slow. Real drives whose PDOs differ are set up accordingly: `canopen drive plan NODE` shows how. Simulated ones
    home where they stand.

    With a machine file (-m; CANOPEN_MACHINE does not count) its chain moves: simulated, or for real with -b NAME of one of its
    buses, then on all of its buses, in its units and limits.

    Exit status: 0 done. If more than 5 % of the cycles were late, that is said.

    \b
    canopen demo
    canopen demo --web                                        on a page in a browser
    canopen demo --plot arm.png
    canopen demo --record run.csv                             every cycle; canopen plot run.csv
    canopen demo --fault 5@2.0                                what a drive's breakdown looks like
    canopen demo --eds drive.dcf                              drives made of a file
    canopen demo -m cell.toml                                 a machine of yours, simulated
    canopen demo --bus socketcan:can0 --chains my.csv         the same on hardware
    """
    if web:
        _show_in_browser(settings, screen, port)
        return ExitCode.OK
    # CANOPEN_BUS does not count here: a demonstration must not move an arm because a variable was set long ago.
    bus = settings.bus if settings.bus not in (None, "demo") else None
    if fault is not None and bus is not None:
        raise usage("CO123", "--fault breaks a simulated drive; those on a bus are real", tries=("canopen demo --fault 5@2.0",))
    if fault is not None and fault[1] > seconds:
        tries = (f"--fault {fault[0]}@{seconds / 2:g}", f"--for {fault[1] + 2:g}s")
        raise usage(
            "CO123", f"--fault: after {fault[1]:g} s the arm has stopped", seen=f"it moves for {seconds:g} s", tries=tries
        )
    machine = None if settings.machine is None else settings.machine_file()
    if machine is not None and (chains is not None or settings.eds or counts_per_degree is not None):
        what = "--chains" if chains is not None else "--eds" if settings.eds else "--counts-per-degree"
        raise usage("CO123", f"{what}: the machine file says that already", tries=("the same without -m",))
    told = 10 * MILLISECOND if machine is None else machine.master.cycle
    cycle = told if cycle is None else cycle
    check_cycle(cycle)
    if plot is not None:
        check_plot(plot)
        check_new_file(settings, screen, plot)
    check_record(settings, screen, record)
    if defaults and not settings.eds and machine is None:
        raise usage("CO123", "--defaults is for drives made of a file", tries=("canopen demo --eds drive.dcf --defaults",))
    described = read_device_files(settings.eds, load_dictionary()[0], screen, settings.encoding) if settings.eds else {}
    files = {node_id: drive_of(each, defaults=defaults) for node_id, each in described.items()}
    drives = {} if machine is None else drives_of_machine(machine, defaults=defaults)
    scale = None if counts_per_degree is None else math.degrees(counts_per_degree)  # per radian
    is_default = machine is None and settings.master_id is None  # not that of CANOPEN_MACHINE
    watchdog = DEFAULT_WATCHDOG if is_default else settings.watchdog
    timeout = settings.timeout if settings.timeout is not None or machine is None else machine.master.timeout
    arm = chains or CHAINS
    task = DemonstrationTask(bus, arm, chain, seconds, cycle, swing, fault, timeout, files, scale, watchdog, machine, drives)
    if bus is None and settings.clock is None:
        settings.clock = PatientClock()
    shown = ShownDemonstration(screen, task, partial(recorded, settings, screen, path=record))
    demonstration = shown.demonstration
    try:
        run(settings, screen, shown.run, story=lambda _: demonstration.story())
        return shown.show_result()
    finally:  # also after a breakdown
        if plot is not None and demonstration.recording.times:
            write_plot(plot, demonstration.recording, *shown.titles())
            screen.say(f"Drawn: [bold]{escape(str(plot))}[/]")


def _show_in_browser(settings: Settings, screen: Screen, port: int) -> None:
    """Serve the page; of the options only --seconds counts, and only if it was given. Raises a CommandError for the others."""
    context = click.get_current_context()
    given = {name for name in context.params if context.get_parameter_source(name) is ParameterSource.COMMANDLINE}
    if others := given & {"chains", "chain", "cycle", "swing", "plot", "record", "counts_per_degree", "fault", "defaults"}:
        option = f"--{min(others).replace('_', '-')}"
        raise usage("CO123", f"{option} does not go with --web: the page moves the joints", tries=("canopen demo --web",))
    if settings.eds or settings.bus not in (None, DEMO):
        raise usage(
            "CO123", "--web shows the simulated joints", tries=("canopen serve web -m cell.toml", "canopen serve web -b can0")
        )
    from canopen_cli.demo.web import show_in_browser  # needs the extra `web`, which no other demonstration does

    show_in_browser(settings, screen, port, context.params["seconds"] if "seconds" in given else math.inf)


def check_cycle(cycle: Time) -> None:
    """Raise a CommandError for a cycle that 0x60C2 of a drive cannot hold: 1 to 255 units of 1 ms or of 0.1 ms."""
    unit = MILLISECOND if cycle % MILLISECOND == 0 else MILLISECOND // 10
    if cycle % unit or cycle > 255 * unit:
        near = max(1, round(cycle / MILLISECOND))
        raise usage(
            "CO124",
            f"drives cannot follow a cycle of {cycle / MILLISECOND:g} ms: whole milliseconds, or tenths below 25.5 ms",
            tries=(f"--cycle {near}ms",),
        )
