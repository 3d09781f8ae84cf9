"""`MachineSubject`: the machine of a gateway, for the web door of its own computer."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from contextlib import asynccontextmanager, contextmanager
from typing import Any, Final

import trio

from canopen_gateway.errors import first_line
from canopen_gateway.places import bytes_of, find_net, find_object
from canopen_gateway.plain_data import (
    Plain,
    chain_data,
    event_data,
    lease_data,
    net_data,
    node_data,
    object_data,
    plain_value,
    value_data,
    view_data,
)
from canopen_gateway.service import GatewayService, GatewaySession
from canopen_gateway.values import WatchedObject
from canopen_gateway.web.subject import TakeRows, TellEvent, WebClient, WebSubject
from canopen_master import MasterError
from canopen_master.errors import NodeIsNoDriveError
from canopen_proto import NmtCommand
from canopen_proto.datatypes import Value
from canopen_proto.machine import SECOND
from canopen_proto.procedures import ProcedureError

LOOK_EACH: Final = 0.5
"""Seconds between two looks for nodes whose heartbeat has begun."""
LOGGER: Final = logging.getLogger("canopen_gateway")


class MachineSubject(WebSubject):
    """See this module's text. session: the client that all requests are to the service."""

    absent: Mapping[str, str] = {}

    def __init__(self, service: GatewayService, session: GatewaySession) -> None:
        self.service = service
        self.limits = service.limits
        self.guard = service.guard
        self._session = session

    def machine(self, what: str) -> GatewayService:
        """See WebSubject."""
        return self.service

    @property
    def nets(self) -> Sequence[str]:
        """See WebSubject."""
        return self.service.nets

    def find_net(self, text: str) -> str:
        """See WebSubject."""
        return find_net(self.service, text)

    def state(self) -> Plain:
        """See WebSubject."""
        return {
            "allow": sorted(each.value for each in self.guard.allowed),
            "mode": self.guard.mode,
            "chains": [chain_data(chain) for chain in self.service.master.chains.values()],
            "lease": lease_data(self.service),
        }

    def net_data(self, net: str) -> Plain:
        """See WebSubject."""
        return net_data(self.service, net)

    def node_data(self, net: str, node_id: int) -> Plain:
        """See WebSubject."""
        return node_data(self.service.master, net, self.service.node(net, node_id).node_id)

    def now(self) -> float:
        """See WebSubject."""
        return self.service.master.now() / SECOND

    async def hear(self, tell: TellEvent, clock: Callable[[], float]) -> None:
        """See WebSubject."""
        with self.service.open_session("the page's ear") as ear:
            for net in self.nets:
                ear.hear_boot_ups(net, True)
                self.service.traffic(net)  # from now on, so that a trace has what was before it is asked for
            async with trio.open_nursery() as nursery:
                nursery.start_soon(self._watch_heartbeats, ear)
                while True:
                    heard = await ear.next_event()
                    tell(heard.net, event_data(self.service, heard, clock()))

    async def _watch_heartbeats(self, ear: GatewaySession) -> None:
        while True:
            ear.watch_heard()
            await trio.sleep(LOOK_EACH)

    async def search(self, net: str) -> None:
        """See WebSubject."""
        await self.service.find_nodes(net)

    async def about(self, net: str, node_id: int) -> Plain:
        """See WebSubject."""
        node = self.service.node(net, node_id)
        name, drive, problem = "", None, ""
        try:
            drive = view_data(await self.service.look_at_drive(net, node_id))
        except NodeIsNoDriveError:
            LOGGER.debug("%s is no drive", node.where)
        except (MasterError, ProcedureError) as error:
            problem = first_line(error)
        if not problem:
            try:
                name = await self._session.read_name(net, node_id)
            except MasterError as error:
                LOGGER.debug("%s has no name: %s", node.where, first_line(error))
        return {"name": name, "drive": drive, "problem": problem}

    async def objects(self, net: str, node_id: int) -> Sequence[Plain]:
        """See WebSubject."""
        dictionary = self.service.node(net, node_id).dictionary
        return [object_data(dictionary, variable) for variable in dictionary]

    async def read(self, net: str, node_id: int, text: str) -> tuple[bytes, Plain]:
        """See WebSubject."""
        dictionary = self.service.node(net, node_id).dictionary
        index, subindex = find_object(dictionary, text)
        data = await self._session.read(net, node_id, index, subindex)
        return data, value_data(dictionary, index, subindex, data)

    async def may_write(self, net: str, node_id: int, text: str) -> tuple[int, int]:
        """See WebSubject."""
        index, subindex = find_object(self.service.node(net, node_id).dictionary, text)
        self.guard.require_write(index, subindex)
        return index, subindex

    async def write(self, net: str, node_id: int, place: tuple[int, int], given: bytes | Value | None) -> str:
        """See WebSubject."""
        data = given if isinstance(given, bytes) else bytes_of(self.service.node(net, node_id), *place, given)
        await self._session.write(net, node_id, *place, data)
        return data.hex(" ")

    async def nmt(self, net: str, command: NmtCommand, node_id: int) -> None:
        """See WebSubject."""
        await self._session.nmt(net, command, node_id)

    async def halt(self, net: str | None, node_id: int = 0) -> list[str]:
        """See WebSubject."""
        return await self.service.halt(net, node_id)

    def place_of(self, net: str, node_id: int, text: str) -> WatchedObject:
        """See WebSubject."""
        node = self.service.node(net, node_id)
        return WatchedObject(net, node.node_id, *find_object(node.dictionary, text))

    @contextmanager
    def open_client(self, name: str) -> Iterator[WebClient]:
        """See WebSubject."""
        with self.service.open_session(name) as session:
            yield _MachineClient(self, session)


class _MachineClient(WebClient):
    def __init__(self, subject: MachineSubject, session: GatewaySession) -> None:
        self.name = session.name
        self._subject = subject
        self._session = session

    def machine_session(self, what: str) -> GatewaySession:
        return self._session

    @asynccontextmanager
    async def watch(self, objects: Sequence[WatchedObject], period: float) -> AsyncIterator[TakeRows]:
        half = self._subject.limits.subscriptions // 2  # each is sampled, and asked for while no PDO brings it
        if len(objects) > half:
            raise ValueError(f"a page watches {half} objects at most")
        polled: deque[list[Any]] = deque(maxlen=4 * len(objects))
        with self._session.sample_pdos(objects) as samples:
            came = [float("-inf")] * len(objects)

            def take() -> list[list[Any]]:
                rows = list(polled)
                polled.clear()
                for number, at, value in samples.take():
                    came[number] = trio.current_time()
                    rows.append([number, round(at, 4), plain_value(value)])
                return rows

            async with trio.open_nursery() as nursery:
                nursery.start_soon(self._poll, objects, period, came, polled)
                yield take
                nursery.cancel_scope.cancel()

    async def _poll(
        self, objects: Sequence[WatchedObject], period: float, came: Sequence[float], polled: deque[list[Any]]
    ) -> None:
        """Ask for the values that no PDO has brought of late."""
        places = {place: number for number, place in enumerate(objects)}
        async with self._session.watch_values(objects, period) as values:
            async for seen in values:
                number = places[seen.place]
                if trio.current_time() - came[number] > 2 * period:
                    polled.append([number, round(self._subject.now(), 4), plain_value(seen.value), seen.problem])
