"""A whole session of CiA's conformance test tool, replayed to our device: see `cct_session`.

The device of the session passed, so ours should say what it said. Where ours says something else, `DIFFERENCES` gives the reason;
an entry that no longer occurs is an error too. CiA 301 v4.2.0 throughout.
"""

from __future__ import annotations

from collections import Counter

from canopen_check.catalogue import run_all
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import Outbox
from canopen_proto.verdict import Result
from tests.check.certified_nodes import certified
from tests.check.conformance_rig import Fault, Site
from tests.interop.cct_session import Difference, Replay, load_device, load_session, unexplained, with_application
from tests.interop.recorded import needs_recordings

pytestmark = needs_recordings

REGISTER = "0x1001 has the bits of the error as long as it lasts (7.5.2.2); the recorded device clears them at once"
SYNC_TIME_OUT = "the recorded device tells of a SYNC that does not come (0x8100); no clause asks for that"
WHO = "the last five bytes of an emergency message are the maker's (7.2.7.1): ours hold the node-ID, theirs the entry"
PHASE = "a TPDO of type n goes at the n-th SYNC; the recorded device begins to count in the middle, so that it sends one more"
NOT_NOW = "the PDO is valid: both refuse. 0x08000022 (present device state) says that the same write can succeed later"
NO_OBJECT = "both refuse an entry that is too long for a PDO and names no object; which is looked at first is left open"
NO_RTR = "ours has transmission types 252 and 253, which go by remote request; theirs does not support these"
SYNC_RACE = "one SYNC more was on its way when the tool reset the device"

DIFFERENCES = (
    Difference(
        "2.7", "584#8004100001000405", "584#8000000001000405", "which object an unknown command is about, nobody can know"
    ),
    Difference("2.27", "584#8000100001000405", "584#8000100003000405", "0x05040003 (invalid sequence number) says what is wrong"),
    Difference(
        "5.4", "084#1082000402000000", "084#1082110100000000", f"{REGISTER}; then theirs has the CAN-ID, ours the PDO's number"
    ),
    Difference("5.5", "584#4F01100000000000", "584#4F01100011000000", REGISTER),
    Difference("5.6", "584#4303100110820004", "584#4303100110820100", "the upper half of an entry is the maker's (7.5.2.4)"),
    *(Difference(case, "084#(0081|0000)(10|00)18.{8}", "", SYNC_TIME_OUT) for case in ("6.3", "6.4", "6.6", "6.7", "6.8")),
    Difference("6.3", "184#FF00|284#FF03FF03FF03FF03", "", PHASE),
    Difference("6.8", "080#01", "", SYNC_RACE),
    Difference("7.106", "084#3081101B0[0-7]000000", "084#3081110[1-9]00000000", WHO),
    Difference("7.106", "084#0000001B00000000", "084#0{16}", WHO),
    Difference("7.107", "084#3081101B0[0-7]000000", "084#3081114700000000", WHO),
    Difference("7.107", "084#0000001B00000000", "084#0{16}", WHO),
    Difference("8.6", "704#7F", "", "the boot-up message is the first heartbeat (7.2.8.3.2.2); the next comes 20 s later"),
    Difference("9.1", "584#8002140130000906", "584#6002140100000000", "a PDO with an empty mapping may be valid"),
    Difference("9.1", "584#80(..1[6A]0000000106|0216..(42000406|00000206))", "584#80....(..)22000008", NOT_NOW),
    Difference("9.1", "584#80(0[01]180[36])30000906", r"584#80..180[36]22000008", NOT_NOW),
    Difference("9.1", "584#800[23]1[6A]0.42000406", "584#800[23]1[6A]0.00000206", NO_OBJECT),
    *(Difference(case, "584#800.180230000906", "584#600.180200000000", NO_RTR) for case in ("9.1", "9.2", "9.3", "9.4")),
    *(Difference(case, "080#", "", SYNC_RACE) for case in ("9.2", "9.3", "9.4")),
)

ITSELF = "this one starts by itself, which the device of the session did not do"

VERDICTS = {
    "3.7": ("failed", "passed", "the tool wants a TPDO of type 0 at each SYNC, though nothing has changed; 7.5.2.37 does not"),
    "3.22": ("failed", "passed", "the tool says of no step what was wrong with it: each was confirmed"),
    "4.2": ("failed", "failed", "a power-on counter and a constant of the application are not those of the EDS"),
    "4.8": ("failed", "passed", "the tool failed an input, 0x6000:01, that was not 0; ours knows that inputs live"),
    "5.6": (
        "failed",
        "passed",
        "the tool did not take the entry, whose lower half is the code of its message, as 7.5.2.4 has it",
    ),
    "9.2": ("passed", "remark", ITSELF),
    "10.1": ("passed", "remark", ITSELF),
}
"""Where our verdict on a device like that of the session is not the tool's: theirs, ours, and why."""


def test_our_device_in_the_place_of_a_certified_one() -> None:
    session, description = load_session(), load_device()
    assert Counter(session.verdicts.values()) == {"passed": 85, "skipped": 36, "failed": 5, "warning": 1}
    replay = Replay(description.dictionary)
    replay.play(session, DIFFERENCES)
    assert list(unexplained(replay, DIFFERENCES)) == []
    assert replay.matched > 8900


def test_our_verdicts_on_a_certified_device_are_those_of_the_tool() -> None:
    """`canopen check` of a device that does what the session's did. Where the tool skipped a case, ours may look."""
    session, description = load_session(), load_device()

    def make(out: Outbox, node_id: int, dictionary: ObjectDictionary) -> LocalNode:
        return certified(out, node_id, with_application(dictionary))

    site = Site(Fault("certified", node=make), description=description, stimulus=False)
    results = site.result_of(lambda bench: run_all(bench))
    differing = {
        case.number: (session.verdicts[case.number], str(verdict.result))
        for case, verdict in results
        if verdict.result is not Result.PASSED or session.verdicts[case.number] == "failed"
        if (session.verdicts[case.number], verdict.result) != ("skipped", Result.NOT_APPLICABLE)
    }
    assert differing == {number: (theirs, ours) for number, (theirs, ours, _) in VERDICTS.items()}
