"""`?listen_only=true`: the adapter only listens; it does not even acknowledge frames.

A node with the wrong bit rate destroys the frames of others by its error frames; a node that only listens disturbs nobody. So
`canopen doctor` opens a bus in this mode. It is a mode of the adapter's controller, and each backend of python-can has its own
option for it. A backend without such an option is refused, as it would be heard on the bus.
"""

from __future__ import annotations

from typing import Any, Final

from canopen_transports.diagnosis import bring_up
from canopen_transports.errors import BAD_LOCATOR, TransportError
from canopen_transports.locator import Locator

LISTEN_ONLY: Final = "listen_only"

_PASSIVE: Final = "PASSIVE"
"""The name of python-can's bus state, which is looked up where python-can is used."""

_BY_BACKEND: Final[dict[str, dict[str, Any]]] = {
    "pcan": {"state": _PASSIVE},
    "systec": {"state": _PASSIVE},
    "slcan": {"listen_only": True},
    "vector": {"listen_only": True},
    "nixnet": {"listen_only": True},
    "kvaser": {"driver_mode": False},
    "cantact": {"monitor": True},
    "seeedstudio": {"operation_mode": "silent"},
    # These have no wire: it is enough that we send no frames.
    "virtual": {},
    "udp_multicast": {},
}


def can_listen_only(locator: Locator) -> bool:
    """Return whether an adapter of this kind has a listen-only mode."""
    return not locator.own and locator.interface in _BY_BACKEND


def is_listen_only(locator: Locator) -> bool:
    """Return whether the locator asks for it."""
    return locator.options.get(LISTEN_ONLY) in (True, 1)


def backend_options(locator: Locator) -> dict[str, Any]:
    """Return the locator's options for python-can's backend. Raises TransportError (CO100) if the backend has no listen-only
    mode."""
    options: dict[str, Any] = dict(locator.options)
    wanted = options.pop(LISTEN_ONLY, False)
    if wanted in (False, 0):
        return options
    if wanted not in (True, 1) or locator.interface not in _BY_BACKEND:
        raise refused(locator)
    own = _BY_BACKEND[locator.interface]
    if own.get("state") == _PASSIVE:
        from can import BusState

        own = {"state": BusState[_PASSIVE]}
    return {**options, **own}


def refused(locator: Locator) -> TransportError:
    """Return why this bus cannot be opened to listen only."""
    seen = f"{LISTEN_ONLY} is true or false, not {locator.options[LISTEN_ONLY]}"
    tries: tuple[str, ...] = (f"?{LISTEN_ONLY}=true",)
    if locator.options[LISTEN_ONLY] in (True, 1):
        seen, tries = f"python-can cannot make {locator.interface} listen only", ("leave the option out",)
        if locator.interface == "socketcan":
            seen = "the kernel sets listen-only mode, like the bit rate; a program cannot"
            tries = (
                f"sudo ip link set {locator.channel} down && {bring_up(locator)} listen-only on   (and leave the option out)",
            )
    return TransportError(BAD_LOCATOR, locator.text, f"cannot open {locator.text}", seen=seen, tries=tries)
