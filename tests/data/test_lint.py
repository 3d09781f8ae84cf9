"""The linter: each rule with a case that it warns of and one that it lets pass."""

from __future__ import annotations

import pytest

from canopen_data.csv import load_csv
from canopen_data.lint import Finding, Severity

INDICES = """\
controlword 0x6040 0x0 2 rw
statusword 0x6041 0x0 2 ro
modes 0x6060 0x0 1 wo
pad16 0xFFFF 0xFF 2 rw
pad32 0xFFFF 0xFE 4 rw
"""


def warnings(indices: str = "", constants: str = "", pdos: str = "") -> list[Finding]:
    _, findings = load_csv(INDICES + indices, constants, pdos)
    assert all(each.severity is Severity.WARNING for each in findings)
    return findings


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ("torque_actual_value 0x6077 0x0 2 rw",
         "indices.csv:6:34: warning: 0x6077:00 is torque_actual_value, which to the standard is ro, not rw [read-only]"),
        ("position 0x6064 0x0 2 ro",
         "indices.csv:6:21: warning: 0x6064:00 is position_actual_value, which to the standard is 4 bytes long [length-differs]"),
        ("eds 0x1021 0x0 4 ro",
         "indices.csv:6:16: warning: 0x1021:00 is store_eds, which to the standard is of any length [length-differs]"),
        ("status 0x6041 0x0 2 ro",
         "indices.csv:6:1: warning: 0x6041:00 is 'statusword' already (line 2) [two-aliases]"),
        ("command 0x6040 0x0 2 wo",
         "indices.csv:6:1: warning: 0x6040:00 is 'controlword' already (line 1), whose mode rw counts [two-aliases]"),
        ("6041 0x2000 0x0 2 ro",
         "indices.csv:6:1: warning: alias '6041' reads like an index; the alias counts [alias-number]"),
        ("Statusword 0x2000 0x0 2 ro",
         "indices.csv:6:1: warning: alias 'Statusword' differs from 'statusword' (line 2) in case only [alias-case]"),
        ("field 0x2000 10 2 ro",
         "indices.csv:6:14: warning: subindex 10 is read as 0x10 (16): write 0x before it [decimal-looking]"),
        ("type 0x0005 0x0 1 ro",
         "indices.csv:6:6: warning: no device has an object at 0x0005:00: objects are at 0x1000 to 0xBFFF [reserved-index]"),
    ],
)  # fmt: skip
def test_warnings_of_indices(line: str, text: str) -> None:
    assert [str(each) for each in warnings(line)] == [text]


@pytest.mark.parametrize(
    "line",
    [
        "torque_actual_value 6077 0 2 ro",  # an index is read as hexadecimal by everybody
        "modes_of_operation_display 0x6061 0 1 ro",
        "own 0x2000 9 3 rww",
        "name 0x1008 0 - const",
        "NMT 0 0 1 wo",
        "dead_band 0x2001 0 2 rw",
    ],
)
def test_sound_rows_of_indices(line: str) -> None:
    assert warnings(line) == []


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ("statusword x 0xFFFF 253",
         "constants.csv:1:21: warning: value 253 is read as 0x253 (595): write 0x before it [decimal-looking]"),
        ("statusword x 10 0x10",
         "constants.csv:1:14: warning: mask 10 is read as 0x10 (16): write 0x before it [decimal-looking]"),
        ("statusword x 0x4F 0x20",
         "constants.csv:1:19: warning: 0x20 has bits outside its mask 0x4F: no value can ever match x [outside-mask]"),
        ("modes x 0xFFFF 0x107",
         "constants.csv:1:16: warning: 0x107 does not fit the 1 bytes of modes [constant-too-wide]"),
    ],
)  # fmt: skip
def test_warnings_of_constants(line: str, text: str) -> None:
    assert [str(each) for each in warnings("", line)] == [text]


def test_sound_constants() -> None:
    assert warnings("name 0x1008 0 - ro\n", "statusword a FF 9\nstatusword b 0xFF 0x9\nmodes c 0xFFFF FD\nname d FF FF") == []


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ("debug_rPDO 0x480 statusword pad16 pad32",
         "PDOs.csv:1:1: warning: debug_rPDO is called RPDO, but 0x480 is predefined as TPDO, which counts [pdo-direction]"),
        ("x_rPDO 0x200 controlword", "PDOs.csv:1:1: warning: x_rPDO has 2 bytes, not 8 [pdo-short]"),
        ("x_rPDO 0x200 statusword pad16 pad32",
         "PDOs.csv:1:14: warning: statusword is ro: a device cannot take it from an RPDO [pdo-access]"),
        ("x_tPDO 0x180 modes pad32 pad16 modes",
         "PDOs.csv:1:14: warning: modes is wo: a device cannot send it in a TPDO [pdo-access]"),
        ("x_tPDO 0x181 statusword pad16 pad32",
         "PDOs.csv:1:8: warning: 0x181 seems to have a node-ID in it; the node-ID is added to it [cob-id]"),
        ("x_tPDO 0x80 statusword pad16 pad32",
         "PDOs.csv:1:8: warning: 0x80 with a node-ID added meets the CAN-IDs of SYNC and EMCY [cob-id]"),
        ("x_tPDO 0x100 statusword pad16 pad32",
         "PDOs.csv:1:8: warning: 0x100 with a node-ID added meets the CAN-IDs of a reserved range [cob-id]"),
        ("x_tPDO 0x5F0 statusword pad16 pad32",
         "PDOs.csv:1:8: warning: 0x5F0 with a node-ID added meets the CAN-IDs of SDO [cob-id]"),
        ("x_tPDO 0x700 statusword pad16 pad32",
         "PDOs.csv:1:8: warning: 0x700 with a node-ID added meets the CAN-IDs of heartbeat [cob-id]"),
    ],
)  # fmt: skip
def test_warnings_of_pdos(line: str, text: str) -> None:
    assert str(warnings("", "", line)[0]) == text


def test_sound_pdos() -> None:
    for line in ("x_rPDO 0x200 controlword pad16 pad32", "x_tPDO 0x280 statusword pad16 pad32", "any 0x500 pad32 pad32"):
        assert warnings("", "", line) == []
