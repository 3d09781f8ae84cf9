"""The address of a web door: the options of each command that has one, and the door that they mean."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from functools import partial
from pathlib import Path
from typing import Final, TypeAlias

import click

from canopen_cli.shared.options import together
from canopen_cli.shared.problem import usage
from canopen_gateway.web import WebDoor, bind_web_door
from canopen_gateway.web.door import DEFAULT_PORT

FILE: Final = click.Path(dir_okay=False, exists=True, path_type=Path)
BindDoor: TypeAlias = Callable[[], Awaitable[WebDoor]]
"""Binds the socket of a door."""


def _bind_door(
    bind: str, port: int, names: tuple[str, ...], cert: Path | None, key: Path | None, token_file: Path | None
) -> BindDoor:
    """Return what binds a door. Raises a CommandError for options that do not fit."""
    if (cert is None) is not (key is None):
        raise usage("CO123", "--cert and --key belong together", tries=("--cert FILE --key FILE",))
    certificate = None if cert is None or key is None else (cert, key)
    token = "" if token_file is None else _token_in(token_file)
    return partial(bind_web_door, host=bind, port=port, names=names, certificate=certificate, token=token)


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


web_address: Final = together(
    "bind_door",
    _bind_door,
    click.option("--bind", default="127.0.0.1", metavar="HOST", show_default=True, help="Where to listen."),
    click.option("--port", type=click.IntRange(0, 65535), default=DEFAULT_PORT, show_default=True, help="0: any free one."),
    click.option("--name", "names", multiple=True, metavar="NAME", help="A further name by which browsers reach it."),
    click.option("--cert", type=FILE, metavar="FILE", help="A certificate (PEM), for TLS: other computers may then reach it."),
    click.option("--key", type=FILE, metavar="FILE", help="Its key."),
    click.option("--token-file", type=FILE, metavar="FILE", help="A file with the token.  [default: a new one at each start]"),
)
"""The options of a web door. The command takes `bind_door`, which binds it."""
