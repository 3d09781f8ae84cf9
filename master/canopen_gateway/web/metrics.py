"""Numbers for Prometheus, at `/metrics`: of the buses, the nodes, the chains, and the requests of the gateway.

All of it was counted or heard anyway: a scrape sends nothing on a bus. Made anew for each scrape, so nothing is kept twice.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import accumulate
from typing import Final, TypeAlias

from prometheus_client import CollectorRegistry
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.exposition import CONTENT_TYPE_LATEST, generate_latest
from prometheus_client.registry import Collector

from canopen_gateway.plain_data import STATE_WORDS, node_ids
from canopen_gateway.request_times import BOUNDS
from canopen_gateway.service import GatewayService
from canopen_proto.machine import SECOND
from canopen_transports.errors import BusState

METRICS_TYPE: Final = CONTENT_TYPE_LATEST
EventCounts: TypeAlias = "Mapping[tuple[str, int, str], int]"


def metrics_text(service: GatewayService, events: EventCounts) -> bytes:
    """Return all numbers, in Prometheus's text format. events: those that were heard, counted by net, node and kind."""
    registry = CollectorRegistry(auto_describe=False)
    registry.register(_MachineCollector(service, events))
    return generate_latest(registry)


class _MachineCollector(Collector):
    def __init__(self, service: GatewayService, events: EventCounts) -> None:
        self._service = service
        self._events = events

    def describe(self) -> list[Metric]:
        return []

    def collect(self) -> Iterator[Metric]:
        yield from self._of_buses()
        yield from self._of_nodes()
        yield from self._of_chains()
        yield from self._of_requests()
        yield self._of_events()

    def _of_buses(self) -> Iterator[Metric]:
        bits = CounterMetricFamily(
            "canopen_bus_bits", "Bits of all frames sent and heard; rate() / bitrate is the load.", labels=["net"]
        )
        rate = GaugeMetricFamily("canopen_bus_bitrate", "Bits per second, where the interface tells them.", labels=["net"])
        state = GaugeMetricFamily(
            "canopen_bus_state",
            "1 for the present state of the interface (fault confinement, ISO 11898-1).",
            labels=["net", "state"],
        )
        waiting = GaugeMetricFamily("canopen_bus_frames_waiting", "Frames that wait to be sent.", labels=["net"])
        for net in self._service.nets:
            bus = self._service.master.bus(net)
            bits.add_metric([net], bus.bits)
            waiting.add_metric([net], bus.pending)
            if bus.bitrate is not None:
                rate.add_metric([net], bus.bitrate)
            for each in BusState:
                state.add_metric([net, each.value], float(bus.state is each))
        yield from (bits, rate, state, waiting)

    def _of_nodes(self) -> Iterator[Metric]:
        labels = ["net", "node"]
        state = GaugeMetricFamily("canopen_node_state", "1 for the NMT state that was last heard.", labels=[*labels, "state"])
        silent = GaugeMetricFamily("canopen_node_silent_seconds", "Seconds since anything was heard of a node.", labels=labels)
        emcy = GaugeMetricFamily(
            "canopen_node_emergency", "The last emergency error code; 0: all errors are gone.", labels=labels
        )
        drive = GaugeMetricFamily(
            "canopen_drive_state", "1 for the state of a drive (CiA 402).", labels=[*labels, "axis", "state"]
        )
        master = self._service.master
        now = master.now()
        for net in self._service.nets:
            network = master.bus(net).network
            for node_id in node_ids(master, net):
                heard = network.heard(node_id)
                for each, words in STATE_WORDS.items():
                    state.add_metric([net, str(node_id), words], float(heard.state is each))
                if heard.time is not None:
                    silent.add_metric([net, str(node_id)], (now - heard.time) / SECOND)
                if heard.emcy is not None:
                    emcy.add_metric([net, str(node_id)], heard.emcy.error_code)
        for device in master.devices.values():
            place = [device.node.bus, str(device.node.node_id), str(device.axis.number)]
            drive.add_metric([*place, str(device.state)], 1)
        yield from (state, silent, emcy, drive)

    def _of_chains(self) -> Iterator[Metric]:
        sent = CounterMetricFamily("canopen_chain_sync", "SYNC cycles of a chain.", labels=["chain"])
        missed = CounterMetricFamily("canopen_chain_missed_cycles", "SYNCs without a new set-point.", labels=["chain"])
        skipped = CounterMetricFamily("canopen_chain_skipped_cycles", "Periods without a SYNC.", labels=["chain"])
        for chain in self._service.master.chains.values():
            sent.add_metric([chain.name], chain.sync_cycles)
            missed.add_metric([chain.name], chain.missed_cycles)
            skipped.add_metric([chain.name], chain.skipped_cycles)
        yield from (sent, missed, skipped)

    def _of_events(self) -> Metric:
        labels = ["net", "node", "kind"]
        events = CounterMetricFamily("canopen_events", "Boot-ups, emergencies, changed states, lost heartbeats.", labels=labels)
        for place, count in self._events.items():
            events.add_metric(list(map(str, place)), count)
        return events

    def _of_requests(self) -> Iterator[Metric]:
        took = HistogramMetricFamily("canopen_request_seconds", "SDO requests of this gateway's clients.", labels=["net"])
        failed = CounterMetricFamily("canopen_request_failures", "Those that ended with an error.", labels=["net"])
        clients = GaugeMetricFamily("canopen_gateway_clients", "Clients of the gateway.")
        for net, times in self._service.request_times.nets.items():
            bounds = [*map(str, BOUNDS), "+Inf"]
            took.add_metric([net], list(zip(bounds, map(float, accumulate(times.counts)), strict=True)), times.total)
            failed.add_metric([net], times.failed)
        clients.add_metric([], len(self._service.sessions))
        yield from (took, failed, clients)
