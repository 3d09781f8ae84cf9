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

**Nobody else takes its ground away.** An NMT command, or a write that does the same, is refused to all but the owner while the
drive has power: it would lose its commands, and brake as its own settings say, or not at all.

**Anybody may halt**, with or without the lease, in a read-only gateway too. A halt ends the lease by which the machine was moved,
and the chains stay halted until somebody gives them power anew: whoever goes on sending moves nothing. A halt stops what clients
have set moving, though another program has given it power: the drives to which they have written, and each drive with power on a
net where they have sent PDOs, since nobody knows which drives took these.

It is no safety function: a computer, its network and this program may all fail. Keep the emergency stop wired.
"""

from __future__ import annotations

import logging
import math
from collections import Counter
from collections.abc import Awaitable, Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from functools import partial
from typing import Final, Protocol

import trio

from canopen_gateway.errors import LeaseError, first_line
from canopen_gateway.guard import Guard, Permission
from canopen_master import Chain, ChainState, Device, Jog, Master, MasterError, Node, SdoTimeoutError
from canopen_proto.drives import halt
from canopen_proto.drives.cia402.axes import axes_of, axis_of, swapped
from canopen_proto.drives.cia402.objects import CONTROLWORD, STATUSWORD
from canopen_proto.drives.cia402.states import POWERED, state_of
from canopen_proto.machine import LocalProtocolError
from canopen_proto.multiplexer import index_of, mux
from canopen_proto.nmt import NmtState
from canopen_proto.procedures import ProcedureError
from canopen_proto.procedures.objects import ABSENT, urgent_request
from canopen_proto.procedures.steps import Procedure
from canopen_proto.remote_node import RemoteNode
from canopen_proto.sdo.events import SdoAborted, SdoUploaded

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
    halt was not confirmed; "" if all went well. What did not confirm that it stands is told to the next owner too, until a motion
    of just that chain or drive begins. doing: what the owner is moved by at present: "", "enable", "jog", "move", "disable",
    "commission"."""

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
        self._ended = trio.Event()  # that motion is over
        self._waiting = trio.CancelScope()
        self._jogged = ""
        self._jog: Jog | None = None
        self._wanted: list[float] = []
        self._wanted_at = -math.inf  # when these velocities came
        self._commanded: dict[Node, set[int]] = {}  # by single writes; and which axes of it nobody has seen at rest since
        self._halts: Counter[tuple[str | None, int]] = Counter()  # what was halted, and how often
        self._pdos_sent: set[str] = set()  # the nets on which a client has sent PDOs
        self._halted_by_hand: set[str] = set()  # chains that somebody has halted, and nobody has enabled since
        self._over = THE_TIME
        self._commissioned: Node | None = None  # the drive that the owner commissions
        self._set_up: set[Node] = set()  # the drives that he has commissioned
        self._unconfirmed: dict[str, str] = {}  # what did not confirm that it stands, and nobody has moved since: its name -> why

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
            self.owner, self._last, self.problem, self._over = session, -1, self._with_unconfirmed(), THE_TIME
            self._deadline = trio.current_time() + LEASE_TIME
            self._nursery.start_soon(self._watch, session)
            for each in self._commanded.keys() - self._in_use():  # what others have said, and waits, would reach a drive of his
                each.drop_commands()

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

    async def require_no_power(self, session: LeaseHolder, net: str, node_id: int, what: str) -> None:
        """Raise LeaseError if a drive would lose its commands by what was to be done: one that the owner moves, or one that has
        power. The owner himself may. Each node is asked (0x6041), since another program may have given its drive power; of one
        that does not answer, what was last heard counts. node_id: 0 for all nodes of a net that were heard. what: was to be done,
        such as "NMT stop"."""
        powered: set[Node] = set()
        reached = self._reached(session, net, node_id, what)
        async with trio.open_nursery() as nursery:
            for node in reached:
                nursery.start_soon(self._ask_power, node, powered)
        for node in self._reached(session, net, node_id, what):  # the lease may have been taken meanwhile
            if node in powered or self._has_power(node):
                raise LeaseError(
                    f"{what} of {node.where} was refused: its drive has power",
                    seen="it would lose its commands: what moves may not stop, and what hangs may fall",
                    tries=("halt it, which is open to everybody, and take its power away",),
                )

    def _reached(self, session: LeaseHolder, net: str, node_id: int, what: str) -> list[Node]:
        """Return the nodes whose drives may have power; none for the owner. Raises LeaseError for one that another client
        moves."""
        if self.owner is session and self.left > 0.0:
            return []
        arms = [self._master.chains[name] for name in self._chains]
        in_hand = {device.node for arm in arms for device in (arm.devices if self.doing else _led(arm))}
        known = self._drives(net, node_id)
        for node in known:
            if node in in_hand or node is self._commissioned:
                self.require_free(session, f"{what} of {node.where}")
        heard = () if node_id else self._master.bus(net).network.heard_nodes()
        return list(dict.fromkeys([*known, *(self._master.node(each, bus=net) for each in heard)]))

    async def _ask_power(self, node: Node, powered: set[Node]) -> None:
        """Add a node to `powered` if it says that a drive of it has power."""
        if self._master.bus(node.bus).network.heard(node.node_id).state is NmtState.STOPPED:
            return  # it has no SDO then (CiA 301 v4.2.0, 7.3.2.2.4)
        for axis in _axes(node):
            with suppress(MasterError):
                if await self._says_powered(node, axis):
                    powered.add(node)

    async def _says_powered(self, node: Node, axis: int) -> bool:
        """Return whether a drive says that it has power; it is asked twice, since an answer may be lost. Raises SdoError."""
        index = index_of(swapped(STATUSWORD, axis))
        try:
            data = await node.read_bytes(index, 0)
        except SdoTimeoutError:
            data = await node.read_bytes(index, 0)
        return state_of(int.from_bytes(data, "little")) in POWERED

    def halts_of(self, node: Node) -> int:
        """Return how often a node was halted by hand so far: alone, or with its net, or with all."""
        return sum(self._halts[net, node_id] for net in (None, node.bus) for node_id in (0, node.node_id))

    def require_no_halt(self, node: Node, index: int, halts: int) -> None:
        """Raise LeaseError for a controlword that waited for its turn while its drive was halted: behind the halt it would undo
        it. index: of the object. halts: as `halts_of` said when the write was asked for."""
        axis = axis_of(mux(index))
        if self.halts_of(node) != halts and axis is not None and swapped(mux(index), axis) == CONTROLWORD:
            raise LeaseError(
                f"writing 0x{index:04X} of {node.where} was dropped: somebody has halted it",
                seen="the write waited for its turn meanwhile, and nothing was sent",
                tries=("again, if it is meant",),
            )

    def note_command(self, node: Node, index: int) -> None:
        """Remember a node to which a client has written something that moves: `halt` stops it, too, whoever has given it power.
        index: of the object."""
        axis = axis_of(mux(index))
        self._commanded.setdefault(node, set()).update(() if axis is None else (axis,))

    def note_pdo(self, net: str) -> None:
        """Remember that a client has sent a PDO on a net. Nobody knows which drives took it: `halt` stops each one with power."""
        self._pdos_sent.add(net)

    # ---- intents ----

    def enable(self, session: LeaseHolder, sequence: int, chain: str) -> None:
        """Give the joints of a chain power, and let them follow; in the background. Raises LeaseError, UnknownChainError."""
        arm = self._begin(session, sequence, chain, "enable")
        self._run("enable", lambda: self._enabling(arm), _names_of(arm))

    def disable(self, session: LeaseHolder, sequence: int, chain: str) -> None:
        """Halt the joints of a chain and take their power away; in the background. Raises as `enable`."""
        arm = self._begin(session, sequence, chain, "disable")
        self._run("disable", arm.shut_down, _names_of(arm))

    def move(self, session: LeaseHolder, sequence: int, chain: str, targets: Sequence[float], *, speed: float = 1.0) -> None:
        """Move a chain to a target; in the background, for as long as the lease is renewed. targets: one for each joint, in its
        unit. speed: the share of each limit that is used. Raises as `enable`."""
        arm = self._begin(session, sequence, chain, "move")
        self._require_power(chain)
        self._run("move", lambda: arm.move(targets, speed=speed), _names_of(arm))

    def jog(self, session: LeaseHolder, sequence: int, chain: str, velocities: Sequence[float]) -> None:
        """Move the joints of a chain at these velocities, in their units per second, until the next message, or the end of the
        lease. All zeros: the joints brake, and the jog goes on. Raises as `enable`; LeaseError if it cannot move like that."""
        if self.doing != "jog" or self._jogged != chain:
            arm = self._begin(session, sequence, chain, "jog")
            self._require_power(chain)
            self._jogged, self._wanted, self._wanted_at = chain, list(velocities), trio.current_time()
            self._run("jog", lambda: self._jogging(arm), _names_of(arm))
            return
        self.renew(session, sequence)
        self._require_power(chain)
        self._wanted, self._wanted_at = list(velocities), trio.current_time()
        if self._jog is not None:
            try:
                self._jog.velocity(self._wanted)
            except MasterError as error:
                raise LeaseError(f"chain {chain} does not jog", seen=first_line(error)) from error

    def stop(self, session: LeaseHolder, sequence: int) -> None:
        """End the motion under way: the joints brake, and stay enabled. Raises LeaseError."""
        self.renew(session, sequence)
        self.stop_motion()

    def commission(self, session: LeaseHolder, sequence: int, node: Node, dialogue: Callable[[], Awaitable[object]]) -> None:
        """Commission a drive, in the background: see commissioning.py. It goes on while this client renews the lease. dialogue:
        leads through it; it is cancelled when the lease ends, and halts the drive then. Raises LeaseError."""
        self.renew(session, sequence)
        if self.doing:
            raise LeaseError(
                "a drive cannot be commissioned now", seen=f"it is under way: {self.doing}", tries=("halt it first",)
            )
        self._commissioned = node
        self._set_up.add(node)
        self._run("commission", dialogue, (node.where,))

    # ---- halt ----

    async def halt(self, net: str | None = None, node_id: int = 0) -> list[str]:
        """Stop everything that this gateway's master moves; or what is on a net, or on a node of it. Everybody may.

        Returns what did not confirm that it stands, one line each. Sends the halts of all chains and drives at once, and waits
        HALT_TIME at most. What was halted stays so: the lease of whoever has moved one of these chains ends, and none of them
        moves before it was given power anew (`enable`), whoever goes on sending.
        """
        self._halts[net, node_id] += 1
        self.stop_motion()
        for each in self._commanded:  # one whose command still waits has no power yet, and would not be halted below
            if _is_at(each, net, node_id):
                each.drop_commands()
        chains = [
            chain for chain in self._master.chains.values() if any(_is_at(each.node, net, node_id) for each in chain.devices)
        ]
        names = {chain.name for chain in chains}
        self._halted_by_hand |= names
        commissioned = self._commissioned
        if self.owner is not None and (names & self._chains or (commissioned and _is_at(commissioned, net, node_id))):
            self._over = BY_HAND
            self.leave(self.owner)
        problems: list[tuple[str, str]] = []
        with trio.CancelScope(shield=True):  # the client that asked may be gone: the halt still counts
            async with trio.open_nursery() as nursery:
                for chain in chains:
                    if chain.state is not ChainState.OFF or chain.is_busy:  # a program may be giving it power
                        nursery.start_soon(self._halted, chain.name, chain.halt, problems)
                for node in self._nodes(net, node_id):
                    for axis in node.axes_enabled or ((0,) if node_id else ()):
                        nursery.start_soon(self._halted, node.where, self._halt_of(node, axis), problems)
                for node, axis in self._asked(net, node_id):
                    nursery.start_soon(self._halted, node.where, partial(self._halt_if_powered, node, axis), problems)
        return _told(problems)

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

    def _run(self, doing: str, motion: Callable[[], Awaitable[object]], moved: Iterable[str]) -> None:
        """Begin a motion. moved: the names of the chain and the nodes that it moves: whether these stand is asked anew."""
        if self._nursery is None:
            raise LeaseError("the machine cannot be moved", seen="the gateway is ending")
        for name in moved:
            self._unconfirmed.pop(name, None)
        self.doing, self.problem = doing, self._with_unconfirmed()
        self._scope, self._ended = trio.CancelScope(), trio.Event()
        self._nursery.start_soon(self._carry_out, self._scope, motion)

    async def _carry_out(self, scope: trio.CancelScope, motion: Callable[[], Awaitable[object]]) -> None:
        """Run a motion. Whatever becomes of it, the gateway and its master go on."""
        try:
            with scope:
                await motion()
        except Exception as error:  # noqa: BLE001 - whatever it is, it is told, and ends this motion alone
            problem = first_line(error)
            self.problem = self._with_unconfirmed(problem)
            LOGGER.warning("%s ended: %s", self.doing, problem)
        finally:
            if self._scope is scope:
                self._scope, self.doing, self._commissioned = None, "", None
                self._ended.set()

    async def _enabling(self, arm: Chain) -> None:
        await _enabled(arm)
        self._halted_by_hand.discard(arm.name)  # not before: it may be ended at once, with the joints as they were

    async def _jogging(self, arm: Chain) -> None:
        async with arm.jog(renew_within=LEASE_TIME) as jog:
            self._jog = jog
            try:
                # joints may need seconds to begin, and who has let go meanwhile moves nothing
                if trio.current_time() - self._wanted_at < LEASE_TIME:
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
        """Halt what the owner moves; then the lease is free. Nobody takes it before the machine stands, or HALT_TIME is over for
        what did not confirm that it stands: `problem` tells it."""
        owner = self.owner
        moved = self._scope is not None
        self.stop_motion()
        with trio.CancelScope(shield=True):
            problems: list[tuple[str, str]] = []
            async with trio.open_nursery() as nursery:
                left = set(self._set_up)
                for name in self._chains:
                    chain = self._master.chains[name]
                    if chain.state is not ChainState.OFF:
                        nursery.start_soon(self._halted, name, chain.halt, problems)
                    else:  # some of its joints may have got power already
                        left |= {device.node for device in chain.devices}
                for node in left:
                    for axis in _axes(node):
                        nursery.start_soon(self._halted, node.where, partial(self._left, node, axis), problems)
        if moved or problems:
            LOGGER.warning(
                "%s: what %s moved was halted. %s", why, "nobody" if owner is None else owner.name, "; ".join(_told(problems))
            )
        for name in dict.fromkeys(name for name, _ in problems):
            self._unconfirmed[name] = "; ".join(_told(each for each in problems if each[0] == name))
        self.problem = self._with_unconfirmed(why)
        self._chains.clear()
        self._set_up.clear()
        self.owner = None

    async def _left(self, node: Node, axis: int) -> None:
        """Wait for the end of what was under way with a drive. If it has power then, it is halted: the end of a commissioning did
        not succeed in that, or its chain was about to be enabled."""
        if self._scope is not None:
            await self._ended.wait()
        if self._has_power(node):
            await self._halt_of(node, axis)()

    def _with_unconfirmed(self, problem: str = "") -> str:
        """Return a problem, with what did not confirm that it stands."""
        return "; ".join([problem, *self._unconfirmed.values()] if problem else self._unconfirmed.values())

    async def _halted(self, what: str, stop: Callable[[], Awaitable[object]], problems: list[tuple[str, str]]) -> None:
        try:
            with trio.fail_after(HALT_TIME):
                await stop()
        except trio.TooSlowError:
            problems.append((what, f"it did not confirm within {HALT_TIME:g} s that it stands"))
        except (MasterError, ProcedureError, LocalProtocolError) as error:
            problems.append((what, first_line(error)))

    def _halt_of(self, node: Node, axis: int) -> Callable[[], Awaitable[object]]:
        return lambda: self._master.run(halt(self._master.device(node, axis=axis).axis))

    async def _halt_if_powered(self, node: Node, axis: int) -> None:
        """Halt a drive unless it says that it has no power."""
        axes = self._commanded.setdefault(node, set())
        axes.discard(axis)  # before: a client may write to it meanwhile
        try:
            if await self._master.run(_may_have_power(node.remote, index_of(swapped(STATUSWORD, axis)))):
                await self._halt_of(node, axis)()
        except BaseException:
            axes.add(axis)
            raise

    def _asked(self, net: str | None, node_id: int) -> Iterator[tuple[Node, int]]:
        """Yield the drives that clients may have moved though this master has not given them power: those to which they have
        written, and all that were heard where they have sent PDOs."""
        led = self._led()
        found = {(node, axis) for node, axes in self._commanded.items() for axis in axes}
        for each in self._pdos_sent:
            nodes = [self._master.node(number, bus=each) for number in self._master.bus(each).network.heard_nodes()]
            found |= {(node, axis) for node in nodes for axis in _axes(node)}
        for node, axis in found:
            is_halted = axis in (node.axes_enabled or ((0,) if node_id else ()))
            if _is_at(node, net, node_id) and node not in led and not is_halted:
                yield node, axis

    def _nodes(self, net: str | None, node_id: int) -> list[Node]:
        """Return the nodes that may move without a chain: those commanded by single writes, and the one that was named."""
        led = self._led()
        return [node for node in self._drives(net, node_id) if node not in led]

    def _in_use(self) -> set[Node]:
        """Return the nodes of chains that move, or are about to: a program beside the gateway may be giving them power."""
        chains = [each for each in self._master.chains.values() if each.is_busy or each.state is not ChainState.OFF]
        return {device.node for chain in chains for device in chain.devices}

    def _led(self) -> set[Node]:
        return {each.node for chain in self._master.chains.values() for each in _led(chain)}

    def _drives(self, net: str | None, node_id: int) -> list[Node]:
        """Return the nodes whose drives this gateway may have commanded, of a net or of all; and the one that was named."""
        known = {device.node for device in self._master.devices.values()} | self._commanded.keys()
        if net is not None and node_id:
            known.add(self._master.node(node_id, bus=net))
        return [node for node in known if _is_at(node, net, node_id)]

    def _has_power(self, node: Node) -> bool:
        devices = [device for (each, _), device in self._master.devices.items() if each is node]
        if not devices:
            return node.was_enabled
        return any(device.may_move or device.state in POWERED for device in devices)


def _may_have_power(node: RemoteNode, statusword: int) -> Procedure[bool]:
    """Ask a drive whether it has power. A halt waits for the answer, so the question goes before all others. A node without a
    statusword is no drive. A drive that does not answer may have power. statusword: its index."""
    outcome = yield from urgent_request(node, lambda now: node.sdo.upload(statusword, 0, now, urgent=True))
    if isinstance(outcome, SdoUploaded):
        return state_of(int.from_bytes(outcome.data, "little")) in POWERED
    return not (isinstance(outcome, SdoAborted) and outcome.abort_code in ABSENT)


async def _enabled(arm: Chain) -> None:
    if arm.state in (ChainState.HALTED, ChainState.FAULT):
        await arm.recover()
    elif arm.state is ChainState.OFF:
        await arm.initialise()
    if arm.state is not ChainState.FOLLOWING:
        await arm.follow()


def _led(chain: Chain) -> Sequence[Device]:
    """Return the joints of a chain that it moves, or holds, at present."""
    return () if chain.state is ChainState.OFF else chain.devices


def _axes(node: Node) -> Sequence[int]:
    """Return the axes that a node may have: those in use, and those that its dictionary describes."""
    return sorted({*node.axes, *axes_of(node.dictionary)}) or (0,)


def _is_at(node: Node, net: str | None, node_id: int) -> bool:
    return (net is None or node.bus == net) and node_id in (0, node.node_id)


def _names_of(chain: Chain) -> list[str]:
    """Return the names under which what did not confirm that it stands is kept: of a chain, and of its nodes."""
    return [chain.name, *(device.node.where for device in chain.devices)]


def _told(problems: Iterable[tuple[str, str]]) -> list[str]:
    return [f"{what}: {why}" for what, why in problems]
