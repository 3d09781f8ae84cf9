"""CiA 402, drives and motion control: both sides of the profile.

    states.py            the state machine as one table, and the way through it       both sides
    modes.py             modes of operation, their bits, texts                        both sides
    objects.py           the objects' multiplexers                                    both sides
    motion.py            closed-form motion profiles
    names.py             words for the values of a drive's objects
    drive.py             `Drive`: a simulated drive                                   the drive's side
    drive_events.py      the events of a simulated drive
    late_drive.py        a drive that acts late, as real ones do
    drive_modes.py       its profile position and velocity modes
    synchronous_modes.py its ip and csp modes: a set-point at each SYNC
    homing_run.py        its homing
    servo.py             its mechanics: track, lag, limits
    drive_dictionary.py  its object dictionary, in two shapes
    drive_node.py        `DriveNode`: the simulated drive on the bus

The master's side of a drive is in `canopen_proto.drive`. Import from these modules: neither side needs the other.
"""
