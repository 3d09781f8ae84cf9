"""Home the devices of an arm and move them all, with the master's thread: the 2012 library's canopenmaster_multiple_devices.

    python -m canopen_cli.demos.canopenmaster_multiple_devices
    python -m canopen_cli.demos.canopenmaster_multiple_devices 3 4 --bus virtual

The devices are those of the chain file multiple_devices.csv, 3 to 8, unless other IDs are given.
"""

import sys
from collections.abc import Sequence

from canopen_cli.demos.canopenmaster_single_device import serve
from canopen_cli.demos.running import Options, parse, run

USAGE = "Please call the program with the CAN deviceIDs, e.g. './canopenmaster_multiple_devices 3 4 5 6 7 8'"

DEVICES = (3, 4, 5, 6, 7, 8)


def serve_arm(options: Options) -> None:
    serve(options, "arm1", "multiple_devices.csv", DEVICES)


def main(arguments: Sequence[str] | None = None) -> int:
    ids = [str(device) for device in DEVICES]
    return run(serve_arm, lambda: parse(arguments, str(__doc__), USAGE, ids=ids, steps=500, pause=4.0))


if __name__ == "__main__":
    sys.exit(main())
