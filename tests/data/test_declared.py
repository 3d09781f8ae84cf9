"""The files of a device that is declared in code say what the device is."""

from __future__ import annotations

import pytest

from canopen_data.checks import check
from canopen_data.declared import describe_device
from canopen_data.description import BIT_RATES, DeviceDescription, FileKind
from canopen_data.eds.reader import read_eds
from canopen_data.eds.writer import write_eds
from canopen_data.xdd import read_xdd
from canopen_data.xdd.writer import write_xdd
from canopen_proto.declared import Nameplate, nameplate
from tests.core.test_declared_device import Kettle


def eds() -> DeviceDescription:
    return read_eds(write_eds(describe_device(Kettle)), "kettle.eds", strict=True)


def xdd() -> DeviceDescription:
    return read_xdd(write_xdd(describe_device(Kettle)).encode(), "kettle.xdd", strict=True)


@pytest.mark.parametrize(("read", "kind"), [(eds, FileKind.EDS), (xdd, FileKind.XDD)])
def test_a_file_has_every_object_and_nothing_is_wrong_with_it(read: object, kind: FileKind) -> None:
    assert callable(read)
    found = read()
    assert found.kind is kind
    assert list(found.dictionary) == list(Kettle.dictionary)
    assert check(found) == []
    info = found.device_info
    assert (info.vendor_name, info.product_name, info.vendor_number, info.product_number) == ("Maker", "Kettle", 0x7F, 2)
    assert (info.rpdo_count, info.tpdo_count, info.lss_supported, info.simple_boot_up_slave) == (1, 3, True, True)
    assert info.bit_rates == {125, 250, 500, 1000}


def test_a_nameplate_takes_the_bit_rates_that_a_file_can_name() -> None:
    assert Nameplate("All", bit_rates=frozenset(BIT_RATES)).bit_rates == set(nameplate.BIT_RATES)
