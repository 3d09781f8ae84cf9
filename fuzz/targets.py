"""Bodies of the fuzz targets: ordinary functions of bytes, which the normal tests run too (tests/core/test_fuzz_corpus.py).

The oracle is one sentence of the core's contract: nothing but LocalProtocolError may be raised, and that only by a wrong call of
our own side. Besides: each request has one outcome, served time does not want to be served again, memory is bounded. Two targets
know more than that, namely what is true: `sdo_pair` (two_ended.py) and `heartbeat`.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Final

from canopen_data.csv import load_csv
from canopen_data.eds import read_eds
from canopen_data.eds.ini import MAX_FINDINGS
from canopen_data.findings import DictionaryError
from canopen_data.xdd import read_xdd
from canopen_master.machine_file import machine_text, parse_machine
from canopen_proto.dictionary import Values
from canopen_proto.frame import Frame
from canopen_proto.gateway import (
    DIALECTS,
    GatewayAnswered,
    GatewayClient,
    GatewayCommand,
    GatewayLines,
    GatewayRequest,
    parse_message,
    parse_request,
    print_answer,
    print_request,
)
from canopen_proto.gateway.client import PATIENCE
from canopen_proto.heartbeat import HeartbeatConsumer, HeartbeatLost, HeartbeatReceived, HeartbeatRecovered, NodeBooted
from canopen_proto.machine import SECOND, LocalProtocolError, Machine, Outbox, Outcome, RequestId, Time
from canopen_proto.sdo.client import Block, SdoAborted, SdoClient, SdoDownloaded, SdoStreamUploaded, SdoUploaded
from canopen_proto.sdo.server import SdoServer
from canopen_proto.sdo.store import ValuesStore
from fuzz.steps import decode
from fuzz.two_ended import sdo_pair
from tests.core.devices import io_device
from tests.data.subjects import LocalSubject, RemoteSubject, held

LARGEST_TRANSFER: Final = 64
MOST_STEPS: Final = 2000
_DICTIONARY: Final = io_device()


def local_node(data: bytes) -> None:
    """A device."""
    _drive(LocalSubject(), data)


def remote_node(data: bytes) -> None:
    """A master's view of a device."""
    _drive(RemoteSubject(), data)


def _drive(subject: LocalSubject | RemoteSubject, data: bytes) -> None:
    for count, step in enumerate(decode(data)):
        if count >= MOST_STEPS:
            break
        if isinstance(step, Frame):
            subject.receive(step)
        elif step[0] == "wait":
            subject.pass_time(step[1])
        else:
            subject.act(step[1])
    subject.check()


def sdo_client(data: bytes) -> None:
    """An SDO client that stands alone; its own side uploads, downloads, in blocks and as streams too, and cancels."""
    client = SdoClient(Outbox(), 5, max_upload=LARGEST_TRANSFER, max_queue=1 << 16)
    client.copy_guard = 50_000_000 if data[:1] > b"\x80" else 0
    now: Time = 0
    open_requests: set[RequestId] = set()

    def settle() -> None:
        for report in client.out.events:
            if isinstance(report, Outcome):
                assert isinstance(report, SdoUploaded | SdoDownloaded | SdoStreamUploaded | SdoAborted)
                open_requests.remove(report.request_id)
                assert not isinstance(report, SdoUploaded) or len(report.data) <= LARGEST_TRANSFER
        client.out.events.clear()
        client.out.frames.clear()

    for step in decode(data):
        if isinstance(step, Frame):
            client.receive(step, now)
        elif step[0] == "wait":
            now = _wake(client, now, now + step[1])
        else:
            _ask(client, open_requests, step[1] % 8, step[1] >> 3, now)
        settle()
    for _ in range(9 * len(open_requests) + 9):  # nobody answers: each waits for guards, and for strangers
        now = _wake(client, now, max(now, client.deadline)) if client.busy else now
        settle()
    assert not client.busy
    assert not open_requests
    assert held(client) < 4000


def _ask(client: SdoClient, open_requests: set[RequestId], choice: int, size: int, now: Time) -> None:
    """One act of the client's own side. A stream that is not the one under way refuses to go on."""
    block: Block = (False, True, "auto")[size // 64 % 3]
    match choice:
        case 0 | 1:
            open_requests.add(client.upload(0x2000 + size % 3, 0, now, urgent=size % 5 == 0, block=block))
        case 2 | 3:
            open_requests.add(client.download(0x2000, size % 3, bytes(size % 30), now, block=block))
        case 4:
            for request_id in sorted(open_requests)[: size % 3]:
                client.cancel(request_id, now)
        case 5:
            client.abort_all(0x08000000, now)
        case 6:
            open_requests.add(
                client.upload_stream(0x2000, 0, now)
                if size % 2
                else client.download_stream(0x2000, 0, now, size=size % 60 or None)
            )
        case _:
            for request_id in sorted(open_requests):
                client.proceed(request_id, now)
                with suppress(LocalProtocolError):
                    client.feed(request_id, bytes(size % 70), now, last=size % 2 == 1)


def sdo_server(data: bytes) -> None:
    """An SDO server over a dictionary: whatever is written, its values stay such that they can be read."""
    values = Values(_DICTIONARY, 5)
    server = SdoServer(Outbox(), 5, ValuesStore(values), max_download=LARGEST_TRANSFER)
    now: Time = 0
    for step in decode(data):
        if isinstance(step, Frame):
            server.receive(step, now)
        elif step[0] == "wait":
            now = _wake(server, now, now + step[1])
        elif step[1] % 3 == 0:
            server.reset()
        elif step[1] % 3 == 1:
            server.disable()
        else:
            server.enable()
        assert all(len(frame.data) == 8 for frame in server.out.frames)
        server.out.frames.clear()
        server.out.events.clear()
    for variable in _DICTIONARY:
        assert variable.decode(values.raw(variable.index, variable.subindex)) == values[variable.mux]
    assert held(server) < 5000


def _wake(machine: Machine, now: Time, end: Time) -> Time:
    """Serve a machine's deadlines up to a time, which comes back: some when they are due, the rest late."""
    for _ in range(40):
        if machine.deadline > end:
            return end
        now = max(now, machine.deadline)
        machine.handle_timeout(now)
    for _ in range(MOST_STEPS):  # all that wait may be late
        machine.handle_timeout(end)
    assert machine.deadline > end
    return end


def csv_files(data: bytes) -> None:
    """The readers of the three CSV files: one text, cut at NULs. An error is a DictionaryError with its place."""
    texts = data.decode("utf-8", errors="replace").split("\x00")
    indices, constants, pdos = (*texts, "", "")[:3] if len(texts) < 3 else texts[:3]
    try:
        dictionary, _ = load_csv(indices, constants, pdos)
    except DictionaryError as error:
        if not error.findings:
            raise
        return
    for variable in dictionary:
        assert dictionary.variable(variable.name).index == variable.index
    for pdo in dictionary.pdos:
        assert pdo.bit_length <= 64


def xdd_files(data: bytes) -> None:
    """The reader of XDD and XDC. Whatever the bytes are, it gives a description that can be used, and places for it."""
    description = read_xdd(data, "any.xdd")
    assert len(description.findings) <= MAX_FINDINGS + 1
    for variable in description.dictionary:
        for value in (variable.default, variable.configured):
            assert value is None or variable.encode(value) is not None
        assert description.place_of(variable.index, variable.subindex, "DefaultValue")[0] >= 1


def eds_files(data: bytes) -> None:
    """The reader of EDS and DCF: the same."""
    description = read_eds(data, "any.eds")
    assert len(description.findings) <= MAX_FINDINGS + 1
    for variable in description.dictionary:
        for value in (variable.default, variable.configured):
            assert value is None or isinstance(value, str) or variable.encode(value) is not None
        line, column = description.place_of(variable.index, variable.subindex, "DefaultValue")
        # Both stand for whole objects, which have no section of their own
        assert line >= 1 <= column or description.device_info.compact_pdo or description.connected_modules


def machine_files(data: bytes) -> None:
    """The reader of machine files. A machine that it takes is written and read back; an error has its place."""
    text = data.decode("utf-8", errors="replace")
    try:
        machine = parse_machine(text)
    except DictionaryError as error:
        if not error.findings:
            raise
        assert all(finding.line <= text.count("\n") + 1 for finding in error.findings)
        return
    written = machine_text(machine)
    assert machine_text(parse_machine(written)) == written  # so, as nan is not nan


def heartbeat(data: bytes) -> None:
    """A heartbeat consumer: a node is lost when, and only when, its time is over (CiA 301 v4.2.0, 7.2.8.3.2.2 and 7.5.2.19).

    Each byte is a heartbeat (0..99), a boot-up (100..127), or so many tenths of the consumer time that pass (128 and on).
    """
    timeout, now = SECOND, 0
    consumer = HeartbeatConsumer(Outbox(), 5, timeout)
    heard_at: Time | None = None  # since when it is watched and lives
    for byte in data[:MOST_STEPS]:
        if byte >= 128:
            end = now + (byte - 128) % 16 * timeout // 10
            if consumer.deadline <= end:
                now = consumer.deadline
                consumer.handle_timeout(now)
            is_over = heard_at is not None and end >= heard_at + timeout
            lost = [report for report in consumer.out.events if isinstance(report, HeartbeatLost)]
            assert len(lost) == is_over
            if is_over and heard_at is not None:
                assert now == heard_at + timeout
                heard_at = None
            now = end
        else:
            boots = byte >= 100
            was_lost = consumer.lost
            consumer.receive(Frame(0x705, bytes((0 if boots else 5,))), now)
            kinds = [type(report) for report in consumer.out.events]
            assert kinds[0] is (NodeBooted if boots else HeartbeatReceived)
            assert (HeartbeatRecovered in kinds) == (was_lost and not boots)
            if not boots or heard_at is not None:
                heard_at = now
        consumer.out.events.clear()


def gateway_text(data: bytes) -> None:
    """The text protocol of CiA 309-3, in both dialects: any bytes are lines of bounded length; each line is a request that can be
    typed again, a refusal, or nothing; and a client that hears these bytes gives each of its requests one outcome."""
    for dialect in DIALECTS.values():
        lines = GatewayLines(limit=200)
        for line in lines.feed(data):
            request = parse_request(line, dialect)
            if isinstance(request, GatewayRequest):
                assert parse_request(print_request(request, dialect), dialect) == request
            elif request is not None:
                assert parse_message(print_answer(request, dialect).removesuffix(dialect.line_end)) == request
        assert lines.pending <= 200
        client = GatewayClient(dialect)
        sent = {client.send(GatewayRequest(GatewayCommand.READ, numbers=(0x1000, 0)), 0) for _ in range(3)}
        client.receive(data, 0)
        client.handle_timeout(PATIENCE)
        answered = [each.request.sequence for each in client.take_messages() if isinstance(each, GatewayAnswered)]
        assert sorted(answered) == sorted(sent)


TARGETS: Final[dict[str, Callable[[bytes], None]]] = {
    target.__name__: target
    for target in (
        local_node,
        remote_node,
        sdo_client,
        sdo_server,
        sdo_pair,
        heartbeat,
        csv_files,
        xdd_files,
        eds_files,
        machine_files,
        gateway_text,
    )
}
