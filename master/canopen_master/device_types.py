"""The device type, 0x1000: the number of a device profile in the low half; the profile defines the high half.

Source: CiA 301 v4.2.0, 7.5.2.1.
"""

from __future__ import annotations

from typing import Final

PROFILES: Final = {
    0: "no device profile",
    401: "I/O module (CiA 401)",
    402: "drive (CiA 402)",
    404: "measuring device (CiA 404)",
    405: "programmable controller (CiA 405)",
    406: "encoder (CiA 406)",
    408: "hydraulic valve or drive (CiA 408)",
    410: "inclinometer (CiA 410)",
    418: "battery module (CiA 418)",
    419: "battery charger (CiA 419)",
}
"""The most usual profiles."""

DRIVE_PROFILE: Final = 402
_DRIVE_KINDS: Final = {0x01: "frequency converter (CiA 402)", 0x02: "servo drive (CiA 402)", 0x04: "stepper drive (CiA 402)"}


def profile_of(device_type: int) -> int:
    """Return the number of the device profile, 0 for none."""
    return device_type & 0xFFFF


def device_type_text(device_type: int) -> str:
    """Return the text of a device type for people."""
    profile, kind = profile_of(device_type), device_type >> 16 & 0xFF
    if profile == DRIVE_PROFILE and kind in _DRIVE_KINDS:
        return _DRIVE_KINDS[kind]
    return PROFILES.get(profile, f"device profile {profile}")
