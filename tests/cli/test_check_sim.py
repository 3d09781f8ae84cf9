"""`canopen check` of `canopen sim`, over each file of real devices that there is: what fails is explained by the file.

The device is the one that `sim` makes of the file, with the drive that it puts behind a drive's; it has the node-ID 5. All 127
cases are run, in virtual time. Without the makers' files (see `vendor_files`) the tests are skipped.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import NamedTuple

import pytest

from canopen_check.catalogue import CASES, run_all
from canopen_data.reading import read_description
from canopen_master.simulation.device_files import models_of
from canopen_master.simulation.plant import DeviceEntry
from canopen_proto.verdict import Result
from tests.check.conformance_rig import Fault, Site
from tests.core.full_device import NODE_ID
from tests.vendor_files import ALL_NAMES, load, needs_vendor_files, path_of


class Failure(NamedTuple):
    """A case that fails. said: what each failure says; why: what is wrong with the file."""

    said: str
    why: str


NO_COB_IDS = 'its COB-IDs are prose ("0000 0080h or 8000 0080h"): it is the standard\'s table, not a device'
CUT_OUT = "it is an extract: its PDOs carry objects of CiA 402 that it does not have, and there are other gaps"
NODE_32 = "its ParameterValue of COB-IDs is that of node 32, though it is an EDS"
NO_CHANNEL = "its 0x1200 is not valid (0x80000000), though each device has the first SDO channel"
SHARED = "TPDOs share CAN-IDs until a master gives them others"

FAILURES: Mapping[str, Mapping[str, Failure]] = {
    "canopen-sample.eds": {
        "1.0": Failure("is no OCTET_STRING|which is not in the file|ARRAY without any sub-object", CUT_OUT),
        "3.21": Failure("which is not in the dictionary", CUT_OUT),
    },
    "cia-301.eds": {
        "1.0": Failure("is not a number", NO_COB_IDS),
    },
    "faulhaber-605.3150.51-V.eds": {
        "1.0": Failure("LowLimit 0 is above HighLimit -1", "0xFF is -1 in an INTEGER8"),
    },
    "inovance-e35.eds": {
        "1.0": Failure("0x6505 is listed, but has no section", "0x6505 is listed, but has no section"),
        "2.12": Failure(r"0x1200:01 is 1568 \(0x620\)", NODE_32),
        "5.1": Failure(r"is 160 \(0xA0\)", NODE_32),
    },
    "oresat-battery.dcf": {
        "2.12": Failure(r"0x1200:01 is .*\(0x80000000\)", NO_CHANNEL),
        "3.2": Failure("have the same CAN-ID", SHARED),
        "6.3": Failure("length of TPDO|number of TPDO", SHARED),
    },
    "oresat-gps.xdd": {
        "2.12": Failure(r"0x1200:01 is .*\(0x80000000\)", NO_CHANNEL),
        "3.2": Failure("have the same CAN-ID", SHARED),
        "3.5": Failure(r"length of TPDO|TPDO \d came \d+ times", SHARED),
        "6.3": Failure("length of TPDO|number of TPDO", SHARED),
    },
}


@pytest.mark.thorough(2)
@needs_vendor_files
@pytest.mark.parametrize("name", ALL_NAMES)
def test_what_fails_is_explained_by_the_file(name: str) -> None:
    description = read_description(load(name), name)
    (model,) = models_of([DeviceEntry(str(path_of(name)), (NODE_ID,))])
    device = Fault("what sim makes of the file", node=lambda out, node_id, dictionary: model(out))
    results = Site(device, description=description, stimulus=False).result_of(lambda bench: run_all(bench))
    assert len(results) == len(CASES)
    explained = FAILURES.get(name, {})
    failed = {case.number: verdict.failures for case, verdict in results if verdict.result is Result.FAILED}
    assert failed.keys() == explained.keys()
    for number, failures in failed.items():
        assert [each for each in failures if not re.search(explained[number].said, each)] == []
    assert [case.number for case, verdict in results if verdict.result is Result.REMARK] == []
