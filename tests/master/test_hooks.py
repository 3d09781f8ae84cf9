"""Scripts that animate simulated devices: what they may do, and what happens when they fail."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from canopen_master import Host, Master, open_master
from canopen_master.errors import NodeError, SdoError
from canopen_master.simulation.hooks import MAX_FAILURES, Hooks, Script, ScriptError
from canopen_master.simulation.host import DeviceModel
from canopen_master.simulation.parameter_keeper import ParameterKeeper
from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Access, Object, ObjectDictionary, Variable
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.emcy import EmcyReceived
from canopen_proto.frame import Frame
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import Outbox
from canopen_proto.nmt import NmtCommand
from canopen_proto.pdo.multiplexed import MpdoReceived
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.settings import DriveSettings
from canopen_transports import open_transport
from tests.master.loops import loop
from tests.master.world import BUS, virtual_time


def _of(index: int, name: str, data_type: DataType, access: Access = Access.RW, **more: object) -> Object:
    return Object.of(name, [Variable(index, 0, name, data_type, access, pdo_mappable=True, **more)])  # type: ignore[arg-type]


DICTIONARY = ObjectDictionary(
    [
        standard_object(0x1000, 0x191),
        standard_object(0x1001),
        standard_object(0x1010, highest=1),
        standard_object(0x1011, highest=1),
        standard_object(0x1014),
        standard_object(0x1400, highest=2, defaults={1: 0x205, 2: 255}),
        standard_object(0x1600, highest=1, defaults={0: 1, 1: 0x2001_0008}),
        standard_object(0x1800, highest=2, defaults={1: 0x185, 2: 255}),
        standard_object(0x1A00, highest=1, defaults={0: 1, 1: 0x2000_0010}),
        _of(0x2000, "temperature", DataType.INTEGER16, Access.RO),
        _of(0x2001, "valve", DataType.UNSIGNED8, Access.RWW, high_limit=100),
        _of(0x2002, "counter", DataType.UNSIGNED32),
    ]
)


class Rig:
    """A device with a script, and a master that has its dictionary."""

    def __init__(self, host: Host, master: Master, told: list[str]) -> None:
        self.host = host
        self.master = master
        self.node = master.node(5, host.nodes[0].dictionary)
        self.told = told

    async def refused(self, access: object) -> int:
        """The abort code with which an access is refused."""
        with pytest.raises(SdoError) as caught:
            await access  # type: ignore[misc]
        assert caught.value.abort_code is not None
        return caught.value.abort_code


@asynccontextmanager
async def animated(text: str, keeper: ParameterKeeper | None = None, model: DeviceModel | None = None) -> AsyncIterator[Rig]:
    told: list[str] = []
    script = Script(text, "anim.py")
    model = DeviceModel(DICTIONARY, 5, script=script) if model is None else model
    transport = await open_transport(BUS)
    host = Host(transport, [model], keeper=keeper, say=told.append)
    async with loop.open_nursery() as nursery:
        await nursery.start(host.serve)
        async with open_master(BUS) as master:
            yield Rig(host, master, told)
        nursery.cancel_scope.cancel()
    await transport.aclose()


@virtual_time
async def test_reading_and_writing_are_served() -> None:
    script = """
OBJECTS = ["temperature", 0x2001]
written = []
def on_read(device, index, subindex):
    return -40 if index == 0x2000 else None
def on_write(device, index, subindex, value):
    written.append((index, subindex, value))
    device["counter"] = len(written)
    if value == 7:
        device.abort(0x06090030)
    if value == 8:
        device.abort(0x12345678)
"""
    async with animated(script) as rig:
        assert await rig.node.read("temperature") == -40
        assert rig.host.nodes[0].values[0x200000] == -40
        await rig.node.write("valve", 5)
        assert await rig.node.read("valve") == 5
        assert await rig.refused(rig.node.write("valve", 7)) == AbortCode.INVALID_VALUE
        assert await rig.refused(rig.node.write("valve", 8)) == AbortCode.CANNOT_TRANSFER
        assert await rig.refused(rig.node.write_bytes(0x2001, 0, b"\x65")) == AbortCode.VALUE_TOO_HIGH
        assert await rig.node.read("valve") == 5
        assert await rig.node.read("counter") == 3
        assert rig.told == []


@virtual_time
async def test_without_a_list_all_free_objects_are_served() -> None:
    async with animated("def on_read(device, index, subindex): return 3") as rig:
        assert await rig.node.read("valve") == 3
        await rig.node.write("counter", 9)
        assert rig.host.nodes[0].values[0x200200] == 9
        assert await rig.node.read(0x1000) == 0x191


@virtual_time
async def test_async_functions_answer_when_they_are_done() -> None:
    script = """
from tests.master.loops import loop
async def on_read(device, index, subindex):
    await loop.sleep(0.2)
    if index == 0x2001:
        device.abort(0x08000022)
    if index == 0x2002:
        1 / 0
    return 21
async def on_write(device, index, subindex, value):
    await loop.sleep(0.1)
    device["temperature"] = value
"""
    async with animated(script) as rig:
        start = loop.current_time()
        assert await rig.node.read("temperature") == 21
        assert loop.current_time() - start >= 0.2
        assert await rig.refused(rig.node.read("valve")) == AbortCode.DEVICE_STATE
        assert await rig.refused(rig.node.read("counter")) == AbortCode.CANNOT_TRANSFER
        assert rig.told == ["node 5: anim.py:8: in on_read: ZeroDivisionError: division by zero"]
        await rig.node.write("valve", 50)
        assert rig.host.nodes[0].values[0x200000] == 50


@virtual_time
async def test_values_go_out_by_event_driven_pdos_and_come_in_by_others() -> None:
    script = """
from tests.master.loops import loop
def on_write(device, index, subindex, value):
    device["temperature"] = value * 10
    if value == 9:
        device.abort()
    if value == 8:
        raise RuntimeError("jammed")
"""
    async with animated(script) as rig:
        await rig.master.nmt(NmtCommand.START, 5)
        await loop.sleep(0.01)
        peer = await open_transport(BUS)
        seen = []
        for value in (3, 9, 8):
            await peer.send(Frame(0x205, bytes((value,))))
            frame, _ = await peer.receive()
            seen.append(str(frame))
        await peer.aclose()
        assert seen == ["185#1E00", "185#5A00", "185#5000"]
        assert rig.host.nodes[0].values[0x200100] == 8  # a PDO cannot be refused
        assert rig.told == ["node 5: anim.py:8: in on_write: RuntimeError: jammed"]


@virtual_time
async def test_async_functions_hear_of_pdos_too_and_of_multiplexed_ones() -> None:
    script = """
from tests.master.loops import loop
async def on_write(device, index, subindex, value):
    await loop.sleep(0.1)
    device["counter"] = value
"""
    multiplexed = [
        standard_object(0x1401, highest=2, defaults={1: 0x305, 2: 255}),
        standard_object(0x1601, highest=1, defaults={0: 0xFF}),
    ]
    model = DeviceModel(DICTIONARY.with_objects(multiplexed), 5, script=Script(script, "anim.py"))
    async with animated("", model=model) as rig:
        await rig.master.nmt(NmtCommand.START, 5)
        peer = await open_transport(BUS)
        seen = []
        for frame in ("205#04", "305#8501200009000000"):
            await peer.send(Frame.parse(frame))
            await loop.sleep(0.05)
            before = rig.host.nodes[0].values[0x200200]
            await loop.sleep(0.1)
            seen.append((before, rig.host.nodes[0].values[0x200200]))
        assert seen == [(0, 4), (4, 9)]
        await peer.aclose()


class Bench:
    """Drives a device without any bus."""

    def now(self) -> int:
        return 0

    def pump(self) -> None:
        pass


def test_a_device_that_has_ended_answers_at_once() -> None:
    told: list[str] = []
    out = Outbox()
    node = LocalNode(out, 5, DICTIONARY)
    hooks = Hooks(Script("async def on_read(device, index, subindex): pass"), node, Bench(), told.append)
    node.boot(0)
    node.receive(Frame.parse("605#4001200000000000"), 0)
    for event in out.events:
        hooks.on_event(event)
    assert str(out.frames[-1]) == "585#8001200021000008"
    assert told == []
    loud = Hooks(Script("async def on_write(device, index, subindex, value): pass"), node, Bench(), told.append)
    loud.on_event(MpdoReceived(5, 1, 0x205, 0, 0x2001, 0, 5, None))
    assert told == []


@virtual_time
async def test_steps_and_a_task() -> None:
    script = """
from tests.master.loops import loop
PERIOD = 0.1
def setup(device):
    device["counter"] = 1000
def step(device, t):
    device["counter"] = 1000 + round(t * 10)
async def run(device):
    await loop.sleep(1)
    device.raise_error(0x4210, b"hot")
    await loop.sleep(1)
    device.clear_error(0x4210)
    device.say(f"done, operational: {device.is_operational}, node {device.node_id}")
"""
    async with animated(script) as rig, rig.master.events(EmcyReceived) as errors:
        assert 1000 <= (await rig.node.read("counter")) <= 1001  # type: ignore[operator]
        await loop.sleep(0.95)
        assert 1009 <= (await rig.node.read("counter")) <= 1011  # type: ignore[operator]
        error = await errors.receive()
        assert (error.code, error.error_register, error.vendor_data) == (0x4210, 0x09, b"hot\0\0")
        assert (await errors.receive()).code == 0
        await loop.sleep(0.01)
        assert rig.told == ["node 5: done, operational: False, node 5"]


@virtual_time
async def test_setup_is_for_each_power_on() -> None:
    async with animated("def setup(device): device['counter'] = 77") as rig:
        await rig.node.write("counter", 1)
        await rig.master.nmt(NmtCommand.RESET_NODE, 5)
        await loop.sleep(0.1)
        assert await rig.node.read("counter") == 77
        await rig.node.write("counter", 1)
        await rig.master.nmt(NmtCommand.RESET_COMMUNICATION, 5)
        await loop.sleep(0.1)
        assert await rig.node.read("counter") == 1


@virtual_time
async def test_errors_of_a_script_do_not_end_the_simulation() -> None:
    script = """
def setup(device):
    device["nothing"] = 1
def run(device):
    raise ValueError("run")
def step(device, t):
    device["valve"] = 1000
def on_read(device, index, subindex):
    return "hot" if index == 0x2000 else 70000
def on_write(device, index, subindex, value):
    raise KeyError(value)
"""
    async with animated(script) as rig:
        await loop.sleep(1)
        assert await rig.refused(rig.node.read("temperature")) == AbortCode.CANNOT_TRANSFER
        assert await rig.refused(rig.node.read("valve")) == AbortCode.CANNOT_TRANSFER
        assert await rig.refused(rig.node.write("valve", 1)) == AbortCode.CANNOT_TRANSFER
        assert rig.told[0].startswith(
            "node 5: anim.py:3: in setup: ObjectNotFoundError: object 'nothing' is not in the dictionary"
        )
        assert "node 5: anim.py:5: in run: ValueError: run" in rig.told
        assert [text for text in rig.told if "in step" in text] == [
            "node 5: anim.py:7: in step: ValueRangeError: valve (0x2001:00): 1000 is outside 0..255 (UNSIGNED8)"
        ] * MAX_FAILURES
        assert f"node 5: anim.py: step failed {MAX_FAILURES} times in a row and is no longer called" in rig.told
        assert any("in on_read: ConstantNotFoundError" in text for text in rig.told)
        assert rig.told[-1] == "node 5: anim.py:11: in on_write: KeyError: 1"


@virtual_time
async def test_a_script_before_a_simulated_drive() -> None:
    script = """
seen = []
def on_write(device, index, subindex, value):
    seen.append(value)
def on_read(device, index, subindex):
    return None
def step(device, t):
    device.say(str((seen, device["statusword"] & 0x6F)))
PERIOD = 1
"""
    model = DeviceModel(drive_dictionary(), 5, DriveSettings(), Script(script, "anim.py"))
    async with animated("", model=model) as rig:
        node = rig.node
        await node.write("controlword", 6)
        assert await node.read("statusword") == 0x221  # the drive took it
        await loop.sleep(1.1)
        assert rig.told[-1] == "node 5: ([6], 33)"
        assert await rig.refused(node.write("modes_of_operation", 5)) == AbortCode.INVALID_VALUE


@virtual_time
async def test_a_device_that_ends_while_a_script_thinks() -> None:
    script = "from tests.master.loops import loop\nasync def on_read(device, index, subindex):\n    await loop.sleep(100)\n"
    async with animated(script) as rig, loop.open_nursery() as nursery:
        nursery.start_soon(rig.refused, rig.node.read("valve"))
        await loop.sleep(1)


@pytest.mark.parametrize("period", ["0", "-1", "float('nan')", "'x'", "1e-9"])
def test_periods_that_cannot_be(period: str) -> None:
    @virtual_time
    async def run() -> None:
        async with animated(f"PERIOD = {period}\ndef step(device, t): device['counter'] = round(t * 1e6)") as rig:
            await loop.sleep(0.1)
            assert await rig.node.read("counter") > 80_000  # type: ignore[operator]

    run()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("def (", "anim.py:1: invalid syntax"),
        ("a = 1\n\x00", "anim.py: source code string cannot contain null bytes"),
        ("\n1 / 0", "anim.py:2: ZeroDivisionError: division by zero"),
        ("import nothing_of_the_kind", "anim.py:1: ModuleNotFoundError: No module named 'nothing_of_the_kind'"),
        ("on_read = 5", "anim.py: on_read must be a function of 3 arguments"),
        ("def setup(): pass", "anim.py: setup must be a function of 1 argument"),
        ("OBJECTS = ['valv']", "anim.py: OBJECTS: object 'valv' is not in the dictionary; did you mean valve?"),
        ("OBJECTS = 5", "anim.py: OBJECTS: 'int' object is not iterable"),
        ("OBJECTS = [0x1000]", "anim.py: OBJECTS: 0x1000 is the protocol's own: from 0x2000 on they are free"),
    ],
)
def test_scripts_that_cannot_be_used(text: str, message: str) -> None:
    @virtual_time
    async def run() -> None:
        transport = await open_transport(BUS)
        async with transport:
            with pytest.raises(ScriptError) as caught:
                Host(transport, [DeviceModel(DICTIONARY, 5, script=Script(text, "anim.py"))])
            assert caught.value.failed == message

    run()


# ---- what is stored


@virtual_time
async def test_what_is_stored_is_there_after_a_reset_and_in_the_file(tmp_path: Path) -> None:
    path = tmp_path / "state.json"
    async with animated("", ParameterKeeper(path)) as rig:
        await rig.node.write("counter", 5)
        await rig.node.write((0x1010, 1), 0x65766173)
        await rig.node.write("counter", 6)
        await rig.master.nmt(NmtCommand.RESET_NODE, 5)
        await loop.sleep(0.1)
        assert await rig.node.read("counter") == 5
    async with animated("", ParameterKeeper(path)) as rig:
        assert await rig.node.read("counter") == 5
        await rig.node.write((0x1011, 1), 0x64616F6C)
        assert await rig.node.read("counter") == 5
    async with animated("", ParameterKeeper(path)) as rig:
        assert await rig.node.read("counter") == 0


@virtual_time
async def test_a_file_that_cannot_be_written_is_a_hardware_error(tmp_path: Path) -> None:
    async with animated("", ParameterKeeper(tmp_path / "gone" / "state.json")) as rig:
        assert await rig.refused(rig.node.write((0x1010, 1), 0x65766173)) == AbortCode.HARDWARE_ERROR
        assert "node 5: what it stores cannot be kept: [Errno 2]" in rig.told[0]


@virtual_time
async def test_storage_that_somebody_else_has_deferred_is_his() -> None:
    async with animated("") as rig:
        rig.host.nodes[0].deferred.add(0x1010)
        with pytest.raises(NodeError):  # it did not answer
            await rig.node.write((0x1010, 1), 0x65766173)
        assert rig.host.nodes[0].storage.saved == {}
