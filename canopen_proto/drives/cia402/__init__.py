"""CiA 402, drives and motion control: the facts that both sides of the profile share.

    states.py        the state machine as one table, and the way through it
    modes.py         modes of operation, their bits, texts
    option_codes.py  how a drive stops, and on what
    objects.py       the objects' multiplexers
    drive_bit.py     where makers show what has no object
    names.py         words for the values of a drive's objects

The master's side of a drive is in `canopen_proto.drives.axis`, the device's side in
`canopen_proto.simulation.drive`. Neither needs the other.
"""
