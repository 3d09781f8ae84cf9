"""`canopen jog`: the joints of a chain move while a key is held."""

from __future__ import annotations

import math
import sys
from importlib.util import find_spec
from pathlib import Path

import click
import trio

from canopen_cli.motion.chain_session import ChosenChains, choose_chains, open_chains
from canopen_cli.motion.record_option import check_record, record_option, recorded
from canopen_cli.motion.view import DemoView, JointView, ViewStep
from canopen_cli.shared.named_machine import machine_argument, machine_of
from canopen_cli.shared.options import FiniteRange, Settings, command, enabling, without_dry_run
from canopen_cli.shared.problem import usage
from canopen_cli.shared.running import run
from canopen_cli.shared.screen import Screen, counted
from canopen_cli.shared.terminal_keys import END, LEFT, RIGHT, TerminalKeys, key_by_key, read_terminal
from canopen_master.motion.chain import Chain
from canopen_master.trajectories.scaled_joints import load_ruckig

WAYS = {RIGHT: 1.0, "+": 1.0, LEFT: -1.0, "-": -1.0}
REFRESH = 0.2
"""Seconds between two updates of what is shown while a joint moves."""
ENDS = ("q", "\x1b", END)


@command()
@machine_argument
@click.option("--chain", metavar="NAME", help="Which chain of the machine.  [default: the first]")
@click.option("--home", is_flag=True, help="Home the joints first that have no reference.")
@click.option(
    "--speed",
    type=FiniteRange(0.01, 1),
    default=0.1,
    show_default=True,
    help="The share of each speed limit that is used.",
)
@record_option
@without_dry_run("what it sends is as long as a key is held", "canopen move --dry-run")
@enabling
def jog(
    settings: Settings, screen: Screen, file: Path | None, chain: str | None, home: bool, speed: float, record: Path | None
) -> None:
    """Move joints of a chain by keys, as long as a key is held. THEY MOVE.

    1 to 9 choose a joint. The cursor keys right and left (or + and -) move it, from their first repetition on: a tap moves
    nothing. It brakes within its limits when the key is released, that is, once 0.15 s have passed without a repetition; at
    another key, at Ctrl-C, and when the terminal is gone. It also brakes before the limits of its position. q ends, and takes the
    power away. Needs ruckig.

    \b
    canopen jog -b demo                        a simulated arm
    canopen jog cell.toml --speed 0.05
    """
    if settings.json:
        raise usage("CO123", "a jog has no JSON", seen="it goes on as long as keys are held", tries=("canopen move --json",))
    machine_of(settings, file)
    chosen = choose_chains(settings, *([] if chain is None else [chain]))
    if not is_terminal():
        raise usage("CO122", "a jog needs a terminal, whose keys are held", seen="nothing was sent", tries=("canopen move",))
    load_ruckig("jogging")  # told before anything has power
    check_record(settings, screen, record)
    jogging = _Jogging(settings, screen, chosen, home, speed)
    with key_by_key():
        run(settings, screen, lambda: jogging.run(record), story=jogging.story)


def is_terminal() -> bool:
    """Return whether keys come from a terminal, of a system that tells when it is gone (not Windows)."""
    return sys.stdin.isatty() and find_spec("termios") is not None


class _Jogging:
    """One run of the command."""

    def __init__(self, settings: Settings, screen: Screen, chosen: ChosenChains, home: bool, speed: float) -> None:
        self.settings, self.screen, self.chosen = settings, screen, chosen
        self.home, self.speed = home, speed
        self._joint = 0

    async def run(self, record: Path | None) -> None:
        """Open the machine, and follow the keys until they end."""
        async with open_chains(self.settings, self.chosen) as (_, group):
            (arm,) = group.chains
            with DemoView(self.screen, f"{arm.name}: {counted(len(arm.devices), 'joint')}", range=180) as view:
                view.joints = [JointView(device.name, device.node.node_id) for device in arm.devices]
                await arm.initialise()
                if self.home:
                    await arm.home(if_needed=True)
                await arm.follow()
                self.screen.say(f"1 to {min(9, len(arm.devices))}: choose a joint; hold → or ←: move it; q: end")
                async with recorded(self.settings, self.screen, arm, record):
                    await self._follow_keys(arm, TerminalKeys(read_terminal), view)
                await arm.shut_down()

    async def _follow_keys(self, arm: Chain, keys: TerminalKeys, view: DemoView) -> None:
        step = view.begin("jog", "")
        while True:
            self._show(arm, view, step, "stands")
            key = await keys.next()
            if key in ENDS:
                view.done(step, "ended")
                return
            if key.isdigit() and 0 < int(key) <= len(arm.devices):
                self._joint = int(key) - 1
            elif key in WAYS and await keys.is_held(key):
                await self._move(arm, keys, key, view, step)

    async def _move(self, arm: Chain, keys: TerminalKeys, key: str, view: DemoView, step: ViewStep) -> None:
        """Move the chosen joint as long as its key is held."""
        velocities = [0.0] * len(arm.devices)
        async with arm.jog() as jogging:
            velocities[self._joint] = WAYS[key] * self.speed * arm.devices[self._joint].limits.speed.value
            held = True
            shown = -math.inf
            while held:
                jogging.velocity(velocities)
                if trio.current_time() - shown >= REFRESH:  # keys come faster, and drawing delays the cycle
                    self._show(arm, view, step, "moves")
                    shown = trio.current_time()
                held = await keys.is_still_held(key)

    def _show(self, arm: Chain, view: DemoView, step: ViewStep, doing: str) -> None:
        device = arm.devices[self._joint]
        step.text = f"{device.name} {doing}"
        for joint, each in zip(view.joints, arm.devices, strict=True):
            joint.state, joint.position = str(each.state), each.position
        view.refresh()

    def story(self, confirmed: bool) -> list[str]:
        """Tell what was done if it was interrupted."""
        halted = "halted" if confirmed else "told to halt"
        return [f"the joints braked and were {halted}; `canopen drive disable NODE` takes the power"]
