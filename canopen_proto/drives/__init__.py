"""Drives and motion control (CiA 402), the master's side, and the mathematics of their paths.

cia402/       states, modes and objects of the profile, as tables; the simulated drive uses them too
axis/         `Axis` and the procedures on it: enable, home, move, follow, halt; why a drive does not move
trajectory/   paths of several joints, their limits, and the clock that runs them
"""
