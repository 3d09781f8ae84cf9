"""Plan motions of several joints.

    point_to_point.py   `point_to_point`: from any state of motion to a target, as fast as the limits allow
    through_points.py   `through_points`: along a smooth curve through waypoints without times
    target_stream.py    `TargetStream`: targets or velocities that come at any time, filtered to the limits cycle by cycle

The first and the last one need the extra `motion` (ruckig): pip install 'canopen-proto[motion]'. All are pure: no bus, no clock,
no task. They give positions in the user's unit of each joint and times in seconds; a chain executes them. Joints are counted from
0.
"""
