"""The errors of a master: one tree of exceptions under `MasterError`.

Each says, on one screen, what failed (node, object, value), what was seen, the likely causes (the best guess first), and what to
try next. `str(error)` is that screen; the fields are for programs. The codes are those of the command line: CO1xx the bus, CO2xx
SDO, CO3xx files and names, CO4xx drives.

A wrong call raises an error of the core instead, and nothing is sent: `ObjectNotFoundError` for an unknown name,
`ValueRangeError` for a value that does not fit, `LocalProtocolError` for a node-ID of 200. A procedure that you wrote raises its
own errors.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence, Sized
from numbers import Real
from typing import Final, Unpack

from canopen_master.silence import SCAN, sdo_silence, two_devices
from canopen_proto.abort import AbortCode, AbortOrigin, text_of
from canopen_proto.drives.cia402.states import State
from canopen_proto.emcy import EmcyReceived
from canopen_proto.explained import ErrorWords, Explained, counted
from canopen_proto.machine import SECOND, LocalProtocolError, Time
from canopen_proto.network import Network
from canopen_proto.procedures.steps import NOT_CONFIRMED
from canopen_proto.remote_node import RemoteNode
from canopen_proto.sdo.client import SdoAborted
from canopen_transports import TransportError

MASTER_CLOSED: Final = "CO130"
"""The master has been left, or is on its way out."""
HALT_NOT_CONFIRMED: Final = "CO131"
"""The master has been left, and a drive did not confirm that it stands."""
PACKAGE_MISSING: Final = "CO141"
REALTIME_REFUSED: Final = "CO142"
CALL_TIMEOUT: Final = "CO143"
"""A call of the blocking master took longer than its `timeout`."""
NO_ANSWER: Final = "CO201"
REFUSED: Final = "CO202"
GIVEN_UP: Final = "CO203"
UNEXPECTED_ANSWER: Final = "CO204"
CONTESTED: Final = "CO206"
"""Another SDO client uses the node's channel."""
CHANNEL_TAKEN: Final = "CO208"
"""Another program of ours uses the node's SDO channel."""
NOT_HEARD: Final = "CO210"
"""A node did not boot, or did not send the frame that was waited for."""
DEMONSTRATION_REFUSED: Final = "CO123"
SIMULATED_DEVICE: Final = "CO127"
CHAIN_FILE: Final = "CO320"
BAD_SET_POINT: Final = "CO321"
UNKNOWN_CHAIN: Final = "CO322"
PLAN_REFUSED: Final = "CO323"
NOT_A_DRIVE: Final = "CO332"
CHAIN_FAILED: Final = "CO401"
CHAIN_FAULT: Final = "CO402"
CHAIN_HALTED: Final = "CO403"
CHAIN_NOT_READY: Final = "CO404"
MODE_UNSUPPORTED: Final = "CO405"
HOMING_FAILED: Final = "CO406"
PROCEDURE_FAILED: Final = "CO407"
NODE_IS_NO_DRIVE: Final = "CO408"


class MasterError(Explained, Exception):
    """A command failed; see this module's text, and Explained for the fields."""


class RealtimeRefusedError(MasterError):
    """The operating system does not give what `Realtime(required=True)` asks for; the master was not opened."""


class DeviceRefusedError(MasterError, ValueError):
    """A simulated device cannot be made as its entry says: its node-ID is not known, or another one has it; a value does not
    fit. For the fields see Explained."""

    def __init__(self, failed: str, **words: Unpack[ErrorWords]) -> None:
        super().__init__(SIMULATED_DEVICE, failed, **words)


class DemonstrationRefusedError(MasterError, ValueError):
    """A demonstration cannot be shown with these joints: one has no scale, or does not turn. For the fields see Explained."""

    def __init__(self, failed: str, **words: Unpack[ErrorWords]) -> None:
        super().__init__(DEMONSTRATION_REFUSED, failed, **words)


class NoDriveInFileError(MasterError, ValueError):
    """A file describes no drive by CiA 402 that could move. For the fields see Explained."""

    def __init__(self, failed: str, *tries: str) -> None:
        super().__init__(NOT_A_DRIVE, failed, tries=tries)


class BusError(MasterError):
    """A bus cannot be opened, or has failed. Every task that waits for it gets this error. bus: its name in this master."""

    def __init__(self, bus: str, error: TransportError) -> None:
        failed = error.failed if error.locator == bus else f"bus {bus}: {error.failed}"
        super().__init__(error.code, failed, seen=error.seen, cause=error.cause, tries=error.tries)
        self.bus = bus
        self.__cause__ = error


class MasterClosedError(MasterError):
    """The block of `open_master` is over or ending, or the master was closed: it takes no new commands."""

    def __init__(self) -> None:
        cause = "its block is over or was cancelled, or somebody has closed it"
        super().__init__(MASTER_CLOSED, "the master is closed", cause=cause, tries=("open it again",))


class HaltNotConfirmedError(MasterError):
    """The master was left, and at least one drive that was enabled did not confirm that it stands."""


class CallTimeoutError(MasterError, TimeoutError):
    """A call of the blocking master took longer than its `timeout`, and was taken back. timeout: seconds."""

    def __init__(self, timeout: float) -> None:
        failed = f"the call was not done within {timeout:g} s, and was taken back"
        super().__init__(CALL_TIMEOUT, failed, tries=("a longer timeout",))
        self.timeout = timeout


class NodeError(MasterError):
    """An error of one node. node_id: 1..127; bus: the name of its bus. For the other fields see Explained."""

    def __init__(self, code: str, node_id: int, bus: str, failed: str, **words: Unpack[ErrorWords]) -> None:
        super().__init__(code, failed, **words)
        self.node_id = node_id
        self.bus = bus


class NodeSilentError(NodeError, TimeoutError):
    """A node did not boot in time, or did not send an expected frame in time."""


class NodeIsNoDriveError(NodeError):
    """A node has no statusword of CiA 402, or none of the axis that was meant. statusword: its index there."""

    def __init__(self, node_id: int, axis: int, statusword: int) -> None:
        what = f"has no axis {axis}" if axis else "is no drive by CiA 402"
        failed = f"node {node_id} (0x{node_id:02X}) {what}: it has no statusword (0x{statusword:04X})"
        super().__init__(NODE_IS_NO_DRIVE, node_id, "", failed, tries=(f"canopen info {node_id}    what it is",))


class SdoError(NodeError):
    """An SDO transfer ended without success. abort_code: 32 bits, the node's or ours (0x05040000 for a timeout). bus: its name.
    For the other fields see Explained."""

    def __init__(
        self, code: str, aborted: SdoAborted, bus: str, failed: str, seen: str, cause: str, tries: Iterable[str]
    ) -> None:
        super().__init__(code, aborted.node_id, bus, failed, seen=seen, cause=cause, tries=tries)
        self.index = aborted.index
        self.subindex = aborted.subindex
        self.abort_code = aborted.abort_code


class SdoTimeoutError(SdoError, TimeoutError):
    """The node did not answer."""


class SdoRefusedError(SdoError):
    """The node answered with an abort."""


class SdoGivenUpError(SdoError):
    """We ended the transfer: the node was reset or lost during it, or its answer was not valid."""


class SdoContestedError(SdoGivenUpError):
    """Another SDO client uses the node's channel: what the node did, or answered, cannot be told apart from its requests."""


class SdoNotConfirmedError(SdoTimeoutError, SdoGivenUpError):
    """A whole write was sent, but neither confirmed nor refused: it may have been executed. The master never sends it again.

    An `except` for SdoTimeoutError or SdoGivenUpError catches it too; `code` says which of the two it was (CO201, CO203), or that
    another client disturbed it (CO206).
    """


class UnexpectedAnswerError(NodeError, ValueError):
    """A node sent an object whose length is not that of its type."""


class ChainFileError(MasterError, ValueError):
    """A chain file cannot be used. problems: every problem found, as (line, column, text); lines and columns count from 1.
    source: the name of the file."""

    def __init__(self, source: str, problems: Iterable[tuple[int, int, str]]) -> None:
        self.source = source
        self.problems = tuple(problems)
        first, *rest = [f"{source}:{line}:{column}: {text}" for line, column, text in self.problems]
        super().__init__(
            CHAIN_FILE,
            first,
            also=rest,
            tries=("a line is: CHAIN, then for each joint NAME BUS NODE-ID, as in: chain1 joint1 /dev/pcan32 12",),
        )


class UnknownChainError(MasterError, KeyError):
    """No chain, joint or bus has this name."""

    __str__ = MasterError.__str__  # KeyError would show the arguments


class SetPointRefusedError(MasterError, ValueError):
    """Set-points were refused. None of them is sent; the ones before stay. joint: the joint refused, "" for all. For the other
    fields see Explained."""

    def __init__(self, failed: str, joint: str, seen: str, tries: Iterable[str] = ()) -> None:
        super().__init__(BAD_SET_POINT, failed, seen=seen, tries=tries)
        self.joint = joint


def wrong_values(values: object, joints: int) -> str:
    """Return why values are not one number for each joint, as large as a float at most; "" if they are. Any sequence will do, and
    arrays of numpy."""
    is_unordered = isinstance(values, dict | set | frozenset)  # a dict would give its keys: {3: 10.0} moves the first joint to 3
    if isinstance(values, str | bytes) or is_unordered or not isinstance(values, Sized) or not isinstance(values, Iterable):
        return f"{values!r} is no list of numbers"
    if len(values) != joints:
        return f"{len(values)} for {counted(joints, 'joint')}"
    for each in values:
        if type(each) is not float and (isinstance(each, bool) or not isinstance(each, Real)):
            return f"{each!r} is no number"
        try:
            float(each)
        except OverflowError:
            size = f"whole number of {each.bit_length()} bits" if isinstance(each, int) else "number"
            return f"a {size} is beyond all positions"
    return ""


class PathRefusedError(SetPointRefusedError):
    """A path was refused as a whole: nothing of it is followed. joint: by its name, "" for all.

    time: of the path, in s. kind: "position", "speed", "acceleration" or "jerk". value: the path's; limit: the one it exceeds.
    None where there is no such number. For the other fields see Explained.
    """

    def __init__(
        self,
        failed: str,
        joint: str = "",
        *,
        time: float | None = None,
        kind: str = "",
        value: float | None = None,
        limit: float | None = None,
        seen: str = "",
        tries: Iterable[str] = (),
    ) -> None:
        super().__init__(failed, joint, seen, tries)
        self.time = time
        self.kind = kind
        self.value = value
        self.limit = limit


class PlanRefusedError(MasterError, ValueError):
    """A motion cannot be planned, or a target cannot be taken. joint: its number, counted from 0; None for all joints.

    value: the value that was asked for. limit: the limit that refuses it. None where there is no such number. For the other
    fields see Explained.
    """

    def __init__(
        self,
        failed: str,
        *,
        joint: int | None = None,
        value: float | None = None,
        limit: float | None = None,
        **words: Unpack[ErrorWords],
    ) -> None:
        super().__init__(PLAN_REFUSED, failed, **words)
        self.joint = joint
        self.value = value
        self.limit = limit

    def name_joint(self, names: Sequence[str]) -> None:
        """Name the joint in the text, in place of its number. names: of all joints, in their order."""
        self.failed, self.seen = with_names(self.failed, names), with_names(self.seen, names)


def with_names(text: str, joints: Sequence[str]) -> str:
    """Return what the core says of paths and their joints ("joint 0", "Joint 1") with the names of the joints. text: what it
    says. joints: their names, in order."""
    return _JOINT.sub(lambda found: joints[int(found[1])] if int(found[1]) < len(joints) else found[0], text)


_JOINT = re.compile(r"\b[Jj]oint ([0-9]+)\b")


class PackageMissingError(MasterError, ImportError):
    """A Python package that only this task needs is not installed. package: its name. extra: ours that brings it. task: what
    needs it, for the text. error: of the import."""

    def __init__(self, package: str, extra: str, task: str, error: ImportError) -> None:
        super().__init__(
            PACKAGE_MISSING,
            f"{task} needs the package {package}, which cannot be imported",
            seen=str(error),
            cause="it is not installed here",
            tries=(f"pip install 'canopen-proto[{extra}]'",),
        )
        self.package = package


class ChainError(MasterError):
    """A chain could not carry out a command. chain: its name. joint: the joint that failed, "" for all. For the other fields see
    Explained."""

    def __init__(self, code: str, chain: str, failed: str, *, joint: str = "", **words: Unpack[ErrorWords]) -> None:
        super().__init__(code, failed, **words)
        self.chain = chain
        self.joint = joint


class ChainHaltedError(ChainError):
    """The chain was halted (by `halt`, or because no set-points came), and follows no set-points until it is started again."""


class MotionReplacedError(ChainError):
    """The motion did not come to its end: another one took over from where it was."""


class ChainFaultError(ChainError):
    """A joint failed, and with it its whole chain was stopped.

    node_id, bus: of the joint. state, statusword: of its drive at that time. error_code: 0x603F; 0 if it is not known. emcy: the
    last emergency of the node, or None. reason: one line.
    """

    def __init__(
        self,
        chain: str,
        joint: str,
        node_id: int,
        bus: str,
        reason: str,
        *,
        state: State,
        statusword: int,
        error_code: int,
        emcy: EmcyReceived | None,
        **words: Unpack[ErrorWords],
    ) -> None:
        failed = f"chain {chain} was stopped: {joint} (node {node_id} on {bus}) {reason}"
        super().__init__(CHAIN_FAULT, chain, failed, joint=joint, **words)
        self.node_id = node_id
        self.bus = bus
        self.reason = reason
        self.state = state
        self.statusword = statusword
        self.error_code = error_code
        self.emcy = emcy


def sdo_error(
    network: Network, node: RemoteNode, bus: str, aborted: SdoAborted, attempt: str, now: Time, *, size_unknown: bool = False
) -> SdoError:
    """Return the exception for a transfer that ended with an abort. bus: its name.

    network: of the node. attempt: "reading", or "writing 5 to".
    size_unknown: it was a download whose size the server was not told.
    """
    place = f"{attempt} {_name_of(node, aborted.index, aborted.subindex)}"
    who = f"node {aborted.node_id}"
    code_text = f"abort 0x{aborted.abort_code:08X}, {text_of(aborted.abort_code)}"
    hint = NOT_CONFIRMED if aborted.not_confirmed else ""
    if aborted.origin is AbortOrigin.TIMEOUT and aborted.abort_code != AbortCode.CANNOT_TRANSFER:
        failed = f"{who} did not answer {place} in {(aborted.waited or node.sdo.timeout) / SECOND:g} s{hint}"
        seen, cause, tries = sdo_silence(network, node, now)
        silent = SdoNotConfirmedError if aborted.not_confirmed else SdoTimeoutError
        return silent(NO_ANSWER, aborted, bus, failed, seen, cause, tries)
    if aborted.origin is AbortOrigin.PEER and not aborted.not_confirmed:
        cause, tries = _REASONS.get(aborted.abort_code, ("", ()))
        if size_unknown and aborted.abort_code in _OF_SIZE:
            cause, tries = "the device wants to know the size before the first byte", ("size=... , in bytes",)
        elif aborted.abort_code in _OF_LENGTH:
            tries = (f"check the object in {node.dictionary.source or 'the dictionary'}",)
        if node.dictionary.get(aborted.index, aborted.subindex) is None:
            cause = cause.partition(", though our dictionary")[0]
        return SdoRefusedError(REFUSED, aborted, bus, f"{who} refused {place}", code_text, cause, tries)
    if aborted.origin is AbortOrigin.CONTESTED:
        contested = SdoNotConfirmedError if aborted.not_confirmed else SdoContestedError
        seen = f"another SDO client {aborted.others_doing}"
        return contested(CONTESTED, aborted, bus, f"{place} of {who} was disturbed{hint}", seen, _CONTESTED[0], _CONTESTED[1:])
    given_up = SdoNotConfirmedError if aborted.not_confirmed else SdoGivenUpError
    if aborted.origin is AbortOrigin.CANCELLED:
        return given_up(GIVEN_UP, aborted, bus, f"{place} of {who} was given up{hint}", "", _TAKEN_BACK, ())
    is_peers = aborted.origin is AbortOrigin.PEER
    cause = "its answer to the last frame was lost" if is_peers else _OWN_REASONS.get(aborted.abort_code, "")
    twins, tries = two_devices(network, node.node_id, now), ()
    if twins:
        cause, tries = twins, ("take one of the two off the bus", SCAN)
    return given_up(GIVEN_UP, aborted, bus, f"{place} of {who} was given up{hint}", code_text, cause, tries)


_CONTESTED: Final = (
    "two programs use one SDO channel of the node, against CiA 301: a service tool, a second master, another command",
    "end the other program, or wait until it is done",
    "if there is none: does the adapter hand our own frames back (receive_own_messages)?",
)
"""The cause, and what to try."""


_TAKEN_BACK: Final = "a stop of its drive went before it; or this program has taken it back itself"
"""The cause where our own side has cancelled a request that somebody waits for."""

_OWN_REASONS: Final[dict[int, str]] = {
    AbortCode.NO_SDO_CONNECTION: "it was reset, or its heartbeat was lost",
    AbortCode.CANNOT_TRANSFER: "our own side was too slow: the next piece of the stream did not come, or was not taken, in time",
}
"""Why we end transfers."""


_REASONS: Final[dict[int, tuple[str, tuple[str, ...]]]] = {
    AbortCode.NO_SUCH_OBJECT: ("the device does not have this object, though our dictionary lists it", ("check its manual",)),
    AbortCode.NO_SUCH_SUBINDEX: ("the device does not have this subindex, though our dictionary lists it", ("check its manual",)),
    AbortCode.READ_ONLY: ("the device permits only reading here", ()),
    AbortCode.WRITE_ONLY: ("the device permits only writing here", ()),
    AbortCode.TOGGLE_NOT_ALTERNATED: ("perhaps two masters talk to this node", ("end the other one",)),
    AbortCode.DEVICE_STATE: (
        "the device does not permit it in its present state",
        ("look at its NMT state and, for a drive, at its statusword",),
    ),
    AbortCode.LENGTH_MISMATCH: ("the object has another length than our dictionary says", ()),
    AbortCode.LENGTH_TOO_HIGH: ("the object is shorter than our dictionary says", ()),
    AbortCode.LENGTH_TOO_LOW: ("the object is longer than our dictionary says", ()),
}
"""What CiA 301's abort codes mean in practice, where that says more than their text."""

_OF_LENGTH: Final = (AbortCode.LENGTH_MISMATCH, AbortCode.LENGTH_TOO_HIGH, AbortCode.LENGTH_TOO_LOW)
_OF_SIZE: Final = (*_OF_LENGTH, AbortCode.OUT_OF_MEMORY, AbortCode.INVALID_COMMAND)
"""What devices say that need the size first."""


def _name_of(node: RemoteNode, index: int, subindex: int) -> str:
    variable = node.dictionary.get(index, subindex)
    return f"{index:04X}:{subindex:02X}" + (f" ({variable.name})" if variable is not None else "")


def forked() -> LocalProtocolError:
    """Return the error for the use of a master in a child process."""
    return LocalProtocolError(
        "this master belongs to the process that this one was forked from, and so do its thread and its bus; "
        "open a master of its own here, or start processes by the method `spawn`"
    )
