"""`ChainCalls`: a chain that may be asked and commanded from any thread; the values of `chain_map`.

Its methods are the manual's callbacks (init, homing, IPmode, setPos, getCurrentPos), free of any framework: a program that wraps
the master for another process calls them from threads of its own. Methods that take time return True or False, and `last_error`
says why; `set_pos` raises.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path as FilePath
from typing import TypeVar

from canopen_master.direct.connection import Connection, NotConnectedError
from canopen_master.errors import BusError, MasterClosedError
from canopen_master.master import Master
from canopen_master.motion.chain import Chain, ChainState
from canopen_master.motion.chain_file import ChainDescription
from canopen_master.motion.cycles import Cycle, Cycles
from canopen_master.motion.recording import Recorder
from canopen_proto.drives.trajectory import Path
from canopen_proto.machine import LocalProtocolError

R = TypeVar("R")


class ChainCalls:
    """One chain; see this module's text. name, joints: as in the chain file. Positions are in millidegrees, or what the drives
    count in, one per joint in the order of the file; with a machine file they are in the units of the joints.

    Raises NotConnectedError before open_connection, and MasterClosedError or BusError after its end.
    """

    def __init__(self, connection: Connection, description: ChainDescription, in_counts: bool = True) -> None:
        self._in_counts = in_counts
        self._connection = connection
        self.description = description
        self.name = description.name
        self.joints = tuple(joint.name for joint in description.joints)

    def __repr__(self) -> str:
        return f"<chain {self.name}: {', '.join(self.joints)}>"

    def init(self) -> bool:
        """Make all joints ready to move: PDOs, NMT start, fault reset, Operation enabled. True if all are ready."""
        return self._attempt(Chain.initialise)

    def homing(self) -> bool:
        """Home all joints side by side; return when all have stopped. True if all are referenced."""
        return self._attempt(Chain.home)

    def ip_mode(self) -> bool:
        """Let all joints follow set-points from where they stand. False if a drive lacks the mode."""
        return self._attempt(Chain.enable_interpolated_position)

    def move(self, targets: Sequence[float], *, speed: float = 1.0) -> bool:
        """Move all joints to their targets, to arrive together, as fast as their limits allow. True once they are there.

        speed: the share of each speed limit that is used. A chain that does not follow set-points begins to. Ctrl-C, and `halt`
        of another thread, stop it on its path. Needs the extra `motion` (ruckig). See `Chain.move`.
        """
        return self._attempt(lambda chain: chain.move(targets, speed=speed))

    def follow(self, path: Path) -> bool:
        """Follow a path from its start, where the joints have to stand, to its end. True once they are there.

        It is checked as a whole before anything moves. It ends as `move` does. See `Chain.follow`.
        """
        return self._attempt(lambda chain: chain.follow(path))

    @property
    def override(self) -> float:
        """The rate at which `move` and `follow` run: 0 (a pause on the path) to 1. It may be set from any thread, at any time."""
        return self._ask(lambda chain: chain.override)

    @override.setter
    def override(self, override: float) -> None:
        async def set_override(chain: Chain) -> None:
            chain.override = override

        self._call(set_override)

    @contextmanager
    def record(self, path: str | FilePath) -> Iterator[Recorder]:
        """Record what the chain does while a block runs, a row for each SYNC: `with chain.record("run.csv"): chain.move(...)`.

        path: Parquet if it ends in ".parquet", else CSV. Rows begin once the chain is ready to move. Raises OSError;
        PackageMissingError without pyarrow for Parquet; at the end RecordError if rows are missing. See `Chain.record`.
        """
        recorder = self._ask(lambda chain: chain.recorder(path))
        try:
            yield recorder
        finally:
            try:
                self._ask(lambda chain: recorder.close())
            except (NotConnectedError, MasterClosedError, BusError):
                recorder.close()  # the connection has ended, and nothing records any more
        recorder.wait()

    def halt(self) -> bool:
        """Stop all joints, whatever the chain is doing in another thread, and wait until they stand. They stay enabled."""
        return self._attempt(Chain.halt)

    def recover(self) -> bool:
        """After a fault or a halt: reset and enable all joints; a chain that followed set-points does so again."""
        return self._attempt(Chain.recover)

    def shut_down(self) -> bool:
        """Halt, engage the brakes, take the power away, and stop the nodes (NMT stop)."""
        return self._attempt(Chain.shut_down)

    def cycles(self) -> Iterator[Cycle]:
        """Iterate over the SYNC cycles from now on: `for cycle in chain.cycles(): chain.set_pos(...)`. Each `next` waits for one.

        If this thread is late, a path that uses `cycle.time` takes longer, but never jumps. From the first cycle on, each cycle
        needs a set-point: after 10 cycles in a row without one, the chain is halted. Raises ChainFaultError, ChainHaltedError,
        and ChainError for a chain that is not in IP mode.
        """

        async def begin(chain: Chain) -> Cycles:
            return chain.cycles()

        async def wait(chain: Chain) -> Cycle:
            return await anext(cycles)

        cycles = self._call(begin)
        while True:
            yield self._call(wait)

    def set_pos(self, positions: Sequence[float]) -> None:
        """Give the set-points to send behind the next SYNC. They are repeated until others are given. positions: one for each
        joint, in the order of `joints`.

        Raises SetPointRefusedError for a wrong count, a value that does not fit, or one beyond the limits of its joint;
        ChainFaultError if a joint has failed; ChainHaltedError; and ChainError for a chain that is not in IP mode.
        """

        async def give(chain: Chain) -> None:
            chain.set_positions(positions)

        self._call(give)

    def get_current_pos(self) -> list[float]:
        """Return the actual positions, as last heard."""
        return self._shown(self._ask(lambda chain: chain.positions))

    def get_desired_pos(self) -> list[float]:
        """Return the positions that the next PDOs command."""
        return self._shown(self._ask(lambda chain: chain.desired_positions))

    def _shown(self, positions: list[float]) -> list[float]:
        return [round(position) for position in positions] if self._in_counts else positions

    @property
    def is_homed(self) -> bool:
        """Whether all joints are homed."""
        return self._ask(lambda chain: chain.is_homed)

    @property
    def state(self) -> ChainState:
        """The state of the chain."""
        return self._ask(lambda chain: chain.state)

    def describe(self) -> list[str]:
        """Return one line for each joint, with its state and statusword."""
        return self._ask(lambda chain: [f"{device.name}: {device.describe()}" for device in chain.devices])

    def _ask(self, question: Callable[[Chain], R]) -> R:
        async def ask(chain: Chain) -> R:
            return question(chain)

        return self._call(ask)

    def _call(self, function: Callable[[Chain], Awaitable[R]]) -> R:
        return self._connection.call(lambda master: function(self._chain_of(master)))

    def _attempt(self, function: Callable[[Chain], Awaitable[None]]) -> bool:
        return self._connection.attempt(lambda master: function(self._chain_of(master)))

    def _chain_of(self, master: Master) -> Chain:
        if self.name not in master.chains:
            raise LocalProtocolError(f"chain {self.name} is not commanded yet: init_master_thread() first")
        return master.chains[self.name]
