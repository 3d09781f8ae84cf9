"""Chapter 3 of the conformance test: PDO."""

from __future__ import annotations

from typing import Final

from canopen_proto.conformance.case import Case

_NEXT: Final = "this chapter"

CASES: Final = (
    Case("3.1", "PDO 01", "Scan for RPDOs: the communication parameters", None, waits_for=_NEXT),
    Case("3.2", "PDO 02", "Scan for TPDOs: the communication parameters", None, waits_for=_NEXT),
    Case("3.3", "PDO 03", "Operational: request TPDOs by RTR, if allowed", None, waits_for=_NEXT),
    Case("3.4", "PDO 04", "Operational: configure TPDOs for event-driven mode", None, waits_for=_NEXT),
    Case("3.5", "PDO 05", "Operational: configure the event timer of TPDOs", None, waits_for=_NEXT),
    Case("3.6", "PDO 06", "Operational: configure TPDOs for SYNC (cyclic) mode", None, waits_for=_NEXT),
    Case("3.7", "PDO 07", "Operational: configure TPDOs for SYNC (acyclic) mode", None, waits_for=_NEXT),
    Case("3.8", "PDO 08", "Operational: configure TPDOs for SYNC (cyclic) mode and a SYNC start value", None, waits_for=_NEXT),
    Case("3.9", "PDO 09", "Stopped: request TPDOs by RTR, if allowed", None, waits_for=_NEXT),
    Case("3.10", "PDO 10", "Stopped: configure TPDOs for event-driven mode", None, waits_for=_NEXT),
    Case("3.11", "PDO 11", "Stopped: configure the event timer of TPDOs", None, waits_for=_NEXT),
    Case("3.12", "PDO 12", "Stopped: configure TPDOs for SYNC (cyclic) mode", None, waits_for=_NEXT),
    Case("3.13", "PDO 13", "Stopped: configure TPDOs for SYNC (acyclic) mode", None, waits_for=_NEXT),
    Case("3.14", "PDO 14", "Stopped: configure TPDOs for SYNC (cyclic) mode and a SYNC start value", None, waits_for=_NEXT),
    Case("3.15", "PDO 15", "Pre-operational: request TPDOs by RTR, if allowed", None, waits_for=_NEXT),
    Case("3.16", "PDO 16", "Pre-operational: configure TPDOs for event-driven mode", None, waits_for=_NEXT),
    Case("3.17", "PDO 17", "Pre-operational: configure the event timer of TPDOs", None, waits_for=_NEXT),
    Case("3.18", "PDO 18", "Pre-operational: configure TPDOs for SYNC (cyclic) mode", None, waits_for=_NEXT),
    Case("3.19", "PDO 19", "Pre-operational: configure TPDOs for SYNC (acyclic) mode", None, waits_for=_NEXT),
    Case(
        "3.20", "PDO 20", "Pre-operational: configure TPDOs for SYNC (cyclic) mode and a SYNC start value", None, waits_for=_NEXT
    ),
    Case("3.21", "PDO 21", "Read the default mappings and look for their objects in the dictionary", None, waits_for=_NEXT),
    Case("3.22", "PDO 22", "Write a new correct mapping with the mapping procedure", None, waits_for=_NEXT),
    Case("3.23", "PDO 23", "Try to write a new mapping without the mapping procedure", None, waits_for=_NEXT),
    Case("3.24", "PDO 24", "Try to write a new mapping to a valid PDO", None, waits_for=_NEXT),
    Case("3.25", "PDO 25", "Try to write an incorrect mapping: too many objects", None, waits_for=_NEXT),
    Case("3.26", "PDO 26", "Try to write an incorrect mapping: objects too long", None, waits_for=_NEXT),
    Case("3.27", "PDO 27", "Map an rww or wo object to an RPDO", None, waits_for=_NEXT),
    Case("3.28", "PDO 28", "Try to map an rwr or ro object to an RPDO", None, waits_for=_NEXT),
    Case("3.29", "PDO 29", "Try to map an object that is not mappable to an RPDO", None, waits_for=_NEXT),
    Case("3.30", "PDO 30", "Map an rwr or ro object to a TPDO", None, waits_for=_NEXT),
    Case("3.31", "PDO 31", "Try to map an rww or wo object to a TPDO", None, waits_for=_NEXT),
    Case("3.32", "PDO 32", "Try to map an object that is not mappable to a TPDO", None, waits_for=_NEXT),
    Case("3.33", "PDO 33", "Map a dummy object to an RPDO, if dummy objects are supported", None, waits_for=_NEXT),
)
