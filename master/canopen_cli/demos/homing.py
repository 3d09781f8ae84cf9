"""Home one device: the manual's demo/homing.

python -m canopen_cli.demos.homing 12
python -m canopen_cli.demos.homing 12 --bus virtual
"""

import sys
from collections.abc import Sequence

from canopen_cli.demos.running import Options, check, make_ready, parse, run, shut_down
from canopen_master import direct as canopen

USAGE = "Please call the program with the CAN deviceID, e.g. './homing 12'"


def home(options: Options) -> None:
    (device,) = options.node_ids
    make_ready(options)

    print(f"homing device {device}")
    check(canopen.homing(device), f"Homing of device {device} was not successful; aborting.")
    print(f"device {device} is referenced, at {canopen.get_pos(device)} mdeg")

    shut_down(options)


def main(arguments: Sequence[str] | None = None) -> int:
    return run(home, lambda: parse(arguments, str(__doc__), USAGE, most=1))


if __name__ == "__main__":
    sys.exit(main())
