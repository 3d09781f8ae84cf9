"""What a gateway lets its clients do, as a table: every kind of request with every permission."""

from __future__ import annotations

import itertools

import pytest

from canopen_gateway import Guard, NotAllowedError, Permission, parse_permissions, permission_to_write

P = Permission

NEEDS = {
    # what moves a drive, or decides how it stops
    0x6040: P.MOTION, 0x6042: P.MOTION, 0x6060: P.MOTION, 0x6071: P.MOTION, 0x607A: P.MOTION, 0x60FF: P.MOTION,
    0x60B0: P.MOTION, 0x60B1: P.MOTION, 0x60B2: P.MOTION, 0x60C1: P.MOTION, 0x60EA: P.MOTION, 0x60FE: P.MOTION,
    0x6007: P.MOTION, 0x605A: P.MOTION, 0x605B: P.MOTION, 0x605C: P.MOTION, 0x605D: P.MOTION, 0x605E: P.MOTION,
    0x100C: P.MOTION, 0x100D: P.MOTION, 0x1016: P.MOTION, 0x1029: P.MOTION,
    # the same of further axes
    0x6840: P.MOTION, 0x70FF: P.MOTION, 0x9840: P.MOTION, 0x9860: P.MOTION,
    # what else may reach these
    0x1005: P.MOTION, 0x1006: P.MOTION, 0x1400: P.MOTION, 0x15FF: P.MOTION, 0x1600: P.MOTION, 0x17FF: P.MOTION,
    0x1FA0: P.MOTION, 0x1FD0: P.MOTION, 0x1FFF: P.MOTION,
    # what may be made to send under the COB-ID of a set-point, or of a heartbeat
    0x1012: P.MOTION, 0x1013: P.MOTION, 0x1014: P.MOTION, 0x1015: P.MOTION, 0x1200: P.MOTION, 0x1280: P.MOTION, 0x12FF: P.MOTION,
    0x1800: P.MOTION, 0x19FF: P.MOTION, 0x1A00: P.MOTION, 0x1BFF: P.MOTION,
    # which way a set-point goes
    0x607E: P.MOTION, 0x687E: P.MOTION,
    # what lasts
    0x1010: P.STORE, 0x1011: P.STORE, 0x1F20: P.STORE, 0x1F22: P.STORE,
    # programs and commands to an operating system
    0x1023: P.PROGRAM, 0x1026: P.PROGRAM, 0x1F50: P.PROGRAM, 0x1F51: P.PROGRAM, 0x1F57: P.PROGRAM,
    # commands by another NMT master
    0x1F80: P.NMT, 0x1F81: P.NMT, 0x1F82: P.NMT, 0x1F83: P.NMT,
    # settings
    0x1017: P.WRITE, 0x1300: P.WRITE, 0x1F84: P.WRITE, 0x1F8A: P.WRITE, 0x2000: P.WRITE,
    0x5FFF: P.WRITE, 0x6081: P.WRITE, 0x6083: P.WRITE, 0x6098: P.WRITE, 0x607C: P.WRITE, 0x6041: P.WRITE, 0xA000: P.WRITE,
    0xFFFF: P.WRITE, 0x0005: P.WRITE, 0x100F: P.WRITE, 0x1022: P.WRITE, 0x1027: P.WRITE, 0x1F1F: P.WRITE,
    0x1F4F: P.WRITE, 0x13FF: P.WRITE, 0x1F9F: P.WRITE,
}  # fmt: skip


def test_each_object_has_its_permission() -> None:
    assert {index: permission_to_write(index) for index in NEEDS} == NEEDS
    assert {permission_to_write(index, 1) for index in (0x60C1, 0x1010)} == {P.MOTION, P.STORE}


@pytest.mark.parametrize("index", NEEDS, ids=hex)
def test_a_write_is_let_through_by_its_own_permission_and_by_no_other(index: int) -> None:
    for count in range(len(P) + 1):
        for allowed in itertools.combinations(P, count):
            guard = Guard(allowed)
            if NEEDS[index] in allowed:
                guard.require_write(index, 0)
                continue
            with pytest.raises(NotAllowedError) as refused:
                guard.require_write(index, 0)
            assert refused.value.permission == NEEDS[index].value
            assert f"--allow {NEEDS[index].value}" in str(refused.value)


def test_by_default_nothing_is_allowed() -> None:
    guard = Guard()
    assert guard.mode == "read-only"
    for permission in P:
        with pytest.raises(NotAllowedError):
            guard.require(permission, "this")
    assert Guard([P.MOTION, P.WRITE]).mode == "read, write, motion"


def test_permissions_as_they_are_typed() -> None:
    assert parse_permissions("write, motion") == {P.WRITE, P.MOTION}
    assert parse_permissions("") == frozenset()
    with pytest.raises(ValueError, match="'all' is no permission; there are write, motion, store, program, nmt, lss"):
        parse_permissions("write,all")
