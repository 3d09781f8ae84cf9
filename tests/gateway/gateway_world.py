"""A gateway over simulated drives, in virtual time, and a client of its text door without a socket."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import trio

from canopen_gateway import GatewayService, Limits, open_gateway, parse_permissions
from canopen_gateway.ascii import AsciiConnection
from canopen_gateway.service import GatewaySession
from canopen_master import Host, open_master
from canopen_proto.gateway import CANOPENNODE, Dialect, print_answer
from tests.master.world import BUS, simulated

EVERYTHING = "write,motion,store,program,nmt,lss"


class TextClient:
    """Says lines to a gateway, and has the answers as they would go over the wire."""

    def __init__(self, session: GatewaySession, dialect: Dialect = CANOPENNODE) -> None:
        self.session = session
        self.dialect = dialect
        self.connection = AsciiConnection(session, dialect)

    async def say(self, line: str) -> str:
        """The answer to a line, without the end of its line; "" for an empty one."""
        answer = await self.connection.answer(line.encode())
        return (
            ""
            if answer is None
            else print_answer(answer, self.dialect).decode("latin-1").removesuffix(self.dialect.line_end.decode())
        )

    async def event(self) -> str:
        """The next event."""
        with trio.fail_after(60):
            text = self.connection.event_text(await self.connection.next_event())
        assert text is not None
        return text.decode().strip()


@asynccontextmanager
async def gateway(
    *node_ids: int,
    allow: str = "",
    limits: Limits | None = None,
    makers: Any = (),
    heard: list[str] | None = None,
    **options: Any,
) -> AsyncIterator[tuple[Host, GatewayService]]:
    """A gateway over drives on a virtual bus. heard: the frames that pass, as text."""

    async with (
        simulated(*node_ids, makers=makers) as host,
        open_master(BUS, **options) as master,
        open_gateway(master, allow=parse_permissions(allow), limits=limits) as service,
    ):
        if heard is not None:
            master.bus().listen(lambda frame, *_: heard.append(str(frame)))
        yield host, service


@asynccontextmanager
async def text_client(
    *node_ids: int, allow: str = "", dialect: Dialect = CANOPENNODE, makers: Any = (), **options: Any
) -> AsyncIterator[tuple[Host, TextClient]]:
    """The same with one client of its text door."""
    async with gateway(*node_ids, allow=allow, makers=makers, **options) as (host, service):
        with service.open_session("a test") as session:
            yield host, TextClient(session, dialect)
