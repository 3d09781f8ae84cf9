"""Home one device: the manual's demo/homing.

python -m canopen_cli.demos.homing 12
python -m canopen_cli.demos.homing 12 --bus virtual
"""

import sys
from collections.abc import Sequence

from canopen_cli.demos.running import Options, check, parse, run
from canopen_master import direct as canopen

USAGE = "Please call the program with the CAN deviceID, e.g. './homing 12'"


def home(options: Options) -> None:
    (device,) = options.node_ids
    check(canopen.open_connection(options.bus), "Cannot open CAN device; aborting.")
    canopen.init_listener_thread()
    check(canopen.fault_reset(device), f"The fault of device {device} could not be reset; aborting.")
    canopen.init_nmt()
    check(canopen.init_device(device), f"Device {device} could not be initialized; aborting.")

    print(f"homing device {device}")
    check(canopen.homing(device), f"Homing of device {device} was not successful; aborting.")
    print(f"device {device} is referenced, at {canopen.get_pos(device)} mdeg")

    canopen.enable_brake(device)
    canopen.shutdown_device(device)
    canopen.close_connection()


def main(arguments: Sequence[str] | None = None) -> int:
    return run(home, lambda: parse(arguments, str(__doc__), USAGE, most=1))


if __name__ == "__main__":
    sys.exit(main())
