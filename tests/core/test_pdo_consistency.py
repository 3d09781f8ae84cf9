"""The PDOs of several nodes compared: who sends to whom, and each rule, once broken and once kept."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.dictionary import Direction
from canopen_proto.frame import COB_ID_INVALID, COB_ID_NO_RTR
from canopen_proto.multiplexer import mapping_entry, mux
from canopen_proto.pdo.consistency import RULES, check_pdos, flows_of
from canopen_proto.pdo.settings import PdoSettings
from tests.examples import examples

TPDO, RPDO = Direction.TPDO, Direction.RPDO
WORD, LONG, OTHER = mapping_entry(mux(0x6041), 16), mapping_entry(mux(0x6064), 32), mapping_entry(mux(0x6040), 16)
FILLER = mapping_entry(mux(0x0006), 16)


def pdo(direction: Direction, cob_id: int, *entries: int, number: int = 1) -> PdoSettings:
    return PdoSettings(number, direction, cob_id, 1, entries)


SENDER = pdo(TPDO, 0x185 | COB_ID_NO_RTR, WORD, LONG)
TAKER = pdo(RPDO, 0x185, WORD, LONG)


def rules(pdos: dict[int, list[PdoSettings]]) -> list[str]:
    return [each.rule for each in check_pdos(pdos)]


def test_a_pdo_that_is_sent_and_taken_is_no_finding() -> None:
    assert check_pdos({5: [SENDER], 6: [TAKER], 7: [TAKER]}) == []
    (flow,) = flows_of({5: [SENDER], 7: [TAKER], 6: [TAKER]})
    assert [each.node_id for each in flow.senders] == [5]
    assert [each.node_id for each in flow.receivers] == [6, 7]


@pytest.mark.parametrize(
    ("rule", "pdos"),
    [
        ("restricted", {5: [pdo(TPDO, 0x605, WORD)], 6: [pdo(RPDO, 0x605, WORD)]}),
        ("too long", {5: [pdo(TPDO, 0x185, LONG, LONG, WORD)], 6: [pdo(RPDO, 0x185, LONG, LONG, WORD)]}),
        ("two senders", {5: [SENDER], 6: [SENDER], 7: [TAKER]}),
        ("too short", {5: [pdo(TPDO, 0x185, WORD)], 6: [TAKER]}),
        ("set twice", {5: [SENDER, pdo(TPDO, 0x285, LONG)], 6: [TAKER, pdo(RPDO, 0x285, LONG, number=2)]}),
        ("rest ignored", {5: [SENDER], 6: [pdo(RPDO, 0x185, WORD)]}),
        ("other borders", {5: [SENDER], 6: [pdo(RPDO, 0x185, LONG, OTHER)]}),
        ("unheard", {5: [SENDER]}),
        ("unsent", {5: [TAKER]}),
    ],
)
def test_each_rule_is_found_alone(rule: str, pdos: dict[int, list[PdoSettings]]) -> None:
    assert set(rules(pdos)) - ({"restricted"} if rule != "restricted" else set()) == {rule}


def test_a_pdo_that_carries_nothing_is_a_remark() -> None:
    found = check_pdos({5: [pdo(TPDO, 0x185)], 6: [TAKER]})
    assert [(each.rule, each.is_error) for each in found] == [("empty", False)]


def test_a_pdo_that_is_switched_off_counts_for_nothing() -> None:
    off = pdo(TPDO, 0x185 | COB_ID_INVALID, WORD)
    assert flows_of({5: [off]}) == []
    assert check_pdos({5: [off, SENDER], 6: [TAKER]}) == []


def test_fillers_have_no_borders_and_are_not_set_twice() -> None:
    taker = pdo(RPDO, 0x185, FILLER, LONG)
    assert check_pdos({5: [SENDER], 6: [taker]}) == []
    assert check_pdos({5: [SENDER], 6: [pdo(RPDO, 0x185, WORD, FILLER, FILLER)]}) == []
    twice = [pdo(RPDO, 0x185, WORD, FILLER, FILLER), pdo(RPDO, 0x285, FILLER, number=2)]
    assert rules({5: [SENDER, pdo(TPDO, 0x285, OTHER, number=2)], 6: twice}) == []


PDOS = st.lists(
    st.builds(
        pdo,
        st.sampled_from([TPDO, RPDO]),
        st.sampled_from([0x185, 0x285, 0x605, 0x185 | COB_ID_INVALID, 0x80]),
        st.sampled_from([WORD, LONG, FILLER, 0]),
        st.sampled_from([WORD, LONG, OTHER]),
        number=st.integers(1, 512),
    ),
    max_size=4,
)


@examples(100)
@given(st.dictionaries(st.integers(1, 127), PDOS, max_size=4))
def test_whatever_nodes_show_each_finding_has_its_rule_and_its_nodes(pdos: dict[int, list[PdoSettings]]) -> None:
    for each in check_pdos(pdos):
        assert each.rule in RULES
        assert each.ends
        for node_id, settings in each.ends:
            assert settings in pdos[node_id]
            assert f"node {node_id}" in each.text
