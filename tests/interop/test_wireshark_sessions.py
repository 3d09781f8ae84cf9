"""Each frame of each recorded session: the observer says what Wireshark says, where Wireshark knows the service.

The text that the observer has to give is made of Wireshark's fields alone. Of SDO block transfers Wireshark 4.0 knows the
frames around the blocks, and takes the segments for other commands: see test_wireshark_sdo. It never puts the frames of a
transfer together: whole values are compared in test_decoding.
"""

from __future__ import annotations

import datetime
import re
from collections import Counter

import pytest

from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND
from canopen_proto.observer.meaning import Meaning
from canopen_proto.observer.observer import Observer
from tests.examples import takes_all
from tests.interop.cct_session import SESSION
from tests.interop.pcap import TSHARK, Packet, check_whole, read_by_wireshark
from tests.interop.recorded import FOLDER, load, needs_recordings

pytestmark = [
    needs_recordings,
    pytest.mark.skipif(TSHARK is None, reason="tshark is not installed (apt-get install tshark)"),
]

LINES_OF_TOOL = 100_000 if takes_all() else 2500
"""Of the conformance tool's session, which is long."""

KINDS = {
    "NMT": "NMT",
    "NMT Error Control": "(heartbeat|boot-up)",
    "EMCY": "EMCY",
    "SYNC": "SYNC",
    "TIME STAMP": "TIME",
    "LSS (Master)": "LSS",
    "LSS (Slave)": "LSS",
    "Default-SDO (rx)": "SDO",
    "Default-SDO (tx)": "SDO",
    **{f"PDO{number} ({side})": f"{name} {number}" for number in range(1, 5) for side, name in (("tx", "TPDO"), ("rx", "RPDO"))},
}
"""Wireshark's word for a service; ours."""
COMMANDS = {
    1: "start",
    2: "stop",
    0x80: "enter pre-operational",
    0x81: "reset node",
    0x82: "reset communication",
}
STATES = {0: "", 4: "stopped", 5: "operational", 0x7F: "pre-operational"}
REGISTER = {
    "ge": "generic",
    "cu": "current",
    "vo": "voltage",
    "te": "temperature",
    "co": "communication",
    "de": "device profile",
    "ma": "manufacturer",
}
OBJECT = "[0-9A-F]{4}:[0-9A-F]{2}( .*)?"
IN_BLOCK = re.compile("block segment [0-9]|: in blocks|go on, [0-9]+ segments a block")
"""Segments of blocks, and initiate frames with CRC: Wireshark takes them for segments of segmented transfers."""
LONE = "part of a transfer whose beginning was not heard: .*"


def words(packet: Packet) -> str:
    """The text that the observer has to give, as a regular expression."""
    if packet.kind == "NMT":
        target = packet["nmt_ctrl.node_id"]
        return f"{COMMANDS[packet['nmt_ctrl.cd']]}: {f'node {target}' if target else 'all nodes'}"
    if packet.kind == "NMT Error Control":
        return STATES[packet["nmt_guard.state"]]
    if packet.kind == "EMCY":
        names = [word for bit, word in REGISTER.items() if packet[f"em.err_reg_{bit}"]]
        rest = packet["em.err_field"]
        register = f"error register 0x{packet['em.err_reg']:02X}" + (rf" \({', '.join(names)}\)" if names else "")
        return f"0x{packet['em.err_code']:04X} .*, {register}" + (f", {rest.hex(' ')}" if any(rest) else "")
    if packet.kind == "SYNC":
        return "" if packet["sync.counter"] is None else f"counter {packet['sync.counter']}"
    if packet.kind == "TIME STAMP":
        since = datetime.timedelta(days=packet["time_stamp_days"], milliseconds=packet["time_stamp_ms"])
        return re.escape(str(datetime.datetime(1984, 1, 1, tzinfo=datetime.UTC) + since))
    if packet.kind.startswith("LSS"):
        return lss(packet)
    if packet.kind.startswith("Default-SDO"):
        return sdo(packet)
    data = (packet["pdo.data.bytes"] or b"").hex(" ")
    return f"{data or 'no data|nothing'}|.* = .*|shorter than its mapping of . bytes: {data or 'no data'}"


def lss(packet: Packet) -> str:
    """Its text for an LSS frame."""
    for name in ("vendor", "product", "revision", "serial"):
        value = packet[f"lss.addr.{name}"]
        if value is not None:
            return f".*{name}.* 0x{value:08X}"
    node_id = packet["lss.nid"]
    return f".*{node_id}.*" if node_id is not None else ".+"


def sdo(packet: Packet) -> str:
    """Its text for an SDO frame."""
    is_request = packet.kind.endswith("(rx)")
    service = packet["sdo.ccs" if is_request else "sdo.scs"]
    index, subindex = packet["sdo.main_idx"], packet["sdo.sub_idx"]
    mux = OBJECT if index is None else f"{index:04X}:{subindex:02X}"
    if service == 4:
        return rf"aborted by the {'client' if is_request else 'server'}, {mux}.*: .*0x{packet['sdo.abort_code']:08X}.*"
    if service in (5, 6, 7):
        return f"(read|write|written) {mux}.*|a block transfer is confirmed|{LONE}"
    verb = "read" if (service == 2) else "write"
    if service == (1 if is_request else 2):
        if not packet["sdo.e"]:
            return f"{verb} {mux}.*: in segments.*"
        data = packet["sdo.data.bytes"]
        return f"{verb} {mux}.* = .*{value(data[: len(data) - packet['sdo.n']])}.*"
    if service == 2:
        return f"read {mux}.*"
    if service == 3:
        return f"read {OBJECT}: next segment|{LONE}" if is_request else f"written {mux}.*|write {mux}.*: go on"
    if service == 1:
        return f"write {OBJECT}: segment confirmed|written {OBJECT}|a segment is confirmed"
    verb = "write" if is_request else "read"
    return (f"{verb} {OBJECT} = .*" if packet["sdo.c"] else f"{verb} {OBJECT}: segment, .* bytes so far") + f"|{LONE}"


def value(data: bytes) -> str:
    """The value of an expedited transfer: objects of the standard have their type, the type of others nobody knows here."""
    number = int.from_bytes(data, "little")
    return rf"({number}\b|0x0*{number:X}\b|{data.hex(' ')}|'.*')"


def session() -> list[Frame]:
    """All frames of all recorded sessions, one after the other."""
    frames = [line.frame for path in sorted(FOLDER.glob("*.log")) for line in load(path.stem)]
    tool = FOLDER / SESSION
    texts = tool.read_text().splitlines()[:LINES_OF_TOOL] if tool.exists() else []
    return frames + [Frame.parse(text[2:]) for text in texts if text[0] in "<>"]


def is_right(packet: Packet, meaning: Meaning) -> bool:
    """Whether a line says what Wireshark says."""
    if not re.fullmatch(KINDS[packet.kind], meaning.service):
        return False
    if packet.kind.startswith(("Default", "PDO", "EMCY", "NMT E")) and meaning.node_id != packet["node_id"]:
        return False
    return IN_BLOCK.search(meaning.text) is not None or re.fullmatch(words(packet), meaning.text) is not None


def test_each_frame_is_what_wireshark_says(tmp_path_factory: pytest.TempPathFactory) -> None:
    frames = session()
    packets = read_by_wireshark(tmp_path_factory.mktemp("wireshark") / "recorded.pcap", frames)
    observer = Observer()
    counts: Counter[str] = Counter()
    for number, packet in enumerate(packets):
        meaning = observer.observe(packet.frame, number * MILLISECOND).meaning
        counts[packet.kind] += 1
        assert is_right(packet, meaning), (packet, words(packet), meaning.service, meaning.text)
    check_whole(packets)
    assert counts.keys() == KINDS.keys() - {"PDO2 (rx)", "PDO3 (tx)", "PDO3 (rx)", "PDO4 (tx)", "PDO4 (rx)"}
