"""Chapter 8 of the conformance test: storing, restoring, restricted CAN-IDs."""

from __future__ import annotations

from typing import Final

from canopen_proto.conformance.case import Case

_STORE: Final = "store and restore in a device"

CASES: Final = (
    Case("8.1", "Testing other 01", "Write a wrong signature to 0x1010:01", None, waits_for=_STORE),
    Case("8.2", "Testing other 02", "Write save to 0x1010:01", None, waits_for=_STORE),
    Case("8.3", "Testing other 03", "Write a wrong signature to 0x1011:01", None, waits_for=_STORE),
    Case("8.4", "Testing other 04", "Write load to 0x1011:01", None, waits_for=_STORE),
    Case("8.5", "Testing other 05", "Write a wrong signature to 0x1010:02", None, waits_for=_STORE),
    Case("8.6", "Testing other 06", "Write save to 0x1010:02", None, waits_for=_STORE),
    Case("8.7", "Testing other 07", "Write a wrong signature to 0x1011:02", None, waits_for=_STORE),
    Case("8.8", "Testing other 08", "Write load to 0x1011:02", None, waits_for=_STORE),
    Case("8.9", "Testing other 09", "Save the configuration date and time of 0x1020", None, waits_for=_STORE),
    Case("8.10", "Testing other 10", "Try to use restricted CAN-IDs", None, waits_for=_STORE),
)
