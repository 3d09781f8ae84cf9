"""The conformance kit on what needs no world outside: the virtual buses, a recording of them, and a recording as a bus."""

from __future__ import annotations

import tempfile
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from canopen_proto.frame import Frame
from canopen_transports import Transport, open_transport
from canopen_transports.conformance import NotApplicable, Site, SiteBus, TransportCase, at, openings
from canopen_transports.conformance.bench import TransportBench
from canopen_transports.log_files import log_writer
from canopen_transports.record import Record
from canopen_transports.tracing import recording
from tests.transports.support import cases

PHYSICS = openings(
    "virtual:a@500",
    "virtual:a?bitrate=fast",
    "virtual:a@500k?bitrate=500k",
    "virtual:a?loss=often",
    "virtual:a?loss=2",
    "virtual:a?seed=0.5",
    "virtual:a?queue=lifo",
    "virtual:a?queue_size=0",
    "virtual:a?ack=maybe",
    "virtual:a?delay_ms=0",
    "virtual:a?fd=false",
)
RECORDINGS = openings(
    "file:",
    "file:/no/such/file.log",
    "file:/dev/null/a.log",
    "file:/etc/hostname",
    f"file:{Path(__file__)}",
    "file:trace.log?speed=0",
    "file:trace.log?speed=fast",
    "file:trace.log?send=perhaps",
    "file:trace.log?fd=false",
)


@asynccontextmanager
async def recorded() -> AsyncIterator[SiteBus]:
    """A virtual bus whose members tell a trace what they hear and say."""
    with tempfile.TemporaryDirectory() as folder, recording(log_writer(Path(folder) / "trace.log")):
        async with at("virtual:recorded")() as bus:
            yield bus


class Recording(SiteBus):
    """A log file. Nobody can be heard on it but those who spoke long ago."""

    def __init__(self, path: Path) -> None:
        super().__init__(self.nobody)
        self.path = path

    async def nobody(self, place: int) -> Transport:
        raise NotApplicable("on a recording nobody hears us")

    async def hearer(self, bench: TransportBench, frames: Sequence[Frame]) -> Transport:
        writer = log_writer(self.path)
        for number, frame in enumerate((*frames, Frame(0))):  # one is kept back: a recording without frames is none
            writer.write(Record(number * 1_000_000, "can0", frame))
        writer.close()
        member = bench.keep(await open_transport(f"file:{self.path}?speed=step"))
        member.step(len(frames))  # type: ignore[union-attr]
        return member


@asynccontextmanager
async def replayed() -> AsyncIterator[SiteBus]:
    with tempfile.TemporaryDirectory() as folder:
        yield Recording(Path(folder) / "trace.log")


SITES = {
    "virtual": Site(at("virtual:kit"), openings("virtual:demo@500", "virtual:demo?fd=false"), virtual_time=True),
    "virtual in real time": Site(at("virtual:kit")),
    "physics": Site(at("virtual:kit?bitrate=1M&ack=false&queue_size=32"), PHYSICS, virtual_time=True, burst=1_000),
    "physics with acknowledge": Site(at("virtual:kit@1M"), virtual_time=True, burst=1_000),
    "physics in real time": Site(at("virtual:kit@1M"), burst=500),
    "recorded": Site(recorded, virtual_time=True),
    "replayed": Site(replayed, RECORDINGS, virtual_time=True),
}


APPLY = [
    (name, case)
    for name, site in SITES.items()
    for case in cases(
        site,
        hears_only=name == "replayed",
        optional=("eager_send", "many_at_once", *(["pushed_frames", "what_has_come"] if name.startswith("virtual") else [])),
    )
]


@pytest.mark.thorough(8)
@pytest.mark.parametrize(("name", "case"), APPLY, ids=str)
def test_conformance(name: str, case: TransportCase) -> None:
    case.run(SITES[name])
