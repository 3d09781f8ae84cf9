"""`canopen fleet halt`: stop what moves, at one place or everywhere."""

from __future__ import annotations

import click

from canopen_cli.fleet.joining import PlaceText, WayIn, joining
from canopen_cli.shared.options import Settings, command
from canopen_cli.shared.problem import ExitCode
from canopen_cli.shared.running import run
from canopen_cli.shared.screen import Screen
from canopen_gateway.fleet import FleetPlace


@command()
@click.argument("place", type=PlaceText(), default="*/*")
@joining
def halt(settings: Settings, screen: Screen, place: FleetPlace, way_in: WayIn) -> int:
    """Stop what moves, at one place or everywhere. Anybody may, always; nothing has to be allowed for it.

    PLACE is SITE/BUS or SITE/BUS/NODE; * stands for each. Everywhere by default. It is no safety function: keep the emergency
    stop within reach. Exit status 12: something did not confirm that it stands; 3: nobody answered.

    \b
    canopen fleet halt
    canopen fleet halt hall-2/arm
    """

    async def stop() -> dict[FleetPlace, list[str]]:
        async with way_in.open() as fleet:
            return await fleet.halt(place)  # at once: who is there is not waited for

    answers = run(settings, screen, stop)
    if settings.json:
        screen.json([{"place": str(where), "problems": problems} for where, problems in sorted(answers.items())])
    else:
        for where, problems in sorted(answers.items()):
            screen.text(f"{where}: {'; '.join(problems) or 'nothing moves'}")
    return ExitCode.DRIVE_FAULT if any(answers.values()) else ExitCode.OK
