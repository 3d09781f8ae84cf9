"""Move one device faster and faster, on at that speed, and slower again to rest: the 2012 library's move_device.

python -m canopen_cli.demos.move_device 12
python -m canopen_cli.demos.move_device 12 --speed -5000 --bus virtual
"""

import sys
from collections.abc import Sequence

from canopen_cli.demos.running import Options, check, make_ready, parse, run, shut_down
from canopen_master import direct as canopen

USAGE = "Please call the program with the CAN deviceID, e.g. './move_device 12'"

INTERVAL = 10  # milliseconds from SYNC to SYNC


def move(options: Options) -> None:
    (device,) = options.node_ids
    make_ready(options)
    check(canopen.enable_ip_mode(device), f"Device {device} could not be put into IP mode; aborting.")
    canopen.send_sync(INTERVAL)
    canopen.send_sync(INTERVAL)

    start = position = canopen.get_pos(device)
    print(f"device {device} is at {start} mdeg")
    faster = [step / options.steps for step in range(1, options.steps + 1)]
    for name, parts in (("faster", faster), ("on", [1.0] * options.steps), ("slower", faster[::-1]), ("rest", [0.0] * 3)):
        for part in parts:
            position += part * options.speed * INTERVAL / 1000
            canopen.send_pos(device, round(position))
            canopen.send_sync(INTERVAL)
        print(f"{name}: sent to {round(position)} mdeg, at {parts[-1] * options.speed:.0f} mdeg/s")
    print(f"device {device} ends at {canopen.get_pos(device)} mdeg")
    shut_down(options)


def main(arguments: Sequence[str] | None = None) -> int:
    return run(move, lambda: parse(arguments, str(__doc__), USAGE, most=1, steps=100, speed=10_000.0))


if __name__ == "__main__":
    sys.exit(main())
