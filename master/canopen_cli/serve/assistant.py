"""`canopen serve mcp`: a machine for an assistant, by the Model Context Protocol."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeAlias

import click
import trio
from mcp.server.mcpserver import MCPServer

from canopen_cli.serve.assistant_files import FileTools
from canopen_cli.serve.served import open_served
from canopen_cli.shared.options import Settings, command, lasting
from canopen_cli.shared.permissions import allow_option
from canopen_cli.shared.problem import usage
from canopen_cli.shared.running import first_error, run_until_interrupted
from canopen_cli.shared.screen import Screen, escape
from canopen_gateway import GatewayService, GatewaySession, Permission, open_gateway
from canopen_gateway.assistant import assistant_server
from canopen_gateway.web import bind_web_door
from canopen_gateway.web.guard import AsgiApp

Making: TypeAlias = Callable[[GatewayService, GatewaySession], MCPServer[Any]]


@command(name="mcp")
@click.option("--http", "port", type=click.IntRange(0, 65535), metavar="PORT", help="By HTTP on this computer; 0: any free port.")
@allow_option("What the assistant may change: write, store, program, nmt")
@click.option(
    "--logs",
    type=click.Path(file_okay=False, exists=True, path_type=Path),
    metavar="DIR",
    help="Recordings that it may look at; none by default.",
)
@lasting("End after this time.")
def serve_mcp(
    settings: Settings, screen: Screen, port: int | None, allow: frozenset[Permission], logs: Path | None, seconds: float
) -> None:
    """Let an assistant read a machine, by the Model Context Protocol. Needs the extra `mcp`.

    It speaks on its standard input and output, as assistants start their tools; with --http on a port of this computer, with a
    token. The assistant reads objects, lists nodes, explains drives and codes, measures the load, says what is wrong, decodes and
    checks recordings of --logs, and plans the buses of the machine file. It moves nothing. Anybody may halt.

    \b
    canopen serve mcp -b can0                  what an assistant's configuration starts
    canopen serve mcp -b demo --http 8403      six simulated drives, by HTTP
    """
    if Permission.MOTION in allow:
        tries = ("the same without motion", "canopen serve web --allow motion")
        raise usage("CO123", "--allow motion: an assistant cannot hold a dead man's switch", tries=tries)
    serve = _on_streams if port is None else _by_http
    files = FileTools(settings, logs)

    def make(service: GatewayService, session: GatewaySession) -> MCPServer[Any]:
        more = (files.plan_bus, *((files.list_logs, files.decode_log, files.check_log) if logs else ()))
        resources = {"canopen://machine-file": files.machine_file} if settings.machine else {}
        return assistant_server(service, session, more, resources)

    @first_error()
    async def serve_in_time() -> None:
        with trio.move_on_after(seconds):
            await serve(settings, screen, allow, port or 0, make)

    run_until_interrupted(settings, screen, serve_in_time)


async def _on_streams(settings: Settings, screen: Screen, allow: frozenset[Permission], _port: int, server: Making) -> None:
    async with open_served(settings, screen) as master, open_gateway(master, allow=allow) as service:
        with service.open_session("an assistant") as session:
            await server(service, session).run_stdio_async()


async def _by_http(settings: Settings, screen: Screen, allow: frozenset[Permission], port: int, server: Making) -> None:
    door = await bind_web_door(port=port)
    async with door, open_served(settings, screen) as master, open_gateway(master, allow=allow) as service:

        def make(session: GatewaySession) -> AsgiApp:
            # The guard in front of it looks at Host and Origin
            app: AsgiApp = server(service, session).streamable_http_app(stateless_http=True, json_response=True)
            return app

        url = f"http://127.0.0.1:{door.port}/mcp"
        if settings.json:
            screen.json({"url": url, "token": door.token, "nets": list(service.nets)})
        screen.say(f"[bold]{escape(url)}[/] with the header Authorization: Bearer {escape(door.token)}")
        await door.serve_app(service, make)
    if door.failure is not None:
        raise door.failure
