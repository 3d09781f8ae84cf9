"""`canopen listen`: who is on a bus, and at which bit rate, without sending. See canopen_transports.receive_test."""

from __future__ import annotations

import trio

from canopen_cli.bus.doctor import LISTEN, LISTENING, bitrates_too, hear, heard_as_json, show_heard, status_of, try_bitrates
from canopen_cli.live.top_view import BusShown, TopView, as_json, plain
from canopen_cli.shared.node_files import NodeFiles
from canopen_cli.shared.options import DEMO, Settings, command, lasting
from canopen_cli.shared.problem import ExitCode
from canopen_cli.shared.running import run
from canopen_cli.shared.screen import Screen, escape
from canopen_master.simulation.serving import DEMO_LOCATOR
from canopen_proto.frame import Frame
from canopen_proto.machine import SECOND
from canopen_proto.observer.bus_view import BusView
from canopen_proto.observer.observer import Observer
from canopen_transports.diagnosis import bring_up
from canopen_transports.locator import parse_locator
from canopen_transports.receive_test import NO_WIRE
from canopen_transports.stamp_clock import StampClock


@command()
@bitrates_too
@lasting(LISTENING, low=0.1, high=3600, default=LISTEN)
def listen(settings: Settings, screen: Screen, bitrates: bool, seconds: float) -> int:
    """Hear who is on a bus, and with --bitrates find its bit rate. Nothing is sent.

    An adapter with a listen-only mode (pcan, slcan, kvaser, vector ...) does not even acknowledge frames. Exit status: 0 frames
    were heard, 5 none, 4 faults on the bus; with --bitrates 1: at none of them were frames heard without errors.

    \b
    canopen listen -b pcan:PCAN_USBBUS1 --bitrates
    canopen listen -b socketcan:can0 --for 10s
    """
    bus = settings.required_bus()
    files = NodeFiles(settings, screen)
    if bitrates:
        found = run(settings, screen, lambda: try_bitrates(screen, bus, seconds))
        if found is None:
            if screen.json_output:
                screen.json(None)
            return ExitCode.DIFFERENT
        bus = found.locator
    rate = _bitrate(bus) or settings.told_bitrate() or 0
    observer, view, clock = Observer(files.dictionary_of, bitrate=rate), BusView(bitrate=rate), StampClock()
    now = 0

    def each(frame: Frame, stamp: int | None) -> None:
        nonlocal now
        now = clock.time_of(stamp, round(trio.current_time() * SECOND))
        view.add(frame, observer.observe(frame, now), now)

    heard = run(settings, screen, lambda: hear(screen, bus, seconds, each))
    shown = TopView(bus, (BusShown(bus, view.figures(now), now, now, rate),))
    if screen.json_output:
        screen.json(heard_as_json(heard) | {"figures": as_json(shown)[0]})
        return status_of(heard)
    if heard.frames:
        screen.data(plain(shown, screen.out.width))
    show_heard(screen, heard, seconds)
    if not heard.listen_only:
        _tell_how_to_be_silent(screen, bus)
    return status_of(heard)


def _bitrate(bus: str) -> int | None:
    return None if bus == DEMO else parse_locator(bus).bitrate


def _tell_how_to_be_silent(screen: Screen, bus: str) -> None:
    """Tell that the adapter has taken part in the traffic: it acknowledges frames, and at a wrong bit rate destroys them."""
    locator = parse_locator(DEMO_LOCATOR if bus == DEMO else bus)
    if locator.interface in (*NO_WIRE, "file"):
        return
    screen.say(
        "[yellow]No frame was sent. But the adapter acknowledges the frames of others, and at a wrong bit rate destroys them, "
        "unless its driver was told to listen only.[/]"
    )
    if locator.interface == "socketcan" and not locator.channel.startswith("vcan"):
        silent = f"sudo ip link set {locator.channel} down && {bring_up(locator)} listen-only on"
        screen.say(f"To listen only: {escape(silent)}")
