"""`Lease`: who moves the machine. One client at a time, for LEASE_TIME after each sign of life, and by intents only.

A client takes the lease, and says what it wants: give the joints of a chain power, jog, move to a target, take the power away.
The set-points of each cycle are made here, in the process that owns the bus; no network lies between them and the drives.

    lease.take(session)
    lease.enable(session, "arm")                            in the background; `renew` goes on meanwhile
    lease.jog(session, 1, "arm", [0.1, 0.0])                again and again: this is the dead man's switch
    lease.move(session, 2, "arm", [0.5, 0.0])
    lease.leave(session)

**It ends by itself.** If no sign of life of its owner arrives for LEASE_TIME by our clock, if the owner's connection ends, or if
the gateway ends, the motion brakes, and the chain is halted. A jog has a second switch: the chain itself brakes if its velocities
are not renewed for that time (`Moving.jog`). Each sign of life has a number that is greater than all before: a message that was
delayed, or sent again after a new connection, moves nothing.

**Anybody may halt**, with or without the lease, in a read-only gateway too. A halt ends the lease by which the machine was moved,
and the chains stay halted until somebody gives them power anew: whoever goes on sending moves nothing.

It is no safety function: a computer, its network and this program may all fail. Keep the emergency stop wired.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Awaitable, Callable, Sequence
from typing import Final, Protocol

import trio

from canopen_gateway.errors import LeaseError
from canopen_gateway.guard import Guard, Permission
from canopen_master import Chain, ChainState, Jog, Master, MasterError, Node
from canopen_proto.drives import halt
from canopen_proto.machine import LocalProtocolError
from canopen_proto.procedures import ProcedureError

LEASE_TIME: Final = 0.3
"""Seconds from one sign of life of the owner to the next: a page that sends one each 100 ms may lose two of them."""
HALT_TIME: Final = 5.0
"""Seconds that a halt may take before it counts as not confirmed."""
THE_TIME: Final = "the lease is over"
BY_HAND: Final = "somebody has halted the machine"
LOGGER: Final = logging.getLogger("canopen_gateway")


class LeaseHolder(Protocol):
    """A client that may have the lease. name: for people."""

    name: str


class Lease:
    """See this module's text. owner: the client that moves the machine, or None. problem: why the last motion ended early, or a
    halt was not confirmed; "" if all went well. doing: what the owner is moved by at present: "", "enable", "jog", "move",
    "disable"."""

    def __init__(self, master: Master, guard: Guard) -> None:
        self.owner: LeaseHolder | None = None
        self.problem = ""
        self.doing = ""
        self._master = master
        self._guard = guard
        self._nursery: trio.Nursery | None = None
        self._deadline = 0.0
        self._last = -1
        self._chains: set[str] = set()  # those that the owner has commanded
        self._scope: trio.CancelScope | None = None  # of the motion under way
        self._waiting = trio.CancelScope()
        self._jogged = ""
        self._jog: Jog | None = None
        self._wanted: list[float] = []
        self._commanded: set[Node] = set()  # by single writes
        self._halted_by_hand: set[str] = set()  # chains that somebody has halted, and nobody has enabled since
        self._over = THE_TIME

    # ---- whose it is ----

    @property
    def left(self) -> float:
        """Seconds until it is over; 0 if nobody has it."""
        return 0.0 if self.owner is None else max(0.0, self._deadline - trio.current_time())

    def take(self, session: LeaseHolder) -> None:
        """Be the one who moves the machine, for LEASE_TIME. Does nothing if this client is. Raises NotAllowedError; LeaseError if
        another one has it, or while what was left is being halted."""
        self._guard.require(Permission.MOTION, "moving the machine")
        self.require_free(session, "taking the lease")
        if self.owner is session and self.left == 0.0:
            raise LeaseError("the lease is over, and what it moved is being halted", tries=("again, in a moment",))
        if self.owner is None:
            if self._nursery is None:
                raise LeaseError("the machine cannot be moved", seen="the gateway does not run, or is ending")
            self.owner, self._last, self.problem, self._over = session, -1, "", THE_TIME
            self._deadline = trio.current_time() + LEASE_TIME
            self._nursery.start_soon(self._watch, session)

    def renew(self, session: LeaseHolder, sequence: int) -> None:
        """Show that the owner lives. sequence: greater than that of each message before. Raises LeaseError."""
        self._require_owner(session)
        if sequence <= self._last:
            raise LeaseError("an old message was refused", seen=f"its number is {sequence}; {self._last} came before it")
        self._last = sequence
        self._deadline = trio.current_time() + LEASE_TIME

    def leave(self, session: LeaseHolder) -> None:
        """Give the lease back: what moves is halted. Does nothing if this client does not have it."""
        if self.owner is session:
            self._deadline = -math.inf  # `_watch` looks again when its wait is cancelled
            self._waiting.cancel()

    def require_free(self, session: LeaseHolder | None, what: str) -> None:
        """Raise LeaseError if another client than this one moves the machine. what: was to be done."""
        if self.owner is not None and self.owner is not session:
            raise LeaseError(
                f"{what} was refused: {self.owner.name} moves this machine",
                seen=f"its lease ends in {self.left:.2f} s, unless it renews it",
                tries=("halt is open to everybody",),
            )

    def note_command(self, node: Node) -> None:
        """Remember a node to which a client has written something that moves: `halt` stops it, too."""
        self._commanded.add(node)

    # ---- intents ----

    def enable(self, session: LeaseHolder, sequence: int, chain: str) -> None:
        """Give the joints of a chain power, and let them follow; in the background. Raises LeaseError, UnknownChainError."""
        arm = self._begin(session, sequence, chain, "enable")
        self._halted_by_hand.discard(chain)
        self._run("enable", lambda: _enabled(arm))

    def disable(self, session: LeaseHolder, sequence: int, chain: str) -> None:
        """Halt the joints of a chain and take their power away; in the background. Raises as `enable`."""
        arm = self._begin(session, sequence, chain, "disable")
        self._run("disable", arm.shut_down)

    def move(self, session: LeaseHolder, sequence: int, chain: str, targets: Sequence[float], *, speed: float = 1.0) -> None:
        """Move a chain to a target; in the background, for as long as the lease is renewed. targets: one for each joint, in its
        unit. speed: the share of each limit that is used. Raises as `enable`."""
        arm = self._begin(session, sequence, chain, "move")
        self._require_power(chain)
        self._run("move", lambda: arm.move(targets, speed=speed))

    def jog(self, session: LeaseHolder, sequence: int, chain: str, velocities: Sequence[float]) -> None:
        """Move the joints of a chain at these velocities, in their units per second, until the next message, or the end of the
        lease. All zeros: the joints brake, and the jog goes on. Raises as `enable`; LeaseError if it cannot move like that."""
        if self.doing != "jog" or self._jogged != chain:
            arm = self._begin(session, sequence, chain, "jog")
            self._require_power(chain)
            self._jogged, self._wanted = chain, list(velocities)
            self._run("jog", lambda: self._jogging(arm))
            return
        self.renew(session, sequence)
        self._require_power(chain)
        self._wanted = list(velocities)
        if self._jog is not None:
            try:
                self._jog.velocity(self._wanted)
            except MasterError as error:
                raise LeaseError(f"chain {chain} does not jog", seen=_first_line(error)) from error

    def stop(self, session: LeaseHolder, sequence: int) -> None:
        """End the motion under way: the joints brake, and stay enabled. Raises LeaseError."""
        self.renew(session, sequence)
        self.stop_motion()

    # ---- halt ----

    async def halt(self, net: str | None = None, node_id: int = 0) -> list[str]:
        """Stop everything that this gateway's master moves; or what is on a net, or on a node of it. Everybody may.

        Returns what did not confirm that it stands, one line each. Sends the halts of all chains and drives at once, and waits
        HALT_TIME at most. What was halted stays so: the lease of whoever has moved one of these chains ends, and none of them
        moves before it was given power anew (`enable`), whoever goes on sending.
        """
        self.stop_motion()
        chains = [
            chain for chain in self._master.chains.values() if any(_is_at(each.node, net, node_id) for each in chain.devices)
        ]
        names = {chain.name for chain in chains}
        self._halted_by_hand |= names
        if self.owner is not None and names & self._chains:
            self._over = BY_HAND
            self.leave(self.owner)
        problems: list[str] = []
        with trio.CancelScope(shield=True):  # the client that asked may be gone: the halt still counts
            async with trio.open_nursery() as nursery:
                for chain in chains:
                    if chain.state is not ChainState.OFF:
                        nursery.start_soon(self._halted, chain.name, chain.halt, problems)
                for node in self._nodes(net, node_id):
                    for axis in node.axes_enabled or ((0,) if node_id else ()):
                        nursery.start_soon(self._halted, node.where, self._halt_of(node, axis), problems)
        return problems

    def stop_motion(self) -> None:
        """Cancel the motion of the lease: the joints brake. Does nothing if there is none."""
        if self._scope is not None:
            self._scope.cancel()

    # ---- for the service ----

    def begin(self, nursery: trio.Nursery) -> None:
        """Let the lease be taken. nursery: for what moves."""
        self._nursery = nursery

    async def end(self) -> None:
        """Take no new owner; halt what the present one moves."""
        self._nursery = None
        if self.owner is not None:
            await self._release("the gateway ends")

    def _begin(self, session: LeaseHolder, sequence: int, name: str, what: str) -> Chain:
        self.renew(session, sequence)
        chain = self._chain(name)
        if self.doing:
            raise LeaseError(f"chain {name} cannot {what} now", seen=f"it is under way: {self.doing}", tries=("halt it first",))
        self._chains.add(name)
        return chain

    def _require_power(self, chain: str) -> None:
        """Raise LeaseError for a chain that somebody has halted, until it is given power anew."""
        if chain in self._halted_by_hand:
            raise LeaseError(f"chain {chain} was halted", seen="somebody has halted it", tries=("enable it",))

    def _chain(self, name: str) -> Chain:
        chain = self._master.chains.get(name)
        if chain is None:
            known = ", ".join(self._master.chains) or "none: a machine file has them"
            raise LeaseError(f"this machine has no chain {name!r}", seen=f"its chains are {known}")
        return chain

    def _require_owner(self, session: LeaseHolder) -> None:
        if self.owner is not session or trio.current_time() >= self._deadline:
            raise LeaseError("this client does not have the lease, or not any more", tries=("take it first",))

    def _run(self, doing: str, motion: Callable[[], Awaitable[object]]) -> None:
        if self._nursery is None:
            raise LeaseError("the machine cannot be moved", seen="the gateway is ending")
        self.doing, self.problem = doing, ""
        self._scope = trio.CancelScope()
        self._nursery.start_soon(self._carry_out, self._scope, motion)

    async def _carry_out(self, scope: trio.CancelScope, motion: Callable[[], Awaitable[object]]) -> None:
        """Run a motion. Whatever becomes of it, the gateway and its master go on."""
        try:
            with scope:
                await motion()
        except Exception as error:  # noqa: BLE001 - whatever it is, it is told, and ends this motion alone
            self.problem = _first_line(error)
            LOGGER.warning("%s ended: %s", self.doing, self.problem)
        finally:
            if self._scope is scope:
                self._scope, self.doing = None, ""

    async def _jogging(self, arm: Chain) -> None:
        async with arm.jog(renew_within=LEASE_TIME) as jog:
            self._jog = jog
            try:
                jog.velocity(self._wanted)
                await trio.sleep_forever()
            finally:
                self._jog = None

    async def _watch(self, session: LeaseHolder) -> None:
        """End the lease when its time is over."""
        while trio.current_time() < self._deadline:
            with trio.CancelScope() as self._waiting:
                await trio.sleep_until(self._deadline)
        if self.owner is session:
            await self._release(self._over)

    async def _release(self, why: str) -> None:
        """Halt what the owner moves; then the lease is free. Nobody takes it before the machine stands, or may not."""
        owner = self.owner
        moved = self._scope is not None
        self.stop_motion()
        with trio.CancelScope(shield=True):
            problems: list[str] = []
            async with trio.open_nursery() as nursery:
                for name in self._chains:
                    chain = self._master.chains[name]
                    if chain.state is not ChainState.OFF:
                        nursery.start_soon(self._halted, name, chain.halt, problems)
        if moved or problems:
            LOGGER.warning(
                "%s: what %s moved was halted. %s", why, "nobody" if owner is None else owner.name, "; ".join(problems)
            )
        self.problem = "; ".join([why, *problems])
        self._chains.clear()
        self.owner = None

    async def _halted(self, what: str, stop: Callable[[], Awaitable[object]], problems: list[str]) -> None:
        try:
            with trio.fail_after(HALT_TIME):
                await stop()
        except trio.TooSlowError:
            problems.append(f"{what}: it did not confirm within {HALT_TIME:g} s that it stands")
        except (MasterError, ProcedureError, LocalProtocolError) as error:
            problems.append(f"{what}: {_first_line(error)}")

    def _halt_of(self, node: Node, axis: int) -> Callable[[], Awaitable[object]]:
        return lambda: self._master.run(halt(self._master.device(node, axis=axis).axis))

    def _nodes(self, net: str | None, node_id: int) -> list[Node]:
        """Return the nodes that may move without a chain: those commanded by single writes, and the one that was named."""
        led = {each.node for chain in self._master.chains.values() if chain.state is not ChainState.OFF for each in chain.devices}
        known = {device.node for device in self._master.devices.values()} | self._commanded
        if net is not None and node_id:
            known.add(self._master.node(node_id, bus=net))
        return [node for node in known - led if _is_at(node, net, node_id)]


async def _enabled(arm: Chain) -> None:
    if arm.state in (ChainState.HALTED, ChainState.FAULT):
        await arm.recover()
    elif arm.state is ChainState.OFF:
        await arm.initialise()
    if arm.state is not ChainState.FOLLOWING:
        await arm.follow()


def _is_at(node: Node, net: str | None, node_id: int) -> bool:
    return (net is None or node.bus == net) and node_id in (0, node.node_id)


def _first_line(error: BaseException) -> str:
    return str(error).splitlines()[0] if str(error) else type(error).__name__
