"""`canopen_check`: one case of the conformance test, against a simulated device of a world, or a real one on a bus."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import TypeAlias

import pytest
import trio

from canopen_check.bench import Bench
from canopen_check.case import Case
from canopen_data.description import DeviceDescription
from canopen_data.descriptions import load_description
from canopen_master import open_master
from canopen_master.errors import MasterError
from canopen_proto.dictionary import Variable
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import LocalProtocolError, Time
from canopen_proto.verdict import Result, Verdict

RunCase: TypeAlias = Callable[[], Verdict]


@dataclass(frozen=True)
class RealDevice:
    """A device on a bus. locator: of the bus. node_id: 1..127. description: its file."""

    locator: str
    node_id: int
    description: DeviceDescription


def device_of(config: pytest.Config) -> RealDevice:
    """Return the device that the options name. Raises UsageError if one of them is missing."""
    locator, node_id, file = (config.getoption(name) for name in ("canopen_bus", "canopen_device", "canopen_eds"))
    missing = [
        name for name, value in (("--canopen-bus", locator), ("--canopen-device", node_id), ("--eds", file)) if value is None
    ]
    if missing:
        raise pytest.UsageError(
            f"which device is to be checked? {', '.join(missing)} is missing; or override the fixture canopen_device with a "
            "simulated device"
        )
    return RealDevice(locator, node_id, load_description(file))


def run_case(request: pytest.FixtureRequest, device: RealDevice | LocalNode) -> RunCase:
    """Return the function that runs the case of this test: passed, failed with what the device did wrong or
    why it cannot be judged, or skipped."""
    case: Case = request.param
    if case.stores and not request.config.getoption("canopen_storing"):
        pytest.skip("it changes what the device stores: --canopen-storing")

    def run() -> Verdict:
        if isinstance(device, RealDevice):
            verdict = trio.run(check_on_bus, case, device, _is_strict(request))
        else:
            verdict = _in_world(case, device, request)
        for remark in verdict.remarks:
            request.node.user_properties.append(("remark", remark))
        if verdict.result is Result.NOT_APPLICABLE:
            pytest.skip(verdict.reason)
        if verdict.result is Result.FAILED:
            lines = "\n".join(f"  {failure}" for failure in verdict.failures)
            pytest.fail(f"case {case.number}, {case.title}:\n{lines}", pytrace=False)
        if verdict.result is Result.NOT_JUDGED:
            pytest.fail(f"case {case.number}, {case.title}: {verdict.reason}", pytrace=False)
        return verdict

    return run


def _is_strict(request: pytest.FixtureRequest) -> bool:
    return bool(request.config.getoption("canopen_strict"))


async def check_on_bus(case: Case, device: RealDevice, strict: bool = False) -> Verdict:
    """Run a case against a real device, and reset it behind that. strict: ask for more than CiA's own tool does."""
    async with open_master(device.locator) as master:
        network = master.bus().network
        bench = Bench(network, device.node_id, device.description.dictionary, description=device.description, strict=strict)
        try:
            verdict: Verdict = await master.run(case.run(bench))
        finally:
            if case.uses_device:
                with trio.CancelScope(shield=True), suppress(MasterError):
                    await master.nmt_reset_node(device.node_id)
    return verdict


def _in_world(case: Case, device: LocalNode, request: pytest.FixtureRequest) -> Verdict:
    world = request.getfixturevalue("canopen_world")
    master = world.master()
    bench = Bench(master.runs, device.node_id, device.dictionary, stimulus=partial(_change, device), strict=_is_strict(request))
    verdict: Verdict = master.run(case.run(bench))
    return verdict


def _change(device: LocalNode, variable: Variable, now: Time) -> bool:
    """Let the process of a simulated device change a value, of whatever type: by its lowest bit that its limits let change."""
    data = variable.encode(device.values.store[variable.mux])
    for bit in range(8 * len(data)):
        changed = int.from_bytes(data, "little") ^ 1 << bit
        try:
            device.set_value(variable.index, variable.subindex, variable.decode(changed.to_bytes(len(data), "little")), now)
        except LocalProtocolError:
            continue
        return True
    return False
