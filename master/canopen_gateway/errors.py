"""The errors of a gateway: what it refuses, and what its client meets."""

from __future__ import annotations

from typing import ClassVar, Final, Unpack

from canopen_proto.abort import AbortCode
from canopen_proto.explained import ErrorWords, Explained
from canopen_proto.gateway import GatewayCode

NOT_ALLOWED: Final = "CO150"
"""The gateway was not started with the permission for this."""
GATEWAY_FULL: Final = "CO151"
"""The gateway has as many clients, requests or subscriptions as it takes."""
LEASE_TAKEN: Final = "CO152"
"""Somebody else moves the machine, or the lease is over."""
NO_GATEWAY: Final = "CO153"
"""The other end is no text gateway, or the connection to it has ended."""
GATEWAY_REFUSED: Final = "CO154"
"""A text gateway has answered with an error of its own."""
DOOR_REFUSED: Final = "CO155"
"""A door cannot be opened, or not like this."""
NOT_OVER_TEXT: Final = "CO156"
"""A command needs a bus, and this is a text gateway."""

NO_HISTORY: Final = "CO163"
"""A history cannot be read, or not be asked for this."""
WRONG_QUERY: Final = "CO164"
"""A query of a history cannot be answered as it stands."""
NO_SUCH_PLACE: Final = "CO162"
"""A request names a net, a node or an object that is not there."""
NOT_OVER_FLEET: Final = "CO165"
"""What was asked for needs the computer that has the bus, and this is a page over a fleet."""
NO_BRIDGE: Final = "CO160"
"""Nobody answers for this place in a fleet, or the fleet cannot be joined."""
BRIDGE_REFUSED: Final = "CO161"
"""A bridge of a fleet has answered with an error: its own, or that of a node."""


class GatewayError(Explained, Exception):
    """A gateway cannot do what it was asked for. For the fields see Explained."""

    CODE: ClassVar[str]
    """The code of all errors of this class."""

    def __init__(self, failed: str, **words: Unpack[ErrorWords]) -> None:
        super().__init__(self.CODE, failed, **words)


class NotAllowedError(GatewayError, PermissionError):
    """The gateway was not started with the permission for this; nothing was sent. permission: its name."""

    CODE = NOT_ALLOWED

    def __init__(self, permission: str, what: str) -> None:
        super().__init__(
            f"{what} is not allowed here",
            seen=f"started without --allow {permission}",
            tries=(f"start it with --allow {permission}, if that is meant",),
        )
        self.permission = permission


class GatewayFullError(GatewayError):
    """The gateway takes no more of this. For the fields see Explained."""

    CODE = GATEWAY_FULL

    def __init__(self, what: str, most: int) -> None:
        super().__init__(f"there is no room for more {what}", seen=f"{most} are there", tries=("end some, or wait",))


class PdoTakenError(GatewayError):
    """Another client of the gateway has set up a PDO with this number. For the fields see Explained."""

    CODE = GATEWAY_FULL

    def __init__(self, number: int) -> None:
        super().__init__(f"PDO {number} is another client's", tries=("another number",))


class LeaseError(GatewayError):
    """The machine is not moved: somebody else has the lease, it is over, or the request is an old one. Or a drive with power
    would lose its commands. For the fields see Explained."""

    CODE = LEASE_TAKEN


class NoGatewayError(GatewayError, ConnectionError):
    """There is no text gateway at this address, or the connection to it has ended. For the fields see Explained."""

    CODE = NO_GATEWAY


class GatewayRefusedError(GatewayError):
    """A text gateway has answered with an error.

    gateway_code: its own (`canopen_proto.gateway.GatewayCode`), 0 if a node refused. abort_code: the node's, or None. node_id: of
    the node, 0 if it is about none. index, subindex: of the object; None if it is about none. For the other fields see Explained.
    """

    CODE = GATEWAY_REFUSED

    def __init__(
        self,
        failed: str,
        *,
        gateway_code: int = 0,
        abort_code: int | None = None,
        node_id: int = 0,
        index: int | None = None,
        subindex: int | None = None,
        **words: Unpack[ErrorWords],
    ) -> None:
        super().__init__(failed, **words)
        self.gateway_code = gateway_code
        self.abort_code = abort_code
        self.node_id = node_id
        self.index = index
        self.subindex = subindex

    @property
    def is_silence(self) -> bool:
        """Whether the node did not answer the gateway."""
        return self.abort_code == AbortCode.TIMED_OUT or self.gateway_code == GatewayCode.TIME_OUT


class NotOverTextError(GatewayError):
    """A command needs frames, and this is a text gateway. For the fields see Explained."""

    CODE = NOT_OVER_TEXT

    def __init__(self, locator: str, works: str) -> None:
        super().__init__(
            f"{locator} is a text gateway, which carries no frames",
            cause="this command needs a bus: it listens, or sends frames of its own",
            tries=(f"what works over it: {works}", "the bus itself, on the computer that has it"),
        )


class NoSuchPlaceError(GatewayError, LookupError):
    """A request names a net, a node or an object that is not there; nothing was sent. For the fields see Explained."""

    CODE = NO_SUCH_PLACE


class DoorError(GatewayError):
    """A door cannot be opened: its address is in use, or reachable from other computers without a word about it. For the fields
    see Explained."""

    CODE = DOOR_REFUSED


class FleetError(GatewayError, ConnectionError):
    """Nobody answers for a place in a fleet, or the fleet cannot be joined; nothing is known of what became of a request. For the
    fields see Explained."""

    CODE = NO_BRIDGE


class BridgeRefusedError(GatewayError):
    """A bridge of a fleet has answered with an error.

    bridge_code: its code there, such as "CO201". abort_code: the node's, or None. not_confirmed: it may have been executed. For
    the other fields see Explained.
    """

    CODE = BRIDGE_REFUSED

    def __init__(
        self, failed: str, *, bridge_code: str = "", seen: str = "", abort_code: int | None = None, not_confirmed: bool = False
    ) -> None:
        super().__init__(failed, seen=seen)
        self.bridge_code = bridge_code
        self.abort_code = abort_code
        self.not_confirmed = not_confirmed

    @property
    def is_silence(self) -> bool:
        """Whether the node did not answer the bridge."""
        return self.abort_code == AbortCode.TIMED_OUT


class NotOverFleetError(GatewayError):
    """What was asked for needs the computer that has the bus, and this is a page over a fleet; nothing was sent. For the fields
    see Explained."""

    CODE = NOT_OVER_FLEET

    def __init__(self, what: str) -> None:
        super().__init__(
            f"{what}: not over a fleet",
            seen="this page shows the machines of many computers",
            cause="it needs the computer that has the bus",
            tries=("canopen serve web, on that computer",),
        )


class HistoryError(GatewayError, ValueError):
    """A history of a fleet cannot be written, or not be read: it is not there, or a file in it is half, or none of it. For the
    fields see Explained."""

    CODE = NO_HISTORY


class HistoryQueryError(GatewayError, ValueError):
    """A query of a history is wrong, or reaches for something else. For the fields see Explained."""

    CODE = WRONG_QUERY


class QueryRefusedError(GatewayError, ValueError):
    """A bridge of a fleet was asked for what it cannot do; nothing was done. For the fields see Explained."""

    CODE = BRIDGE_REFUSED


def first_line(error: BaseException) -> str:
    """Return the first line of an error's text; without a text, the name of its class."""
    return str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__


def first_of(error: BaseException) -> Exception:
    """Return the error that nurseries have put into groups: the first one, if there are several."""
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    assert isinstance(error, Exception)
    return error
