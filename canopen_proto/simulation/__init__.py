"""Simulated devices beyond a plain `LocalNode`.

drive/           a CiA 402 drive: its states, modes and mechanics
boot_loader.py   a device whose program can be written over the bus (CiA 302-3)
"""
