"""`canopen serve mqtt`: telemetry to an MQTT broker, one way."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, Final

import click

from canopen_cli.fleet.joining import SiteName
from canopen_cli.serve.served import open_service, serve_door
from canopen_cli.shared.options import FILE, Kind, Seconds, Settings, command, lasting
from canopen_cli.shared.problem import usage
from canopen_cli.shared.screen import Screen, escape
from canopen_gateway.mqtt import BrokerAddress, BrokerLogin, MqttDoor, bind_mqtt_door, parse_broker
from canopen_gateway.mqtt.door import LEAST_PERIOD, PERIOD

PASSWORD_VARIABLE: Final = "CANOPEN_MQTT_PASSWORD"


class Broker(Kind):
    """Where a broker is: "mqtts://broker.lan"."""

    name = "broker"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> BrokerAddress:
        if isinstance(value, BrokerAddress):
            return value
        try:
            return parse_broker(str(value))
        except ValueError as error:
            self.fail(str(error), param, ctx)


@command(name="mqtt")
@click.option("--site", type=SiteName(), required=True, metavar="NAME", help="The name of this computer in topics.")
@click.option(
    "--broker",
    type=Broker(),
    default="mqtt://127.0.0.1",
    show_default=True,
    metavar="URL",
    help="mqtt://HOST; mqtts:// for TLS.",
)
@click.option("--user", default="", metavar="NAME", help=f"Its password stands in --password-file, or in {PASSWORD_VARIABLE}.")
@click.option("--password-file", type=FILE, metavar="FILE", help="A file with the password in its first line.")
@click.option("--ca", "authority", type=FILE, metavar="FILE", help="Whom to believe (PEM).  [default: as the system does]")
@click.option("--cert", "certificate", type=FILE, metavar="FILE", help="Our own certificate (PEM), if the broker asks for one.")
@click.option("--key", type=FILE, metavar="FILE", help="Its key.")
@click.option("--read", "objects", multiple=True, metavar="OBJECT", help="Read from each node, too; may be repeated.")
@click.option("--every", type=Seconds(LEAST_PERIOD), default="5s", show_default=True, help="How often each is read.")
@click.option(
    "--period",
    type=Seconds(LEAST_PERIOD),
    default=f"{PERIOD:g}s",
    show_default=True,
    help="From one value to the next.",
)
@click.option("--clear-text", is_flag=True, help="The password may cross the network without TLS.")
@lasting()
def serve_mqtt(
    settings: Settings,
    screen: Screen,
    site: str,
    broker: BrokerAddress,
    user: str,
    password_file: Path | None,
    authority: Path | None,
    certificate: Path | None,
    key: Path | None,
    objects: tuple[str, ...],
    every: float,
    period: float,
    clear_text: bool,
    seconds: float,
) -> None:
    """Tell an MQTT broker what a machine does, one way: states, values, emergencies. Until Ctrl-C; needs the extra `mqtt`.

    It tells, and is told nothing: it subscribes to no topic. Last values are retained. A broker that is away, or hangs, is tried
    again, and delays no bus. Topics: canopen/v1/SITE/BUS/NODE/values/NAME, and docs/gateway.md.

    \b
    canopen serve mqtt --site hall-2 -b demo --read statusword
    mosquitto_sub -v -t 'canopen/v1/#'
    canopen serve mqtt --site hall-2 -m cell.toml --broker mqtts://broker.lan --user hall-2 --password-file secret
    """
    password = _password(password_file)
    if password and not user:
        raise usage("CO123", "a password needs its --user", tries=("--user NAME",))
    if key is not None and certificate is None:
        raise usage("CO123", "--key belongs to --cert", tries=("--cert FILE --key FILE",))
    login = BrokerLogin(user, password, authority, certificate, key)

    serve_door(
        settings,
        screen,
        lambda: bind_mqtt_door(site, broker, login, objects=objects, period=period, every=every, clear_text=clear_text),
        lambda: open_service(settings, screen, ()),
        lambda door, service: _tell(settings, screen, door, service.nets),
        seconds,
    )


def _tell(settings: Settings, screen: Screen, door: MqttDoor, nets: tuple[str, ...]) -> None:
    if settings.json:
        screen.json({"site": door.site, "broker": str(door.link.address), "nets": list(nets)})
    there = (
        "connected" if door.link.is_connected else f"not there yet, and tried again: {door.link.problem or 'it has not answered'}"
    )
    screen.say(f"[bold]telemetry to {escape(str(door.link.address))}[/], one way; {escape(there)}")


def _password(file: Path | None) -> str:
    """Return the password of a file, or of the environment. Raises a CommandError."""
    if file is None:
        return os.environ.get(PASSWORD_VARIABLE, "")
    try:
        lines = file.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise usage("CO123", f"--password-file: {file} cannot be read as a text", seen=str(error)) from error
    if not lines or not lines[0]:
        raise usage("CO123", f"--password-file: {file} has no first line", tries=("a file with the password in its first line",))
    return lines[0]
