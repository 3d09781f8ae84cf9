"""EDS, DCF and XDD files of real devices.

They are not part of the project: they belong to the makers. They are looked for in `$CANOPEN_VENDOR_EDS`, else in
`../shared/eds` beside the repository; without them the tests are skipped.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest

VARIABLE = "CANOPEN_VENDOR_EDS"
FOLDER = Path(os.environ.get(VARIABLE) or Path(__file__).parents[1] / ".." / "shared" / "eds")

EDS_NAMES = (
    "canopen-sample.eds",
    "canopennode-demo-device.eds",
    "canopennode-ds301.eds",
    "cia-301.eds",
    "cia-401.eds",
    "cia-402.eds",
    "faulhaber-605.3150.51-V.eds",
    "faulhaber-605.3150.70-B.eds",
    "inovance-e35.eds",
    "maxon-epos2.eds",
    "ros2-cia402-slave.eds",
    "sample-node-1.eds",
    "systec-io-x1.eds",
    "systec-mm217.eds",
)
DCF_NAMES = ("oresat-battery.dcf", "schunk-powerball-lwa4p.dcf")
XDD_NAMES = ("oresat-gps.xdd", "sample-node-1.xdd")

needs_vendor_files = pytest.mark.skipif(
    not FOLDER.is_dir(), reason=f"no device files of makers: there is no folder {FOLDER} (${VARIABLE} names another)"
)

INI_NAMES = EDS_NAMES + DCF_NAMES
ALL_NAMES = INI_NAMES + XDD_NAMES


def path_of(name: str) -> Path:
    """A file by its name; the test is skipped where there is none."""
    path = FOLDER / name
    if not path.exists():
        pytest.skip(f"no vendor file {name}: {FOLDER} has none (${VARIABLE} names another folder)")
    return path


def load(name: str) -> bytes:
    """A file's bytes; the test is skipped where there is none."""
    return path_of(name).read_bytes()
