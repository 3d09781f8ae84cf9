"""The manual's demos: short files to read first, with `canopen_master.direct`.

    python -m canopen_cli.demos.homing 12
    python -m canopen_cli.demos.single_device 12
    python -m canopen_cli.demos.multiple_devices 3 4 5 6 7 8
    python -m canopen_cli.demos.canopenmaster_single_device

More, which the library of 2012 had besides:

    python -m canopen_cli.demos.getpos 12
    python -m canopen_cli.demos.move_device 12                       faster and slower again
    python -m canopen_cli.demos.move_single_device 12                by keys: hold + or -; q ends
    python -m canopen_cli.demos.move_until_user_interrupt 12         as long as a key is held
    python -m canopen_cli.demos.interactive_homing 12                the same; where it stands then is its home position
    python -m canopen_cli.demos.canopenmaster_multiple_devices
    python -m canopen_cli.demos.memtest 12                           does memory grow?

Without --bus they open the manual's /dev/pcan32, and THE DRIVES MOVE. `--bus virtual` needs no hardware: it starts simulated
drives in the same process. Ctrl-C halts the drives.
"""
