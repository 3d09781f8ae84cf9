"""What a device shows of its errors, and what a client cannot make it do."""

from __future__ import annotations

import pytest

from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import ValueRangeError
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.drives.cia402 import objects
from canopen_proto.machine import MILLISECOND
from canopen_proto.procedures.steps import SdoTransferError, download
from canopen_proto.simulation.drive.settings import Shape
from tests.core.devices import LIMITED, Pair, io_device
from tests.drives.rig import Rig


def test_a_tpdo_carries_the_error_register_as_it_is_at_the_sync() -> None:
    dictionary = io_device().with_objects(
        [standard_object(0x1A01, highest=2, defaults={0: 1, 1: 0x10010008}), standard_object(0x1801, defaults={1: 0x285, 2: 1})]
    )
    pair = Pair(dictionary)
    pair.bus.send("000#0105")
    pair.bus.run(MILLISECOND)
    pair.local.raise_error(0x4210, 0x08, b"", pair.bus.now)
    pair.bus.send("080#")
    pair.bus.run(MILLISECOND)
    assert "285#09" in pair.bus.trace()
    pair.local.clear_error(0x4210, pair.bus.now)
    pair.bus.send("080#")
    pair.bus.run(MILLISECOND)
    assert "285#00" in pair.bus.trace()


def test_an_event_driven_tpdo_goes_out_when_the_error_register_changes() -> None:
    dictionary = io_device().with_objects([standard_object(0x1A00, highest=2, defaults={0: 1, 1: 0x10010008})])
    pair = Pair(dictionary)
    pair.bus.send("000#0105")
    pair.bus.run(MILLISECOND)
    pair.local.raise_error(0x4210, 0x08, b"", pair.bus.now)
    pair.bus.run(MILLISECOND)
    assert pair.bus.trace().count("185#09") == 1


@pytest.mark.parametrize(("stop", "code"), [("000#0205", 0x8100), ("000#8005", 0x8100)])
def test_a_drive_that_faults_when_its_node_leaves_operational_says_so(stop: str, code: int) -> None:
    rig = Rig(Shape.STANDARD)
    rig.node.values.store[objects.ABORT_CONNECTION_OPTION_CODE] = 1
    rig.bus.send(stop)
    rig.bus.run(MILLISECOND)
    assert rig.node.values.store[objects.ERROR_CODE] == code


@pytest.mark.parametrize(("period", "accepted"), [(0, True), (1, False), (99, False), (100, True), (10_000, True)])
def test_a_client_cannot_make_a_device_flood_the_bus_with_sync(period: int, accepted: bool) -> None:
    pair = Pair()
    request = pair.master.run(download(pair.remote.sdo, 0x1006, 0, period.to_bytes(4, "little")), pair.bus.now)
    pair.bus.run(10 * MILLISECOND)
    (ended,) = [event for event in pair.bus.events if getattr(event, "request_id", None) == request]
    error = getattr(ended, "error", None)
    assert (error is None) is accepted
    if error is not None:
        assert isinstance(error, SdoTransferError)
        assert error.abort_code == AbortCode.INVALID_VALUE


def test_the_device_itself_keeps_to_the_limits_of_its_objects() -> None:
    pair = Pair()
    with pytest.raises(ValueRangeError):
        pair.local.set_value(LIMITED, 0, 21, pair.bus.now)
    pair.local.set_value(LIMITED, 0, 20, pair.bus.now)
