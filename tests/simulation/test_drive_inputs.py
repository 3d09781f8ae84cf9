"""The simulated drive's touch probes, digital inputs and second encoder."""

from __future__ import annotations

import pytest

from canopen_proto.abort import AbortCode
from canopen_proto.machine import MILLISECOND
from canopen_proto.simulation.drive.events import InputsChanged
from canopen_proto.simulation.drive.settings import DriveSettings, Shape, Track
from tests.simulation.drive_bench import Bench

PROBES = ((2_000.0, 3_000.0), (-5_000.0, -4_000.0))
TRACK = Track(index_offset=100, index_distance=1_000, probes=PROBES)
ENABLED, POSITIVE, NEGATIVE, POSITIVE_TOGGLE = 0x01, 0x02, 0x04, 0x40
FIRST, EACH, INDEX, RISING, FALLING = 0x01, 0x03, 0x04, 0x10, 0x20


def bench_at(position: float, function: int, lag: int = 0) -> Bench:
    bench = Bench(DriveSettings(position=position, track=TRACK, lag=lag))
    bench.preset(0x6081, 40_000)
    bench.preset(0x6083, 10_000_000)
    bench.preset(0x6084, 10_000_000)
    bench.enable(1)
    bench.write(0x60B8, function)
    return bench


def go(bench: Bench, *targets: int) -> None:
    for target in targets:
        bench.write(0x607A, target)
        bench.control(0x2F, 0x3F, 0x2F)
        bench.run(1_000)


@pytest.mark.parametrize("lag", [0, 20 * MILLISECOND])
def test_both_edges_of_a_probe_are_latched_where_they_lie(lag: int) -> None:
    bench = bench_at(0, FIRST | RISING | FALLING, lag)
    assert bench.read(0x60B9) == ENABLED
    go(bench, 10_000)
    assert bench.read(0x60B9) == ENABLED | POSITIVE | NEGATIVE
    assert (bench.read(0x60BA), bench.read(0x60BB)) == (2_000, 3_000)
    assert (bench.read(0x60D5), bench.read(0x60D6)) == (1, 1)
    go(bench, 0)  # backwards the edges lie at the other ends; but only the first ones are latched
    assert (bench.read(0x60BA), bench.read(0x60BB)) == (2_000, 3_000)
    bench.write(0x60B8, 0)
    assert bench.read(0x60B9) == 0
    bench.write(0x60B8, FIRST | RISING | FALLING)  # armed anew
    assert bench.read(0x60B9) == ENABLED
    go(bench, 10_000, 0)
    assert (bench.read(0x60BA), bench.read(0x60BB)) == (2_000, 3_000)


def test_backwards_the_edges_are_at_the_other_ends() -> None:
    bench = bench_at(10_000, FIRST | RISING | FALLING)
    go(bench, 0)
    assert (bench.read(0x60BA), bench.read(0x60BB)) == (3_000, 2_000)


def test_each_edge_is_latched_counted_and_toggles_a_bit() -> None:
    bench = bench_at(0, EACH | RISING)
    for number in range(1, 4):
        go(bench, 10_000 if number & 1 else 0)
        assert bench.read(0x60BA) == (2_000 if number & 1 else 3_000)
        assert bench.read(0x60D5) == number
        assert bool(bench.read(0x60B9) & POSITIVE_TOGGLE) is bool(number & 1)
    assert bench.read(0x60D6) == 0  # the other edge is not armed


def test_an_edge_is_armed_alone() -> None:
    bench = bench_at(0, FIRST | RISING | FALLING)
    go(bench, 10_000)
    bench.write(0x60B8, FIRST | FALLING)
    assert bench.read(0x60B9) == ENABLED | NEGATIVE
    bench.write(0x60B8, FIRST | RISING | FALLING)
    go(bench, 0)
    assert (bench.read(0x60BA), bench.read(0x60BB)) == (3_000, 3_000)


def test_the_second_probe_has_the_high_bytes() -> None:
    bench = bench_at(0, (FIRST | RISING) << 8)
    go(bench, -10_000)
    assert bench.read(0x60B9) == (ENABLED | POSITIVE) << 8
    assert (bench.read(0x60BC), bench.read(0x60BD), bench.read(0x60D7)) == (-4_000, 0, 1)


def test_the_index_pulse_as_a_source() -> None:
    bench = bench_at(0, FIRST | INDEX | RISING)
    go(bench, 5_000)
    assert bench.read(0x60BA) == 100
    bench = bench_at(0, EACH | INDEX | RISING)
    go(bench, 5_000)
    assert (bench.read(0x60BA), bench.read(0x60D5)) == (4_100, 5)
    go(bench, 0)
    assert (bench.read(0x60BA), bench.read(0x60D5)) == (100, 10)


def test_positions_count_from_the_reference() -> None:
    bench = bench_at(500, 0)
    bench.write(0x6098, 37)
    bench.write(0x6060, 6)
    bench.control(0x0F, 0x1F)
    bench.run(100)
    bench.write(0x6060, 1)
    bench.write(0x60B8, FIRST | RISING)
    go(bench, 5_000)
    assert bench.read(0x60BA) == 1_500


def test_an_edge_before_the_probe_was_armed_does_not_count() -> None:
    bench = bench_at(0, 0)
    bench.write(0x607A, 10_000)
    bench.control(0x2F, 0x3F)
    bench.now += round(55 * MILLISECOND)  # nobody has looked since: the axis is at about 2200
    bench.write(0x60B8, FIRST | RISING | FALLING)
    bench.run(1_000)
    assert (bench.read(0x60B9), bench.read(0x60BA), bench.read(0x60BB)) == (ENABLED | NEGATIVE, 0, 3_000)


@pytest.mark.parametrize("word", [0x08, 0x0C, 0x40, 0x80, 0x0800, 0x4000])
def test_reserved_bits_and_sources_are_refused(word: int) -> None:
    assert Bench().drive.check_write(0x60B8, 0, word) is AbortCode.INVALID_VALUE


def test_changed_inputs_are_told() -> None:
    bench = bench_at(0, FIRST | RISING)
    bench.out.events.clear()
    go(bench, 2_500)
    told = [event.mux >> 8 for event in bench.out.events if isinstance(event, InputsChanged)]
    assert sorted(told) == [0x60B9, 0x60FD]
    assert bench.read(0x60FD) == 0b100 | 1 << 16


def test_the_second_encoder_keeps_its_zero() -> None:
    bench = Bench(DriveSettings(position=3_000, second_encoder=0.5))
    assert bench.read(0x60E4, 1) == 1_500
    bench.write(0x6098, 37)
    bench.enable(6)
    bench.control(0x1F)
    bench.run(100)
    assert (bench.position, bench.read(0x60E4, 1)) == (0, 1_500)


def test_a_drive_without_probes_has_none() -> None:
    bench = Bench(DriveSettings(shape=Shape.SCHUNK_POWERBALL))
    assert 0x60B9_00 not in bench.values.store
