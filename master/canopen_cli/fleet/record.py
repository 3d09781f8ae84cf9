"""`canopen fleet record`: what a fleet tells, as Parquet in a folder."""

from __future__ import annotations

from pathlib import Path

import click
import trio

from canopen_cli.fleet.joining import PlaceText, WayIn, joined, joining
from canopen_cli.shared.options import Seconds, Settings, command, lasting
from canopen_cli.shared.problem import ExitCode
from canopen_cli.shared.running import run_until_interrupted
from canopen_cli.shared.screen import Screen, counted, escape
from canopen_gateway.fleet import FleetPlace
from canopen_gateway.history import Recorded, record_fleet
from canopen_gateway.history.recorder import FLUSH, LEAST_FLUSH


@command()
@click.argument("folder", type=click.Path(file_okay=False, path_type=Path), metavar="DIR")
@click.argument("place", type=PlaceText(), default="*/*")
@click.option(
    "--read", "objects", multiple=True, metavar="OBJECT", help="An object that is read from each node, too; may be repeated."
)
@click.option("--every", type=Seconds(0.05), default="1s", show_default=True, help="How often each is read.")
@click.option(
    "--flush",
    type=Seconds(LEAST_FLUSH),
    default=f"{FLUSH:g}s",
    show_default=True,
    help="How often it goes to the disk: what a kill loses at most.",
)
@lasting()
@joining
def record(
    settings: Settings,
    screen: Screen,
    folder: Path,
    place: FleetPlace,
    objects: tuple[str, ...],
    every: float,
    flush: float,
    seconds: float,
    way_in: WayIn,
) -> int:
    """Record a fleet as Parquet, by site, node and hour, until Ctrl-C: PDOs, states, emergencies, who comes and goes.

    PLACE is SITE/BUS, for all of a bus, or SITE/BUS/NODE; * stands for each. All by default. What was lost on the way is recorded
    as such. A file is whole, or not there. Several recorders may write to one folder. Needs the extra `history`. Exit status 6:
    the disk did not take the end.

    \b
    canopen fleet record history --read statusword --every 1s
    canopen fleet query history
    """
    recorded = Recorded()
    scope = trio.CancelScope()

    def started(_: Recorded) -> None:
        scope.deadline = trio.current_time() + seconds
        screen.say(f"recording to {escape(str(folder))}; a kill loses {flush:g} s at most")

    async def work() -> None:
        async with joined(way_in) as fleet:
            with scope:
                await record_fleet(
                    fleet,
                    folder,
                    pattern=place,
                    objects=objects,
                    every=every,
                    flush=flush,
                    started=started,
                    told=recorded,
                )

    try:
        run_until_interrupted(settings, screen, work)
    finally:
        if recorded.run:
            _tell(settings, screen, folder, recorded)
    return ExitCode.BAD_FILE if recorded.problem else ExitCode.OK


def _tell(settings: Settings, screen: Screen, folder: Path, recorded: Recorded) -> None:
    if settings.json:
        screen.json(
            {
                "folder": str(folder),
                "run": recorded.run,
                "rows": recorded.rows,
                "files": recorded.files,
                "lost": recorded.lost,
                "problem": recorded.problem,
            }
        )
    screen.say(f"{counted(recorded.rows, 'row')} in {counted(recorded.files, 'file')}: [bold]{escape(str(folder))}[/]")
    if recorded.lost:
        screen.warn(f"{counted(recorded.lost, 'sample')} lost, and recorded as lost: SELECT * FROM gaps")
    if recorded.problem:
        screen.warn(f"the disk did not take the last rows: {escape(recorded.problem)}")
