"""The demonstration: the joints of a chain, simulated or real, boot, home and swing; `canopen demo` shows it.

task.py       `DemonstrationTask`: which chain moves, on which buses, with which drives and settings
run.py        `Demonstration`: one run of it, and the events by which it tells how far it is
swing.py      `SwingPath`: the path of the joints
recording.py  `Recording`: where the joints were, for a picture
"""
