"""Lead one device to its home position by holding a key: the 2012 library's interactiveHoming.

python -m canopen_cli.demos.interactive_homing 12
python -m canopen_cli.demos.interactive_homing 12 --speed -500 --bus virtual

When the key is released, the device homes: a drive of CiA 402 takes the place where it stands as its home position. Schunk's
joints have no such method; they home in their own way, and MOVE AGAIN.
"""

import sys
from collections.abc import Sequence

from canopen_cli.demos.move_until_user_interrupt import lead
from canopen_cli.demos.running import Options, parse, run
from canopen_master import direct as canopen

USAGE = "Please call the program with the CAN deviceID, e.g. './interactive_homing 12'"

SPEED = 500.0  # millidegrees per second, as in 2012


def home(options: Options) -> None:
    lead(options, canopen.interactive_homing)


def main(arguments: Sequence[str] | None = None) -> int:
    return run(home, lambda: parse(arguments, str(__doc__), USAGE, most=1, speed=SPEED))


if __name__ == "__main__":
    sys.exit(main())
