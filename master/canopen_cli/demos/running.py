"""The common part of the demos: their arguments, how they fail, and that they always end with the drives halted."""

from __future__ import annotations

import argparse
import contextlib
import signal
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from canopen_cli.shared.failures import problem_of
from canopen_cli.shared.options import node_id_of
from canopen_cli.shared.problem import ExitCode
from canopen_master import direct as canopen
from canopen_master.plain_text import clean_lines


@dataclass(frozen=True)
class Options:
    """The arguments of a demo. cycles, steps: how often and how far it moves; pause: seconds before that; speed: millidegrees per
    second."""

    node_ids: tuple[int, ...]
    bus: str
    cycles: int
    steps: int
    pause: float
    speed: float = 0.0


class StepFailedError(Exception):
    """A step of a demo that did not succeed; __cause__ is the reason."""


def check(succeeded: bool, otherwise: str) -> None:
    """Go on if a call returned True; else end the demo with these words and the reason."""
    if not succeeded:
        raise StepFailedError(otherwise) from canopen.last_error()


def make_ready(options: Options) -> None:
    """Open the bus and lead its devices to Operation enabled."""
    check(canopen.open_connection(options.bus), "Cannot open CAN device; aborting.")
    canopen.init_listener_thread()
    for device in options.node_ids:
        check(canopen.fault_reset(device), f"The fault of device {device} could not be reset; aborting.")
    canopen.init_nmt()
    for device in options.node_ids:
        check(canopen.init_device(device), f"Device {device} could not be initialized; aborting.")


def shut_down(options: Options) -> None:
    """Engage the brakes, take the power away, and close the bus."""
    for device in options.node_ids:
        canopen.enable_brake(device)
        canopen.shutdown_device(device)
    canopen.close_connection()


def parse(
    arguments: Sequence[str] | None,
    about: str,
    usage: str,
    *,
    ids: Sequence[str] = (),
    most: int = 127,
    cycles: int | None = None,
    steps: int | None = None,
    pause: float | None = None,
    speed: float | None = None,
) -> Options | None:
    """Parse the arguments of a demo; print `usage` and return None if there are no node-IDs, or more than `most`. Raises
    CommandError.

    ids: the default node-IDs. cycles, steps, pause, speed: the defaults; None if the demo does not have the option.
    """
    parser = argparse.ArgumentParser(description=about.splitlines()[0], epilog=usage)
    parser.add_argument("ids", metavar="ID", nargs="*", help="CAN device ID, decimal")
    parser.add_argument("--bus", default="/dev/pcan32", help="virtual, socketcan:can0 ... (default: %(default)s)")
    if cycles is not None:
        parser.add_argument("--cycles", type=_count, help=f"how often it moves to and fro (default: {cycles})")
    if steps is not None:
        parser.add_argument("--steps", type=_count, help=f"set-points of one way (default: {steps})")
    if pause is not None:
        parser.add_argument("--pause", type=float, help=f"seconds before it moves (default: {pause:g})")
    if speed is not None:
        parser.add_argument("--speed", type=float, help=f"millidegrees per second; below 0 the other way (default: {speed:g})")
    parser.set_defaults(cycles=cycles or 0, steps=steps or 0, pause=pause or 0.0, speed=speed or 0.0)
    given = parser.parse_args(arguments)
    chosen = given.ids or ids
    if not 1 <= len(chosen) <= most:
        print(usage)
        return None
    node_ids = dict.fromkeys(map(node_id_of, chosen))
    return Options(tuple(node_ids), given.bus, given.cycles, given.steps, given.pause, given.speed)


def _count(text: str) -> int:
    count = int(text)
    if count < 1:
        raise argparse.ArgumentTypeError(f"{text} is less than 1")
    return count


def run(demo: Callable[[Options], None], read_options: Callable[[], Options | None]) -> int:
    """Run a demo to its end and return the exit status. On a virtual bus, drives are simulated for its node-IDs."""
    with contextlib.suppress(ValueError):  # not the main thread
        signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    try:
        options = read_options()
        if options is None:
            return ExitCode.USAGE
        with contextlib.ExitStack() as stack:
            stack.callback(canopen.close_connection)  # halts the drives
            if options.bus.partition(":")[0] == "virtual":
                stack.enter_context(canopen.simulated(options.node_ids, bus=options.bus))
            demo(options)
    except KeyboardInterrupt:
        print("interrupted; the drives are halted", file=sys.stderr)
        return ExitCode.INTERRUPTED
    except Exception as error:  # noqa: BLE001 - any error becomes one screen
        reason = error.__cause__ if isinstance(error, StepFailedError) and error.__cause__ is not None else error
        if isinstance(error, StepFailedError):
            print(clean_lines(str(error)), file=sys.stderr)
        problem = problem_of(reason)
        print(clean_lines(str(problem)), file=sys.stderr)
        return problem.exit_code
    return ExitCode.OK
