"""Show where devices are; nothing moves: the 2012 library's getpos.

python -m canopen_cli.demos.getpos 12
python -m canopen_cli.demos.getpos 3 4 5 --bus virtual
"""

import sys
from collections.abc import Sequence

from canopen_cli.demos.running import Options, check, parse, run
from canopen_master import direct as canopen

USAGE = "Please call the program with the CAN deviceID, e.g. './getpos 12'"


def show(options: Options) -> None:
    check(canopen.open_connection(options.bus), "Cannot open CAN device; aborting.")
    canopen.init_listener_thread()
    for device in options.node_ids:
        print(f"device {device} is at {canopen.get_pos(device)} mdeg")
    canopen.close_connection()


def main(arguments: Sequence[str] | None = None) -> int:
    return run(show, lambda: parse(arguments, str(__doc__), USAGE))


if __name__ == "__main__":
    sys.exit(main())
