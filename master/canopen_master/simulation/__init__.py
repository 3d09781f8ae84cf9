"""Simulated devices on a bus, for demonstrations and tests without hardware.

host.py              `simulate`, `Host`, `DeviceModel`: devices on a bus, driven by the same pump as a master
serving.py             several simulated drives for as long as a block runs
plant.py             plant files: the devices of a bus in TOML
hooks.py             scripts that animate a device
parameter_keeper.py  what devices store by 0x1010 and LSS, in memory or in a file
"""
