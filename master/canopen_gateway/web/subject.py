"""`WebSubject`: what a web door shows, a machine or a fleet; the paths and the live channel ask it for all that they tell.

`MachineSubject` (machine_subject.py) is the machine of a gateway, `FleetSubject` (fleet_subject.py) the machines of many
computers. What only the computer that has a bus can do (frames, the lease, commissioning, metrics) is asked of
`WebSubject.machine`, which a fleet refuses by `NotOverFleetError`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractAsyncContextManager, AbstractContextManager
from typing import Any, TypeAlias

from canopen_gateway.guard import Guard
from canopen_gateway.limits import Limits
from canopen_gateway.plain_data import Plain
from canopen_gateway.service import GatewayService, GatewaySession
from canopen_gateway.values import WatchedObject
from canopen_proto import NmtCommand
from canopen_proto.datatypes import Value

TellEvent: TypeAlias = Callable[[str, Plain], None]
"""Is called with the name of a net, and an event of it."""
TakeRows: TypeAlias = Callable[[], list[list[Any]]]
"""Returns what has come since the last call: [number, time, value], perhaps a problem, perhaps how many seconds late it is."""


class WebClient(ABC):
    """A client of the live channel. name: for people."""

    name: str

    @abstractmethod
    def machine_session(self, what: str) -> GatewaySession:
        """Return the session by which this client moves the machine. what: it wants to do. Raises NotOverFleetError."""

    @abstractmethod
    def watch(self, objects: Sequence[WatchedObject], period: float) -> AbstractAsyncContextManager[TakeRows]:
        """Have the values of objects while the block runs: each that a PDO brings; any other is read once in each period
        (seconds). Raises GatewayFullError for more than the limits allow."""


class WebSubject(ABC):
    """See this module's text. limits: how much its clients may do. guard: what they may change. absent: what is not there, by a
    word for programs, with the reason in words."""

    limits: Limits
    guard: Guard
    absent: Mapping[str, str]

    @abstractmethod
    def machine(self, what: str) -> GatewayService:
        """Return the machine's own service. what: is wanted of it, for the error. Raises NotOverFleetError."""

    # ---- what was heard ----

    @property
    @abstractmethod
    def nets(self) -> Sequence[str]:
        """The names of the nets."""

    @abstractmethod
    def find_net(self, text: str) -> str:
        """Return the name of a net. text: that name, or its number, from 1. Raises NoSuchPlaceError."""

    @abstractmethod
    def state(self) -> Plain:
        """Return what is allowed, the chains, and who moves them."""

    @abstractmethod
    def net_data(self, net: str) -> Plain:
        """Return a net, with its nodes."""

    @abstractmethod
    def node_data(self, net: str, node_id: int) -> Plain:
        """Return a node. Raises NoSuchPlaceError."""

    @abstractmethod
    def now(self) -> float:
        """Return the clock of the samples, in seconds."""

    @abstractmethod
    async def hear(self, tell: TellEvent, clock: Callable[[], float]) -> None:
        """Tell what happens, until cancelled. clock: seconds since 1970."""

    # ---- what is asked, and changed ----

    @abstractmethod
    async def search(self, net: str) -> None:
        """Ask the node-IDs that were not heard yet. Raises GatewayFullError, BusError, NotOverFleetError."""

    @abstractmethod
    async def about(self, net: str, node_id: int) -> Plain:
        """Ask a node what it says of itself: "name", "drive" (null: it is none), "problem"."""

    @abstractmethod
    async def objects(self, net: str, node_id: int) -> Sequence[Plain]:
        """Return the objects that a node has by its dictionary, as `object_data` tells them."""

    @abstractmethod
    async def read(self, net: str, node_id: int, text: str) -> tuple[bytes, Plain]:
        """Read an object: its bytes, and its value as `value_data` tells it. text: its name, or 6041:00."""

    @abstractmethod
    async def may_write(self, net: str, node_id: int, text: str) -> tuple[int, int]:
        """Return the index and subindex of an object that may be written. Raises NotAllowedError: before the value is looked at,
        since nothing else would help."""

    @abstractmethod
    async def write(self, net: str, node_id: int, place: tuple[int, int], given: bytes | Value | None) -> str:
        """Write an object. place: as `may_write` has returned it. given: its bytes, or its value. Returns what was written."""

    @abstractmethod
    async def nmt(self, net: str, command: NmtCommand, node_id: int) -> None:
        """Send an NMT command to a node, or to all of a net (0)."""

    @abstractmethod
    async def halt(self, net: str | None, node_id: int = 0) -> list[str]:
        """Stop what moves: everything, or one net, or one node. Returns what did not confirm that it stands. Everybody may."""

    # ---- clients of the live channel ----

    @abstractmethod
    def place_of(self, net: str, node_id: int, text: str) -> WatchedObject:
        """Return an object to watch. Raises ObjectNotFoundError, ValueError."""

    @abstractmethod
    def open_client(self, name: str) -> AbstractContextManager[WebClient]:
        """Be a client while the block runs. name: for people. Raises GatewayFullError."""
