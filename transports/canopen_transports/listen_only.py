"""`?listen_only=true`: the adapter hears and says nothing, not even the dominant bit that acknowledges a frame.

A node with the wrong bit rate destroys the frames of the others by its error frames; one that only listens disturbs nobody. So
`canopen doctor` opens a bus like this. It is the adapter's controller that must be told, and each backend of python-can has
another word for it. Where it cannot, opening is refused: listening that is heard on the bus is not what was asked for.
"""

from __future__ import annotations

from typing import Any, Final

import can

from canopen_transports.diagnosis import bring_up
from canopen_transports.errors import BAD_LOCATOR, TransportError
from canopen_transports.locator import Locator

LISTEN_ONLY: Final = "listen_only"
"""The option's name."""

_BY_BACKEND: Final[dict[str, dict[str, Any]]] = {
    "pcan": {"state": can.BusState.PASSIVE},
    "systec": {"state": can.BusState.PASSIVE},
    "slcan": {"listen_only": True},
    "vector": {"listen_only": True},
    "nixnet": {"listen_only": True},
    "kvaser": {"driver_mode": False},
    "cantact": {"monitor": True},
    "seeedstudio": {"operation_mode": "silent"},
    # No wire, so nothing to be silent on: it is enough that we send no frames.
    "virtual": {},
    "udp_multicast": {},
}


def can_listen_only(locator: Locator) -> bool:
    """Whether an adapter of this kind can be opened so."""
    return not locator.own and locator.interface in _BY_BACKEND


def is_listen_only(locator: Locator) -> bool:
    """Whether the locator asks for it."""
    return locator.options.get(LISTEN_ONLY) in (True, 1)


def backend_options(locator: Locator) -> dict[str, Any]:
    """The locator's options as python-can's backend takes them. TransportError (CO100) where it has no such mode."""
    options: dict[str, Any] = dict(locator.options)
    wanted = options.pop(LISTEN_ONLY, False)
    if wanted in (False, 0):
        return options
    if wanted not in (True, 1) or locator.interface not in _BY_BACKEND:
        raise refused(locator)
    return {**options, **_BY_BACKEND[locator.interface]}


def refused(locator: Locator) -> TransportError:
    """Why this cannot be opened to listen only."""
    seen = f"{LISTEN_ONLY} is true or false, not {locator.options[LISTEN_ONLY]}"
    tries: tuple[str, ...] = (f"?{LISTEN_ONLY}=true",)
    if locator.options[LISTEN_ONLY] in (True, 1):
        seen, tries = f"python-can cannot make {locator.interface} listen only", ("leave the option out",)
        if locator.interface == "socketcan":
            seen = "the kernel keeps whether an interface only listens, as it keeps the bit rate; a program cannot set it"
            tries = (
                f"sudo ip link set {locator.channel} down && {bring_up(locator)} listen-only on   (and leave the option out)",
            )
    return TransportError(BAD_LOCATOR, locator.text, f"cannot open {locator.text}", seen=seen, tries=tries)
