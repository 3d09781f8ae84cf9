"""What the paths of the web door answer, as types: the OpenAPI description is made of them.

The answers are plain data (plain_data.py, fleet_picture.py); tests/gateway/test_web_openapi.py compares what is sent.
"""

from __future__ import annotations

from typing import TypeAlias, TypedDict

Shown: TypeAlias = "int | float | str | bool | None"


class EmergencyData(TypedDict):
    """An error code of a device. code: as "0x2310"."""

    code: str
    text: str


class ReasonData(TypedDict):
    """Why a drive does not move. remedy: what to do."""

    what: str
    remedy: str


class ViewData(TypedDict):
    """What a drive shows. statusword: null if it was not heard. reasons: the first obstacle first."""

    state: str
    mode: str | None
    statusword: int | None
    shown: str
    error: EmergencyData | None
    reasons: list[ReasonData]


class DriveData(ViewData):
    """A drive of the machine. axis: its number, from 0. position, velocity: in its unit, and in that per second; null if they
    were not heard."""

    name: str
    axis: int
    position: float | None
    velocity: float | None
    unit: str
    homed: bool


class NodeData(TypedDict):
    """A node. state: in words. age: seconds since it was heard; null if it never was. heard: the service that was heard last."""

    node: int
    name: str
    state: str
    age: float | None
    heard: str | None
    emergency: EmergencyData | None
    drives: list[DriveData]


class _AnyBusData(TypedDict):
    net: int
    name: str
    state: str
    outage: str
    nodes: list[NodeData]


class BusData(_AnyBusData, total=False):
    """A bus. net: its number, from 1. outage: why it is away; else "". bitrate: bits per second, null if nobody tells it. bits:
    that have passed. Over a fleet, in place of these two: age: seconds since it is lost or late, null while neither; allow: what
    may be changed there."""

    bitrate: int | None
    bits: int
    age: float | None
    allow: list[str]


class JointData(TypedDict):
    """A joint of a chain. position, velocity: in its unit, and in that per second; null if they were not heard. speed: its limit,
    in its unit per second."""

    name: str
    node: int
    bus: str
    position: float | None
    velocity: float | None
    unit: str
    state: str
    speed: float | None
    homed: bool


class ChainData(TypedDict):
    """A chain. missed: cycles without a set-point."""

    name: str
    state: str
    missed: int
    joints: list[JointData]


class LeaseData(TypedDict):
    """Who moves the machine. owner: null if nobody does. left: seconds until the lease is over."""

    owner: str | None
    left: float
    doing: str
    problem: str


class StateData(TypedDict):
    """nets: their names. absent: what is not there, with the reason. allow: what may be changed. mode: the same in words."""

    nets: list[str]
    absent: dict[str, str]
    allow: list[str]
    mode: str
    chains: list[ChainData]
    lease: LeaseData


class ObjectData(TypedDict):
    """An object of a dictionary. path: its name in requests, as "6041:00". constants: names of values."""

    path: str
    name: str
    type: str
    access: str
    unit: str
    constants: list[str]


class _AnyValueData(TypedDict):
    path: str
    size: int
    hex: str
    name: str
    type: str
    value: Shown
    unit: str
    constants: list[str]


class ValueData(_AnyValueData, total=False):
    """A value that was read. size: of its bytes. hex: its first 4096 bytes. value: null if its type is not known; bytes in
    hexadecimal. constants: those that it bears. late: over a fleet, seconds."""

    access: str
    late: float


class AboutData(TypedDict):
    """What a node says of itself. drive: null if it is none. problem: why it says nothing; else ""."""

    name: str
    drive: ViewData | None
    problem: str


class WrittenData(TypedDict):
    """written: the bytes in hexadecimal; over a fleet the value as text."""

    written: str


class SentData(TypedDict):
    """sent: the NMT command."""

    sent: str


class HaltedData(TypedDict):
    """problems: what did not confirm that it stands."""

    problems: list[str]


class MappedData(TypedDict):
    """An object in a PDO."""

    index: int
    sub: int
    bits: int
    name: str


class _AnyDevicePdoData(TypedDict):
    pdo: str
    remark: str | None


class DevicePdoData(_AnyDevicePdoData, total=False):
    """A PDO as the device tells it. pdo: "TPDO 1". remark: what is odd; what follows is left out if it cannot be understood."""

    valid: bool
    can_id: int
    cob_id: int
    transmission_type: int
    sent: str
    inhibit_time_ms: float | None
    event_timer_ms: float | None
    sync_start: int | None
    bytes: int
    objects: list[MappedData]


class FailureData(TypedDict):
    """Why a request has failed. code: such as CO202, docs/errors.md; "" if there is none. text: its first line."""

    code: str
    text: str
    details: list[str]


class DeviceFailureData(FailureData, total=False):
    """A failure; abort: the abort code of the device, as "0x06020000", if it refused; abort_text: the same in words."""

    abort: str
    abort_text: str


class ErrorData(TypedDict):
    """An error of this interface."""

    error: DeviceFailureData
