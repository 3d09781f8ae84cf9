"""`RemoteGateway`: a client of a text gateway, another maker's or ours: objects and NMT commands of nodes that it can reach.

    async with open_remote_gateway("gw:localhost:60000") as gateway:
        device_type = await gateway.read(5, 0x1000)

A text gateway carries no frames. So this is no bus, and no master can stand on it: it reads, writes and commands, one request at
a time, and that is all. Values go as base64 (`d`), which both CANopenNode and Lely CANopen take for any object; CANopenNode
reads no more at a time than its own limits allow.
"""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Final

import trio

from canopen_gateway.ascii.address import GatewayAddress, parse_gateway_address
from canopen_gateway.errors import GatewayRefusedError, NoGatewayError
from canopen_gateway.nmt_words import NMT_OF
from canopen_proto import NmtCommand
from canopen_proto.abort import AbortCode, text_of
from canopen_proto.gateway import (
    VALUE_TYPES,
    GatewayAnswer,
    GatewayAnswered,
    GatewayClient,
    GatewayCode,
    GatewayCommand,
    GatewayEvent,
    GatewayRequest,
    code_text,
    parse_value,
)
from canopen_proto.machine import MILLISECOND, SECOND

PATIENCE: Final = 5.0
"""Seconds that an answer may take beyond the time-out for SDO: the gateway may be busy with others."""
CONNECT_SECONDS: Final = 5.0
READ_SIZE: Final = 65_536
EVENTS_KEPT: Final = 256
_ANY: Final = VALUE_TYPES["d"]
_COMMANDS: Final = {command: typed for typed, command in NMT_OF.items()}


class RemoteGateway:
    """See this module's text; made by `open_remote_gateway`. events: what the gateway told by itself, the last EVENTS_KEPT."""

    def __init__(self, stream: trio.SocketStream, address: GatewayAddress) -> None:
        self.events: list[GatewayEvent] = []
        self._stream = stream
        self._address = address
        self._sdo_timeout = 0.5
        self._client = GatewayClient(address.dialect)
        self._turn = trio.Lock()

    async def set_sdo_timeout(self, seconds: float) -> None:
        """Let the gateway wait so long for each answer of a node: 0.001 to 65.535 s. Raises GatewayRefusedError, NoGatewayError,
        as all methods here."""
        milliseconds = min(max(1, round(seconds * 1000)), 0xFFFF)
        request = GatewayRequest(GatewayCommand.SET_SDO_TIMEOUT, net=self._address.net, numbers=(milliseconds,))
        await self._done(request, f"setting its time-out to {milliseconds} ms")
        self._sdo_timeout = milliseconds / 1000

    async def read(self, node_id: int, index: int, subindex: int = 0) -> bytes:
        """Read an object's bytes."""
        what = f"reading {index:04X}:{subindex:02X} of node {node_id}"
        request = GatewayRequest(GatewayCommand.READ, 0, self._address.net, node_id, (index, subindex), _ANY)
        answer = await self._done(request, what, node_id, index, subindex)
        data = parse_value(_ANY, answer.value or "", self._address.dialect)
        if data is None:
            shown = (answer.value or "OK")[:60]
            raise NoGatewayError(f"{what}: the gateway has not answered with a value", seen=repr(shown))
        return data

    async def write(self, node_id: int, index: int, subindex: int, data: bytes) -> None:
        """Write an object's bytes; return when the node has confirmed them. Raises LocalProtocolError for no bytes at all, which
        cannot be typed."""
        what = f"writing {index:04X}:{subindex:02X} of node {node_id}"
        request = GatewayRequest(GatewayCommand.WRITE, 0, self._address.net, node_id, (index, subindex), _ANY, data)
        await self._done(request, what, node_id, index, subindex)

    async def nmt(self, command: NmtCommand, node_id: int = 0) -> None:
        """Let the gateway send an NMT command, to a node or to all (0); return when it says that it has."""
        name = command.name.lower().replace("_", " ")
        request = GatewayRequest(_COMMANDS[command], 0, self._address.net, node_id)
        await self._done(request, f"NMT {name} to {f'node {node_id}' if node_id else 'all nodes'}", node_id)

    async def request(self, request: GatewayRequest) -> GatewayAnswer:
        """Send any request and return its answer, an error too. Raises NoGatewayError if none comes, or the connection ends."""
        async with self._turn:
            self._client.patience = round((PATIENCE + 2 * self._sdo_timeout) * SECOND)
            self._client.send(request, _now())
            try:
                await self._stream.send_all(self._client.take_bytes())
                return await self._answer()
            except (trio.BrokenResourceError, trio.ClosedResourceError) as error:
                raise self._gone("the connection has ended") from error
            except trio.Cancelled:
                self._client.give_up()  # its answer will be an odd line
                self._client.take_messages()
                raise

    async def _answer(self) -> GatewayAnswer:
        while True:
            for message in self._client.take_messages():
                if isinstance(message, GatewayAnswered):
                    if message.answer is None:
                        broken = self._client.is_broken
                        raise self._gone("it sent a line without an end" if broken else "it did not answer in time")
                    return message.answer
                if isinstance(message, GatewayEvent):
                    self.events.append(message)
                    del self.events[:-EVENTS_KEPT]
            with trio.move_on_after(max(0, self._client.deadline - _now()) / SECOND) as limit:
                data = await self._stream.receive_some(READ_SIZE)
                if not data:
                    raise self._gone("it has closed the connection")
                self._client.receive(bytes(data), _now())
            if limit.cancelled_caught:
                self._client.handle_timeout(_now() + MILLISECOND)

    async def _done(
        self, request: GatewayRequest, what: str, node_id: int = 0, index: int | None = None, subindex: int | None = None
    ) -> GatewayAnswer:
        answer = await self.request(request)
        if not answer.is_error:
            return answer
        remark = f" ({answer.remark})" if answer.remark else ""
        if answer.abort_code is not None:
            seen = f"abort 0x{answer.abort_code:08X}, {text_of(answer.abort_code)}{remark}"
            is_silence = answer.abort_code == AbortCode.TIMED_OUT
            failed = f"{what} was not answered" if is_silence else f"{what} was refused by the node"
        else:
            seen = f"error {answer.code}, {code_text(answer.code)}{remark}"
            failed = f"{what} was refused by the gateway"
        raise GatewayRefusedError(
            failed,
            gateway_code=answer.code,
            abort_code=answer.abort_code,
            node_id=node_id,
            index=index,
            subindex=subindex,
            seen=seen,
            cause=_CAUSES.get(answer.code, ""),
        )

    def _gone(self, seen: str) -> NoGatewayError:
        return NoGatewayError(
            f"the text gateway {self._address.text} is gone, or is none",
            seen=seen,
            cause="it was ended; or another program uses this port; or it ends its lines in another way",
            tries=("the same again", f"-b {self._address.text}{'&' if '?' in self._address.text else '?'}dialect=lely"),
        )


@asynccontextmanager
async def open_remote_gateway(locator: str | GatewayAddress) -> AsyncIterator[RemoteGateway]:
    """Connect to a text gateway while the block runs. Raises NoGatewayError."""
    address = parse_gateway_address(locator) if isinstance(locator, str) else locator
    try:
        with trio.fail_after(CONNECT_SECONDS):
            stream = await (
                trio.open_unix_socket(address.path) if address.path else trio.open_tcp_stream(address.host, address.port)
            )
    except (OSError, UnicodeError, RuntimeError, trio.TooSlowError) as error:
        place = address.path or f"{address.host} port {address.port}"
        raise NoGatewayError(
            f"there is no text gateway at {place}",
            seen=str(error) or "it did not answer",
            cause="it does not run, or listens elsewhere",
            tries=("canopen serve ascii -b BUS    (one of ours, in another terminal)",),
        ) from error
    async with stream:
        yield RemoteGateway(stream, address)


_CAUSES: Final = {
    int(GatewayCode.NOT_SUPPORTED): "this gateway does not know the command, or was not started with the permission for it",
    int(GatewayCode.UNSUPPORTED_NET): "it has fewer nets",
    int(GatewayCode.OUT_OF_MEMORY): "it has too many clients, or the value is too long for it",
}


def _now() -> int:
    return round(trio.current_time() * SECOND)
