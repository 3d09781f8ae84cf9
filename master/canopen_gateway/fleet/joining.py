"""How a program joins a fleet: the Zenoh session, and what it may listen to.

No multicast and no gossip: who is asked stands in the program's own words. A viewer is a "peer" and connects. A bridge is a
"router" in Zenoh's sense, whether it listens or connects: it passes on what it hears, as `canopen fleet router` does, and peers
do not.

TLS, users and access rules are Zenoh's own, in a file of its configuration (JSON5): docs/fleet.md has one of each.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from canopen_gateway.errors import DoorError, FleetError, first_line
from canopen_master.errors import PackageMissingError
from canopen_transports.loop import current_loop
from canopen_transports.tcp.address import is_loopback

if TYPE_CHECKING:
    import zenoh

DEFAULT_ENDPOINT: Final = "tcp/127.0.0.1:7447"
"""Zenoh's own port, on this computer."""
HUNG_TIME: Final = 1000
"""Milliseconds after which a program that says nothing counts as gone."""
_TLS: Final = ("tls", "quic", "wss")


async def open_zenoh(
    *,
    connect: Sequence[str] = (),
    listen: Sequence[str] = (),
    config: Path | None = None,
    reachable: bool = False,
    mode: str = "peer",
) -> zenoh.Session:
    """Open a Zenoh session. connect, listen: endpoints, as "tcp/192.168.1.20:7447"; they replace those of `config`, a file of
    Zenoh's configuration. reachable: other computers may come in though nobody proves who he is. mode: "peer", or "router".

    Who is not there yet when it connects is tried again, for ever. Raises DoorError if it cannot listen, or should not;
    FleetError; PackageMissingError without the extra `fleet`.
    """
    try:
        import zenoh  # here: 10 MB, and no other door needs it
    except ImportError as error:
        raise PackageMissingError("eclipse-zenoh", "fleet", "a fleet", error) from error

    if config is not None and not config.is_file():
        raise FleetError(f"{config} cannot be read", seen="there is no such file", tries=("--zenoh FILE.json5",))
    try:
        settings = zenoh.Config() if config is None else zenoh.Config.from_file(str(config))
    except zenoh.ZError as error:
        raise FleetError(f"{config} is no configuration of Zenoh", seen=first_line(error)) from error
    _set(settings, "mode", mode)
    for part in ("multicast", "gossip"):
        _set(settings, f"scouting/{part}/enabled", False)
    _set(settings, "transport/link/tx/lease", HUNG_TIME)
    _set(settings, "transport/link/tx/queue/congestion_control/drop/wait_before_drop", 0)  # the bus does not wait for a viewer
    untold = zenoh.Config().get_json("listen/endpoints")
    for part, endpoints in (("connect", connect), ("listen", listen)):
        key = f"{part}/endpoints"
        if endpoints or settings.get_json(key) == untold:  # Zenoh alone would listen on all interfaces
            _set(settings, key, list(endpoints))
    _check_reach(settings, reachable)
    _set(settings, "listen/exit_on_failure", True)
    try:
        return await current_loop().in_thread(zenoh.open, settings)
    except zenoh.ZError as error:
        listens = ", ".join(_endpoints(settings, "listen"))
        if listens:
            raise DoorError(
                f"cannot listen at {listens}",
                seen=first_line(error),
                cause="another program has the port, or this computer has no such address",
                tries=("another port", "canopen fleet router once, and --connect for each bridge"),
            ) from error
        raise FleetError("the fleet cannot be joined", seen=first_line(error), tries=("--connect tcp/HOST:7447",)) from error


async def close_zenoh(session: zenoh.Session) -> None:
    """Close a session; it waits for its network, but not for ever."""
    loop = current_loop()
    with loop.move_on_after(5.0, shield=True):
        await loop.in_thread(session.close, abandon_on_cancel=True)


def check_endpoint(text: str) -> str:
    """Return an endpoint such as "tcp/192.168.1.20:7447". Raises ValueError."""
    protocol, slash, address = text.partition("/")
    host, colon, port = address.partition("#")[0].rpartition(":")
    if not (slash and protocol.isalnum() and colon and host and port.isdigit() and int(port) <= 65535):
        raise ValueError(f"{text!r} is no endpoint: it is PROTOCOL/HOST:PORT, as tcp/192.168.1.20:7447")
    return text


def _check_reach(settings: zenoh.Config, reachable: bool) -> None:
    """Raise DoorError if other computers could come in, and nobody proves who he is."""
    if reachable or _proves(settings):
        return
    for endpoint in _endpoints(settings, "listen"):
        protocol, _, address = endpoint.partition("/")
        if not is_loopback(address.partition("#")[0].rpartition(":")[0].strip("[]")):
            raise DoorError(
                f"{endpoint} is reachable from other computers",
                seen=f"{protocol} without users and without certificates of clients",
                cause="whoever reaches it may do what this door allows",
                tries=(
                    "users or mTLS in a file of Zenoh's configuration: --zenoh FILE.json5 (docs/fleet.md)",
                    "--reachable, if that is meant",
                ),
            )


def _proves(settings: zenoh.Config) -> bool:
    """Return whether whoever comes in has to prove who he is: by a password, or by a certificate on each endpoint."""
    if _get(settings, "transport/auth/usrpwd/dictionary_file"):
        return True
    endpoints = _endpoints(settings, "listen")
    mutual = bool(_get(settings, "transport/link/tls/enable_mtls"))
    return mutual and all(each.partition("/")[0] in _TLS for each in endpoints)


def _endpoints(settings: zenoh.Config, part: str) -> list[str]:
    found = _get(settings, f"{part}/endpoints")
    if isinstance(found, dict):  # by mode
        found = [endpoint for each in found.values() for endpoint in each]
    return [str(each) for each in found or ()]


def _get(settings: zenoh.Config, key: str) -> Any:
    import zenoh

    try:
        return json.loads(settings.get_json(key))
    except zenoh.ZError:
        return None


def _set(settings: zenoh.Config, key: str, value: object) -> None:
    settings.insert_json5(key, json.dumps(value))
