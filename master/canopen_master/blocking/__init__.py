"""A CANopen master for scripts, notebooks and threads: all of the async one, in plain calls.

    with open_master("socketcan:can0") as master:
        node = master.node(5, "drive.eds")
        node["producer_heartbeat_time"] = 500
        node.on(EmcyReceived, print)
        arm = master.load_chains("single_device.csv")["chain1"]
        arm.initialise()
        arm.home()

It runs the async master in a thread of its own. docs/blocking.md has the rules: threads, timeouts, Ctrl-C, callbacks, the end.

classes.py         what users hold; made from the async classes by docs/blocking_classes.py
twin.py            their bases, and how a master is opened
callbacks.py       the thread in which `on` calls
background.py      calls from all threads into a context that is held in the loop
loop_thread.py     the thread of the loop
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_master.blocking.callbacks import Handler as Handler
    from canopen_master.blocking.classes import BlockingChain as BlockingChain
    from canopen_master.blocking.classes import BlockingCycles as BlockingCycles
    from canopen_master.blocking.classes import BlockingDevice as BlockingDevice
    from canopen_master.blocking.classes import BlockingDriveCommissioning as BlockingDriveCommissioning
    from canopen_master.blocking.classes import BlockingJog as BlockingJog
    from canopen_master.blocking.classes import BlockingMaster as BlockingMaster
    from canopen_master.blocking.classes import BlockingMoving as BlockingMoving
    from canopen_master.blocking.classes import BlockingNode as BlockingNode
    from canopen_master.blocking.classes import BlockingProgresses as BlockingProgresses
    from canopen_master.blocking.classes import BlockingReadStream as BlockingReadStream
    from canopen_master.blocking.classes import BlockingRecorder as BlockingRecorder
    from canopen_master.blocking.classes import BlockingSimulatedDevices as BlockingSimulatedDevices
    from canopen_master.blocking.classes import BlockingSubscription as BlockingSubscription
    from canopen_master.blocking.classes import BlockingTargets as BlockingTargets
    from canopen_master.blocking.classes import BlockingTogether as BlockingTogether
    from canopen_master.blocking.classes import boot_network as boot_network
    from canopen_master.blocking.classes import open_master as open_master
    from canopen_master.blocking.classes import simulated_devices as simulated_devices
    from canopen_master.blocking.classes import simulated_drives as simulated_drives
    from canopen_master.blocking.classes import together as together
else:
    from canopen_proto.lazy_names import lazy_names

    __getattr__, __dir__ = lazy_names(globals())
