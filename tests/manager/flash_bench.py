"""A device with a boot loader on a bus in virtual time, and a master that writes programs into it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, SECOND, Event, Time
from canopen_proto.manager.programs.download import (
    DownloadLimits,
    ProgramDownload,
    ProgramProgress,
    ProgramStep,
    download_program,
)
from canopen_proto.multiplexer import mux
from canopen_proto.network import Network
from canopen_proto.nmt import NmtCommand, NmtMaster
from canopen_proto.remote_node import RemoteNode
from canopen_proto.simulation.boot_loader import BootLoader, BootLoaderSettings, ProgramMemory
from tests.core.bus import Bus, Ended, result_of
from tests.core.devices import whole_device

NODE = 6


class LossyBus(Bus):
    """A bus that loses some frames to and from the device: those with these numbers, counted from 0."""

    lose: frozenset[int] = frozenset()
    count = 0

    def _schedule(self, frame: Frame, receiver: Any) -> None:
        self.count += 1
        if self.count - 1 not in self.lose:
            super()._schedule(frame, receiver)


class FlashBench:
    """The device, whose memory outlives it, and its master."""

    def __init__(
        self,
        settings: BootLoaderSettings | None = None,
        *,
        memory: ProgramMemory | None = None,
        lose: Iterable[int] = (),
        limits: DownloadLimits | None = None,
        heartbeat: bool = False,
        frame_time: Time = 0,
        seed: int = 0,
    ) -> None:
        self.bus = LossyBus(seed, frame_time=frame_time)
        self.master = self.bus.attach(Network())
        self.remote = RemoteNode(self.master.out, NODE, whole_device())
        self.nmt = NmtMaster(self.master.out)
        self.master.attach(self.remote)
        self.master.attach(self.nmt)
        self.settings = (
            BootLoaderSettings(erase_time=30 * MILLISECOND, program_time=20 * MILLISECOND) if settings is None else settings
        )
        self.memory = ProgramMemory() if memory is None else memory
        self.limits = limits
        self.progress: list[ProgramProgress] = []
        self.ended: list[Ended] = []
        self.bus.on_event = self._on_event
        self.network: Network | None = None
        self.has_heartbeat = heartbeat
        self.power_on()
        self.bus.run(MILLISECOND)
        self.device.execute(NmtCommand.START, self.bus.now)
        self.bus.sent.clear()
        self.bus.lose = frozenset(lose)
        self.bus.count = 0

    def power_on(self) -> None:
        self.network = self.bus.attach(Network())
        self.device = BootLoader(self.network.out, NODE, self.settings, self.memory)
        if not self.has_heartbeat:
            self.device.values.store[mux(0x1017)] = 0
        self.network.attach(self.device)
        self.device.boot(self.bus.now)

    def power_off(self) -> None:
        if self.network is not None:
            self.bus.detach(self.network)
            self.network = None

    def _on_event(self, event: Event) -> None:
        if isinstance(event, ProgramProgress):
            self.progress.append(event)
        if isinstance(event, Ended):
            self.ended.append(event)

    def begin(self, image: bytes, so_far: ProgramDownload | None = None, **options: Any) -> int:
        options.setdefault("limits", self.limits)
        return self.master.run(download_program(self.remote, self.nmt, image, so_far, **options), self.bus.now)

    def outcome(self, limit: Time = 600 * SECOND) -> Ended:
        self.bus.run_until(lambda: bool(self.ended), limit)
        (outcome,) = self.ended
        self.ended.clear()
        return outcome

    def flash(self, image: bytes, **options: Any) -> ProgramDownload:
        """Write a program; raise what the procedure raises."""
        self.begin(image, **options)
        return result_of(self.outcome())  # type: ignore[no-any-return]

    @property
    def steps(self) -> list[ProgramStep]:
        """The steps that were taken, in their order."""
        return list(dict.fromkeys(each.step for each in self.progress))

    def to_device(self) -> list[str]:
        """The frames that the master sent."""
        return [line for line in self.bus.trace() if line.startswith(("606", "000"))]
