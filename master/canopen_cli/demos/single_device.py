"""Home one device and move it to and fro: the manual's demo/single_device.

python -m canopen_cli.demos.single_device 12
python -m canopen_cli.demos.single_device 12 --bus virtual
"""

import sys
from collections.abc import Sequence

from canopen_cli.demos.running import Options, check, make_ready, parse, run, shut_down
from canopen_master import direct as canopen

USAGE = "Please call the program with the CAN deviceID, e.g. './single_device 12'"

STEP = 100  # millidegrees a SYNC: 10 degrees per second
INTERVAL = 10  # milliseconds from SYNC to SYNC


def move(options: Options) -> None:
    (device,) = options.node_ids
    make_ready(options)

    print(f"homing device {device}")
    check(canopen.homing(device), f"Homing of device {device} was not successful; aborting.")
    check(canopen.enable_ip_mode(device), f"Device {device} could not be put into IP mode; aborting.")
    canopen.send_sync(INTERVAL)
    canopen.send_sync(INTERVAL)

    position = canopen.get_pos(device)
    print(f"device {device} is referenced, at {position} mdeg")
    for cycle in range(1, options.cycles + 1):
        for step in (STEP, -STEP):
            for _ in range(options.steps):
                position += step
                canopen.send_pos(device, position)
                canopen.send_sync(INTERVAL)
            print(f"cycle {cycle}: sent to {position} mdeg")
    for _ in range(3):  # the device reaches a set-point one interval after the SYNC that it took it at
        canopen.send_pos(device, position)
        canopen.send_sync(INTERVAL)
    print(f"device {device} ends at {canopen.get_pos(device)} mdeg")

    shut_down(options)


def main(arguments: Sequence[str] | None = None) -> int:
    return run(move, lambda: parse(arguments, str(__doc__), USAGE, most=1, cycles=2, steps=500))


if __name__ == "__main__":
    sys.exit(main())
