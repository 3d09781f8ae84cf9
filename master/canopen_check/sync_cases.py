"""Chapter 6 of the conformance test: SYNC (CiA 301 v4.2.0, 7.2.5, 7.5.2.5, 7.5.2.6, 7.5.2.22).

Most cases are about a device that produces SYNC; they do not apply to a device that cannot. A period (0x1006) that is not 0 by
default is set to 0 first. A reset undoes that; a case that stores puts the period back itself.
"""

from __future__ import annotations

from typing import Final

from canopen_check.bench import ANSWER_TIME, Bench
from canopen_check.bench import SYNC_PRODUCER as PRODUCER
from canopen_check.case import Case, for_each
from canopen_check.expectations import expect_refusal
from canopen_check.pdo_cases import expect_data
from canopen_check.pdo_tools import Pdo, key_of, set_up, usable
from canopen_check.sdo_cases import SYNC_OVERFLOW, TOO_HIGH, TOO_LOW
from canopen_check.storing_cases import keep, save
from canopen_proto.abort import AbortCode
from canopen_proto.dictionary import Direction
from canopen_proto.explained import counted
from canopen_proto.frame import SYNC, key_of_cob_id
from canopen_proto.indices import COB_ID_SYNC, COMMUNICATION_CYCLE_PERIOD
from canopen_proto.machine import MICROSECOND, MILLISECOND, SECOND
from canopen_proto.nmt import NmtCommand
from canopen_proto.parameter_storage import STORE
from canopen_proto.procedures.steps import Procedure
from canopen_proto.verdict import does_not_apply, expect, expect_equal

PERIOD: Final = 100 * MILLISECOND
COUNTED: Final = 10 * SECOND

EACH_TENTH: Final = 10
"""The transmission type of the TPDOs that are counted; SYNCS is the number of SYNCs that they get."""
SYNCS: Final = 100

NOT_WHILE_RUNNING: Final = (AbortCode.DEVICE_STATE, AbortCode.GENERAL_ERROR)
RESERVED_VALUE: Final = tuple(dict.fromkeys((*TOO_HIGH, *TOO_LOW)))


def default_cob_id(bench: Bench) -> Procedure[None]:
    """6.1: the CAN-ID is 0x80, and the rest of the COB-ID is as described."""
    yield from bench.expect_default(COB_ID_SYNC, 0, "after a reset")
    can_id = key_of_cob_id((yield from bench.number(COB_ID_SYNC)))
    expect_equal(can_id, SYNC, "the default CAN-ID of SYNC")


def produce(bench: Bench, overflow: int | None = None) -> Procedure[None]:
    """Make the device send SYNC; if it cannot, the case does not apply. overflow: value for 0x1019, None to leave it alone."""
    yield from bench.silence_sync()
    bench.probe.listen_also(bench.sync_key)
    if overflow is not None:
        yield from bench.write(SYNC_OVERFLOW, 0, overflow)
    yield from bench.write(COMMUNICATION_CYCLE_PERIOD, 0, PERIOD // MICROSECOND)
    if (yield from bench.refusal_of_write(COB_ID_SYNC, 0, bench.default(COB_ID_SYNC) | PRODUCER)) is not None:
        does_not_apply("the device cannot produce SYNC")


def count_syncs(bench: Bench) -> Procedure[str]:
    """6.2: one SYNC per communication cycle period."""
    yield from produce(bench)
    heard = yield from bench.expect_period(bench.sync_key, COUNTED, PERIOD, "SYNC")
    return counted(len(heard), "SYNC")


def count_tpdos(bench: Bench) -> Procedure[str]:
    """6.3: SYNC (sent by us, as by CiA's tool) triggers TPDOs: a TPDO of type 10 comes once for ten SYNCs."""
    pdos = usable(bench, Direction.TPDO)
    yield from bench.silence_sync()
    for pdo in pdos:
        if not (yield from set_up(bench, pdo, EACH_TENTH)):
            does_not_apply(f"{pdo} does not support transmission type {EACH_TENTH}")
        bench.probe.listen_also(key_of(bench, pdo))
    yield from bench.command(NmtCommand.START)
    for pdo in pdos:
        bench.probe.forget(key_of(bench, pdo))
    for _ in range(SYNCS):
        yield from bench.sync()

    def look(pdo: Pdo) -> Procedure[None]:
        yield from ()
        heard = bench.probe.take_all(key_of(bench, pdo))
        expect_data(bench, pdo, heard)
        expect_equal(len(heard), SYNCS // EACH_TENTH, f"the number of {pdo} of type {EACH_TENTH} after {SYNCS} SYNCs")

    return (yield from for_each(bench, pdos, look, "TPDO"))


def stop_producing(bench: Bench) -> Procedure[None]:
    """6.4: a period of 0 stops the SYNC; so does making the device a consumer (0x1005, bit 30)."""
    yield from produce(bench)
    yield from bench.write(COMMUNICATION_CYCLE_PERIOD, 0, 0)
    yield from bench.expect_silence(bench.sync_key, 1 * SECOND, "the period in 0x1006 is 0, and a SYNC")
    yield from bench.write(COB_ID_SYNC, 0, bench.default(COB_ID_SYNC) & ~PRODUCER)
    yield from bench.write(COMMUNICATION_CYCLE_PERIOD, 0, PERIOD // MICROSECOND)
    yield from bench.expect_silence(bench.sync_key, 1 * SECOND, "0x1005 says that the device is a consumer, and a SYNC")


def invalid_overflow(bench: Bench) -> Procedure[None]:
    """6.5: the reserved counter overflow values 1 and 241 to 255 are refused."""

    def look(value: int) -> Procedure[None]:
        refusal = yield from bench.refusal_of_write(SYNC_OVERFLOW, 0, value)
        expect_refusal(refusal, RESERVED_VALUE, f"writing {value} to 0x1019:00")
        yield from bench.expect_number(SYNC_OVERFLOW, 0, bench.default(SYNC_OVERFLOW), f"after the refusal of {value}")

    yield from bench.silence_sync()
    yield from for_each(bench, (1, 241, 255), look)


def no_counter(bench: Bench) -> Procedure[None]:
    """6.6: with the counter overflow value 0 a SYNC has no data."""
    yield from produce(bench, 0)
    heard = yield from bench.frames_within(bench.sync_key, 1 * SECOND)
    expect(len(heard) > 0, "no SYNC came within 1 s")
    for each in heard:
        expect_equal(each.frame.data, b"", "the data of a SYNC without counter")


def expect_counter(bench: Bench, overflow: int) -> Procedure[None]:
    """Check that the counter of the SYNCs runs from 1 to the overflow value, twice. 7.5.2.22"""
    for turn in range(2 * overflow):
        heard = yield from bench.next_frame(bench.sync_key, ANSWER_TIME, "a SYNC")
        expected = bytes((turn % overflow + 1,))
        expect_equal(heard.frame.data, expected, f"the counter of SYNC {turn + 1}")


def counter(bench: Bench) -> Procedure[None]:
    """6.7: with the counter overflow value 5 the SYNC counter runs from 1 to 5, and starts with 1."""
    yield from produce(bench, 5)
    yield from expect_counter(bench, 5)


def overflow_while_running(bench: Bench) -> Procedure[None]:
    """6.9: the counter overflow value cannot be changed while the period is not 0."""
    yield from bench.silence_sync()
    yield from bench.write(COMMUNICATION_CYCLE_PERIOD, 0, PERIOD // MICROSECOND)
    refusal = yield from bench.refusal_of_write(SYNC_OVERFLOW, 0, 5)
    expect_refusal(refusal, NOT_WHILE_RUNNING, "writing 0x1019:00 while 0x1006 is not 0")


def kept_counter(bench: Bench) -> Procedure[None]:
    """6.8: a saved counter overflow value survives a reset."""
    yield from produce(bench)  # ends the case if it cannot: nothing is stored yet
    yield from bench.reset()
    yield from bench.silence_sync()
    yield from keep(bench, [(SYNC_OVERFLOW, 0, 5)])
    yield from produce(bench)
    yield from expect_counter(bench, 5)
    yield from bench.reset()
    yield from put_back(bench)


def put_back(bench: Bench) -> Procedure[None]:
    """Write the values of the dictionary back, and save them. The period is 0 meanwhile: the other two objects may change only
    then."""
    yield from bench.write(COMMUNICATION_CYCLE_PERIOD, 0, 0)
    for index in (SYNC_OVERFLOW, COB_ID_SYNC, COMMUNICATION_CYCLE_PERIOD):
        yield from bench.write(index, 0, bench.default(index))
    yield from save(bench)


def kept_producer(bench: Bench) -> Procedure[None]:
    """6.10: a SYNC producer whose settings were saved sends SYNC by itself after a reset."""
    yield from produce(bench, 5)
    cob_id = bench.default(COB_ID_SYNC) | PRODUCER
    yield from keep(bench, [(COB_ID_SYNC, 0, cob_id), (COMMUNICATION_CYCLE_PERIOD, 0, PERIOD // MICROSECOND)])
    yield from bench.expect_number(SYNC_OVERFLOW, 0, 5, "saved, after a reset")
    heard = yield from bench.frames_within(bench.sync_key, 1 * SECOND)
    expect(len(heard) >= 5, f"{counted(len(heard), 'SYNC')} came in 1 s, with a period of 0.1 s that was saved")
    expect(all(len(each.frame.data) == 1 for each in heard), "the SYNCs have no counter, though one was saved")
    yield from bench.silence_sync()
    yield from put_back(bench)


_PRODUCER_NEEDS: Final = (COB_ID_SYNC, COMMUNICATION_CYCLE_PERIOD)
_COUNTER_NEEDS: Final = (*_PRODUCER_NEEDS, SYNC_OVERFLOW)
_STORED_NEEDS: Final = (*_COUNTER_NEEDS, STORE)

CASES: Final = (
    Case("6.1", "Synchronization 01", "Check the default COB-ID of SYNC", default_cob_id, (COB_ID_SYNC,)),
    Case("6.2", "Synchronization 02", "Count SYNC messages", count_syncs, _PRODUCER_NEEDS),
    Case("6.3", "Synchronization 03", "Count the TPDOs that SYNC sets off", count_tpdos, (COB_ID_SYNC,)),
    Case("6.4", "Synchronization 04", "Be a SYNC consumer, with 0x1006 set to 0", stop_producing, _PRODUCER_NEEDS),
    Case(
        "6.5", "Synchronization 05", "Set the SYNC counter overflow value to invalid values", invalid_overflow, (SYNC_OVERFLOW,)
    ),
    Case("6.6", "Synchronization 06", "Set the SYNC counter overflow value to 0", no_counter, _COUNTER_NEEDS),
    Case("6.7", "Synchronization 07", "Check the SYNC counter", counter, _COUNTER_NEEDS),
    Case(
        "6.8",
        "Synchronization 08",
        "Save the SYNC counter configuration and reset the node",
        kept_counter,
        _STORED_NEEDS,
        stores=True,
    ),
    Case(
        "6.9",
        "Synchronization 09",
        "Try to write the counter overflow value while a SYNC period is set",
        overflow_while_running,
        _COUNTER_NEEDS,
    ),
    Case(
        "6.10",
        "Synchronization 10",
        "Save the SYNC configuration and reset the node",
        kept_producer,
        _STORED_NEEDS,
        stores=True,
    ),
)
