"""Change the bit rate of all devices of a bus by LSS (CiA 305), so that none is left behind.

The order, and the way back from each step:

    prepare    0x13 to each device, one at a time          one refuses, or is silent: the old bit rate again for those before it
    activate   0x15 to all at once: they fall silent, switch, and are silent as long again. Our own interface has to be switched
               in between, by the caller
    missing    look for each device at the new bit rate    one is not there: look for it at the old one; `prepare` and `activate`
                                                           the others back
    store      0x17, only now                              until then, power off and on brings the old bit rate back

A change that ends before "store" takes the new bit rate back from all devices (`take_back`). Else it would stay pending: a later
"store", of a node-ID, would keep it, and the device would switch at its next power-on.

`activate` reaches all devices of the bus, so `prepare` must have had all of them, also those without a node-ID: a device that was
not prepared stays where it is, and disturbs the bus with every frame that it sends or misunderstands.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final

from canopen_proto.lss.assign import LssNotSelectedError, select_only
from canopen_proto.lss.messages import BIT_RATES, OK, LssAddress, LssService, LssState, error_text
from canopen_proto.lss.scan import TRIES, LssError, LssTool, Pace, all_waiting, ask, released, require_alone
from canopen_proto.machine import MILLISECOND, SECOND, LocalProtocolError, Time
from canopen_proto.procedures.steps import Cancelled, Procedure, act, ask_for_time, sleep

DELAY: Final = 1000 * MILLISECOND
"""The switch delay: longer than the slowest device needs for its controller, and than an interface on USB needs."""


@dataclass(frozen=True)
class Refusal:
    """A device that did not do its part. remark: what it said, for people. is_silent: it was told to, and said nothing: it may
    have done it."""

    address: LssAddress
    remark: str
    is_silent: bool = False


def index_of(bit_rate: int) -> int:
    """Return the index of a bit rate (kbit/s) in CiA's table. Raises LocalProtocolError if it is not in it."""
    for index, rate in BIT_RATES.items():
        if rate == bit_rate:
            return index
    raise LocalProtocolError(f"{bit_rate} kbit/s is not in CiA's table: {', '.join(map(str, BIT_RATES.values()))}")


def prepare(tool: LssTool, pace: Pace, addresses: Sequence[LssAddress], bit_rate: int, present: int) -> Procedure[list[Refusal]]:
    """Set the pending bit rate of all devices, kbit/s; return those that refused, or do not answer. pace: how long questions
    wait. addresses: all devices on the bus.

    With the first refusal the others get the present one back. Nothing is switched, and nothing stored. So too when cancelled,
    and when another LSS master is heard (LssError), by `take_back`. Nothing at all is sent if it was heard before.
    """
    index, old = index_of(bit_rate), index_of(present)
    yield from require_alone(tool)  # else `take_back` would put the devices that the other has selected beside all others
    prepared: list[LssAddress] = []
    try:
        for address in addresses:
            refusal = yield from _set(tool, pace, address, index)
            prepared.append(address)  # one that did not answer may have it all the same
            if refusal is not None:
                return [refusal, *(yield from _put_back(tool, pace, prepared, old))]
    except (Cancelled, LssError):
        yield from ask_for_time(TRIES * pace.window + SECOND)
        yield from take_back(tool, pace, present)
        raise
    return []


def take_back(tool: LssTool, pace: Pace, present: int) -> Procedure[None]:
    """Make the bit rate that all devices have the pending one, too, of all at once: nothing is left that a later store would
    keep. Whether each does so is not asked. pace: how long the answers are awaited. present: kbit/s."""
    index = index_of(present)
    for _ in range(TRIES):
        yield from act(lambda now: tool.master.switch_global(LssState.CONFIGURATION, now))
        yield from ask(tool, lambda now: tool.master.configure_bit_timing(index, now, window=pace.window), alone=False)
    yield from all_waiting(tool)


def _put_back(tool: LssTool, pace: Pace, addresses: Iterable[LssAddress], index: int) -> Procedure[list[Refusal]]:
    failed = []
    for address in addresses:
        refusal = yield from _set(tool, pace, address, index)
        if refusal is not None:
            failed.append(replace(refusal, remark=f"the old bit rate may not be set again: {refusal.remark}"))
    return failed


def _set(tool: LssTool, pace: Pace, address: LssAddress, index: int) -> Procedure[Refusal | None]:
    """Set the pending bit rate of one device; return None if it has confirmed it, else why not."""
    return (yield from _on_selected(tool, pace, address, LssService.CONFIGURE_BIT_TIMING, index))


def store_all(tool: LssTool, pace: Pace, addresses: Iterable[LssAddress]) -> Procedure[list[Refusal]]:
    """Let the devices store node-ID and bit rate; return those that did not. pace: how long questions wait. addresses: of the
    devices."""
    failed = []
    for address in addresses:
        refusal = yield from _on_selected(tool, pace, address, LssService.STORE, 0)
        if refusal is not None:
            failed.append(refusal)
    return failed


def _on_selected(tool: LssTool, pace: Pace, address: LssAddress, service: LssService, index: int) -> Procedure[Refusal | None]:
    return (yield from released(tool, _while_selected(tool, pace, address, service, index)))


def _while_selected(tool: LssTool, pace: Pace, address: LssAddress, service: LssService, index: int) -> Procedure[Refusal | None]:
    try:
        yield from select_only(tool, pace, address)
    except LssNotSelectedError as failed:
        return Refusal(address, str(failed))
    for _ in range(TRIES):
        if service is LssService.STORE:
            reply = yield from ask(tool, lambda now: tool.master.store(now, guard=pace.after_answer))
        else:
            reply = yield from ask(tool, lambda now: tool.master.configure_bit_timing(index, now, window=pace.window))
        if reply.count:
            errors = {error_text(service, answer[1], answer[2]) for answer in reply.answers if answer[1] != OK}
            return Refusal(address, f"the device says: {', '.join(sorted(errors))}") if errors else None
    return Refusal(address, "it does not answer: not supported by this device?", is_silent=True)


def activate(tool: LssTool, delay: Time = DELAY) -> Procedure[None]:
    """Let all devices switch. Returns when the first delay (ns, whole ms) is over: the caller switches its interface at once.

    Meanwhile nothing may be sent: no SYNC, no heartbeat. Then wait for the same time again before anything is sent.
    Raises LssError, with nothing sent, if another LSS master is at work: then call `take_back`.
    """
    yield from require_alone(tool)
    for _ in range(2):
        yield from act(lambda now: tool.master.switch_global(LssState.CONFIGURATION, now))
    yield from act(lambda now: tool.master.activate_bit_timing(delay, now))
    yield from sleep(delay)


def missing(tool: LssTool, pace: Pace, addresses: Iterable[LssAddress]) -> Procedure[list[LssAddress]]:
    """Return which devices do not answer when they are selected. pace: how long questions wait. addresses: of the devices.
    However it ends, all slaves are in "waiting"."""
    return (yield from released(tool, _missing(tool, pace, addresses)))


def _missing(tool: LssTool, pace: Pace, addresses: Iterable[LssAddress]) -> Procedure[list[LssAddress]]:
    absent = []
    for address in addresses:
        try:
            yield from select_only(tool, pace, address)
        except LssNotSelectedError:
            absent.append(address)
    return absent
