"""What `canopen doctor` finds on computers that stand in a folder."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import pytest

from canopen_transports import doctor
from canopen_transports.doctor import DoctorFinding, Health

PROC_PCAN = """
*------------ PEAK-System CAN interfaces (www.peak-system.com) -------------
*------------ Release_20120319_n (7.5.0) Mar 20 2012 10:20:30 --------------
*---------------- [mod] [isa] [pci] [dng] [par] [usb] [pcc] -----------------
*--------------------- {count} interfaces @ major 248 found -----------------------
*n -type- ndev --base-- irq --btr- --read-- --write- --irqs-- -errors- status
{lines}
"""
CHARACTER = "32    usb   NA ffffffff 255 0x001c 00000000 00000000 00000000 00000000 0x0000"
NETWORK = "32    usb can0 ffffffff 255 0x001c 00000000 00000000 00000000 00000000 0x0000"


def put(root: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return root


def link(name: str, *, flags: tuple[str, ...] = ("NOARP", "UP", "LOWER_UP"), **data: Any) -> dict[str, Any]:
    """An interface as `ip -details -json link` tells of it."""
    return {"ifname": name, "flags": list(flags), "linkinfo": {"info_kind": "can", "info_data": data}}


def socketcan(root: Path, told: dict[str, Any]) -> DoctorFinding:
    put(root, {f"sys/class/net/{told['ifname']}/type": "280\n", "sys/class/net/eth0/type": "1\n"})
    (finding,) = doctor.check_socketcan(root, [told])
    return finding


RATE = {"bittiming": {"bitrate": 250_000}}


@pytest.mark.parametrize(
    ("told", "health", "seen", "step"),
    [
        (link("can0", state="ERROR-ACTIVE", berr_counter={"tx": 0, "rx": 1}, **RATE), Health.OK,
         "up, 250kbit/s, error-active, error counters tx 0, rx 1", ""),
        (link("can0", flags=("NOARP",)), Health.WARNING, "DOWN", "sudo ip link set can0 up type can bitrate 500000"),
        (link("can0", flags=(), **RATE), Health.WARNING, "DOWN", "sudo ip link set can0 up type can bitrate 250000"),
        (link("vcan0", flags=()), Health.WARNING, "DOWN", "sudo ip link set vcan0 up"),
        (link("vcan0"), Health.OK, "up, virtual", ""),
        (link("can0", state="BUS-OFF", **RATE), Health.WARNING, "bus-off", "restart-ms 100"),
        (link("can0", state="ERROR-PASSIVE", **RATE), Health.WARNING, "error-passive", "canopen doctor -b socketcan:can0"),
        (link("can0", state="ERROR-ACTIVE", berr_counter={"tx": 0, "rx": 97}), Health.WARNING, "rx 97", "termination"),
        (link("can0", ctrlmode=["LISTEN-ONLY"], **RATE), Health.NOTE, "nothing can be sent", "listen-only off"),
    ],
)  # fmt: skip
def test_a_socketcan_interface(tmp_path: Path, told: dict[str, Any], health: Health, seen: str, step: str) -> None:
    finding = socketcan(tmp_path, told)
    assert finding.health is health
    assert seen in finding.seen
    assert finding.locator == f"socketcan:{told['ifname']}"
    assert step in " ".join(finding.tries)
    assert bool(finding.tries) == bool(step)


@pytest.mark.parametrize(("flags", "health"), [("0x40081", Health.OK), ("0x40080", Health.WARNING), (None, Health.WARNING)])
def test_without_the_tool_the_kernels_files_tell(tmp_path: Path, flags: str | None, health: Health) -> None:
    put(tmp_path, {"sys/class/net/can0/type": "280"} | ({"sys/class/net/can0/flags": flags} if flags else {}))
    (finding,) = doctor.check_socketcan(tmp_path, [])
    assert finding.health is health


@pytest.mark.parametrize(
    ("answer", "links"), [(b'[{"ifname": "can0"}, 7]', [{"ifname": "can0"}]), (b"{}", []), (b"no JSON", []), (None, [])]
)
def test_what_the_tool_says(monkeypatch: pytest.MonkeyPatch, answer: bytes | None, links: list[dict[str, Any]]) -> None:
    def run(command: list[str], **_: object) -> subprocess.CompletedProcess[bytes]:
        if answer is None:
            raise FileNotFoundError(command[0])
        return subprocess.CompletedProcess(command, 0, answer)

    monkeypatch.setattr(subprocess, "run", run)
    assert doctor.ip_links() == links


def peak(root: Path, files: dict[str, str], library: str | None = "libpcanbasic.so", **channels: str) -> list[DoctorFinding]:
    return list(doctor.check_peak(put(root, files), library=library, channels=channels))


def test_peaks_driver_as_the_manual_wants_it(tmp_path: Path) -> None:
    first, second = peak(tmp_path, {"proc/pcan": PROC_PCAN.format(count=1, lines=CHARACTER)}, PCAN_USBBUS1="free")
    assert (first.health, first.seen) == (Health.OK, "PEAK's driver 7.5.0, usb, ndev NA: /dev/pcan32")
    assert first.locator == "/dev/pcan32"
    assert (second.health, second.locator) == (Health.OK, "pcan:PCAN_USBBUS1@500k")


def test_a_device_file_that_this_user_may_not_open(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "access", lambda path, mode: path != tmp_path / "dev/pcan32")
    first, _ = peak(tmp_path, {"proc/pcan": PROC_PCAN.format(count=1, lines=CHARACTER), "dev/pcan32": ""})
    assert (first.health, first.locator) == (Health.WARNING, "/dev/pcan32")
    assert first.tries[0].startswith("sudo chmod a+rw /dev/pcan32")


def test_peaks_driver_without_its_library(tmp_path: Path) -> None:
    first, second = peak(tmp_path, {"proc/pcan": PROC_PCAN.format(count=1, lines=CHARACTER)}, None)
    assert first.locator is None
    assert second.health is Health.WARNING
    assert second.tries == ("install PEAK's PCAN-Basic library (peak-system.com)",)


def test_peaks_driver_in_network_device_mode(tmp_path: Path) -> None:
    first, second = peak(tmp_path, {"proc/pcan": PROC_PCAN.format(count=1, lines=NETWORK)})
    assert first.health is Health.NOTE
    assert first.tries == ("use socketcan:can0, or build the driver with `make NET=NO`",)
    assert second.seen == "installed; it sees no adapter"


def test_peaks_driver_without_an_adapter(tmp_path: Path) -> None:
    first, _ = peak(tmp_path, {"proc/pcan": PROC_PCAN.format(count=0, lines="")})
    assert (first.health, first.seen) == (Health.WARNING, "PEAK's driver 7.5.0 is loaded and sees no adapter")


def test_another_program_has_the_adapter(tmp_path: Path) -> None:
    (finding,) = peak(tmp_path, {}, PCAN_USBBUS1="in use")
    assert (finding.health, finding.tries) == (Health.WARNING, ("close the other program",))


def test_an_adapter_that_is_plugged_in(tmp_path: Path) -> None:
    files = {"sys/bus/usb/devices/1-1/idVendor": "0c72\n", "sys/bus/usb/devices/1-2/idVendor": "1d6b\n"}
    first, second = peak(tmp_path, files, None)
    assert first.seen == "1 USB adapter of PEAK plugged in, and no driver is loaded"
    assert first.tries[0].startswith("sudo modprobe peak_usb")
    assert second.health is Health.NOTE
    first, _ = peak(tmp_path, {"sys/module/peak_usb/version": ""}, None)
    assert (first.health, "socketcan:can0" in first.seen) == (Health.OK, True)


@pytest.mark.parametrize(
    ("vendor", "product", "module", "maker"),
    [
        ("0bfd", "0120", "kvaser_usb", "Kvaser"),
        ("1d50", "606f", "gs_usb", "the candleLight kind"),
        ("1209", "2323", "gs_usb", "the candleLight kind"),
        ("0483", "1234", "usb_8dev", "8devices"),
        ("04d8", "0a30", "mcba_usb", "Microchip"),
        ("108c", "0168", "etas_es58x", "ETAS"),
    ],
)
def test_an_adapter_of_another_maker(tmp_path: Path, vendor: str, product: str, module: str, maker: str) -> None:
    device = "sys/bus/usb/devices/1-1"
    put(tmp_path, {f"{device}/idVendor": f"{vendor}\n", f"{device}/idProduct": f"{product}\n"})
    (finding,) = doctor.check_usb(tmp_path)
    assert finding.health is Health.WARNING
    assert f"1 USB adapter of {maker}" in finding.seen
    assert finding.tries[0] == f"sudo modprobe {module}   (the kernel's own: socketcan:can0)"
    put(tmp_path, {f"sys/module/{module}/refcnt": "0"})
    (finding,) = doctor.check_usb(tmp_path)
    assert (finding.health, finding.tries) == (Health.OK, ())
    assert f"{module}, has it: use socketcan:can0" in finding.seen


def test_another_device_of_a_vendor_of_many_things_is_no_adapter(tmp_path: Path) -> None:
    put(tmp_path, {"sys/bus/usb/devices/1-1/idVendor": "04d8\n", "sys/bus/usb/devices/1-1/idProduct": "000a\n"})
    put(tmp_path, {"sys/bus/usb/devices/1-2/idVendor": "0483\n"})
    assert list(doctor.check_usb(tmp_path)) == []


def test_serial_lines(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    put(tmp_path, {"dev/ttyACM0": "", "dev/ttyUSB1": "", "dev/tty1": ""})
    good = list(doctor.check_serial_lines(tmp_path, has_serial=True))
    assert [each.locator for each in good] == ["slcan:/dev/ttyACM0@500k", "slcan:/dev/ttyUSB1@500k"]
    assert {each.health for each in good} == {Health.OK}
    assert next(doctor.check_serial_lines(tmp_path, has_serial=False)).tries == ("pip install pyserial",)
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    assert "dialout" in next(doctor.check_serial_lines(tmp_path, has_serial=True)).tries[0]


ROUTES = "Iface\tDestination\tGateway\tFlags\tRefCnt\tUse\tMetric\tMask\tMTU\tWindow\tIRTT\n"


@pytest.mark.parametrize(
    ("route", "health"),
    [
        ("lo\t000000E0\t00000000\t0001\t0\t0\t0\t000000F0\t0\t0\t0\n", Health.OK),  # 224.0.0.0/4
        ("eth0\t00000000\t0100A8C0\t0003\t0\t0\t0\t00000000\t0\t0\t0\n", Health.OK),  # default
        ("eth0\t0000A8C0\t00000000\t0001\t0\t0\t0\t00FFFFFF\t0\t0\t0\n", Health.NOTE),
        ("half a line\n", Health.NOTE),
        ("", Health.NOTE),
    ],
)
def test_a_route_for_multicast(tmp_path: Path, route: str, health: Health) -> None:
    (finding,) = doctor.check_multicast(put(tmp_path, {"proc/net/route": ROUTES + route}))
    assert finding.health is health
    assert bool(finding.tries) == (health is Health.NOTE)


def test_a_system_without_such_files(tmp_path: Path) -> None:
    assert list(doctor.check_multicast(tmp_path)) == []
    assert [each.tries for each in doctor.check_vcan(tmp_path)] == [("sudo modprobe vcan",)]
    assert list(doctor.check_vcan(put(tmp_path, {"sys/module/vcan/refcnt": "0"}))) == []


def test_python_can(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None if name == "ics" else name)
    (finding,) = doctor.check_python_can()
    assert finding.seen.endswith("not installed: neovi")
    monkeypatch.setattr("importlib.util.find_spec", lambda name: name)
    (finding,) = doctor.check_python_can()
    assert finding.seen.startswith("version 4")
    assert ";" not in finding.seen


def test_a_computer_without_any_adapter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "ip_links", list)
    monkeypatch.setattr(doctor, "attached", dict)
    monkeypatch.setattr("ctypes.util.find_library", lambda name: None)
    first, *rest = doctor.examine(tmp_path)
    assert (first.health, first.seen) == (Health.WARNING, "none was found on this computer")
    assert first.tries[0].startswith("canopen demo")
    assert all(each.health is not Health.WARNING for each in rest)
    put(tmp_path, {"sys/bus/usb/devices/1-1/idVendor": "0c72\n"})
    assert doctor.examine(tmp_path)[0].subject == "PEAK adapter"  # it is there, only its driver is not
    put(tmp_path, {"sys/class/net/can0/type": "280", "sys/class/net/can0/flags": "0x81"})
    assert doctor.examine(tmp_path)[0].subject == "SocketCAN can0"


def test_this_computer() -> None:
    assert json.dumps([each.seen for each in doctor.examine()])
