"""Sequences over the machines, without I/O: what a procedure is, and those of the product.

    steps.py           what a procedure is made of: upload, download, sleep, wait_for_event, all_of
    runner.py          `Runner`, which runs them; `Network.run` is the usual way in
    streams.py         read and write what nobody holds whole: firmware images, recordings
    objects.py         read and write a node's objects by name and value
    drive/             the manual's sequences for a CiA 402 drive: homing, interpolation, halt ...
    identity.py        what a drive is, by its vendor-ID; limits.py: what it says of its limits
    following.py       what no PDO brings of a drive that follows set-points, and its limit
    grip.py            a drive that stops by itself when its master is gone
    configure_pdo.py   `define_pdo` and what it is made of
    described_pdos.py  the PDOs of a device's file; device_pdos.py: as the device has them set up
    scan.py            who is on the bus
    backup.py          read all that a node holds; walk.py: of one of which nobody knows what it has
    restore.py         set a node to given values, in the order that CiA 302 asks for

Import from these modules.
"""
