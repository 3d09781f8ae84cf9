"""The boot-up of a network in a bus.yml: keys of Lely's dcfgen, which become `[network]` and `boot` of each node.

dcfgen makes of them the objects 0x1F80 to 0x1F8A, 0x1016 and 0x1F55 of its master (dcf-tools 2.4.2); docs/network.md has ours.
Each node of a bus.yml is in the network list.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any, Final, NamedTuple

from canopen_data.durations import duration_text
from canopen_master.ros_configurations.draft import Draft, Setting
from canopen_master.ros_configurations.report import ImportReport, YamlSection
from canopen_master.ros_configurations.yaml_text import Value
from canopen_proto import indices
from canopen_proto.machine import MICROSECOND, MILLISECOND, Time
from canopen_proto.multiplexer import mux

DEFAULT_MULTIPLIER: Final = 3
_IN_BOOT: Final = " in boot of the node"
_NMT_INHIBIT_UNIT: Final = 100 * MICROSECOND
_FLAGS: Final = (("mandatory", "mandatory", False), ("boot", "start", False), ("reset_communication", "keep_alive", True))
"""Keys of a node that are flags: ours, and whether it means the opposite."""
_NUMBERS: Final = {
    "revision_number": ("revision", 0xFFFF_FFFF), "serial_number": ("serial", 0xFFFF_FFFF),
    "software_version": ("software", 0xFFFF_FFFF), "restore_configuration": ("restore", 127),
}  # fmt: skip
"""Keys of a node that are numbers: ours, and the highest value."""


class HeartbeatWatch(NamedTuple):
    """How the master watches heartbeats, if it does (`consumes`). multiplier: heartbeat_multiplier of the options, or None."""

    multiplier: Value | None
    consumes: bool


def take_network(master: YamlSection, draft: Draft) -> None:
    """Take over how the master starts its network."""
    report, network = draft.report, draft.network
    if (value := master.take("start_nodes")) is not None:
        if _is_set(value):
            report.not_needed(value, "`canopen net boot` starts each node as soon as it is ready")
        else:
            network["start"] = "none"
            report.taken(value, 'start = "none" in [network]')
    if (value := master.take("start_all_nodes")) is not None:
        if _is_set(value):
            network.setdefault("start", "all")
        report.taken(value, f'start = "{network.get("start", "each")}" in [network]')
    for key, word in (("reset_all_nodes", "reset all"), ("stop_all_nodes", "stop all")):  # the second one goes before the first
        if (value := master.take(key)) is not None:
            if _is_set(value):
                network["mandatory_lost"] = word
            report.taken(value, f'mandatory_lost = "{network.get("mandatory_lost", "node")}" in [network]')
    for key, ours, unit in (("boot_time", "boot_time", MILLISECOND), ("nmt_inhibit_time", "nmt_pause", _NMT_INHIBIT_UNIT)):
        most = 0xFFFF_FFFF if unit == MILLISECOND else 0xFFFF
        master.into(network, key, partial(_time, most=most, unit=unit), ours, " in [network]")


def take_boot(node: YamlSection, draft: Draft, watch: HeartbeatWatch) -> dict[str, Any]:
    """Return `boot` of a node."""
    report = draft.report
    boot: dict[str, Any] = {}
    for key, ours, is_opposite in _FLAGS:
        node.into(boot, key, partial(_is_set, is_opposite=is_opposite), ours, _IN_BOOT)
    for key, (ours, most) in _NUMBERS.items():
        node.into(boot, key, partial(Value.integer, least=0, most=most), ours, _IN_BOOT)
    _take_program(node, boot, draft)
    _take_heartbeat(node, boot, report, watch)
    _take_guarding(node, boot, report)
    return boot


def settings_of_boot(node: YamlSection, report: ImportReport) -> Iterator[Setting]:
    """Return the objects that keys of a node are, and that a DCF can hold."""
    if (value := node.take("time_cob_id")) is not None:
        yield Setting(mux(indices.COB_ID_TIME_STAMP), value.string(), value, value)
    errors = node.take("error_behavior")
    if errors is None or errors.kind == "null":
        return
    errors.check("map")
    for text, value in errors.entries.items():
        if not (text.isdigit() and 1 <= int(text) <= 254):
            raise value.failure("a subindex of 0x1029 is 1..254")
        yield Setting(mux(indices.ERROR_BEHAVIOR, int(text)), value.string(), value, value)


def _take_program(node: YamlSection, boot: dict[str, Any], draft: Draft) -> None:
    value = node.take("software_file")
    if value is None:
        return
    path = draft.file_beside(value, value.string(), "")
    if path is None:
        return
    if not boot.get("software"):
        draft.report.left_out(value, "without software_version nothing tells whether the node needs it")
        return
    boot["program"] = str(path)
    draft.report.taken(value, "program in boot of the node")


def _take_heartbeat(node: YamlSection, boot: dict[str, Any], report: ImportReport, watch: HeartbeatWatch) -> None:
    producer = node.take("heartbeat_producer")
    if producer is None:
        return
    own = node.take("heartbeat_multiplier")
    times = watch.multiplier if own is None else own
    period = producer.integer(0, 0xFFFF)
    boot["heartbeat"] = f"{period}ms"
    if not watch.consumes:
        boot["heartbeat_timeout"] = "0"
    elif period and times is not None and (factor := times.number()) != DEFAULT_MULTIPLIER:
        timeout = int(period * factor)  # as dcfgen rounds: 0x1016 holds whole milliseconds
        if period < timeout <= 0xFFFF:
            boot["heartbeat_timeout"] = f"{timeout}ms"
        else:
            report.left_out(
                times, f"a node with a heartbeat each {period} ms cannot be lost after {timeout} ms; three times it is"
            )


def _take_guarding(node: YamlSection, boot: dict[str, Any], report: ImportReport) -> None:
    guard, factor, retries = node.take("guard_time"), node.take("life_time_factor"), node.take("retry_factor")
    given = [each for each in (guard, factor, retries) if each is not None]
    milliseconds = 0 if guard is None else guard.integer(0, 0xFFFF)
    lives = DEFAULT_MULTIPLIER if factor is None else factor.integer(0, 0xFF)
    if not milliseconds or not lives or boot.get("heartbeat", "0ms") != "0ms":
        for each in given:
            report.not_needed(each, "the node is not guarded: it has a heartbeat, or guard_time or life_time_factor is 0")
        return
    for key in ("heartbeat", "heartbeat_timeout"):
        boot.pop(key, None)
    boot |= {"guard_time": f"{milliseconds}ms", "life_time_factor": lives}
    for each in given:
        if each is retries and each.integer(0, 0xFF) != lives:
            report.left_out(each, f"the master counts as the node does: life_time_factor = {lives}")
        else:
            report.taken(each, f'guard_time = "{milliseconds}ms", life_time_factor = {lives} in boot of the node')


def _time(value: Value, most: int, unit: Time) -> str:
    return duration_text(value.integer(0, most) * unit)


def _is_set(value: Value, *, is_opposite: bool = False) -> bool:
    """Return a flag; dcfgen takes numbers, too. is_opposite: ours says the opposite."""
    return (value.truth() if value.kind == "bool" else bool(value.integer(0, 1))) is not is_opposite
