"""Move one device by keys: hold + or -, and q ends: the 2012 library's move_single_device.

python -m canopen_cli.demos.move_single_device 12
python -m canopen_cli.demos.move_single_device 12 --bus virtual

It moves from the first repetition of a key on, and brakes when the key is released: see `canopen jog`.
"""

import sys
from collections.abc import Sequence

from canopen_cli.demos.keys import ENDS, held_keys
from canopen_cli.demos.running import Options, check, make_ready, parse, run, shut_down
from canopen_master import direct as canopen

USAGE = "Please call the program with the CAN deviceID, e.g. './move_single_device 12'"

DIRECTIONS = {"+": 1, "-": -1}


def move(options: Options) -> None:
    (device,) = options.node_ids
    with held_keys() as keys:
        make_ready(options)
        print(f"device {device} is at {canopen.get_pos(device)} mdeg; hold + or -: it moves; q: end")
        while (key := keys.next()) not in ENDS:
            if key in DIRECTIONS and keys.is_held(key):
                speed = DIRECTIONS[key] * options.speed
                moved = canopen.move_until_user_interrupt(device, speed, keys.holder(key))
                check(moved, f"Device {device} could not be moved; aborting.")
                print(f"device {device} is at {canopen.get_pos(device)} mdeg")
    shut_down(options)


def main(arguments: Sequence[str] | None = None) -> int:
    return run(move, lambda: parse(arguments, str(__doc__), USAGE, most=1, speed=5000.0))


if __name__ == "__main__":
    sys.exit(main())
