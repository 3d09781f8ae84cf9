"""What each recorded session is about, and where our answers differ from the recorded ones, with the clause that allows it.

CiA 301 v4.2.0 throughout.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from canopen_proto.datatypes import Value
from canopen_proto.nmt import NmtState
from tests.interop.recorded import Difference

INPUT, NUMBER, OUTPUT_1, OUTPUT_2 = 0x60000108, 0x21100120, 0x62000108, 0x62000208
"""Mapping entries."""


@dataclass
class Scene:
    """One recording. What our side has to know of it, which no frame tells.

    state: of the device when it begins. changes: stored values of the device. sends_inputs: the TPDOs that its profile sends
    when it becomes Operational (CiA 401). starts_itself: it goes on to Operational after its boot-up (CiA 302-2, 0x1F80).
    rpdo, tpdo: the master's first ones, as mapping entries. rpdo_by_sync: the RPDO goes behind each SYNC, else when the
    application has a value. differences: of our device. master_differences: of our master.
    """

    name: str
    node_id: int = 4
    state: NmtState = NmtState.OPERATIONAL
    changes: Mapping[tuple[int, int], Value] = field(default_factory=dict)
    sends_inputs: tuple[int, ...] = (1, 2)
    starts_itself: bool = False
    rpdo: tuple[int, ...] = ()
    tpdo: tuple[int, ...] = ()
    rpdo_by_sync: bool = False
    differences: tuple[Difference, ...] = ()
    master_differences: tuple[Difference, ...] = ()


SCENES = [
    Scene("canopennode-bootup-first-run", state=NmtState.INITIALISING),
    Scene("canopennode-nmt-reset-node", starts_itself=True),
    Scene(
        "canopennode-nmt-commands",
        changes={(0x1017, 0): 1000},
        master_differences=(
            Difference(
                "604#8000000000000405",
                "604#8000100000000405",
                "an abort names the object of its transfer, 7.2.4.3.17; the recorded client names none",
            ),
        ),
    ),
    Scene("canopennode-sdo-expedited-reads"),
    Scene(
        "canopennode-sdo-segmented-upload-string",
        differences=(
            Difference(
                "584#800A100047000406",
                "584#410A100000000000",
                "an empty string: a size of 0 is a size (7.2.4.3.6), and nothing in table 22 says that a server has to abort",
            ),
        ),
    ),
    Scene("canopennode-sdo-segmented-download-string"),
    Scene("canopennode-sdo-aborts"),
    Scene("canopennode-sdo-write-1017-heartbeat", changes={(0x1017, 0): 1000}),
    Scene("canopennode-sdo-block-upload-string-1008", changes={(0x1017, 0): 1000}),
    Scene("canopennode-sdo-block-download-domain"),
    Scene(
        "canopennode-pdo-config-and-traffic",
        changes={(0x1017, 0): 1000},
        rpdo=(NUMBER,),
        tpdo=(NUMBER, INPUT),
    ),
    Scene("canopennode-time"),
    Scene(
        "canopennode-heartbeat-consumer-emcy",
        state=NmtState.PRE_OPERATIONAL,
        changes={(0x1017, 0): 1000},
        sends_inputs=(2,),
        differences=(
            Difference(
                "084#3081101B00000000",
                "084#3081110A00000000",
                "the register's bit 0 is set with any error (7.5.2.2), the recorded device leaves it out; the last five bytes "
                "are the manufacturer's (7.2.7.3): ours has the lost node's ID there, the other one the number of its error bit",
            ),
            Difference("084#0000001B00000000", "084#0000000000000000", "the last five bytes are the manufacturer's (7.2.7.3)"),
            Difference(
                "584#430310013081101B",
                "584#4303100130810A00",
                "the upper half of an entry of 0x1003 is the manufacturer's (7.5.2.4): ours has the lost node's ID there",
            ),
            Difference("584#4F01100010000000", "584#4F01100011000000", "the register's bit 0 is set with any error (7.5.2.2)"),
        ),
    ),
    Scene("canopennode-pdo-length-error-emcy", state=NmtState.PRE_OPERATIONAL, sends_inputs=(2,), rpdo=(OUTPUT_1, OUTPUT_2)),
    Scene(
        "lely-slave-pdo-sync",
        node_id=5,
        sends_inputs=(),
        rpdo=(NUMBER,),
        tpdo=(NUMBER, INPUT),
    ),
    Scene(
        "lely-master-boots-lely-slave",
        state=NmtState.INITIALISING,
        sends_inputs=(),
        starts_itself=True,
        rpdo=(OUTPUT_1, OUTPUT_2),
        tpdo=(INPUT, NUMBER),
        rpdo_by_sync=True,
    ),
]
OUT_OF_SCOPE = {"canopennode-lss-selective", "lely-slave-lss"}  # test_lss_sessions.py replays them
