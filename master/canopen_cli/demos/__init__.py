"""The manual's four demos: short files to read first, with `canopen_master.direct`.

    python -m canopen_cli.demos.homing 12
    python -m canopen_cli.demos.single_device 12
    python -m canopen_cli.demos.multiple_devices 3 4 5 6 7 8
    python -m canopen_cli.demos.canopenmaster_single_device

Without --bus they open the manual's /dev/pcan32, and THE DRIVES MOVE. `--bus virtual` needs no hardware: it starts simulated
drives in the same process. Ctrl-C halts the drives.
"""
