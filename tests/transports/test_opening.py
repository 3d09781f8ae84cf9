"""open_transport: what reaches python-can, and what people read when a bus cannot be opened."""

from __future__ import annotations

import errno
import gc
import os
import struct
import subprocess
import sys
import threading
from pathlib import Path

import can
import pytest
import trio
from can.interfaces import VALID_INTERFACES

from canopen_transports import TransportError, open_transport, parse_locator
from canopen_transports.diagnosis import (
    bus_lost,
    cannot_open,
    found_here,
    interface_down,
    interface_missing,
    is_can_device,
    not_a_can_interface,
)
from tests.transports.fake_bus import ScriptedBus
from tests.transports.support import trio_test


def caused_by(error: Exception, cause: Exception) -> Exception:
    error.__cause__ = cause
    return error


def os_error(number: int) -> OSError:
    return OSError(number, os.strerror(number))


@pytest.mark.parametrize(
    ("locator", "channel", "options"),
    [
        ("pcan:PCAN_USBBUS1", "PCAN_USBBUS1", {"interface": "pcan"}),
        ("/dev/pcan32", "PCAN_USBBUS1", {"interface": "pcan", "bitrate": 500_000}),
        ("kvaser:0@1M", 0, {"interface": "kvaser", "bitrate": 1_000_000}),
        ("slcan:/dev/ttyACM0@250k?rtscts=true", "/dev/ttyACM0", {"interface": "slcan", "bitrate": 250_000, "rtscts": True}),
        ("udp_multicast", "239.74.163.2", {"interface": "udp_multicast", "hop_limit": 0}),
        ("udp_multicast:ff15::1?hop_limit=1", "ff15::1", {"interface": "udp_multicast", "hop_limit": 1}),
        ("neousys", None, {"interface": "neousys"}),
    ],
)
def test_a_locator_becomes_python_cans_arguments(
    monkeypatch: pytest.MonkeyPatch, locator: str, channel: object, options: dict[str, object]
) -> None:
    calls: list[dict[str, object]] = []

    def bus(**given: object) -> can.BusABC:
        calls.append(given)
        return ScriptedBus()

    async def body() -> None:
        async with await open_transport(locator) as transport:
            assert transport.locator == locator

    monkeypatch.setattr(can, "Bus", bus)
    trio.run(body)
    assert calls == [{"channel": channel, "ignore_config": True, **options}]


def test_cancelled_while_opening_nothing_stays_open(monkeypatch: pytest.MonkeyPatch) -> None:
    bus = ScriptedBus()
    started, go_on = threading.Event(), threading.Event()

    def slow(**_: object) -> can.BusABC:
        started.set()
        go_on.wait(10)
        return bus

    async def body() -> None:
        with trio.CancelScope() as scope:
            async with trio.open_nursery() as nursery:
                nursery.start_soon(use)
                await trio.to_thread.run_sync(started.wait)
                scope.cancel()
                go_on.set()

    async def use() -> None:
        async with await open_transport("kvaser:0") as transport:
            await transport.receive()

    monkeypatch.setattr(can, "Bus", slow)
    trio.run(body)
    assert bus._is_shutdown


@trio_test(real_time=True)
async def test_cancelled_before_opening_nothing_is_opened() -> None:
    with trio.CancelScope() as scope:
        scope.cancel()
        await open_transport("socketcan:can0")
    assert scope.cancelled_caught


@pytest.mark.thorough(6)
@pytest.mark.parametrize("interface", sorted(set(VALID_INTERFACES) - {"virtual", "udp_multicast"}))
def test_no_interface_of_python_can_is_there_whatever_this_host_has(interface: str, capfd: pytest.CaptureFixture[str]) -> None:
    threads = set(threading.enumerate())
    gc.freeze()  # what was there before is not looked at again
    for channel in ("", "96", "/dev/nowhere@250k", "nowhere@33k", "-1?bogus=1"):
        locator = f"{interface}:{channel}"
        with pytest.raises(TransportError) as caught:
            trio.run(open_transport, locator)
        error = caught.value
        if not (interface in ("serial", "socketcand") and "@" in channel):  # they have no bit rate
            assert error.code in ("CO101", "CO102")
            assert error.cause
        assert error.failed == f"cannot open {locator}"
        assert error.seen
        assert error.tries
        assert len(str(error).splitlines()) <= 10
        assert "Traceback" not in str(error)
        del caught, error
    gc.collect()  # python-can's half-made buses complain when they are collected
    assert capfd.readouterr().err == ""
    left = set(threading.enumerate()) - threads
    assert all(thread.name.startswith("Trio thread") for thread in left)  # trio keeps them for the next call


@pytest.mark.parametrize("interface", ["ixxat", "etas"])
@pytest.mark.skipif(sys.platform == "win32", reason="there they run")
def test_what_runs_on_another_system_alone_says_so(interface: str) -> None:
    with pytest.raises(TransportError) as caught:
        trio.run(open_transport, f"{interface}:0")
    assert caught.value.seen == f"python-can's {interface} does not run on this system ({sys.platform})"


@trio_test(real_time=True)
async def test_a_bit_rate_that_the_adapter_does_not_have_is_not_replaced() -> None:
    with pytest.raises(TransportError) as caught:
        await open_transport("pcan:PCAN_USBBUS1@300k")
    assert caught.value.seen == "pcan has no bit rate 300000"
    assert caught.value.tries[0].startswith("one of 1M, 800k, 500k, 250k")


BAD_PART = "a part of the locator is wrong or missing, or the interface does not know it"
REFUSED = "the adapter is not plugged in, or its driver refuses to open it"


@pytest.mark.parametrize("locator", ["serial:/dev/ttyUSB0@250k", "socketcand:can0@500k?host=127.0.0.1&port=1"])
def test_a_bit_rate_that_would_go_nowhere_is_refused(locator: str) -> None:
    with pytest.raises(TransportError, match="CO100") as caught:
        trio.run(open_transport, locator)
    assert "sets no bit rate" in caught.value.seen


NO_LIBRARY = "the software for this adapter is not installed"
NOT_THERE = "the adapter is not plugged in, its driver is not loaded, or it has another name"


@pytest.mark.parametrize(
    ("locator", "raised", "code", "cause", "step"),
    [
        ("pcan:PCAN_USBBUS1", OSError("pcanbasic library not found."), "CO101", NO_LIBRARY, "install PEAK's driver"),
        ("/dev/pcan32@1M", OSError("pcanbasic library not found."), "CO101", NO_LIBRARY,
         "socketcan:can0, after sudo ip link set can0 up type can bitrate 1000000"),
        ("pcan:PCAN_USBUS1", KeyError("PCAN_USBUS1"), "CO101", BAD_PART, "pcan:PCAN_USBBUS1@500k"),
        ("pcan:PCAN_USBBUS1", can.CanInitializationError("The value of a handle is invalid"), "CO101",
         "no PEAK adapter is plugged in, or its driver is not loaded", "canopen doctor"),
        ("kvaser:0", NameError("name 'canGetNumberOfChannels' is not defined"), "CO101", NO_LIBRARY, "install Kvaser's driver"),
        ("neovi:1", ImportError("Please install python-ics"), "CO101", NO_LIBRARY, "pip install 'python-can[neovi]'"),
        ("slcan:/dev/ttyACM0", can.CanInterfaceNotImplementedError("The serial module is not installed"), "CO101", NO_LIBRARY,
         "pip install 'python-can[serial]'"),
        ("etas:0", can.CanInterfaceNotImplementedError("module 'ctypes' has no attribute 'windll'"), "CO101", NO_LIBRARY, "BOA"),
        ("slcan:/dev/ttyACM0", caused_by(can.CanInitializationError("could not open port"), os_error(errno.EACCES)), "CO102",
         "this user may not use the interface", "sudo usermod -aG dialout $USER"),
        ("gs_usb:0", os_error(errno.EPERM), "CO102", "this user may not use the interface", "run this as root"),
        ("slcan:/dev/ttyACM0", caused_by(can.CanInitializationError("busy"), os_error(errno.EBUSY)), "CO101",
         "another program uses the adapter", "fuser -v /dev/ttyACM0"),
        ("gs_usb:0", os_error(errno.EBUSY), "CO101", "another program uses the adapter", "close the other program"),
        ("slcan:/dev/ttyACM7", caused_by(can.CanInitializationError("no port"), os_error(errno.ENOENT)), "CO101",
         NOT_THERE, "plug it in, then canopen doctor"),
        ("socketcan:can0", os_error(errno.EAFNOSUPPORT), "CO101", "the kernel was built without it, or the module is not loaded",
         "sudo modprobe can_raw"),
        ("socketcan:can0", AttributeError("module 'socket' has no attribute 'AF_CAN'"), "CO101",
         "SocketCAN is a part of Linux", "virtual"),
        ("socketcand:can0", TypeError("missing 2 required positional arguments: 'host' and 'port'"), "CO101", BAD_PART,
         "socketcand:can0?host=192.168.0.2&port=29536"),
        ("socketcand:can0?host=h&port=1", ConnectionRefusedError(errno.ECONNREFUSED, "refused"), "CO101",
         "no server of socketcand runs there, or a firewall is between", "socketcand -v -i can0"),
        ("kvaser:", TypeError("missing 1 required positional argument: 'channel'"), "CO101", BAD_PART, "kvaser:0@500k"),
        ("gs_usb:0@1M", can.CanInitializationError("Cannot find device 0. Devices found: 0"), "CO101", NOT_THERE,
         "socketcan:can0, after sudo ip link set can0 up type can bitrate 1000000   (with the kernel's own driver, gs_usb)"),
        ("canalystii:0@1M", ValueError("No Canalyst-II USB device found"), "CO101", NOT_THERE, "virtual"),
        ("udp_multicast", caused_by(can.CanInitializationError("could not create socket"), os_error(errno.ENODEV)), "CO101",
         "no network interface of this computer carries multicast", "sudo ip route add 224.0.0.0/4 dev lo"),
        ("vector:0", RuntimeError(), "CO101", REFUSED, "virtual"),
        ("vector:0", struct.error("unpack requires a buffer of 4 bytes"), "CO101", REFUSED, "virtual"),
    ],
)  # fmt: skip
def test_every_family_of_exceptions_is_explained(locator: str, raised: Exception, code: str, cause: str, step: str) -> None:
    error = cannot_open(parse_locator(locator), raised)
    assert (error.code, error.cause) == (code, cause)
    assert any(step in line for line in error.tries), error.tries
    assert error.seen
    assert len(str(error).splitlines()) <= 10


def test_one_message_in_full() -> None:
    raised = caused_by(can.CanInitializationError("no port"), os_error(errno.EACCES))
    error = cannot_open(parse_locator("slcan:/dev/ttyACM0"), raised)
    assert str(error) == (
        "CO102: cannot open slcan:/dev/ttyACM0\n"
        "  seen:  no port: [Errno 13] Permission denied\n"
        "  cause: this user may not use the interface\n"
        "  try:   sudo usermod -aG dialout $USER   (then log in again)"
    )
    assert repr(error) == "TransportError('CO102', 'slcan:/dev/ttyACM0', 'cannot open slcan:/dev/ttyACM0')"


def test_a_serial_device_that_is_not_there_is_named_once() -> None:
    raised = caused_by(can.CanInitializationError("[Errno 2] could not open port /dev/nope"), os_error(errno.ENOENT))
    assert cannot_open(parse_locator("slcan:/dev/nope"), raised).seen == "there is no /dev/nope"
    raised = caused_by(can.CanInitializationError("could not open port COM3"), os_error(errno.ENOENT))
    assert "COM3" in cannot_open(parse_locator("slcan:COM3"), raised).seen


def test_socketcan_says_the_exact_command() -> None:
    assert interface_down(parse_locator("can0")).tries == ("sudo ip link set can0 up type can bitrate 500000",)
    assert interface_down(parse_locator("can0@125k")).tries == ("sudo ip link set can0 up type can bitrate 125000",)
    create = "sudo modprobe vcan && sudo ip link add dev vcan0 type vcan && sudo ip link set vcan0 up"
    assert interface_missing(parse_locator("vcan0")).tries[0] == create
    assert interface_missing(parse_locator("can0")).tries[-1] == "ip link show"
    assert "not a CAN bus" in not_a_can_interface(parse_locator("socketcan:eth0")).seen


def test_a_lost_network_is_explained() -> None:
    raised = caused_by(can.CanOperationError("failed to send via socket"), os_error(errno.ENETUNREACH))
    error = bus_lost(parse_locator("udp_multicast"), "send 080#", raised)
    assert error.failed == "cannot send 080# on udp_multicast"
    assert error.tries[0].startswith("sudo ip route add")


def test_adapters_are_found(tmp_path: Path) -> None:
    for name, kind in (("can0", "280\n"), ("eth0", "1\n"), ("odd0", "?")):
        device = tmp_path / "sys/class/net" / name
        device.mkdir(parents=True)
        (device / "type").write_text(kind)
    (tmp_path / "dev").mkdir()
    for name in ("pcan32", "ttyACM0", "ttyUSB1", "tty1"):
        (tmp_path / "dev" / name).touch()
    assert found_here(tmp_path) == ["socketcan:can0", "/dev/pcan32", "slcan:/dev/ttyACM0", "slcan:/dev/ttyUSB1"]
    assert is_can_device("eth0", tmp_path) is False
    assert is_can_device("can7", tmp_path) is None


def test_what_was_found_is_offered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("canopen_transports.diagnosis.found_here", lambda: ["socketcan:can0", "slcan:/dev/ttyACM0"])
    error = cannot_open(parse_locator("socketcan:can0"), os_error(errno.ENODEV))
    assert error.tries[0] == "what was found here: slcan:/dev/ttyACM0"


def test_python_cans_log_does_not_get_in_the_way() -> None:
    program = (
        "import trio, canopen_transports as t\n"
        "for locator in ('kvaser:0', 'pcan:PCAN_USBBUS1', 'socketcan:nocan0', 'vector:0'):\n"
        "    try: trio.run(t.open_transport, locator)\n"
        "    except t.TransportError as error: print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True,
                          env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)})  # fmt: skip
    assert done.stderr == ""
    assert done.stdout.count("cannot open") == 4
