"""Plan motions of several joints. Needs the extra `motion` (ruckig): pip install 'canopen-proto[motion]'.

    point_to_point.py   `plan`: from any state of motion to a target, as fast as the limits allow
    target_stream.py    `TargetStream`: targets or velocities that come at any time, filtered to the limits cycle by cycle

Both are pure: no bus, no clock, no task. They give positions in the user's unit of each joint and times in seconds. A chain
executes them. Joints are counted from 0.
"""
