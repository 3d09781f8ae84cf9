"""Home one device and move it, with the master's thread: the manual's demo/canopenmaster_single_device.

    python -m canopen_cli.demos.canopenmaster_single_device
    python -m canopen_cli.demos.canopenmaster_single_device --bus virtual

The device is that of the chain file single_device.csv, `chain1 joint1 /dev/pcan32 12`, unless another ID is given.
"""

import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

from canopen_cli.demos.running import Options, check, parse, run
from canopen_master import direct as canopen

USAGE = "Please call the program with one CAN deviceID at most, e.g. './canopenmaster_single_device 12'"

SPEED = 10_000  # millidegrees per second
INTERVAL = 0.01  # seconds, as the master's cycle


def serve(options: Options, name: str = "chain1", file: str = "single_device.csv", devices: Sequence[int] = (12,)) -> None:
    """Run the master. It does not need the main thread, and any number of clients may call its chains.

    name: of the chain. file: of the chain of `devices`.
    """
    canopen.using_master_thread = True
    if options.node_ids == tuple(devices):
        canopen.init_chain_map(file)
    else:
        joints = [f"joint{number} /dev/pcan32 {device}" for number, device in enumerate(options.node_ids, start=1)]
        canopen.init_chain_map(text=f"{name} {' '.join(joints)}")
    check(canopen.open_connection(options.bus), "Cannot open CAN device; aborting.")
    canopen.init_nmt()
    canopen.init_listener_thread()
    canopen.init_incoming_pdo_processor_thread()
    canopen.init_master_thread()

    client = ThreadPoolExecutor(max_workers=1).submit(command, options, name)
    while not client.done():
        time.sleep(INTERVAL)
    client.result()  # raises what made the client fail
    canopen.close_connection()


def command(options: Options, name: str) -> None:
    """Run a client in a thread of its own."""
    chain = canopen.chain_map[name]
    check(chain.init(), "The chain could not be initialized; aborting.")
    print(f"homing {', '.join(chain.joints)}")
    check(chain.homing(), "Homing was not successful; aborting.")
    check(chain.ip_mode(), "The chain could not be put into IP mode; aborting.")
    start = chain.get_current_pos()
    print(f"referenced, at {start} mdeg")
    time.sleep(options.pause)

    duration = options.steps * INTERVAL
    end = [position + round(SPEED * duration) for position in start]
    for cycle in chain.cycles():  # this time waits for a late client, so the path never jumps
        now = min(cycle.time, duration)
        chain.set_pos([position + round(SPEED * now) for position in start])
        if cycle.time >= duration + 5 * INTERVAL:  # the last set-points are reached two cycles later
            break
    print(f"sent to {end} mdeg, ends at {chain.get_current_pos()} mdeg")
    check(chain.shut_down(), "The chain could not be shut down.")


def main(arguments: Sequence[str] | None = None) -> int:
    return run(serve, lambda: parse(arguments, str(__doc__), USAGE, ids=("12",), most=1, steps=500, pause=4.0))


if __name__ == "__main__":
    sys.exit(main())
