"""Devices made of makers' files pass the cases, but where the file itself is wrong."""

from __future__ import annotations

import pytest

from canopen_proto.conformance.case import Result
from canopen_proto.conformance.catalogue import run_all
from canopen_proto.dictionary.reading import read_description
from tests.proto.conformance_rig import Site
from tests.vendor_files import load

FAILED = {
    "schunk-powerball-lwa4p.dcf": {},
    "maxon-epos2.eds": {},
    "systec-io-x1.eds": {},
    "canopen-sample.eds": {"1.0": r"DefaultValue '0x0' is no OCTET_STRING", "3.21": "0x6040:00, which is not in the dictionary"},
    "faulhaber-605.3150.51-V.eds": {"1.0": "LowLimit 0 is above HighLimit -1"},
}


@pytest.mark.parametrize("name", FAILED)
def test_a_device_of_a_makers_file(name: str) -> None:
    description = read_description(load(name), name)
    results = Site(description=description, stimulus=False).result_of(lambda bench: run_all(bench))
    failed = {case.number: verdict.reason for case, verdict in results if verdict.result is Result.FAILED}
    assert failed.keys() == FAILED[name].keys()
    for number, said in FAILED[name].items():
        assert said in failed[number]
