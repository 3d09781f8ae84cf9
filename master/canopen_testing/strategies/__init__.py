"""Strategies of Hypothesis for CANopen: what to draw, for properties of devices, masters and tools.

    from canopen_testing.strategies import frames, sdo_conversations

    @given(frames())
    def test_my_decoder_takes_every_frame(frame): ...

Each docstring says what is drawn, its bounds, and towards what it shrinks. All of it depends on Hypothesis' data alone: no clock,
no chance of its own. Needs hypothesis: `pip install canopen-proto[test-tools]`. The page: docs/strategies.md.
"""

from canopen_testing.strategies.conversations import (
    NmtOrder,
    SdoConversation,
    concise_dcfs,
    nmt_sequences,
    sdo_conversations,
)
from canopen_testing.strategies.descriptions import damaged_texts, device_descriptions, eds_texts
from canopen_testing.strategies.devices import PlannedDevice, device_dictionaries, drive_behaviours, networks, pdo_mappings
from canopen_testing.strategies.faults import fault_plans
from canopen_testing.strategies.frames import frames, near_valid_frames, random_frames
from canopen_testing.strategies.identifiers import cob_ids, node_ids
from canopen_testing.strategies.machines import MasterAgainstDevice, MasterAgainstDevices
from canopen_testing.strategies.objects import data_types, object_dictionaries, objects, texts, values, variables

__all__ = [
    "MasterAgainstDevice",
    "MasterAgainstDevices",
    "NmtOrder",
    "PlannedDevice",
    "SdoConversation",
    "cob_ids",
    "concise_dcfs",
    "damaged_texts",
    "data_types",
    "device_descriptions",
    "device_dictionaries",
    "drive_behaviours",
    "eds_texts",
    "fault_plans",
    "frames",
    "near_valid_frames",
    "networks",
    "nmt_sequences",
    "node_ids",
    "object_dictionaries",
    "objects",
    "pdo_mappings",
    "random_frames",
    "sdo_conversations",
    "texts",
    "values",
    "variables",
]
