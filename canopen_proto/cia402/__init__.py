"""CiA 402, drives and motion control: both sides of the profile.

    states.py            the state machine as one table, and the way through it       both sides
    modes.py             modes of operation, their bits, texts                        both sides
    objects.py           the objects' multiplexers                                    both sides
    motion.py            closed-form motion profiles
    names.py             words for the values of a drive's objects
    axis.py              `Axis`: a drive as its master sees it                        the master's side
    limits.py            what an axis must not be asked for by set-points
    following.py         `Following`: whether a drive follows its set-points
    drive.py             `Drive`: a simulated drive                                   the drive's side
    late_drive.py        a drive that acts late, as real ones do
    drive_modes.py       what it does in pp and the velocity modes
    synchronous_modes.py what it does in ip and csp: a set-point at each SYNC
    homing_run.py        how it homes
    servo.py             its mechanics: track, lag, limits
    drive_dictionary.py  its object dictionary, in two shapes
    drive_from_file.py   the drive behind the dictionary of a real one's file
    drive_node.py        `DriveNode`: it on the bus

Import from these modules: the master's side and the drive's need nothing of each other.
"""
