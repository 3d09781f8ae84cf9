"""A simulated CiA 402 drive: the device's side of the profile.

    node.py               `DriveNode`: the simulated drive on the bus
    drive.py              `Drive`: its state machine, its modes, and what it shows; `LateDrive`, which acts late, as real ones do
    settings.py           its settings: shape, track, mechanics, delays
    events.py             the events of a simulated drive
    dictionary.py         its object dictionary, in two shapes
    answers.py            wrong, late and refused answers, for tests
    profile_modes.py      the base of its modes of operation; its velocity modes (pv, vl)
    profile_position.py   its profile position mode
    synchronous_modes.py  its csp mode, and what all modes with a set-point at each SYNC have in common
    interpolated_position.py   its ip mode: records, sub-modes, buffer
    torque_modes.py       its tq, csv and cst modes
    display.py            the values that it shows: position, velocity, torque, inputs, outputs
    homing.py             its homing: searches for switches and index pulses
    inputs.py             its inputs: touch probes
    fallbacks.py          the values of objects that its dictionary lacks
    parameters.py         the values of its objects, as numbers
    servo.py              its mechanics: track, lag, limits
    plant.py              a mass under control loops and a limited torque, instead of the lag
    motion.py             closed-form motion profiles
    smooth_motion.py      those with limited jerk

Source: IEC 61800-7-201 (CiA 402-2).
"""
