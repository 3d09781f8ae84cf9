"""An Observer listens to a full bus: 1 Mbit/s without a pause, twelve drives, SYNC, PDOs, SDO transfers of all kinds, heartbeats.

    python benchmarks/observer.py                       # 10 000 000 frames, a minute or two; and what memory it takes
    python benchmarks/observer.py --frames 200000

The frames are those of our own machines: SDO transfers of SdoClient and SdoServer, and a cycle of SYNC, twelve RPDOs and twelve
TPDOs with three objects each. Each frame comes when the one before is over, to the bit. So the bus has some 9600 frames a second.

Ours finds the service and the node of each frame, follows each SDO transfer to its end (CRC, toggle bits, sizes), looks for all
faults (RULES in observer.py) and counts the load in exact bits; `BusView` adds rates, jitter, states and errors. Words are made
when they are read: here, of each TPDO of node 1.

The peers:

- `canopen` (cases of run.py): its Network gets the same frames by `notify`, with twelve RemoteNodes that have the same mapping;
  node 1's TPDO is decoded each time. It does much less: it follows no SDO transfer, checks no rule, and counts nothing. So the
  ratio says what understanding a bus costs over taking its frames.
- `canopen-monitor` 4.1.0 (here, if it is installed; in its own environment, as it brings a package `tests`): the same work in
  Python, a line of text for each frame by the device's EDS. It does less here: it reads the index of an SDO in the wrong byte
  order, so it shows these frames as bytes; and it checks no rule.
- Wireshark's `tshark` (here, if it is installed): a line of text for each frame of a capture file, in C. It follows no transfer
  and knows no mapping. Its start is left out.
"""

from __future__ import annotations

import argparse
import importlib
import resource
import shutil
import subprocess
import tempfile
import time
import tracemalloc
from collections.abc import Callable, Iterator
from pathlib import Path

from direct import add_tpdo, coupled_networks
from measure import Case

from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Object, ObjectDictionary, Values, Variable
from canopen_proto.frame import Frame
from canopen_proto.frame_bits import duration, frame_bits
from canopen_proto.machine import SECOND, Outbox, Time
from canopen_proto.observer.bus_view import BusView
from canopen_proto.observer.observer import Observer
from canopen_proto.sdo.client import SdoClient
from canopen_proto.sdo.server import SdoServer
from canopen_proto.sdo.store import ValuesStore

BITRATE = 1_000_000
NODES = range(1, 13)
OBJECTS = [
    ("statusword", 0x6041, DataType.UNSIGNED16, 16),
    ("modes_of_operation_display", 0x6061, DataType.INTEGER8, 8),
    ("position_actual_value", 0x6064, DataType.INTEGER32, 32),
]
"""Those of TPDO 1; the COB-IDs are those of the predefined connection set."""
TARGETS = [("controlword", 0x6040, DataType.UNSIGNED16, 16), ("target_position", 0x607A, DataType.INTEGER32, 32)]
"""Those of RPDO 1."""
MAPPINGS = {0x1A00: OBJECTS, 0x1600: TARGETS}
DOMAIN = 0x2001
SDO_FRAMES = 4
"""SDO frames in each cycle."""
CYCLES_PER_HEARTBEAT = 30
OBSERVED, VIEWED = "a frame of a full bus (Observer)", "a frame of a full bus (Observer and BusView)"

Heard = Callable[[int], object]
"""Take so many frames; the last position of node 1."""


def traffic() -> list[Frame]:
    """About a second of the bus, which can be repeated: no transfer is open at its end."""
    transfers = [frame for node_id in NODES for frame in _transfers(node_id)]
    frames = []
    for cycle in range(-(-len(transfers) // SDO_FRAMES)):
        frames.append(Frame(0x80))
        for node_id in NODES:
            target = (1000 * cycle + node_id).to_bytes(4, "little")
            frames.append(Frame(0x200 + node_id, b"\x1f\0" + target))
            frames.append(Frame(0x180 + node_id, bytes((0x37, 0x12, 7)) + target))
        frames += transfers[cycle * SDO_FRAMES : (cycle + 1) * SDO_FRAMES]
        if cycle % CYCLES_PER_HEARTBEAT < len(NODES):
            frames.append(Frame(0x701 + cycle % CYCLES_PER_HEARTBEAT, b"\x05"))
    return frames


def _dictionary() -> ObjectDictionary:
    objects = [Object.of(name, [Variable(index, 0, name, kind)]) for name, index, kind, _ in OBJECTS + TARGETS]
    return ObjectDictionary([*objects, Object.of("domain", [Variable(DOMAIN, 0, "domain", DataType.DOMAIN)])])


def _transfers(node_id: int) -> Iterator[Frame]:
    """Transfers with one node: ten values, a string in segments, and a domain in blocks."""
    values = Values(_dictionary(), node_id)
    client, server = SdoClient(Outbox(), node_id), SdoServer(Outbox(), node_id, ValuesStore(values))

    def exchange() -> Iterator[Frame]:
        while client.busy or client.out.frames:
            for source, target in ((client, server), (server, client)):
                frames = source.out.frames[:]
                source.out.frames.clear()
                for frame in frames:
                    yield frame
                    target.receive(frame, 0)
                if source.deadline <= 0:
                    source.handle_timeout(0)

    for name, index, _, _ in OBJECTS * 3:
        values.write(name, node_id)
        client.upload(index, 0, 0)
        yield from exchange()
    client.download(DOMAIN, 0, bytes(range(100)), 0)
    yield from exchange()
    client.upload(DOMAIN, 0, 0)
    yield from exchange()
    client.download(DOMAIN, 0, bytes(range(200)) * 4, 0, block=True)
    yield from exchange()


def _mapping(node_id: int) -> Iterator[Frame]:
    """Writes of the mappings, as a master makes them: so the observer knows them."""
    for mapping, objects in MAPPINGS.items():
        entries = [(1 + place, index << 16 | bits, 4) for place, (_, index, _, bits) in enumerate(objects)]
        for subindex, value, size in [*entries, (0, len(objects), 1)]:
            place = bytes((mapping & 0xFF, mapping >> 8, subindex))
            yield Frame(0x600 + node_id, bytes((0x23 | (4 - size) << 2,)) + place + value.to_bytes(4, "little"))
            yield Frame(0x580 + node_id, b"\x60" + place + bytes(4))


FRAMES = traffic()
TIMES = [duration(frame_bits(frame), BITRATE) for frame in FRAMES]
PER_SECOND = len(FRAMES) * SECOND / sum(TIMES)


class Ours:
    """Our observer, with a view or without, on a bus that goes on from call to call."""

    def __init__(self, *, has_view: bool) -> None:
        dictionary = _dictionary()
        self.observer = Observer(lambda node_id: dictionary if node_id in NODES else None, bitrate=BITRATE, load_limit=2.0)
        self.view = BusView(bitrate=BITRATE) if has_view else None
        self.now: Time = 0
        self.position: object = None
        self.findings = 0
        self._place = 0
        for node_id in NODES:
            for frame in _mapping(node_id):
                self._take(frame)

    def hear(self, count: int) -> object:
        """Take the next frames."""
        for _ in range(count):
            self.now += TIMES[self._place]
            self._take(FRAMES[self._place])
            self._place = (self._place + 1) % len(FRAMES)
        return self.position

    def words(self, count: int) -> int:
        """Take the next frames, and make a line of each; the characters."""
        characters = 0
        for _ in range(count):
            meaning = self.observer.observe(FRAMES[self._place], self.now).meaning
            characters += len(f"{self.now} {meaning.service} {meaning.node_id} {meaning.text}\n")
            self.now += TIMES[self._place]
            self._place = (self._place + 1) % len(FRAMES)
        return characters

    def _take(self, frame: Frame) -> None:
        observation = self.observer.observe(frame, self.now)
        if observation.findings:
            self.findings += len(observation.findings)
        if self.view is not None:
            self.view.add(frame, observation, self.now)
        if frame.can_id == 0x181:
            self.position = observation.meaning.objects[2].value


def theirs() -> Heard:
    """The peer's Network."""
    network, _ = coupled_networks()
    tpdos, queues = {}, []
    for node_id in NODES:
        tpdos[node_id] = add_tpdo(network, node_id, OBJECTS)
        queues.append(network[node_id].sdo.responses.queue)
    place, position = 0, None

    def heard(count: int) -> object:
        nonlocal place, position
        for _ in range(count):
            frame = FRAMES[place]
            network.notify(frame.can_id, bytearray(frame.data), 0.0)
            if frame.can_id == 0x181:
                position = tpdos[1].map[2].raw
            place = (place + 1) % len(FRAMES)
        for queue in queues:
            queue.clear()  # answers of SDO servers, which it keeps for a client that waits for them
        return position

    return heard


def cases() -> list[Case]:
    """The observer alone, and with the figures for a display."""
    found = []
    for title, has_view in ((OBSERVED, False), (VIEWED, True)):
        mine, peer = Ours(has_view=has_view), theirs()

        def check(mine: Ours = mine, peer: Heard = peer) -> None:
            assert mine.hear(len(FRAMES)) == peer(len(FRAMES)) is not None
            assert not mine.findings

        found.append(Case(title, mine.hear, peer, check))
    return found


def share(nanoseconds: float) -> float:
    """Return the percentage of a core that a full bus takes, at so many ns a frame."""
    return nanoseconds * PER_SECOND / SECOND * 100


def _seconds(work: Callable[[], object]) -> float:
    begin = time.process_time()
    work()
    return time.process_time() - begin


def _by_monitor(frames: int) -> float | None:
    """Return the CPU seconds that canopen-monitor takes for a line of each of so many frames; None if it is not installed."""
    try:
        parse, can = (importlib.import_module(f"canopen_monitor.{name}") for name in ("parse", "can"))
    except ImportError:
        return None
    eds = {node_id: parse.EDS(_eds(node_id)) for node_id in NODES}
    parser = parse.CANOpenParser(eds)

    def lines() -> int:
        characters = 0
        for number in range(frames):
            frame = FRAMES[number % len(FRAMES)]
            message = can.Message(frame.can_id, data=list(frame.data))
            text, _ = parser.parse(message)
            characters += len(f"{number} {message.type} {message.node_id} {text}\n")
        return characters

    return _seconds(lines)


def _eds(node_id: int) -> list[str]:
    """The lines of a file that describes the drives to canopen-monitor: their objects and their PDOs."""
    sections = [("DeviceCommissioning", [f"NodeId={node_id}", "NodeName=drive"])]
    for name, index, kind, _ in OBJECTS + TARGETS:
        sections.append((f"{index:X}", [f"ParameterName={name}", f"DataType=0x{int(kind):04X}", "DefaultValue=0"]))
    sections.append((f"{DOMAIN:X}", ["ParameterName=domain", "DataType=0x000F", "DefaultValue=0"]))
    for mapping, objects in MAPPINGS.items():
        sections.append((f"{mapping:X}", ["ParameterName=mapping"]))
        entries = [len(objects), *(f"0x{index:04X}00{bits:02X}" for _, index, _, bits in objects)]
        for subindex, value in enumerate(entries):
            sections.append((f"{mapping:X}sub{subindex}", ["ParameterName=entry", "DataType=0x0007", f"DefaultValue={value}"]))
    return [line for title, lines in sections for line in (f"[{title}]", *lines, "")] + [""]


def _memory(frames: int) -> str:
    """Say what a further observer holds after a tenth of the frames, and after all of them."""
    tracemalloc.start()
    mine = Ours(has_view=True)
    mine.hear(frames // 10)
    first = tracemalloc.get_traced_memory()[1]
    tracemalloc.reset_peak()
    mine.hear(frames - frames // 10)
    last = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return f"at most {first / 1024:.0f} KiB in the first tenth of {frames} frames, {last / 1024:.0f} KiB in the rest"


def _by_tshark(frames: int) -> float | None:
    """Return the CPU seconds that tshark takes for a line of each of so many frames, its start left out; None without tshark."""
    tshark = shutil.which("tshark")
    return None if tshark is None else _of_child(tshark, frames) - _of_child(tshark, 1)


def _of_child(tshark: str, frames: int) -> float:
    from canopen_transports.log_files import log_writer
    from canopen_transports.record import Record

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bus.pcap"
        writer = log_writer(path)
        now = 0
        for number in range(frames):
            writer.write(Record(now, "can0", FRAMES[number % len(FRAMES)]))
            now += TIMES[number % len(FRAMES)]
        writer.close()
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        command = [tshark, "-r", str(path), "-d", "can.subdissector,canopen"]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    """Observe the bus, and print frames per second, shares of a core, and memory."""
    parser = argparse.ArgumentParser(description="observe a full bus")
    parser.add_argument("--frames", type=int, default=10_000_000, help="default: 10000000")
    frames = parser.parse_args().frames
    print(f"| {BITRATE // 1_000_000} Mbit/s without a pause: {PER_SECOND:.0f} frames a second | frames | frames/s | of a core |")
    print("|---|---:|---:|---:|")
    for title, has_view in (("Observer", False), ("Observer and BusView", True)):
        mine = Ours(has_view=has_view)
        mine.hear(len(FRAMES))
        _row(title, frames, _seconds(lambda mine=mine: mine.hear(frames)))
        assert not mine.findings
    ours = Ours(has_view=False)
    few, many = max(frames // 50, 1), max(frames // 50, 100_000)  # a start of tshark costs as much as ten thousand frames
    _row("Observer, a line of text for each frame", few, _seconds(lambda: ours.words(few)))
    _row("canopen-monitor, likewise", few, _by_monitor(few))
    _row("tshark, likewise", many, _by_tshark(many))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"\nMemory of Observer and BusView: {_memory(max(frames // 10, 10))}; of the whole process {peak:.0f} MiB.")


def _row(title: str, frames: int, taken: float | None) -> None:
    if taken is None:
        print(f"| {title} | not installed | | |")
    else:
        print(f"| {title} | {frames} | {frames / taken:.0f} | {share(taken / frames * SECOND):.1f} % |", flush=True)


if __name__ == "__main__":
    main()
