"""Ask one device again and again, and show how much memory that leaves behind; nothing moves: the 2012 library's memtest.

python -m canopen_cli.demos.memtest 12
python -m canopen_cli.demos.memtest 12 --steps 10000 --bus virtual
"""

import sys
import tracemalloc
from collections.abc import Sequence

from canopen_cli.demos.running import Options, check, parse, run
from canopen_master import direct as canopen

USAGE = "Please call the program with the CAN deviceID, e.g. './memtest 12'"


def test(options: Options) -> None:
    (device,) = options.node_ids
    check(canopen.open_connection(options.bus), "Cannot open CAN device; aborting.")
    canopen.init_listener_thread()
    ask(device, options.steps)  # bounded queues and caches fill
    tracemalloc.start()
    ask(device, options.steps)
    left, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    print(f"{options.steps} answers of device {device}: {left / 1024:.0f} KiB are left behind, {most / 1024:.0f} KiB at most")
    canopen.close_connection()


def ask(device: int, times: int) -> None:
    for _ in range(times):
        canopen.send_sdo(device, "statusword")


def main(arguments: Sequence[str] | None = None) -> int:
    return run(test, lambda: parse(arguments, str(__doc__), USAGE, most=1, steps=1000))


if __name__ == "__main__":
    sys.exit(main())
