"""`canopen sync` and `canopen time`: send SYNC, and the time of day, to all nodes of a bus."""

from __future__ import annotations

import datetime
import math
from typing import Final

import click

from canopen_cli.shared.dry_run import run_or_show
from canopen_cli.shared.options import Duration, Settings, command, commanding, lasting
from canopen_cli.shared.problem import usage
from canopen_cli.shared.questions import confirm
from canopen_cli.shared.running import run
from canopen_cli.shared.screen import Screen
from canopen_cli.shared.session import open_session
from canopen_cli.shared.time_left import time_left
from canopen_cli.shared.withholding import show_unsent
from canopen_proto.machine import MICROSECOND, MILLISECOND, SECOND, Time
from canopen_proto.procedures.steps import act
from canopen_proto.sync import SyncSent
from canopen_proto.time_stamp import TimeProducer

SHOWN: Final = 3
"""SYNCs that a dry run shows: all of them are alike."""


@command()
@click.option(
    "--period", type=Duration(low=100 * MICROSECOND), help="One each so often: 10ms, 1s. Until Ctrl-C, --for or --count."
)
@click.option("--count", type=click.IntRange(min=1), help="How many.  [default: 1, or no end with --period]")
@lasting(low=0, low_open=True)
@click.option("--yes", is_flag=True, help="Do not ask.")
@commanding
def sync(settings: Settings, screen: Screen, period: Time | None, count: int | None, seconds: float, yes: bool) -> None:
    """Send SYNC: all nodes take and send their synchronous PDOs. A DRIVE THAT WAITS FOR SET-POINTS ACTS ON THEM.

    Nobody else may send SYNC on this bus meanwhile.

    \b
    canopen sync -b demo --yes
    canopen sync --period 20ms --count 100 -b demo --yes
    canopen sync --period 20ms --for 2s -b demo --yes
    """
    if period is None and count is not None and count > 1:
        raise usage("CO001", "--count needs a --period", tries=(f"canopen sync --period 10ms --count {count}",))
    if seconds < math.inf:
        if period is None:
            raise usage("CO001", "--for needs a --period", tries=(f"canopen sync --period 10ms --for {seconds:g}s",))
        fit = math.ceil(seconds * SECOND / period)  # the first one goes at once
        count = fit if count is None else min(count, fit)
    confirm(screen, "send SYNC: drives act on the set-points that they have", yes, needed=not settings.dry_run)
    if settings.dry_run:
        shown = min(count or SHOWN, SHOWN)
        show_unsent(settings, screen, lambda: _sync(settings, screen, period, shown))
        if period is not None and shown != count:
            screen.say(
                f"and so on, one each {period / MILLISECOND:g} ms, {'until Ctrl-C' if count is None else f'{count} in all'}"
            )
        return
    sent = run(settings, screen, lambda: _sync(settings, screen, period, count))
    if settings.json:
        screen.json({"sent": sent, "period": None if period is None else period / SECOND})
    else:
        screen.say(f"{sent} SYNC sent")


async def _sync(settings: Settings, screen: Screen, period: Time | None, count: int | None) -> int:
    async with open_session(settings, screen) as session:
        master = session.master
        if period is None:
            await master.send_sync()
            return 1
        with master.events(SyncSent) as syncs:
            master.sync_start(period / SECOND)  # which keeps its phase
            sent = 0
            wait = math.inf if count is None else count * period / SECOND
            async with time_left(screen, f"one SYNC each {period / MILLISECOND:g} ms", wait):
                async for _ in syncs:
                    sent += 1
                    if sent == count:
                        break
            master.sync_stop()
            return sent


@command("time")
@commanding
def time(settings: Settings, screen: Screen) -> None:
    """Send this computer's time of day to all nodes (TIME, 0x100), once, in UTC.

    \b
    canopen time -b demo
    """
    sent = run_or_show(settings, screen, lambda: _time(settings, screen))
    if settings.json:
        screen.json({"time": sent.isoformat()})
    else:
        screen.say(f"TIME sent: {sent:%Y-%m-%d %H:%M:%S} UTC")


async def _time(settings: Settings, screen: Screen) -> datetime.datetime:
    now = datetime.datetime.now(datetime.UTC)
    async with open_session(settings, screen) as session:
        producer = TimeProducer(session.network.out)
        session.network.attach(producer)
        await session.master.run(act(lambda moment: producer.send(now, moment)))
        session.network.detach(producer)
    return now
