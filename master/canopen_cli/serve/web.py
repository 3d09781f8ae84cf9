"""`canopen serve web`: a page, an HTTP interface and a WebSocket."""

from __future__ import annotations

from pathlib import Path

import click

from canopen_cli.serve.permissions import Permissions
from canopen_cli.serve.served import open_service, serve_door
from canopen_cli.shared.options import Settings, common, lasting
from canopen_cli.shared.problem import usage
from canopen_cli.shared.screen import Screen, escape
from canopen_gateway import GatewayService, Permission
from canopen_gateway.web import WebDoor, bind_web_door
from canopen_gateway.web.door import DEFAULT_PORT

FILE = click.Path(dir_okay=False, exists=True, path_type=Path)


@click.command(name="web")
@click.option("--bind", default="127.0.0.1", metavar="HOST", show_default=True, help="Where to listen.")
@click.option("--port", type=click.IntRange(0, 65535), default=DEFAULT_PORT, show_default=True, help="0: any free one.")
@click.option("--name", "names", multiple=True, metavar="NAME", help="A further name by which browsers reach it.")
@click.option("--cert", type=FILE, metavar="FILE", help="A certificate (PEM), for TLS: other computers may then reach it.")
@click.option("--key", type=FILE, metavar="FILE", help="Its key.")
@click.option("--token-file", type=FILE, metavar="FILE", help="A file with the token.  [default: a new one at each start]")
@click.option(
    "--allow",
    type=Permissions(),
    default="",
    metavar="KINDS",
    help="What clients may change: write, motion, store, program, nmt, lss. By default nothing.",
)
@lasting()
@common
@click.pass_obj
def serve_web(
    settings: Settings,
    bind: str,
    port: int,
    names: tuple[str, ...],
    cert: Path | None,
    key: Path | None,
    token_file: Path | None,
    allow: frozenset[Permission],
    seconds: float | None,
) -> None:
    """Serve a machine as a page in a browser, and by HTTP, until Ctrl-C. Needs the extra `web`.

    Open the address that it prints: the token in it is the key. Reading is always allowed. Each kind of change has to be named by
    --allow, as for `canopen serve ascii`. Anybody who has the token may halt, always.

    \b
    canopen serve web -b demo                       six simulated drives, read-only
    canopen serve web -b can0 --allow write,nmt
    canopen serve web -m cell.toml --allow motion   jog its chains, with a dead man's switch
    canopen serve web -b can0 --bind 0.0.0.0 --name cell7.lan --cert cell7.pem --key cell7.key
    """
    screen = settings.screen()
    if (cert is None) is not (key is None):
        raise usage("CO123", "--cert and --key belong together", tries=("--cert FILE --key FILE",))
    certificate = None if cert is None or key is None else (cert, key)
    token = "" if token_file is None else _token_in(token_file)

    serve_door(
        settings,
        screen,
        lambda: bind_web_door(host=bind, port=port, names=names, certificate=certificate, token=token),
        lambda: open_service(settings, screen, allow),
        lambda door, service: tell_web_door(settings, screen, door, service),
        seconds,
    )


def tell_web_door(settings: Settings, screen: Screen, door: WebDoor, service: GatewayService) -> None:
    """Say where the page is, and what it may do."""
    if settings.json:
        allowed = sorted(each.value for each in service.guard.allowed)
        screen.json({"url": door.url, "doors": list(door.addresses), "nets": list(service.nets), "allow": allowed})
    screen.say(f"[bold]open {escape(door.url)}[/]")
    screen.say(f"{escape(service.guard.mode)}; whoever has this address may do that")
    for number, net in enumerate(service.nets, 1):
        screen.say(f"net {number} is {escape(net)}")


def _token_in(file: Path) -> str:
    """Return the token of a file. Raises a CommandError."""
    try:
        token = file.read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise usage("CO123", f"--token-file: {file} cannot be read as a text", seen=str(error)) from error
    if not token:
        raise usage(
            "CO123", f"--token-file: {file} is empty", tries=("the same without --token-file: a new token at each start",)
        )
    return token
