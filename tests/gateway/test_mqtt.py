"""Telemetry to an MQTT broker: what it tells, and that a broker has no way to tell it, or the bus, anything."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
import trio

from canopen_cli.shared.problem import ExitCode
from canopen_data.descriptions import load_description
from canopen_gateway import DoorError, GatewayService
from canopen_gateway.mqtt import BrokerAddress, BrokerLogin, MqttDoor, bind_mqtt_door, parse_broker
from canopen_gateway.mqtt.broker import MOST_UNDER_WAY, check_secret
from canopen_gateway.mqtt.door import EVENTS_KEPT
from canopen_gateway.places import check_object
from canopen_master import DeviceModel, Host
from canopen_proto.dictionary import ObjectNotFoundError
from canopen_proto.frame import Frame
from canopen_transports import open_transport
from tests.cli.cli_support import Run, runner
from tests.gateway.fleet_world import real_time, seen
from tests.gateway.gateway_world import gateway
from tests.gateway.mqtt_world import CONNECT, DISCONNECT, PINGREQ, PUBLISH, BareBroker, Subscriber, broker, free_port
from tests.gateway.test_fleet_access import certify
from tests.master.world import BUS as VIRTUAL
from tests.master.world import drives

pytest.importorskip("paho", reason="the extra mqtt is not installed")
pytest.importorskip("amqtt", reason="amqtt is not installed: the extra `test` has it")

ROOT = "canopen/v1/hall"
BUS = f"{ROOT}/virtual-test"
NOBODY = BrokerLogin()


@asynccontextmanager
async def telemetry(
    port: int, *node_ids: int, login: BrokerLogin = NOBODY, secure: bool = False, **options: Any
) -> AsyncIterator[tuple[Host, GatewayService, MqttDoor]]:
    """A machine that tells a broker on this computer."""
    made = {name: options.pop(name) for name in ("objects", "period", "every") if name in options}
    address = BrokerAddress("127.0.0.1", port, secure)
    door = await bind_mqtt_door("hall", address, login, **{"period": 0.05, "every": 0.2, **made})
    async with door, gateway(*node_ids, **options) as (host, service), trio.open_nursery() as nursery:
        nursery.start_soon(door.serve, service)
        yield host, service, door
        nursery.cancel_scope.cancel()


@real_time
async def test_values_states_and_emergencies_are_told_and_retained_for_who_comes_later(tmp_path: Path) -> None:
    port = free_port()
    objects = ("statusword", "1008", "1018:01", "2FFF:00")
    with broker(tmp_path, port):
        async with telemetry(port, 3, 4, objects=objects) as (host, _, door):
            with Subscriber(port) as early:
                await seen(lambda: early.last(f"{BUS}/4/values/identity_object:vendor_id") is not None)
                drives(host)[0].raise_fault(0x2310, host.now())
                host.pump()
                await seen(lambda: early.last(f"{BUS}/3/emcy") is not None)
            with Subscriber(port) as late:
                values = f"{BUS}/3/values"
                wanted = (f"{ROOT}/online", f"{values}/statusword", f"{BUS}/3/emcy", f"{BUS}/status", f"{values}/2FFF:00")
                await seen(lambda: all(late.last(each) is not None for each in wanted))
                assert all(late.told[each][0][1] for each in wanted)  # the first of each was retained
                told = late.last(f"{values}/manufacturer_device_name")
                assert (told["value"], told["type"]) == ("Simulated Schunk Powerball joint", "VISIBLE_STRING")
                assert late.last(f"{values}/identity_object:vendor_id")["bytes"] == "32 03 00 00"
                assert "refused reading 2FFF:00" in late.last(f"{values}/2FFF:00")["problem"]
                assert late.last(f"{BUS}/3/emcy")["code"] == "0x2310"
                await seen(lambda: list(late.last(f"{BUS}/status")["nodes"]) == ["3", "4"])
                assert late.last(f"{ROOT}/online")["online"] is True
                assert door.dropped == 0
                await leave(door)
                await seen(lambda: late.last(f"{ROOT}/online")["online"] is False)


@real_time
async def test_a_name_that_no_dictionary_at_hand_knows_is_refused_before_anything_is_told() -> None:
    for wrong, told in (("statuswort", "did you mean statusword"), ("NONSENSE", "'NONSENSE' is not in the dictionary")):
        with BareBroker() as bare:
            address = BrokerAddress("127.0.0.1", bare.port, False)
            door = await bind_mqtt_door("hall", address, objects=("1018:01", wrong))
            async with door, gateway(3) as (_, service):
                with pytest.raises(ObjectNotFoundError, match=told):
                    await door.serve(service)
                assert not door._last


@real_time
async def test_a_name_that_one_dictionary_at_hand_knows_is_read_of_its_node() -> None:
    """And the others say that they have none."""
    device = DeviceModel(load_description("sample_io.eds").dictionary, node_id=5)
    name = next(each.name for each in device.dictionary if each.index >= 0x6000)
    with BareBroker() as bare:
        door = await bind_mqtt_door("hall", BrokerAddress("127.0.0.1", bare.port, False), objects=(name,), every=0.2)
        async with door, gateway(makers=[device]) as (_, service), trio.open_nursery() as nursery:
            with pytest.raises(ObjectNotFoundError):
                await door.serve(service)
            service.master.node(5, "sample_io.eds")
            for wrong in (f"{name}x", "statusworx"):
                with pytest.raises(ObjectNotFoundError, match=f"in no dictionary at hand; did you mean .*{re.escape(wrong[:9])}"):
                    check_object(service.master.dictionaries, wrong)
            nursery.start_soon(door.serve, service)
            await seen(lambda: any("/5/values/" in each for each in door._last))
            nursery.cancel_scope.cancel()


async def leave(door: MqttDoor) -> None:
    """End the door as its block does."""
    await door.__aexit__()


@real_time
async def test_values_of_pdos_are_told_with_type_and_unit() -> None:
    device = DeviceModel(load_description("sample_io.eds").dictionary, node_id=5)
    with BareBroker() as bare:
        async with telemetry(bare.port, makers=[device]) as (_, service, door):
            node = service.master.node(5, "sample_io.eds")
            await node.start()
            await seen(lambda: any("/5/values/" in each for each in door._last))
            (topic, payload) = next((topic, told) for topic, told in door._last.items() if "/5/values/" in topic)
            told = json.loads(payload)
            assert set(told) == {"time", "value", "unit", "type"}
            assert topic.startswith(f"{BUS}/5/values/Input-")
            await seen(lambda: PUBLISH in bare.packets)


@real_time
async def test_it_subscribes_to_nothing() -> None:
    with BareBroker() as bare:
        async with telemetry(bare.port, 3, objects=("statusword",)) as (_, _, door):
            await seen(lambda: bare.packets.count(PUBLISH) > 3)
            bare.drop_all()
            await seen(lambda: bare.connections > 1 and door.link.is_connected)
            await seen(lambda: bare.packets.count(PUBLISH) > 6)
        assert set(bare.packets) <= {CONNECT, PUBLISH, PINGREQ, DISCONNECT}


@real_time
async def test_a_broker_that_hangs_gets_no_more_than_a_bound_and_delays_nothing() -> None:
    """It greets, and then reads nothing: what paho holds for it is bounded, the values are the last ones, a read is answered."""
    with BareBroker(hangs=True) as bare:
        async with telemetry(bare.port, 3, objects=("statusword",), every=0.05) as (_, service, door):
            await seen(lambda: door.link.is_connected)
            payload = b"x" * 4000  # so that the system's buffers are soon full
            still = 0
            while still < 10:  # the system takes some more, and then no more
                done = door.link._done
                for number in range(200):
                    door._tell(f"{BUS}/3/values/{number}", {"value": payload.decode()})
                await trio.sleep(door._period)
                is_full = door.link._handed_over - door.link._done >= MOST_UNDER_WAY
                still = still + 1 if is_full and door.link._done == done else 0
            for number in range(1000):
                door._tell(f"{BUS}/3/values/{number}", {"value": number})
            for _ in range(3):
                await trio.sleep(door._period)
                assert await service.node(service.nets[0], 3).read_bytes(0x1000, 0)
                assert door.link._handed_over - door.link._done <= MOST_UNDER_WAY
            await seen(lambda: len(door._changed) > 500)  # while they are offered, they are in a thread
            assert json.loads(door._last[f"{BUS}/3/values/7"]) == {"value": 7}


@pytest.mark.thorough
@real_time
async def test_a_broker_that_is_away_at_first_and_one_that_comes_back_get_all_last_values(tmp_path: Path) -> None:
    port = free_port()
    async with telemetry(port, 3, objects=("statusword",)) as (_, _, door):
        door.link._client.reconnect_delay_set(1, 1)
        await seen(lambda: "refused" in door.link.problem)
        await seen(lambda: f"{BUS}/3/values/statusword" in door._last)
        for _ in range(2):
            with broker(tmp_path, port), Subscriber(port) as viewer:
                await seen(lambda: viewer.last(f"{BUS}/3/values/statusword") is not None)
                assert viewer.last(f"{BUS}/3/values/statusword")["value"] == 0x0240
                assert viewer.last(f"{ROOT}/online")["online"] is True
            await seen(lambda: not door.link.is_connected)


def test_the_last_will_is_published_when_the_program_is_killed(tmp_path: Path) -> None:
    port = free_port()
    paths = [each for each in sys.path if each]
    start = f"import sys; sys.path[:0] = {paths!r}; from canopen_cli.entry import main; sys.exit(main())"
    words = ["serve", "mqtt", "--site", "hall", "-b", "demo", "--broker", f"mqtt://127.0.0.1:{port}"]
    with broker(tmp_path, port), Subscriber(port) as viewer:
        with subprocess.Popen([sys.executable, "-c", start, *words], stderr=subprocess.PIPE) as process:
            try:
                wait(lambda: (viewer.last(f"{ROOT}/online") or {}).get("online") is True)
            finally:
                process.send_signal(signal.SIGKILL)
        wait(lambda: viewer.last(f"{ROOT}/online")["online"] is False)


def wait(condition: Any) -> None:
    """Wait until something is so; pytest's time-out ends it."""
    while not condition():
        time.sleep(0.02)


@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # paho leaves the socket of a failed TLS open
@real_time
async def test_tls_a_stranger_to_the_authority_and_a_wrong_password(tmp_path: Path) -> None:
    certify(tmp_path)
    port = free_port()
    (tmp_path / "users").write_text("hall:" + hashed("stone") + "\n")
    auth = {"amqtt.plugins.authentication.FileAuthPlugin": {"password_file": str(tmp_path / "users")}}
    tls = {"ssl": True, "certfile": str(tmp_path / "bridge.pem"), "keyfile": str(tmp_path / "bridge.key")}
    ca = tmp_path / "ca.pem"
    with broker(tmp_path, port, auth=auth, **tls):
        async with telemetry(port, secure=True, login=BrokerLogin("hall", "stone", ca)) as (_, _, door):
            await seen(lambda: door.link.is_connected)
        async with telemetry(port, secure=True, login=BrokerLogin("hall", "wrong", ca)) as (_, _, door):
            await seen(lambda: "refused" in door.link.problem or "ended" in door.link.problem)
            assert not door.link.is_connected
        async with telemetry(port, secure=True, login=BrokerLogin("hall", "stone")) as (
            _,
            _,
            door,
        ):  # the system knows no such CA
            await seen(lambda: "certificate verify failed" in door.link.problem.lower())
            assert not door.link.is_connected


def hashed(password: str) -> str:
    from pwdlib import PasswordHash
    from pwdlib.hashers.argon2 import Argon2Hasher

    return PasswordHash((Argon2Hasher(),)).hash(password)


@real_time
async def test_a_door_that_fails_says_why_and_the_machine_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    with BareBroker() as bare:
        async with telemetry(bare.port, 3) as (_, service, door):
            await seen(lambda: door.sent > 0)
            monkeypatch.setattr(door.link, "send", lambda messages: {}["no such thread"])
            await seen(lambda: door.failure is not None)
            assert isinstance(door.failure, KeyError)
            assert await service.node(service.nets[0], 3).read("device_type")


@real_time
async def test_emergencies_that_nobody_takes_are_bounded_and_counted() -> None:
    async with telemetry(free_port(), 3) as (_, _, door), await open_transport(VIRTUAL) as other:
        await seen(lambda: f"{BUS}/status" in door._last)
        for number in range(EVENTS_KEPT + 10):
            await other.send(Frame(0x83, (0x2310 + number).to_bytes(2, "little") + bytes(6)))
            while len(door._events) + door.dropped <= number:
                await trio.sleep(0)
        assert (len(door._events), door.dropped) == (EVENTS_KEPT, 10)
        assert json.loads(door._events[0][1])["code"] == f"0x{0x2310 + 10:04X}"  # the oldest went


@real_time
async def test_states_that_came_faster_than_they_were_taken_are_told_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("canopen_gateway.service.EVENTS_WAITING", 1)
    monkeypatch.setattr("canopen_gateway.mqtt.door.STATUS_PERIOD", 0.1)
    async with telemetry(free_port(), 3) as (_, _, door), await open_transport(VIRTUAL) as wire:
        for node_id in range(20, 40):
            await wire.send(Frame(0x700 + node_id, b"\x05"))
        await seen(lambda: door._session.dropped > 0)
        await seen(lambda: all(door._states.get(f"{BUS}/{node_id}/state") == "operational" for node_id in range(20, 40)))
        await seen(lambda: all("lost" in door._states[f"{BUS}/{node_id}/state"] for node_id in range(20, 40)))


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> Run:
    return runner(capsys, monkeypatch, tmp_path_factory.mktemp("own"))


def test_the_command_and_where_its_password_may_stand(run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    words = ("serve", "mqtt", "--site", "hall", "-b", "demo", "--for", "0.1s", "--broker", f"mqtt://127.0.0.1:{free_port()}")
    status, out, err = run(*words, "--json")
    assert (status, json.loads(out)["site"], "one way" in err) == (ExitCode.OK, "hall", True)
    secret, empty = tmp_path / "secret", tmp_path / "empty"
    secret.write_text("stone\n")
    empty.write_text("")
    assert run(*words, "--user", "a", "--password-file", str(secret)).status == ExitCode.OK
    status, out, err = run(*words, "--read", "statusword", "--read", "statuswort")
    assert (status, "did you mean statusword" in out + err, "one way" in err) == (ExitCode.USAGE, True, False)
    status, out, _ = run(*words, "--read", "statuswort", "--json")
    assert (status, out) == (ExitCode.USAGE, "")
    status, _, err = run("serve", "mqtt", "--site", "a/b", "-b", "demo")
    assert (status, "small letters" in err) == (ExitCode.USAGE, True)
    for wrong in (
        ("--password-file", str(secret)),
        ("--user", "a", "--password-file", str(empty)),
        ("--user", "a", "--password-file", str(tmp_path / "none")),
        ("--key", str(secret)),
        ("--broker", "mqtt://a:stone@localhost"),
        ("--allow", "write"),
    ):
        refused = run(*words, *wrong)
        assert refused.status == ExitCode.USAGE, wrong
        assert "stone" not in refused.out + refused.err
    monkeypatch.setenv("CANOPEN_MQTT_PASSWORD", "stone")
    refused = run(*words[:-1], "mqtt://broker.example", "--user", "a")
    assert (refused.status, "unencrypted" in refused.err, "stone" in refused.err) == (ExitCode.CANNOT_OPEN, True, False)
    with monkeypatch.context() as without:
        without.setitem(sys.modules, "paho.mqtt.client", None)
        without.delitem(sys.modules, "paho.mqtt", raising=False)
        without.setitem(sys.modules, "paho", None)
        refused = run(*words, "--user", "a")
        assert (refused.status, "canopen-proto[mqtt]" in refused.err) == (ExitCode.USAGE, True)


@pytest.mark.parametrize(
    "text",
    [
        "broker",
        "http://x",
        "mqtt://",
        "mqtt://a:99999",
        "mqtt://u:secret@a",
        "mqtts://u@a",
        "mqtt://a/topic",
        "mqtt://a?x=1",
        "mqtt:a",
    ],
)
def test_what_is_no_address_of_a_broker(text: str) -> None:
    with pytest.raises(ValueError) as refused:
        parse_broker(text)
    assert "secret" not in str(refused.value)


def test_addresses_and_secrets(tmp_path: Path) -> None:
    assert parse_broker("mqtt://a") == BrokerAddress("a", 1883, False)
    assert str(parse_broker("mqtts://[::1]:1")) == "mqtts://[::1]:1"
    assert parse_broker("mqtts://a") == BrokerAddress("a", 8883, True)
    assert "stone" not in repr(BrokerLogin("hall", "stone"))
    with pytest.raises(DoorError, match="unencrypted"):
        check_secret(BrokerAddress("broker.lan", 1883, False), BrokerLogin("a", "b"), clear_text=False)
    with pytest.raises(DoorError, match="without TLS"):
        check_secret(BrokerAddress("a", 1, False), BrokerLogin(authority=tmp_path), clear_text=False)
    for address, clear in ((BrokerAddress("127.0.0.1", 1, False), False), (BrokerAddress("a", 1, True), False)):
        check_secret(address, BrokerLogin("a", "b"), clear_text=clear)
    check_secret(BrokerAddress("a", 1, False), BrokerLogin("a", "b"), clear_text=True)


@real_time
async def test_certificates_that_are_none_are_told_at_once(tmp_path: Path) -> None:
    (tmp_path / "ca.pem").write_text("x")
    for login in (BrokerLogin(authority=tmp_path / "ca.pem"), BrokerLogin(authority=tmp_path / "none.pem")):
        with pytest.raises(DoorError, match="certificates cannot be used"):
            await bind_mqtt_door("hall", BrokerAddress("127.0.0.1", 1, True), login)
    with pytest.raises(ValueError, match="a name has"):
        await bind_mqtt_door("Hall+", BrokerAddress("127.0.0.1", 1, False))
