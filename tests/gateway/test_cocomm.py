"""Answers as `cocomm` reads them, the client of CANopenNode. Its rules, from its source: a call of read has at most 1,000 bytes,
only the first one is looked at for `] ERROR:`, `] OK` and the number, and an answer ends with CR LF: without, it hangs.
Whatever is left of an answer would be taken for the next one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import trio

from canopen_gateway.ascii import bind_ascii_door
from canopen_gateway.ascii.connection import HELP
from tests.gateway.gateway_world import gateway
from tests.gateway.test_ascii_door import with_sockets


class _Reads(Protocol):
    async def receive_some(self, max_bytes: int) -> bytes | bytearray: ...


@dataclass
class _Reply:
    """What cocomm prints: the status to stderr, the value to stdout, and whether it ends with 1."""

    status: str
    value: str = ""
    failed: bool = False


async def _reply(stream: _Reads) -> _Reply:
    first = bytes(await stream.receive_some(1000)).decode()
    if "] ERROR:" in first and "\r\n" in first:
        return _Reply(first, failed=True)
    if "] OK\r\n" in first:
        return _Reply(first)
    number = first.find("] ")
    status, text = (first[: number + 1], first[number + 2 :]) if 0 <= number < 15 else ("", first)
    while "\r\n" not in text:
        text += bytes(await stream.receive_some(1000)).decode()
    return _Reply(status, text.partition("\r\n")[0])


@with_sockets
async def test_cocomm_understands_each_kind_of_answer() -> None:
    door = await bind_ascii_door(tcp=("127.0.0.1", 0))
    async with gateway(3, allow="write,nmt") as (_, service), trio.open_nursery() as nursery:
        nursery.start_soon(door.serve, service)
        host, _, port = door.addresses[0].rpartition(":")
        async with await trio.open_tcp_stream(host, int(port)) as stream:

            async def run(line: str) -> _Reply:
                await stream.send_all(line.encode() + b"\n")
                return await _reply(stream)

            assert await run("[1] set node 3") == _Reply("[1] OK\r\n")
            assert await run("[2] r 0x1000 0 u32") == _Reply("[2]", "131474")
            assert await run("[4294967295] r 0x1000 0") == _Reply("[4294967295]", "92 01 02 00")
            assert await run("[3] r 0x1008 0 vs") == _Reply("[3]", '"Simulated Schunk Powerball joint"')
            assert await run("[4] w 0x1017 0 u16 500") == _Reply("[4] OK\r\n")
            refused = await run("[5] r 0x5555 0 u8")
            assert refused.failed
            assert refused.status.startswith("[5] ERROR:0x06020000 #")
            assert (await run("[6] 99 nonsense")).failed
            assert (await run("1 r 0x1000 0 u32")).failed
            help_text = await run("[7] help")
            assert (help_text.status, help_text.value) == ("[7]", HELP.rstrip("\n"))
            assert len(help_text.value) > 1000
            assert await run("# from a file") == await run("") == _Reply("")
            assert await run("[8] preop") == _Reply("[8] OK\r\n")
            assert await run("[9] reset node") == _Reply("[9] OK\r\n")
            assert await run("[10] r 0x1000 0 u32") == _Reply("[10]", "131474")
        nursery.cancel_scope.cancel()
