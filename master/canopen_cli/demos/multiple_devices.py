"""Home the devices of an arm and move them all to and fro: the manual's demo/multiple_devices.

python -m canopen_cli.demos.multiple_devices 3 4 5 6 7 8
python -m canopen_cli.demos.multiple_devices 3 4 5 6 7 8 --bus virtual
"""

import sys
from collections.abc import Sequence

from canopen_cli.demos.running import Options, check, make_ready, parse, run, shut_down
from canopen_master import direct as canopen

USAGE = "Please call the program with the CAN deviceIDs, e.g. './multiple_devices 3 4 5 6 7 8'"

STEP = 35  # millidegrees a SYNC
INTERVAL = 10  # milliseconds from SYNC to SYNC


def move(options: Options) -> None:
    devices = options.node_ids
    make_ready(options)
    for device in devices:
        print(f"homing device {device}")
        check(canopen.homing(device), f"Homing of device {device} was not successful; aborting.")
    for device in devices:
        check(canopen.enable_ip_mode(device), f"Device {device} could not be put into IP mode; aborting.")
    canopen.send_sync(INTERVAL)
    canopen.send_sync(INTERVAL)

    seconds = options.cycles * (2 * options.steps + 1) * INTERVAL / 1000
    print(f"moving to and fro for {seconds:.1f} s; Ctrl-C ends it and halts all devices")
    positions = {device: canopen.get_pos(device) for device in devices}
    for cycle in range(1, options.cycles + 1):
        send(positions, STEP, options.steps + 1)
        send(positions, -STEP, options.steps)
        print(f"cycle {cycle}: sent to {', '.join(map(str, positions.values()))} mdeg")
    send(positions, 0, 3)  # the device reaches a set-point one interval after the SYNC that it took it at
    for device in devices:
        print(f"device {device} ends at {canopen.get_pos(device)} mdeg")

    shut_down(options)


def send(positions: dict[int, float], step: int, steps: int) -> None:
    for _ in range(steps):
        for device in positions:
            positions[device] += step
            canopen.send_pos(device, positions[device])
        canopen.send_sync(INTERVAL)


def main(arguments: Sequence[str] | None = None) -> int:
    return run(move, lambda: parse(arguments, str(__doc__), USAGE, cycles=10, steps=300))


if __name__ == "__main__":
    sys.exit(main())
