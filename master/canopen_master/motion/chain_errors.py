"""The errors of a chain: a joint that failed, a chain that was halted, a reference that is lost. chain: its name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from canopen_master.errors import (
    CHAIN_FAILED,
    CHAIN_HALTED,
    CHAIN_NOT_READY,
    GIVEN_UP,
    NO_ANSWER,
    REFUSED,
    ChainError,
    ChainFaultError,
    ChainHaltedError,
)
from canopen_master.motion.device import Device
from canopen_master.motion.joint_procedures import JointError
from canopen_master.silence import sdo_silence
from canopen_proto.abort import AbortOrigin
from canopen_proto.drives.axis import DriveError, DriveInFaultError, ReferenceLostError
from canopen_proto.drives.axis.reasons import Reason, outer_reason
from canopen_proto.drives.axis.view import view_of
from canopen_proto.drives.axis.watchdog import NotHeldError
from canopen_proto.machine import SECOND, Time
from canopen_proto.procedures.steps import SdoTransferError

FIND: Final = "find the cause"
"""The step before a recovery."""
MONITORING: Final = 0x8000
"""Error codes from here on (CiA 301, table 26) may come of what a master does: communication, following errors, a maker's."""


def joint_failed(chain: str, operation: str, failed: JointError) -> ChainError:
    """The error for a joint whose procedure failed in `operation`. chain: its name."""
    device, error = failed.device, failed.error
    if isinstance(error, DriveInFaultError):
        return joint_fault(chain, device, "is in fault", Reason(error.reason, FIND) if error.reason else None)
    if isinstance(error, ReferenceLostError):
        return reference_lost(chain, operation, [device])
    code, what, seen, cause = CHAIN_FAILED, str(error), "", ""
    tries: tuple[str, ...] = ()
    if isinstance(error, DriveError):
        what, cause, tries = error.failed, error.reason, (error.remedy,) if error.remedy else ()
        seen = device.describe()
    if isinstance(error, SdoTransferError) and error.origin is AbortOrigin.TIMEOUT:
        code = NO_ANSWER
        seen, cause, tries = sdo_silence(device.node.network, device.node.remote, device.node.now())
    elif isinstance(error, SdoTransferError):
        code = REFUSED if error.origin is AbortOrigin.PEER else GIVEN_UP
    elif isinstance(error, NotHeldError):
        cause = "Watchdog.required says that no such drive is enabled"
        tries = ("open_master(..., watchdog=Watchdog()) enables it all the same, and names it",)
    failure = f"chain {chain} could not {operation}: {device.where}: {what}"
    return ChainError(code, chain, failure, joint=device.name, seen=seen, cause=cause, tries=tries)


def raise_first(chain: str, operation: str, failures: Sequence[JointError | None]) -> None:
    """Raise the error of the first joint that failed, if one did; the others are its notes. chain: its name. operation: "home",
    for the text. failures: one for each joint, None for one that did not fail."""
    errors = [joint_failed(chain, operation, failed) for failed in failures if failed is not None]
    if errors:
        for other in errors[1:]:
            errors[0].add_note(str(other))
        raise errors[0]


def not_now(chain: str, what: str, seen: str, step: str) -> ChainError:
    """The error for a command that the chain cannot take in its present state. step: the next one. what: the command. seen: the
    state."""
    return ChainError(CHAIN_NOT_READY, chain, f"chain {chain} cannot {what} now", seen=seen, tries=(step,))


def other_cycle(chain: str, cycle_time: float, period: Time, others: Sequence[str]) -> ChainError:
    """Return the error for a chain whose cycle is not that of the others: SYNC is one for all. period: of SYNC, in ns.
    cycle_time: the chain's, s."""
    failed = f"chain {chain} cannot run with a cycle of {cycle_time:g} s"
    seen = f"SYNC runs with {period / SECOND:g} s for {', '.join(others)}"
    return ChainError(CHAIN_NOT_READY, chain, failed, seen=seen, tries=("one cycle_time for all chains",))


def reference_lost(chain: str, operation: str, devices: Sequence[Device]) -> ChainError:
    """The error for joints that were homed, but whose positions mean something else now."""
    where = ", ".join(device.where for device in devices)
    lost = "has lost its reference" if len(devices) == 1 else "have lost their references"
    return ChainError(
        CHAIN_NOT_READY,
        chain,
        f"chain {chain} could not {operation}: {where} {lost}",
        joint=devices[0].name,
        seen="homed, and then reset or without power, or homed without success: positions mean something else now",
        tries=(
            "await chain.home(if_needed=True), then await chain.follow()",
            "AxisSettings(keeps_reference=True) for an absolute encoder",
        ),
    )


def chain_halted(chain: str, why: str) -> ChainHaltedError:
    """The error for a chain that was halted. why: such as "by halt()"."""
    return ChainHaltedError(
        CHAIN_HALTED,
        chain,
        f"chain {chain} was halted {why}",
        tries=("await chain.follow() starts where the joints stand",),
    )


def joint_fault(chain: str, device: Device, reason: str, cause: Reason | None = None) -> ChainFaultError:
    """The error for a joint that is in fault, was lost, or did not follow. reason: what it did. cause: the likely one."""
    view = device.last_look or view_of(device.axis)
    # It took positions until then, so it is no drive that takes none before it is homed
    found = outer_reason(replace(view, is_homed=None))
    if cause is not None and device.has_fault and found is not None and 0 < device.error_code < MONITORING:
        found = Reason(f"{found.what}; beside it, {cause.what}", found.remedy)  # the drive itself says what failed
    elif cause is not None:
        found = cause
    step = FIND if found is None or device.has_fault else found.remedy
    home_again = ", chain.home(if_needed=True) and chain.follow()" if device.axis.has_lost_reference else ""
    return ChainFaultError(
        chain,
        device.name,
        device.node.node_id,
        device.node.bus,
        reason,
        state=device.state,
        statusword=device.statusword,
        error_code=device.error_code,
        emcy=device.emcy,
        seen=device.describe(),
        cause="" if found is None else found.what,
        tries=(f"{step}, then await chain.recover(){home_again}",),
    )
