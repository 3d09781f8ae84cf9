"""The session of most commands: the dictionary, the bus of the options, a master on it, and for `-b demo` the drives too.

A command that gets no answer has listened only for its time limit, while heartbeats come about each second. So it listens on for
LISTEN_ON before it says what it heard of the node that it asked, and of others.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterable
from contextlib import AbstractAsyncContextManager, AsyncExitStack, asynccontextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import trio

from canopen_cli.shared.node_files import NodeFiles
from canopen_cli.shared.options import DEMO, Settings
from canopen_cli.shared.problem import CommandError
from canopen_cli.shared.screen import Screen, escape
from canopen_master.claims.channel_claim import SHORT, channel_claim, state_claim
from canopen_master.claims.further_channels import FurtherChannels
from canopen_master.errors import NO_ANSWER, SdoTimeoutError
from canopen_master.master import Master
from canopen_master.node import Node
from canopen_master.session import open_master
from canopen_master.silence import sdo_silence
from canopen_proto.abort import AbortOrigin
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.drives.axis.settings import AxisSettings
from canopen_proto.drives.cia402.axes import with_axis
from canopen_proto.network import Network
from canopen_proto.nmt import NmtState
from canopen_proto.procedures.steps import SdoTransferError
from canopen_transports import open_transport
from canopen_transports.transport import Transport

if TYPE_CHECKING:
    from canopen_data.description import DeviceDescription
    from canopen_master.simulation.serving import SimulatedDevices

LISTEN_ON: Final = 1.5
"""Seconds after a request without an answer: longer than the usual heartbeat time of 1 s, and the answer may just be late."""
LOOK_AGAIN: Final = 0.05
"""Seconds between two checks of what was heard."""


class BusSession:
    """An open master of one bus, and the files of the devices on it. bus: its locator."""

    def __init__(self, master: Master, files: NodeFiles, bus: str, screen: Screen) -> None:
        self.master = master
        self._screen = screen
        self.bus = bus
        self.files = files
        self._of_axes: dict[tuple[int, int], ObjectDictionary] = {}

    def node(self, node_id: int, axis: int = 0) -> Node:
        """Return a node of the only bus.

        axis: the one that the command is about. A node without a file of its own is taken to have it.
        """
        dictionary = self.dictionary_of(node_id)
        if axis and self.description_of(node_id) is None:
            dictionary = self._of_axes.setdefault((node_id, axis), with_axis(dictionary, axis))
        return self.master.node(node_id, dictionary)

    def claim(self, node_id: int, *files: ObjectDictionary) -> AbstractAsyncContextManager[None]:
        """Have an SDO channel of a node, to read much of it; see channel_claim.py. Raises ChannelTakenError.

        files: what the command knows of the device besides its own file, for the further channels.
        """
        return channel_claim(self.bus, node_id, further=self._further(node_id, files))

    def claim_to_write(self, node_id: int) -> AbstractAsyncContextManager[None]:
        """Have a node without other programs of ours, to write to it; see channel_claim.py. Raises ChannelTakenError."""
        return channel_claim(self.bus, node_id, writes=True)

    def claim_state(self, node_id: int) -> AbstractAsyncContextManager[None]:
        """Have the NMT state of a node: no other program of ours resets or starts it. Raises ChannelTakenError."""
        return state_claim(self.bus, [node_id])

    def turn(self, node_id: int) -> AbstractAsyncContextManager[None]:
        """Have an SDO channel of a node for a few reads, behind a long transfer of another program. Raises ChannelTakenError."""
        return channel_claim(self.bus, node_id, SHORT, brief=True, further=self._further(node_id, ()))

    def _further(self, node_id: int, files: Iterable[ObjectDictionary]) -> FurtherChannels:
        own = self.description_of(node_id)
        known = (*files, *(() if own is None else (own.dictionary,)))
        return FurtherChannels(self.node(node_id), known, lambda line: self._screen.say(escape(line)))

    def dictionary_of(self, node_id: int) -> ObjectDictionary:
        """Return the dictionary of a node; see NodeFiles."""
        return self.files.dictionary_of(node_id)

    def description_of(self, node_id: int) -> DeviceDescription | None:
        """Return the description of a node in its own file, or None."""
        return self.files.description_of(node_id)

    def axis_settings(self, node_id: int, axis: int = 0) -> AxisSettings:
        """Return the settings of a drive: those of its joint in the machine file; else the unit is the count."""
        joint = self.files.settings.joint(node_id, axis)
        settings = AxisSettings() if joint is None else joint.settings
        return settings if joint is not None and joint.has_unit else replace(settings, counts_per_unit=1.0)

    @property
    def network(self) -> Network:
        """The core's network on that bus."""
        return self.master.bus().network


def simulated_drives(devices: Iterable[tuple[str, int]]) -> AbstractAsyncContextManager[SimulatedDevices]:
    """See serving.py, which is imported only for the demonstration: a command on a real bus sends its first frame sooner."""
    from canopen_master.simulation import serving

    return serving.simulated_drives(devices)


@asynccontextmanager
async def open_session(settings: Settings, screen: Screen) -> AsyncIterator[BusSession]:
    """Open a master on the bus of the options while the block runs. Raises CommandError, BusError, DictionaryError, DataError."""
    bus = settings.required_bus()
    files = NodeFiles(settings, screen)
    async with AsyncExitStack() as stack:
        if bus == DEMO:
            from canopen_master.simulation.serving import DEMO_LOCATOR, DEMO_NODES

            await stack.enter_async_context(simulated_drives((DEMO_LOCATOR, node_id) for node_id in DEMO_NODES))
            bus = DEMO_LOCATOR
        opened: str | Transport = bus
        if settings.dry_run:
            from canopen_cli.shared.withholding import withheld

            opened = withheld(await open_transport(bus), files.dictionary_of)
        master = await stack.enter_async_context(
            open_master(opened, sdo_timeout=settings.sdo_timeout, dictionary=files.of_all_others, watchdog=settings.watchdog)
        )
        session = BusSession(master, files, bus, screen)
        try:
            yield session
        except Exception as error:
            silence = _silence_in(error)
            if silence is None:
                raise
            raise await _explained(session.node(silence.node_id), session, silence) from error


def _silence_in(error: Exception) -> SdoTimeoutError | SdoTransferError | None:
    """Return the missing answer in an exception, also in a group that a nursery made of it; else None."""
    if isinstance(error, ExceptionGroup) and len(error.exceptions) == 1:
        return _silence_in(error.exceptions[0])
    # SdoNotConfirmedError may also be a transfer that we gave up.
    if isinstance(error, SdoTimeoutError) and error.code == NO_ANSWER:
        return error
    if isinstance(error, SdoTransferError) and error.origin is AbortOrigin.TIMEOUT:
        return error
    return None


async def _explained(node: Node, session: BusSession, error: SdoTimeoutError | SdoTransferError) -> CommandError:
    """Return the CommandError for a missing answer, with what was heard until now and a little longer."""
    if not node.was_enabled:  # else a drive may move and must be halted first
        with trio.move_on_after(LISTEN_ON):
            while not _is_explained(node, session.network):
                await trio.sleep(LOOK_AGAIN)
    from canopen_cli.shared.failures import advice, problem_of  # only here: it knows the errors of all rooms

    problem = problem_of(error)
    problem.seen, problem.cause, tries = sdo_silence(session.network, node.remote, session.master.now())
    problem.tries = tuple(advice(tries))
    return problem


def _is_explained(node: Node, network: Network) -> bool:
    """Return whether further listening could not change the message."""
    return node.nmt_state is NmtState.STOPPED or network.heard(node.node_id).late_answer is not None
