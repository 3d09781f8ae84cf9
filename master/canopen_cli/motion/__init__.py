"""Chains that move: `canopen move`, `jog`; the view, the session and the recording of a motion."""
