"""The checks of `canopen doctor`: what this computer has to reach a CAN bus with, and what is missing.

Each check reads files below `root` (a test passes a folder of its own), or takes the output of a tool or of a driver's library.
It yields `DoctorFinding`s: what was checked, whether it is in order, what was seen, and the exact command to mend it. A check
changes nothing, opens no bus and sends nothing; `receive_test` is the module that opens a bus.

`check_peak` makes the checks that the manual (chapter 2.1) asks the user to make by hand. `/proc/pcan` shows the driver. Its
column "ndev" is NA for an adapter in character-device mode (`make NET=NO`), which PCAN-Basic and `/dev/pcan32` need. For an
adapter in network-device mode it has the interface's name. With the kernel's own driver, peak_usb, there is no `/proc/pcan`.
"""

from __future__ import annotations

import ctypes.util
import importlib.util
import ipaddress
import json
import os
import re
import subprocess
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import Enum
from importlib import metadata
from pathlib import Path
from typing import Any, Final, NamedTuple

from canopen_transports.diagnosis import is_can_device
from canopen_transports.locator import bitrate_text
from canopen_transports.peak import attached

TOOL_TIME: Final = 5.0
"""Seconds for `ip`, which answers within some milliseconds."""
HIGH_COUNTER: Final = 96
"""From this value of an error counter on, the controller warns: the bus is disturbed (ISO 11898-1)."""
_GROUP: Final = ipaddress.ip_address("239.74.163.2")
_NO_HARDWARE: Final = (
    "canopen demo   (everything but the bus, without hardware)",
    "sudo modprobe vcan && sudo ip link add dev vcan0 type vcan && sudo ip link set vcan0 up   (a bus inside the kernel)",
)
# Backends of python-can that need a Python package of their own, and its module.
_PACKAGES: Final = {
    "slcan": "serial",
    "udp_multicast": "msgpack",
    "gs_usb": "gs_usb",
    "cantact": "cantact",
    "canalystii": "canalystii",
    "neovi": "ics",
    "nixnet": "nixnet",
}


class Health(Enum):
    """Whether the subject of a finding is in order."""

    OK = "ok"
    NOTE = "note"
    """Not in use, or missing; nothing needs to be done."""
    WARNING = "warning"
    """It will not work as it is; the finding says what to do."""


@dataclass(frozen=True)
class DoctorFinding:
    """The result of a check. subject: what was checked. tries: what to do, with commands as they are typed. locator: the bus."""

    subject: str
    health: Health
    seen: str
    tries: tuple[str, ...] = ()
    locator: str | None = None


def examine(root: Path = Path("/")) -> list[DoctorFinding]:
    """Run all checks on this computer. root: of the files to read; a test passes a folder of its own."""
    findings = [
        *check_socketcan(root, ip_links()),
        *check_peak(root, library=ctypes.util.find_library("pcanbasic"), channels=attached()),
        *check_usb(root),
        *check_serial_lines(root, has_serial=importlib.util.find_spec("serial") is not None),
    ]
    if not any(each.locator or each.health is Health.WARNING for each in findings):
        findings.insert(0, DoctorFinding("CAN adapters", Health.WARNING, "none was found on this computer", _NO_HARDWARE))
    return [*findings, *check_vcan(root), *check_multicast(root), *check_python_can()]


# ---- SocketCAN ----


def ip_links() -> list[dict[str, Any]]:
    """Return what `ip` reports of the network interfaces; nothing if there is no `ip` that knows -json."""
    try:
        told = subprocess.run(
            ["ip", "-details", "-statistics", "-json", "link"], capture_output=True, timeout=TOOL_TIME, check=True
        ).stdout
        links = json.loads(told)
    except (OSError, subprocess.SubprocessError, ValueError):
        return []
    return [each for each in links if isinstance(each, dict)] if isinstance(links, list) else []


def check_socketcan(root: Path, links: Iterable[dict[str, Any]]) -> Iterator[DoctorFinding]:
    """Check each CAN interface of the kernel: whether it is up, its bit rate, its controller. links: see `ip_links`. root: see
    `examine`."""
    told = {str(each.get("ifname")): each for each in links}
    for path in sorted((root / "sys/class/net").glob("*")):
        if is_can_device(path.name, root):
            yield _interface(root, path.name, told.get(path.name, {}))


def _interface(root: Path, name: str, link: dict[str, Any]) -> DoctorFinding:
    info = link.get("linkinfo") or {}
    data = info.get("info_data") or {}
    bitrate = (data.get("bittiming") or {}).get("bitrate")
    is_virtual = name.startswith("vcan") or info.get("info_kind") in ("vcan", "vxcan")
    subject, locator = f"SocketCAN {name}", f"socketcan:{name}"
    up = f"sudo ip link set {name} up"
    with_rate = up if is_virtual else f"{up} type can bitrate {bitrate or 500_000}"
    if not _is_up(root, name, link):
        return DoctorFinding(subject, Health.WARNING, "it exists, but is DOWN", (with_rate,), locator)
    state = str(data.get("state", "")).lower()
    counters = data.get("berr_counter") or {}
    sent, received = counters.get("tx", 0), counters.get("rx", 0)
    parts = ["up"]
    parts += ["virtual"] if is_virtual else []
    parts += [f"{bitrate_text(bitrate)}bit/s"] if isinstance(bitrate, int) else []
    parts += [state] if state else []
    parts += [f"error counters tx {sent}, rx {received}"] if counters else []
    modes = [str(each).lower() for each in data.get("ctrlmode") or ()]
    parts += modes
    seen = ", ".join(parts)
    restart = f"sudo ip link set {name} down && {with_rate} restart-ms 100   (it then returns from bus-off after 100 ms)"
    if state == "bus-off":
        return DoctorFinding(subject, Health.WARNING, seen, (restart,), locator)
    if "listen-only" in modes:
        again = f"sudo ip link set {name} down && {with_rate} listen-only off"
        return DoctorFinding(subject, Health.NOTE, f"{seen}: nothing can be sent", (again,), locator)
    if state in ("error-passive", "error-warning") or max(sent, received) >= HIGH_COUNTER:
        steps = (
            f"canopen doctor -b {locator}     (shows what is heard)",
            "check bit rate, CAN-H and CAN-L, termination (60 ohm)",
        )
        return DoctorFinding(subject, Health.WARNING, seen, steps, locator)
    return DoctorFinding(subject, Health.OK, seen, (), locator)


def _is_up(root: Path, name: str, link: dict[str, Any]) -> bool:
    if "flags" in link:
        return "UP" in link["flags"]
    try:
        return bool(int((root / "sys/class/net" / name / "flags").read_text(), 16) & 1)  # IFF_UP
    except (OSError, ValueError):
        return False


# ---- PEAK ----


def check_peak(root: Path, *, library: str | None, channels: dict[str, str]) -> Iterator[DoctorFinding]:
    """Check PEAK's adapters: whether one is plugged in, its driver, `/proc/pcan`, PCAN-Basic.

    library: the name of the PCAN-Basic library, None if there is none. channels: see `attached`.

    root: see `examine`.
    """
    driver = _text(root / "proc/pcan")
    if driver:
        yield from _proc_pcan(root, driver, library)
    else:
        yield from _plugged_in(root, _PEAK)
    if not library:
        health = Health.WARNING if driver and " NA " in driver else Health.NOTE
        steps = ("install PEAK's PCAN-Basic library (peak-system.com)",) if health is Health.WARNING else ()
        yield DoctorFinding("PCAN-Basic", health, "PEAK's library is not installed; pcan:... and /dev/pcan32 need it", steps)
    elif not channels:
        yield DoctorFinding("PCAN-Basic", Health.NOTE, "installed; it sees no adapter")
    for name, condition in channels.items():
        tries = () if condition == "free" else ("close the other program",)
        yield DoctorFinding(
            f"PCAN-Basic {name}", Health.OK if condition == "free" else Health.WARNING, condition, tries, f"pcan:{name}@500k"
        )


# "*n -type- -ndev- --base-- irq --btr- --read-- --write- --irqs-- -errors- status", then one such line for each channel
_PROC_LINE: Final = re.compile(r"^\s*(\d+)\s+(\w+)\s+(-?\w+-?)\s", re.MULTILINE)
_RELEASE: Final = re.compile(r"Release_\S+(?:\s*\(([^)]*)\))?")


def _proc_pcan(root: Path, text: str, library: str | None) -> Iterator[DoctorFinding]:
    release = _RELEASE.search(text)
    version = f"PEAK's driver {release[1] or release[0]}" if release else "PEAK's driver"
    channels = _PROC_LINE.findall(text)
    if not channels:
        yield DoctorFinding(
            "/proc/pcan", Health.WARNING, f"{version} is loaded and sees no adapter", ("plug it in; lsusb -d 0c72:",)
        )
    for minor, kind, ndev in channels:
        interface = ndev.strip("-")
        subject = f"/proc/pcan {minor}"
        if interface == "NA":
            locator = f"/dev/pcan{minor}"
            device = root / locator[1:]
            if device.exists() and not os.access(device, os.R_OK | os.W_OK):
                steps = (f"sudo chmod a+rw {locator}   (until it is plugged in again; then a rule of udev)",)
                yield DoctorFinding(
                    subject, Health.WARNING, f"{version}, {kind}: this user may not open {locator}", steps, locator
                )
                continue
            yield DoctorFinding(subject, Health.OK, f"{version}, {kind}, ndev NA: {locator}", (), locator if library else None)
        else:
            step = f"use socketcan:{interface}, or build the driver with `make NET=NO`"
            yield DoctorFinding(
                subject,
                Health.NOTE,
                f"{version}, {kind}, ndev {interface}: a network interface, no {minor} for PCAN-Basic",
                (step,),
            )


# ---- adapters at USB ----


class _UsbAdapter(NamedTuple):
    """A kind of adapter. ids: vendor:product, or vendor: for all products. module: the kernel's driver. other: another way to use
    it."""

    maker: str
    ids: tuple[str, ...]
    module: str
    other: str


_PEAK: Final = _UsbAdapter("PEAK", ("0c72:",), "peak_usb", "sudo modprobe pcan   (PEAK's: pcan:PCAN_USBBUS1)")
# The IDs are those of the Linux drivers.
_USB_ADAPTERS: Final = (
    _UsbAdapter("Kvaser", ("0bfd:",), "kvaser_usb", "install Kvaser's driver and its CANlib   (kvaser:0@500k)"),
    _UsbAdapter(
        "the candleLight kind (CANable, CANtact Pro)",
        ("1d50:606f", "1209:2323"),
        "gs_usb",
        "pip install 'python-can[gs-usb]'   (gs_usb:0@500k)",
    ),
    _UsbAdapter("8devices (USB2CAN)", ("0483:1234",), "usb_8dev", ""),
    _UsbAdapter("Microchip (CAN BUS Analyzer)", ("04d8:0a30",), "mcba_usb", ""),
    _UsbAdapter("ETAS (ES58x)", ("108c:0159", "108c:0168", "108c:0169"), "etas_es58x", ""),
)


def check_usb(root: Path) -> Iterator[DoctorFinding]:
    """Check that each plugged-in adapter of another maker has a driver. root: see `examine`."""
    for adapter in _USB_ADAPTERS:
        yield from _plugged_in(root, adapter)


def _plugged_in(root: Path, adapter: _UsbAdapter) -> Iterator[DoctorFinding]:
    paths = (root / "sys/bus/usb/devices").glob("*/idVendor")
    plugged = [f"{_text(path)}:{_text(path.with_name('idProduct'))}" for path in paths]
    count = sum(each.startswith(adapter.ids) for each in plugged)
    subject = f"{adapter.maker} adapter"
    if count and (root / "sys/module" / adapter.module).exists():
        seen = f"the kernel's own driver, {adapter.module}, has it: use socketcan:can0"
        yield DoctorFinding(subject, Health.OK, seen)
    elif count:
        seen = f"{count} USB adapter{'s' * (count > 1)} of {adapter.maker} plugged in, and no driver is loaded"
        steps = (f"sudo modprobe {adapter.module}   (the kernel's own: socketcan:can0)", adapter.other)
        yield DoctorFinding(subject, Health.WARNING, seen, tuple(filter(None, steps)))


# ---- serial lines, vcan, multicast, python-can ----


def check_serial_lines(root: Path, *, has_serial: bool) -> Iterator[DoctorFinding]:
    """Check that this user may open the serial lines, which may lead to an slcan adapter. root: see `examine`. has_serial:
    pyserial is installed."""
    for pattern in ("ttyACM*", "ttyUSB*"):
        for path in sorted((root / "dev").glob(pattern)):
            locator, name = f"slcan:/dev/{path.name}@500k", f"serial line /dev/{path.name}"
            if not os.access(path, os.R_OK | os.W_OK):
                steps = ("sudo usermod -aG dialout $USER   (then log in again)",)
                yield DoctorFinding(name, Health.WARNING, "this user may not open it", steps, locator)
            elif not has_serial:
                yield DoctorFinding(name, Health.WARNING, "pyserial is not installed", ("pip install pyserial",), locator)
            else:
                yield DoctorFinding(name, Health.OK, f"may be an adapter that speaks slcan: -b {locator}", (), locator)


def check_vcan(root: Path) -> Iterator[DoctorFinding]:
    """Check whether the kernel has virtual CAN buses. root: see `examine`."""
    if not any((root / "sys/class/net").glob("*can*")) and not (root / "sys/module/vcan").exists():
        yield DoctorFinding(
            "vcan", Health.NOTE, "no virtual CAN bus; the kernel's module vcan is not loaded", ("sudo modprobe vcan",)
        )


def check_multicast(root: Path) -> Iterator[DoctorFinding]:
    """Check whether udp_multicast has a route; with one, two terminals of this computer share a bus. root: see `examine`."""
    routes = _text(root / "proc/net/route").splitlines()[1:]
    for line in routes:
        fields = line.split()
        if len(fields) > 7:
            destination, mask = (int.from_bytes(bytes.fromhex(fields[place]), "little") for place in (1, 7))
            if int(_GROUP) & mask == destination:
                yield DoctorFinding(
                    "udp_multicast", Health.OK, f"{_GROUP} is routed by {fields[0]}: two terminals can share a bus"
                )
                return
    if routes or (root / "proc/net").exists():
        step = "sudo ip route add 224.0.0.0/4 dev lo   (two terminals of this computer)"
        yield DoctorFinding("udp_multicast", Health.NOTE, f"no network interface has a route to {_GROUP}", (step,))


def check_python_can() -> Iterator[DoctorFinding]:
    """Report python-can's version, and the backends that lack a package."""
    missing = [name for name, module in _PACKAGES.items() if importlib.util.find_spec(module) is None]
    seen = f"version {metadata.version('python-can')}"
    if missing:
        seen += f"; python-can's packages for these are not installed: {', '.join(missing)}"
    yield DoctorFinding("python-can", Health.OK, seen)


def _text(path: Path) -> str:
    try:
        return path.read_text(errors="replace").strip()
    except OSError:
        return ""
