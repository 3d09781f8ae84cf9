"""Chapter 8 of the conformance test: storing and restoring parameters, and the CAN-IDs that no object may take
(CiA 301 v4.2.0, 7.5.2.13, 7.5.2.14, 7.3.5).

A reset of the node shows what was stored. A case about saving leaves the device with the values that it had stored before; a case
about restoring leaves it with its defaults.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Final

from canopen_check.bench import Bench
from canopen_check.case import Body, Case, for_each
from canopen_check.expectations import expect_refusal, expect_taken, some
from canopen_check.sdo_cases import ANY_TIME, NO_CAN_ID, NO_TRIAL, settings, takes_any_time
from canopen_proto.abort import AbortCode
from canopen_proto.cob_id import RESTRICTED_CAN_IDS
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Variable
from canopen_proto.frame import COB_ID_INVALID
from canopen_proto.indices import COB_ID_EMERGENCY, COB_ID_SYNC, COB_ID_TIME_STAMP, VERIFY_CONFIGURATION
from canopen_proto.machine import SECOND
from canopen_proto.parameter_storage import ON_COMMAND, RESTORE, SIGNATURES, STORE
from canopen_proto.pdo.settings import COB_ID, place_of
from canopen_proto.procedures.steps import Procedure
from canopen_proto.sdo.channels import FURTHER_SERVERS, TO_CLIENT, TO_SERVER
from canopen_proto.verdict import does_not_apply, expect_equal

ALL: Final = 1
COMMUNICATION: Final = 2

STORE_TIME: Final = 10 * SECOND
"""How long a device may take to confirm that it has stored its parameters: flash memory is slow."""

WRONG_SIGNATURE: Final = 0x6E6F7277
"""ASCII "wron"."""

NOT_STORED: Final = (
    AbortCode.CANNOT_TRANSFER,
    AbortCode.LOCAL_CONTROL,
    AbortCode.DEVICE_STATE,
    AbortCode.NO_DATA,
    AbortCode.GENERAL_ERROR,
)


def _sign(bench: Bench, index: int, subindex: int, signature: int) -> Procedure[int | None]:
    """Write a signature; return the abort code if it is refused. Waits up to STORE_TIME."""
    usual = bench.sdo.timeout
    bench.sdo.timeout = STORE_TIME
    try:
        return (yield from bench.refusal_of_write(index, subindex, signature))
    finally:
        bench.sdo.timeout = usual


def _check_able(bench: Bench, index: int, subindex: int) -> Procedure[None]:
    if bench.dictionary.get(index, subindex) is None:
        does_not_apply(f"the dictionary has no object 0x{index:04X}:{subindex:02X}")
    if not (yield from bench.number(index, subindex)) & ON_COMMAND:
        does_not_apply(f"0x{index:04X}:{subindex:02X} says that the device does not do so on command")


def save(bench: Bench, subindex: int = ALL) -> Procedure[None]:
    """Make the device store parameters; the case does not apply if it does not do so on command."""
    yield from _check_able(bench, STORE, subindex)
    refusal = yield from _sign(bench, STORE, subindex, SIGNATURES[STORE])
    expect_taken(refusal, f"saving by 0x1010:{subindex:02X}")


def wrong_signature(index: int, subindex: int, bench: Bench) -> Procedure[None]:
    """8.1, 8.3, 8.5, 8.7: a wrong signature is refused, and stores nothing. CiA's tool checks the refusal only."""
    yield from _check_able(bench, index, subindex)
    trial = next((each for each in settings(bench) if takes_any_time(each)), None) if index == STORE else None
    before = b""
    if trial is not None:
        before = yield from bench.read(trial.index, trial.subindex)
        yield from bench.write(trial.index, trial.subindex, ANY_TIME)
    refusal = yield from _sign(bench, index, subindex, WRONG_SIGNATURE)
    expect_refusal(refusal, NOT_STORED, f"a wrong signature to 0x{index:04X}:{subindex:02X}")
    if trial is not None:
        yield from bench.reset()
        after = yield from bench.read(trial.index, trial.subindex)
        bench.notes.beyond(after == before, f"a wrong signature was refused, and has stored {trial.label} all the same")


def _setting(bench: Bench, *, known: bool = False) -> Variable:
    """Return a communication object for the trial. known: its default must be in the dictionary."""
    found = [each for each in settings(bench) if takes_any_time(each) and not (known and bench.restored_content_of(each) is None)]
    return some(found, NO_TRIAL)[0]


def store(subindex: int, bench: Bench) -> Procedure[str]:
    """8.2, 8.6: a saved value is there after a reset of the node; a later change is not."""
    variable = _setting(bench)
    place = variable.index, variable.subindex
    before = yield from bench.number(*place)
    for saved, unsaved in ((ANY_TIME, ANY_TIME + 1), (before, ANY_TIME)):
        yield from bench.write(*place, saved)
        yield from save(bench, subindex)
        yield from bench.write(*place, unsaved)
        yield from bench.reset()
        yield from bench.expect_number(*place, saved, f"saved by 0x1010:{subindex:02X}, after a reset")
    return variable.label


def restore(subindex: int, bench: Bench) -> Procedure[str]:
    """8.4, 8.8: after "load" and a reset of the node an object has its default, whatever was saved; before the reset it has not
    (7.5.2.14), which CiA's tool does not check."""
    variable = _setting(bench, known=True)
    place = variable.index, variable.subindex
    yield from _check_able(bench, RESTORE, subindex)
    yield from bench.write(*place, ANY_TIME)
    yield from save(bench, subindex)
    refusal = yield from _sign(bench, RESTORE, subindex, SIGNATURES[RESTORE])
    expect_taken(refusal, f"loading by 0x1011:{subindex:02X}")
    kept = (yield from bench.number(*place)) == ANY_TIME
    bench.notes.beyond(kept, f"0x1011:{subindex:02X} has changed {variable.label} at once, not with the next reset")
    yield from bench.reset()
    seen = yield from bench.read(*place)
    expect_equal(seen, bench.restored_content_of(variable), f"restored by 0x1011:{subindex:02X}, {variable.label}")
    return variable.label


def keep(bench: Bench, changes: Sequence[tuple[int, int, int]]) -> Procedure[None]:
    """Write values (index, subindex, value), save them, reset the node, and check that they are there."""
    for change in changes:
        yield from bench.write(*change)
    yield from save(bench)
    yield from bench.reset()
    for index, subindex, value in changes:
        yield from bench.expect_number(index, subindex, value, "saved, after a reset")


def verify_configuration(bench: Bench) -> Procedure[None]:
    """8.9: configuration date and time are kept: they show a master that it has configured the device already. 7.5.2.23"""
    date, time = (yield from bench.number(VERIFY_CONFIGURATION, 1)), (yield from bench.number(VERIFY_CONFIGURATION, 2))
    yield from keep(bench, [(VERIFY_CONFIGURATION, 1, 14_000), (VERIFY_CONFIGURATION, 2, 43_200_000)])
    yield from keep(bench, [(VERIFY_CONFIGURATION, 1, date), (VERIFY_CONFIGURATION, 2, time)])


def _cob_ids(bench: Bench) -> list[tuple[Variable, int, int]]:
    """Return the writable COB-IDs, each with the value that it must have before its CAN-ID may change, and the flags of a valid
    COB-ID."""
    found = []
    for variable in bench.dictionary:
        if variable.data_type is DataType.UNSIGNED32 and variable.access.writable:
            place, default = place_of(variable.index), bench.default(variable.index, variable.subindex)
            flags = default & ~0x3FFF_FFFF  # not bit 29: of the CAN-IDs of 29 bits none is restricted
            is_pdo = place is not None and not place.is_mapping and variable.subindex == COB_ID
            is_channel = variable.index in FURTHER_SERVERS and variable.subindex in (TO_SERVER, TO_CLIENT)
            if variable.index in (COB_ID_SYNC, COB_ID_TIME_STAMP):
                found.append((variable, default & 0x3FFF_FFFF, 0))
            elif variable.index == COB_ID_EMERGENCY or is_pdo or is_channel:
                found.append((variable, default | COB_ID_INVALID, flags & ~COB_ID_INVALID))
    return some(found, "no COB-ID can be written")


def restricted_can_ids(bench: Bench) -> Procedure[str]:
    """8.10: no communication object takes a CAN-ID that the standard reserves for others. The lowest and the highest of each
    range are tried."""

    def look(cob_id: tuple[Variable, int, int]) -> Procedure[None]:
        variable, inactive, flags = cob_id
        place = variable.index, variable.subindex

        def attempt(can_id: int) -> Procedure[None]:
            refusal = yield from bench.refusal_of_write(*place, flags | can_id)
            expect_refusal(refusal, NO_CAN_ID, f"the restricted CAN-ID 0x{can_id:03X} in {variable.label}")

        yield from bench.write(*place, inactive)
        yield from for_each(bench, [can_id for each in RESTRICTED_CAN_IDS for can_id in (each[0], each[-1])], attempt)
        expect_equal((yield from bench.number(*place)), inactive, f"{variable.label}, after refused writes,")

    return (yield from for_each(bench, _cob_ids(bench), look))


_RESTORING: Final = (RESTORE, STORE)


def _case(number: int, title: str, body: Body, needs: tuple[int, ...]) -> Case:
    return Case(f"8.{number}", f"Testing other {number:02}", title, body, needs, stores=True)


CASES: Final = (
    _case(1, "Write a wrong signature to 0x1010:01", partial(wrong_signature, STORE, ALL), (STORE,)),
    _case(2, "Write save to 0x1010:01", partial(store, ALL), (STORE,)),
    _case(3, "Write a wrong signature to 0x1011:01", partial(wrong_signature, RESTORE, ALL), (RESTORE,)),
    _case(4, "Write load to 0x1011:01", partial(restore, ALL), _RESTORING),
    _case(5, "Write a wrong signature to 0x1010:02", partial(wrong_signature, STORE, COMMUNICATION), (STORE,)),
    _case(6, "Write save to 0x1010:02", partial(store, COMMUNICATION), (STORE,)),
    _case(7, "Write a wrong signature to 0x1011:02", partial(wrong_signature, RESTORE, COMMUNICATION), (RESTORE,)),
    _case(8, "Write load to 0x1011:02", partial(restore, COMMUNICATION), _RESTORING),
    _case(9, "Save the configuration date and time of 0x1020", verify_configuration, (STORE, VERIFY_CONFIGURATION)),
    Case("8.10", "Testing other 10", "Try to use restricted CAN-IDs", restricted_can_ids),
)
