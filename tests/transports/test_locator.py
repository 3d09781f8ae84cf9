"""Locators: every form that the documentation promises, and what is said of the others."""

from __future__ import annotations

import pytest

from canopen_transports import TransportError, parse_bitrate, parse_locator
from canopen_transports.locator import bitrate_text


@pytest.mark.parametrize(
    ("text", "interface", "channel", "bitrate", "options"),
    [
        ("virtual:demo", "virtual", "demo", None, {}),
        ("virtual", "virtual", "default", None, {}),
        ("virtual:demo@500k?loss=0.001", "virtual", "demo", 500_000, {"loss": 0.001}),
        ("socketcan:can0", "socketcan", "can0", None, {}),
        ("socketcan:can0@500k", "socketcan", "can0", 500_000, {}),
        ("can1@125000", "socketcan", "can1", 125_000, {}),
        ("vcan0", "socketcan", "vcan0", None, {}),
        ("slcan0", "socketcan", "slcan0", None, {}),
        ("pcan:PCAN_USBBUS1@500k", "pcan", "PCAN_USBBUS1", 500_000, {}),
        ("/dev/pcan32", "pcan", "PCAN_USBBUS1", 500_000, {}),
        ("/dev/pcan33@1M", "pcan", "PCAN_USBBUS2", 1_000_000, {}),
        ("/dev/pcanusb32", "pcan", "PCAN_USBBUS1", 500_000, {}),
        ("/dev/pcan0", "pcan", "PCAN_PCIBUS1", 500_000, {}),
        ("/dev/pcanpci7", "pcan", "PCAN_PCIBUS8", 500_000, {}),
        ("/dev/pcan9", "pcan", "PCAN_ISABUS2", 500_000, {}),
        ("/dev/pcan40", "pcan", "PCAN_PCCBUS1", 500_000, {}),
        ("slcan:/dev/ttyACM0@250k", "slcan", "/dev/ttyACM0", 250_000, {}),
        ("slcan:COM4@250k?tty_baudrate=57600&rtscts=true", "slcan", "COM4", 250_000, {"tty_baudrate": 57_600, "rtscts": True}),
        ("udp_multicast", "udp_multicast", "", None, {}),
        ("udp_multicast:239.1.2.3?hop_limit=1", "udp_multicast", "239.1.2.3", None, {"hop_limit": 1}),
        ("udp_multicast:ff15::1", "udp_multicast", "ff15::1", None, {}),
        ("kvaser:0@1M", "kvaser", "0", 1_000_000, {}),
        ("socketcand:can0?host=10.0.0.2&port=29536", "socketcand", "can0", None, {"host": "10.0.0.2", "port": 29536}),
        ("pythoncan:virtual:demo", "virtual", "demo", None, {}),
        ("pythoncan:socketcan:can0", "socketcan", "can0", None, {}),
        ("tcp", "tcp", "", None, {}),
        ("tcp:localhost:20301", "tcp", "localhost:20301", None, {}),
        ("file:a@b:c.log?speed=max", "file", "a@b:c.log", None, {"speed": "max"}),
        (" virtual:demo ", "virtual", "demo", None, {}),
        ("pcan:PCAN_USBBUS1?fd=false", "pcan", "PCAN_USBBUS1", None, {"fd": False}),
    ],
)
def test_parts(text: str, interface: str, channel: str, bitrate: int | None, options: dict[str, object]) -> None:
    locator = parse_locator(text)
    assert (locator.interface, locator.channel, locator.bitrate, locator.options) == (interface, channel, bitrate, options)
    assert locator.text == text
    assert locator.own == (interface in ("virtual", "socketcan", "tcp", "file") and not text.startswith("pythoncan:"))


@pytest.mark.parametrize(
    ("text", "seen", "step"),
    [
        ("soketcan:can0", "no interface 'soketcan'", "socketcan:can0"),
        ("pcann:PCAN_USBBUS1@500k", "no interface 'pcann'", "pcan:PCAN_USBBUS1@500k"),
        ("Virtual:demo", "no interface 'Virtual'", "virtual:demo"),
        ("pythoncan:kvasr:0", "no interface 'kvasr'", "pythoncan:kvaser:0"),
        ("xyzzy:0", "known are virtual, tcp, file, pythoncan, canalystii", "a locator such as virtual:demo"),
        ("", "names no interface", "a locator such as virtual:demo"),
        ("pythoncan:", "names no interface", "a locator such as"),
        (":can0", "names no interface", "a locator such as"),
        ("socketcan:can0@fast", "'fast' is not a bit rate", "socketcan:can0@500k"),
        ("socketcan:can0@", "'' is not a bit rate", "socketcan:can0@500k"),
        ("socketcan:can0@500", "did you mean 500k?", "socketcan:can0@500k"),
        ("socketcan:can0@3", "at least 5k", "socketcan:can0@500k"),
        ("socketcan:can0@5M", "at most 1M", "socketcan:can0@500k"),
        ("pcan:PCAN_USBBUS1?fd=true", "CAN FD is not supported", "leave it out"),
        ("kvaser:0?receive_own_messages=1", "own frames", "leave it out"),
        ("kvaser:0?single_handle", "not of the form NAME=VALUE", "&"),
        ("kvaser:0?=1", "not of the form NAME=VALUE", "&"),
        ("/dev/pcan16", "not a device file of a PEAK adapter", "/dev/pcan32"),
        ("/dev/pcan99", "not a device file of a PEAK adapter", "/dev/pcan32"),
        ("/dev/pcanusb0", "not a device file of a PEAK adapter", "/dev/pcan32"),
        ("/dev/pcanx", "not a device file of a PEAK adapter", "/dev/pcan32"),
    ],
)
def test_nonsense(text: str, seen: str, step: str) -> None:
    with pytest.raises(TransportError) as caught:
        parse_locator(text)
    error = caught.value
    assert error.code == "CO100"
    assert error.failed == f"the bus {text!r} is not a valid locator"
    assert seen in error.seen
    assert any(step in line for line in error.tries)


@pytest.mark.parametrize(
    ("text", "bitrate"),
    [("500k", 500_000), ("1M", 1_000_000), ("125000", 125_000), ("83.333k", 83_333), ("0.5M", 500_000), ("5k", 5_000)],
)
def test_bit_rates(text: str, bitrate: int) -> None:
    assert parse_bitrate(text) == bitrate


@pytest.mark.parametrize(("bitrate", "text"), [(500_000, "500k"), (1_000_000, "1M"), (83_333, "83333")])
def test_bit_rates_as_text(bitrate: int, text: str) -> None:
    assert bitrate_text(bitrate) == text
    assert parse_bitrate(text) == bitrate


def test_channels_are_read_as_python_can_reads_them() -> None:
    assert parse_locator("kvaser:0").python_can_channel == 0
    assert parse_locator("slcan:COM4").python_can_channel == "COM4"
