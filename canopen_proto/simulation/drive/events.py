"""The events of the simulated drive. axis: of the node, 0 for the first one."""

from __future__ import annotations

from canopen_proto.drives.cia402.states import State
from canopen_proto.machine import Event
from canopen_proto.multiplexer import Mux


class DriveStateChanged(Event):
    """The drive went to another state. transition: its number in the standard, 0 to 16. previous: the state that it left."""

    __match_args__ = ("node_id", "previous", "state", "transition", "axis")

    def __init__(self, node_id: int, previous: State, state: State, transition: int, axis: int = 0) -> None:
        self.node_id = node_id
        self.axis = axis
        self.previous = previous
        self.state = state
        self.transition = transition


class StatuswordChanged(Event):
    """6041h now holds another value, `statusword`; the node sends the event-driven TPDOs that map it."""

    __match_args__ = ("node_id", "statusword", "axis")

    def __init__(self, node_id: int, statusword: int, axis: int = 0) -> None:
        self.node_id = node_id
        self.axis = axis
        self.statusword = statusword


class ModeChanged(Event):
    """The drive shows another mode of operation in 6061h than before."""

    __match_args__ = ("node_id", "mode", "axis")

    def __init__(self, node_id: int, mode: int, axis: int = 0) -> None:
        self.node_id = node_id
        self.axis = axis
        self.mode = mode


class InputsChanged(Event):
    """The digital inputs (60FDh) or the status of the touch probes (60B9h) have changed. mux: of the object; the node sends the
    event-driven TPDOs that map it."""

    __match_args__ = ("node_id", "mux", "axis")

    def __init__(self, node_id: int, mux: Mux, axis: int = 0) -> None:
        self.node_id = node_id
        self.axis = axis
        self.mux = mux


class DriveFault(Event):
    """A fault has occurred. error_code: of 603Fh and the EMCY; error_register: bits for 1001h."""

    __match_args__ = ("node_id", "error_code", "error_register", "axis")

    def __init__(self, node_id: int, error_code: int, error_register: int, axis: int = 0) -> None:
        self.node_id = node_id
        self.axis = axis
        self.error_code = error_code
        self.error_register = error_register


class DriveFaultCleared(Event):
    """A fault that DriveFault reported was reset. error_code: that of 603Fh and the EMCY."""

    __match_args__ = ("node_id", "error_code", "axis")

    def __init__(self, node_id: int, error_code: int, axis: int = 0) -> None:
        self.node_id = node_id
        self.axis = axis
        self.error_code = error_code
