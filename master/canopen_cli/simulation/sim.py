"""`canopen sim`: serve simulated devices on any bus, made of any device's file, for other programs and terminals."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractAsyncContextManager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final

import click
import trio

from canopen_cli.shared.options import DEMO, Duration, Settings, command, lasting, until_text
from canopen_cli.shared.problem import usage
from canopen_cli.shared.running import run_until_interrupted
from canopen_cli.shared.screen import Screen, counted, escape, node_text
from canopen_cli.simulation.devices import SimulatedIds, buses_of, machine_of, named_devices, teller
from canopen_master.machine_file import MachineFile
from canopen_master.simulated_machine import devices_of_machine
from canopen_master.simulation.device_files import models_of
from canopen_master.simulation.parameter_keeper import ParameterKeeper
from canopen_master.simulation.plant import PROFILES, DeviceEntry
from canopen_master.simulation.serving import (
    DEMO_LOCATOR,
    DEMO_NODES,
    SimulatedDevices,
    drive_maker,
    simulated_devices,
    simulated_drives,
)
from canopen_proto.declared import DeviceCodeFailed
from canopen_proto.error_codes import error_text
from canopen_proto.lss.messages import UNCONFIGURED
from canopen_proto.lss.slave import LssNodeIdSet
from canopen_proto.machine import MILLISECOND, Event, Time
from canopen_proto.manager.programs.identity import FlashStatus
from canopen_proto.nmt import NmtStateChanged
from canopen_proto.simulation.boot_loader import BootLoader, BootLoaderSettings, ProgramErased, ProgramStarted, ProgramWritten
from canopen_proto.simulation.drive.events import DriveFault, DriveStateChanged
from canopen_proto.simulation.drive.settings import SYNC_TOLERANCE, Shape

DEFAULT_IDS: Final = DEMO_NODES


@command()
@click.argument("files", metavar="[[NODES=]FILE]...", nargs=-1)
@click.option(
    "--id",
    "--ids",
    "node_ids",
    type=SimulatedIds(),
    help=f"Node-IDs: 5, or 3-8; 255: none yet, see `canopen lss`. By default that of a DCF; without a file "
    f"{DEFAULT_IDS[0]}-{DEFAULT_IDS[-1]}.",
)
@click.option(
    "--profile",
    type=click.Choice(PROFILES),
    default=PROFILES[0],
    show_default=True,
    help="What is behind a file: 402, our simulated drive; none, plain memory; auto, what its device type says.",
)
@click.option(
    "--shape",
    type=click.Choice(("schunk", "standard")),
    help="Of drives: Powerball joints (without a file), or CiA 402.",
)
@click.option("--script", metavar="FILE.py", default="", help="A Python file that animates the devices.")
@click.option("--state", metavar="FILE.json", help="Where what they store (1010) is kept; by default in memory.")
@click.option("--defaults", is_flag=True, help="Of a DCF: the defaults, not what it has configured.")
@click.option("--boot-loader", is_flag=True, help="Devices that take a program by `canopen flash`, in place of drives.")
@click.option(
    "--hold-clear",
    is_flag=True,
    help='Boot loaders answer "clear" (1F51 = 3) when they have erased, for masters that do not poll 1F57.',
)
@click.option("--erase-time", type=Duration(MILLISECOND), help="Of boot loaders.  [default: 300ms]")
@lasting()
def sim(
    settings: Settings,
    screen: Screen,
    files: tuple[str, ...],
    node_ids: tuple[int, ...] | None,
    profile: str,
    shape: str | None,
    script: str,
    state: str | None,
    defaults: bool,
    boot_loader: bool,
    hold_clear: bool,
    erase_time: Time | None,
    seconds: float,
) -> None:
    """Serve simulated devices on a bus until Ctrl-C: of any EDS, DCF, XDD or XDC, written in Python, or drives of our own.

    Two terminals without hardware meet on udp_multicast:

    \b
    canopen sim -b udp_multicast
    canopen demo -b udp_multicast

    \b
    canopen sim drive.eds --id 5 -b can0
    canopen sim station.py --id 5 -b can0  a device of one's own: see canopen device new
    canopen sim 5=drive.eds 6,7=io.eds --script animate.py -b can0
    canopen sim --id 255,255,255 -b tcp    three drives that wait for their node-IDs: see canopen lss
    canopen sim 5 --boot-loader -b can0    a device that `canopen flash` writes programs into
    canopen sim 5 --boot-loader --hold-clear --erase-time 50ms -b can0    one for Lely's master
    canopen sim plant.toml
    canopen sim cell.toml                  each device of a machine file, on all of its buses; with -b NAME on that one
    """
    files += settings.eds  # -e means the same here: the file of a device
    if boot_loader and files:
        if node_ids:
            raise usage("CO127", "--boot-loader takes node-IDs only", tries=("canopen sim 5 --boot-loader",))
        node_ids, files = SimulatedIds().convert(",".join(files), None, None), ()
    if (hold_clear or erase_time is not None) and not boot_loader:
        raise usage("CO127", "--hold-clear and --erase-time are for boot loaders", tries=("the same with --boot-loader",))
    machine = None if node_ids else machine_of(files, settings)
    if machine is not None:
        _serve_machine(settings, screen, machine, state, seconds)
        return
    common_entry = DeviceEntry("", (), profile, shape or "", script, settings.overlays, defaults, encoding=settings.encoding)
    plant = named_devices(files, node_ids, common_entry) if files else None
    if plant is not None and plant.bus and settings.named_bus() is None:
        settings.bus = plant.bus
    bus = settings.required_bus("-b udp_multicast               another terminal of this computer can join")
    locator = DEMO_LOCATOR if bus == DEMO else bus
    tell = _event_teller(screen)

    def devices() -> tuple[str, AbstractAsyncContextManager[SimulatedDevices]]:
        if plant is None:
            ids = node_ids or DEFAULT_IDS
            if boot_loader:
                how = BootLoaderSettings(holds_clear=hold_clear)
                how = how if erase_time is None else replace(how, erase_time=erase_time)
                loaders = [partial(BootLoader, node_id=node_id, settings=how) for node_id in ids]
                return counted(len(ids), "boot loader"), simulated_devices({locator: loaders}, tell)
            drives = [(locator, node_id) for node_id in ids]
            make = partial(drive_maker, shape=Shape(shape or "schunk"), sync_tolerance=SYNC_TOLERANCE)  # the master is elsewhere
            block = simulated_drives(drives, on_event=tell, make=make, keeper=_keeper(state or ""))
            return counted(len(ids), "simulated drive"), block
        made = models_of(plant.devices, teller(screen))
        keeper = _keeper(state or plant.state)
        what = counted(len(made), "simulated device")
        return what, simulated_devices({locator: made}, tell, keeper=keeper, say=partial(_report, screen))

    async def serve() -> None:
        what, block = devices()
        async with block as served:
            screen.say(f"[bold]{what} on {escape(bus)}[/], {until_text(seconds)}")
            if locator.startswith("virtual:"):
                screen.say("That bus ends with this process: with -b udp_multicast another terminal can join.")
            if settings.json:
                screen.json({"bus": locator, "nodes": served.node_ids})
            await trio.sleep(seconds)

    run_until_interrupted(settings, screen, serve, devices=True)


def _serve_machine(settings: Settings, screen: Screen, machine: MachineFile, state: str | None, seconds: float) -> None:
    """Serve the devices of a machine until Ctrl-C, or for some seconds."""
    by_bus = devices_of_machine(machine, buses_of(machine, settings), settings.overlays, teller(screen))
    keeper = _keeper(state or machine.beside(machine.state))

    async def serve() -> None:
        async with simulated_devices(dict(by_bus.values()), _event_teller(screen), keeper=keeper, say=partial(_report, screen)):
            for name, (locator, made) in by_bus.items():
                screen.say(f"[bold]{counted(len(made), 'simulated device')} on {escape(name)}[/], {escape(locator)}")
            if settings.json:
                screen.json({name: locator for name, (locator, _) in by_bus.items()})
            await trio.sleep(seconds)

    run_until_interrupted(settings, screen, serve, devices=True)


def _report(screen: Screen, text: str) -> None:
    screen.warn(f"[yellow]{escape(text)}[/]")


def _event_teller(screen: Screen) -> Callable[[Event], None]:
    """Tell what happens to the devices."""

    def tell(event: Event) -> None:
        match event:
            case NmtStateChanged(node_id=node_id, state=state):
                screen.say(f"{node_text(node_id)}  NMT {state.name.lower().replace('_', '-')}")
            case LssNodeIdSet(node_id=node_id, pending=pending):
                who = node_text(node_id) if node_id else "a device without a node-ID"
                given = "none" if pending == UNCONFIGURED else str(pending)
                screen.say(f"{who}  LSS gives it the node-ID {given}")
            case ProgramErased(node_id=node_id):
                screen.say(f"{node_text(node_id)}  erases its program")
            case ProgramWritten(node_id=node_id, error=error, size=size):
                verdict = f"[red]{FlashStatus(False, error).text}[/]" if error else "it is right"
                screen.say(f"{node_text(node_id)}  has got a program of {size} bytes: {verdict}")
            case ProgramStarted(node_id=node_id, identification=identification):
                screen.say(f"{node_text(node_id)}  runs the program 0x{identification:08X}")
            case DriveStateChanged(node_id=node_id, state=state):
                screen.say(f"{node_text(node_id)}  {state}")
            case DeviceCodeFailed(node_id=node_id, function=function, error=error):
                what = escape(f"{function}: {type(error).__name__}: {error}")
                screen.say(f"{node_text(node_id)}  [red]its code failed in {what}[/]")
            case DriveFault(node_id=node_id, error_code=code):
                screen.say(f"{node_text(node_id)}  [red]fault 0x{code:04X} {error_text(code)}[/]")

    return tell


def _keeper(path: str) -> ParameterKeeper:
    return ParameterKeeper(Path(path) if path else None)
