"""Move one device as long as a key is held: the 2012 library's moveUntilUserInterrupt.

python -m canopen_cli.demos.move_until_user_interrupt 12
python -m canopen_cli.demos.move_until_user_interrupt 12 --speed -2000 --bus virtual

The old one moved until Return was pressed, also if its user had gone. This one moves while any key is held.
"""

import sys
from collections.abc import Callable, Sequence

from canopen_cli.demos.keys import ENDS, held_keys
from canopen_cli.demos.running import Options, check, make_ready, parse, run, shut_down
from canopen_master import direct as canopen

USAGE = "Please call the program with the CAN deviceID, e.g. './move_until_user_interrupt 12'"

SPEED = 5000.0  # millidegrees per second, as in 2012

Move = Callable[[int, float, Callable[[], bool]], bool]


def move(options: Options) -> None:
    lead(options, canopen.move_until_user_interrupt)


def lead(options: Options, function: Move) -> None:
    """Wait until a key is held; call `function` with what tells how long it is held."""
    (device,) = options.node_ids
    with held_keys() as keys:
        make_ready(options)
        print(f"device {device} is at {canopen.get_pos(device)} mdeg; hold a key: it moves; q: end")
        while (key := keys.next()) not in ENDS:
            if keys.is_held(key):
                check(function(device, options.speed, keys.holder(key)), f"Device {device} could not be moved; aborting.")
                break
    print(f"device {device} ends at {canopen.get_pos(device)} mdeg")
    shut_down(options)


def main(arguments: Sequence[str] | None = None) -> int:
    return run(move, lambda: parse(arguments, str(__doc__), USAGE, most=1, speed=SPEED))


if __name__ == "__main__":
    sys.exit(main())
