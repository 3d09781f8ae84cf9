"""The checks over files of real devices: what they find there, by hand, and that repairs keep what a file says.

An engineer who sees false alarms in the file of a device that runs will not look at the linter again: so each error is listed
here with its reason, and each warning by its rule.
"""

from __future__ import annotations

import pytest

from canopen_data.checks import check
from canopen_data.difference import compare
from canopen_data.findings import Severity
from canopen_data.reading import read_description
from canopen_data.repair import repair
from tests import vendor_files

ERRORS = {
    "canopen-sample.eds": {
        "no-entries",  # [3003] is an ARRAY without any sub-object, made for a test of a reader
        "pdo-object",  # it maps objects of CiA 402, and has none of them
    },
    "faulhaber-605.3150.51-V.eds": {"limits-crossed"},  # 6061: 0x00 to 0xFF, which in an INTEGER8 is 0 to -1
    "inovance-e35.eds": {"list-unknown"},  # 0x6505 is listed, and is not there
}
WARNINGS = {
    "canopennode-demo-device.eds": {"text-characters"},  # a euro sign in a VISIBLE_STRING
    "canopen-sample.eds": {"count-type", "list-missing", "sync-missing"},
    "cia-301.eds": {"bit-rate-missing", "list-missing", "standard-access"},  # a text book's table rather than a device
    "faulhaber-605.3150.51-V.eds": {"default-limits"},
    "inovance-e35.eds": {"commissioning-missing", "identity-differs", "list-missing", "profile-type"},
    "oresat-battery.dcf": {"cob-id-clash", "standard-access"},  # it answers for several node-IDs
    "oresat-gps.xdd": {"cob-id-clash", "standard-access"},
    "sample-node-1.eds": {"cob-id-fixed"},
    "sample-node-1.xdd": {"cob-id-fixed"},
    "schunk-powerball-lwa4p.dcf": {"commissioning-missing"},  # the node-ID of each joint is told elsewhere
    "systec-mm217.eds": {"array-mixed"},
}


@pytest.mark.parametrize("name", vendor_files.ALL_NAMES)
def test_what_is_found_in_a_real_file_is_right(name: str) -> None:
    found = check(read_description(vendor_files.load(name), name))
    assert {each.code for each in found if each.severity is Severity.ERROR} == ERRORS.get(name, set())
    assert {each.code for each in found if each.severity is Severity.WARNING} == WARNINGS.get(name, set())
    assert all(each.line for each in found if each.message.startswith("in [1") or each.message.startswith("in [6"))


@pytest.mark.parametrize("name", vendor_files.INI_NAMES)
def test_a_repaired_file_says_the_same(name: str) -> None:
    before = read_description(vendor_files.load(name), name)
    repaired = repair(before)
    assert compare(before, repaired.description) == []
    assert len(repaired.description.findings) <= len(before.findings)
    assert repair(repaired.description).repairs == ()
