"""`LayerSettings`: layer setting services (CiA 305) for the clients of a gateway: one tool for each net, one service at a time.

It knows whether a device is selected, as far as this gateway did it: without that, a question to "the selected device" is refused
before anything is sent. Searches are the procedures of the core, which doubt late and lost answers.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

import trio

from canopen_gateway.guard import Guard, Permission
from canopen_master import Master
from canopen_proto.lss import (
    LssAddress,
    LssAssignment,
    LssError,
    LssMaster,
    LssReply,
    LssService,
    LssState,
    LssTool,
    assign_all,
    fastscan,
    in_order,
)
from canopen_proto.lss.messages import number_of
from canopen_proto.lss.scan import Known, Pace, all_waiting, ask, identity_of_selected, matches, require_alone, search
from canopen_proto.machine import MILLISECOND, RequestId, Time
from canopen_proto.procedures.steps import Cancelled, Procedure, act


class LayerSettings:
    """See this module's text. is_selected: a device was selected here, and not released since."""

    def __init__(self, master: Master, guard: Guard, net: str) -> None:
        """net: the name of the bus."""
        self.is_selected = False
        self._master = master
        self._guard = guard
        self._bus = master.bus(net)
        self._tool: LssTool | None = None
        self._turn = trio.Lock()

    def require_allowed(self, what: str) -> None:
        """Raise NotAllowedError unless these services are allowed. what: the one that is meant."""
        self._guard.require(Permission.LSS, what)

    async def switch_global(self, state: LssState) -> None:
        """Send all slaves into a state; nobody answers. Raises NotAllowedError, as all commands here; LssError, with nothing
        sent, for "configuration" while another LSS master is at work: what it writes would go to all devices."""
        async with self._in_turn("switch state global") as tool:
            is_safe = state is LssState.WAITING
            await self._master.run(_tell(tool, lambda now: tool.master.switch_global(state, now), alone=not is_safe))
            self.is_selected = state is LssState.CONFIGURATION

    async def select(self, address: LssAddress) -> bool:
        """Select the device with an address, and no other; return whether it has answered."""
        async with self._in_turn("switch state selective") as tool:
            self.is_selected = False
            self.is_selected = await self._master.run(_selected(tool, address))
            return self.is_selected

    async def command(self, what: str, give: Callable[[LssMaster, Time], RequestId]) -> LssReply:
        """Give a command of the LSS master, and return its answers. what: its name, for a refusal. give: gives it, at a time."""
        async with self._in_turn(what) as tool:
            return await self._master.run(ask(tool, lambda now: give(tool.master, now)))

    async def inquire(self, service: LssService) -> int | None:
        """Ask the selected device for a number of its identity, or its node-ID; None without an answer. service: an inquiry."""
        reply = await self.command(service.name.lower(), lambda lss, now: lss.inquire(service, now))
        if not reply.answers:
            return None
        answer = reply.answers[0]
        return answer[1] if service is LssService.INQUIRE_NODE_ID else number_of(answer)

    async def activate_bit_timing(self, delay: Time) -> None:
        """Let the selected devices switch their bit rate. delay: ns, whole ms. Our own interface stays as it is. Raises LssError,
        with nothing sent, while another LSS master is at work: it may have selected others."""
        async with self._in_turn("activate bit timing") as tool:
            await self._master.run(_tell(tool, lambda now: tool.master.activate_bit_timing(delay, now)))

    async def fastscan(self, known: Known, window: Time) -> LssAddress | None:
        """Find and select the device without a node-ID that has the lowest address; None if there is none. known: numbers of its
        address. window: ns for silence. Raises LssError."""
        async with self._in_turn("fastscan") as tool:
            self.is_selected = False
            address: LssAddress | None = await self._master.run(_selected_by_fastscan(tool, Pace(window=window), known))
            self.is_selected = address is not None
            return address

    async def slowscan(
        self, vendor_id: int, product_code: int, revisions: tuple[int, int], serials: tuple[int, int]
    ) -> list[LssAddress]:
        """Find all devices of a type, with and without a node-ID. revisions, serials: least and greatest. Raises LssError."""
        async with self._in_turn("slowscan") as tool:
            return await self._master.run(search(tool, Pace(), vendor_id, product_code, revisions, serials))

    async def assign_all(self, first: int, store: bool, known: Known, window: Time) -> LssAssignment:
        """Give all devices without a node-ID theirs, from `first` on; return what became of each, as canopen_proto/lss/assign.py
        has it. store: they keep it without power. known: numbers that their addresses have. window: ns. Raises LssError."""
        async with self._in_turn("the assignment of node-IDs") as tool:
            self.is_selected = False
            wanted = in_order(range(first, 128))
            assignment = LssAssignment(tool, wanted, Pace(window=window), known, store)
            return await self._master.run(assign_all(assignment))

    @asynccontextmanager
    async def _in_turn(self, what: str) -> AsyncIterator[LssTool]:
        self.require_allowed(what)
        async with self._turn:
            if self._tool is None:
                self._tool = LssTool(self._bus.network.out)
                self._bus.network.attach(self._tool)
                self._bus.renew_filters()
            yield self._tool


def _tell(tool: LssTool, give: Callable[[Time], object], *, alone: bool = True) -> Procedure[None]:
    """Give a command that no device answers. Raises LssError, with nothing sent, if another LSS master is heard. alone: False:
    give it all the same. give: gives it, at a time."""
    if alone:
        yield from require_alone(tool)
    yield from act(give)


def _selected(tool: LssTool, address: LssAddress) -> Procedure[bool]:
    """Select a device, and return whether it has answered. Those selected before would take what is meant for it; and one whose
    answer was lost does not answer once more, unless it is sent to "waiting"."""
    yield from all_waiting(tool)
    reply = yield from ask(tool, lambda now: tool.master.select(address, now))
    return reply.count > 0


def _selected_by_fastscan(tool: LssTool, pace: Pace, known: Known) -> Procedure[LssAddress | None]:
    """Find a device, and select it. If none was found for sure, or this is cancelled, nobody stays selected."""
    try:
        yield from all_waiting(tool)
        address = yield from fastscan(tool, pace, known)
        if address is not None and matches((yield from identity_of_selected(tool, pace)), [address]):
            return address
    except (Cancelled, LssError):
        yield from all_waiting(tool)
        raise
    yield from all_waiting(tool)
    return None


def window_of(milliseconds: int) -> Time:
    """Return the window for silence that a client asked for, in ns; 0 ms: the usual one, 100 ms."""
    return (milliseconds or 100) * MILLISECOND
