"""PDO linking: the PDOs that links make, the problems that they have, and two devices that exchange a value by them."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.cob_id import check_can_id
from canopen_proto.dictionary import Access, Direction
from canopen_proto.dictionary.concise import from_concise, pack_concise
from canopen_proto.frame import COB_ID_INVALID, COB_ID_NO_RTR
from canopen_proto.machine import MICROSECOND, MILLISECOND, LocalProtocolError
from canopen_proto.manager.linking import MASTER, End, KnownNode, Link, LinkError, LinkPlan, Timing, plan_links
from canopen_proto.manager.linking.packing import dummy_entries
from canopen_proto.multiplexer import mapped
from canopen_proto.pdo.settings import PdoSettings, muxes_of
from tests.core.pdo_device import OFF
from tests.examples import examples
from tests.manager.linked_devices import DEVICE, OBJECTS, Linked, dictionary_with, member, with_object, with_pdo

RPDO, TPDO = Direction.RPDO, Direction.TPDO
EACH = Timing()
EVENT = Timing(every=0, inhibit_time=5 * MILLISECOND, event_timer=100 * MILLISECOND)
TWO = (member("a", 1), member("b", 2))


def link(source: str | list[str], target: str | list[str], timing: Timing = EACH, name: str = "links[1]") -> Link:
    """A link in the words of a machine file: "a 2000" or "master"."""

    def ends(texts: str | list[str]) -> tuple[End, ...]:
        listed = [texts] if isinstance(texts, str) else texts
        return tuple(End(node, key) for node, _, key in (text.partition(" ") for text in listed))

    return Link(name, ends(source), ends(target), timing)


def shown(plan: LinkPlan) -> list[str]:
    """Each transfer in a line: CAN-ID, each end with its PDO, type and entries."""
    lines = []
    for each in plan.transfers:
        pdos = [pdo for pdo in (each.sender, *each.receivers) if pdo is not None]
        ends = [
            f"{pdo.node} {pdo.name} type {pdo.settings.transmission_type} "
            + " ".join(f"{entry:08X}" for entry in pdo.settings.entries)
            for pdo in pdos
        ]
        lines.append(f"{each.can_id:03X} {'; '.join(ends)}{' -> master' if each.to_master else ''}")
    return lines


def problems(members: tuple[KnownNode, ...], *links: Link) -> list[str]:
    with pytest.raises(LinkError) as caught:
        plan_links(members, links)
    return [each.text for each in caught.value.problems]


# ---- what comes out


def test_one_object_feeds_another() -> None:
    plan = plan_links(TWO, [link("a 2008", "b 2009")])
    assert shown(plan) == ["181 a TPDO 1 type 1 20080020; b RPDO 1 type 1 20090020"]
    assert plan.changed == ["a", "b"]
    assert plan.transfers[0].size == 4


def test_the_order_of_the_writes() -> None:
    """Bit 31, count 0, entries, count, type and times, and the COB-ID at last: CiA 301 v4.2.0, 7.5.2.36."""
    plan = plan_links(TWO, [link("a 2008", "b 2009", EVENT)])
    assert [(f"{index:04X}:{subindex}", int.from_bytes(data, "little")) for index, subindex, data in plan.writes_of("a")] == [
        ("1800:1", COB_ID_INVALID | COB_ID_NO_RTR | 0x181),
        ("1A00:0", 0),
        ("1A00:1", 0x20080020),
        ("1A00:0", 1),
        ("1800:2", 255),
        ("1800:3", 50),  # 0.1 ms
        ("1800:5", 100),
        ("1800:1", COB_ID_NO_RTR | 0x181),
    ]
    writes = plan.writes_of("b")
    assert from_concise(pack_concise(writes)) == writes
    assert [f"{index:04X}:{subindex}" for index, subindex, _ in writes] == [
        "1400:1", "1600:0", "1600:1", "1600:0", "1400:2", "1400:1",
    ]  # fmt: skip


def test_a_strict_device_finds_its_can_id_unchanged_in_the_write_that_destroys_its_pdo() -> None:
    dictionary = with_pdo(DEVICE, RPDO, 1, 0x200, 0x20090020)
    writes = plan_links((member("a", 1), member("b", 2, dictionary)), [link("a 2008", "b 2009")]).writes_of("b")
    assert writes[0] == (0x1400, 1, (OFF | 0x202).to_bytes(4, "little"))
    assert writes[-1] == (0x1400, 1, (0x181).to_bytes(4, "little"))


def test_what_the_master_wants_comes_in_few_pdos() -> None:
    plan = plan_links(TWO, [link(["a 2000", "a 2008", "a 200c", "b 2002"], "master")])
    assert shown(plan) == [
        "181 a TPDO 1 type 1 20000008 20080020 -> master",
        "182 b TPDO 1 type 1 20020010 -> master",
        "281 a TPDO 2 type 1 200C0040 -> master",
    ]


def test_what_the_master_sends_has_the_predefined_can_id_of_its_receiver() -> None:
    plan = plan_links(TWO, [link("master", ["b 2003", "b 2009", "a 2003"], Timing(every=2))])
    assert shown(plan) == ["201 a RPDO 1 type 2 20030010", "202 b RPDO 1 type 2 20030010 20090020"]


def test_one_pdo_serves_all_that_want_its_object() -> None:
    plan = plan_links((*TWO, member("c", 3)), [link("a 2008", ["b 2009", "c 2009"]), link("a 2008", "master", name="links[2]")])
    assert shown(plan) == ["181 a TPDO 1 type 1 20080020; b RPDO 1 type 1 20090020; c RPDO 1 type 1 20090020 -> master"]
    assert plan.transfers[0].links == ("links[1]", "links[2]")


def test_a_receiver_that_wants_a_part_gets_dummy_entries_for_the_rest() -> None:
    links = [link("a 2000", "b 2001"), link("a 2008", "c 2009"), link("a 2002", "b 2003")]
    plan = plan_links((*TWO, member("c", 3)), links)
    assert shown(plan) == [
        (
            "181 a TPDO 1 type 1 20000008 20020010 20080020;"
            " b RPDO 1 type 1 20010008 20030010 00070020; c RPDO 1 type 1 00060010 00050008 20090020"
        )
    ]


def test_a_receiver_without_dummy_entries_gets_a_pdo_of_its_own() -> None:
    three = (*TWO, member("c", 3, dummies=frozenset()))
    plan = plan_links(three, [link("a 2000", "b 2001"), link("a 2008", "c 2009")])
    assert shown(plan) == [
        "181 a TPDO 1 type 1 20000008; b RPDO 1 type 1 20010008",
        "281 a TPDO 2 type 1 20080020; c RPDO 1 type 1 20090020",
    ]


def test_an_rpdo_has_no_more_entries_than_it_has_room() -> None:
    """Two dummies and the object would be three entries."""
    three = (*TWO, member("c", 3, dictionary_with(room=2)))
    plan = plan_links(three, [link(["a 2000", "a 2002"], "master"), link("a 2008", "c 2009")])
    assert len(plan.transfers) == 2


@pytest.mark.parametrize(
    ("bits", "entries"),
    [(0, []), (8, [0x00050008]), (24, [0x00060010, 0x00050008]), (40, [0x00070020, 0x00050008]), (4, None), (1, None)],
)
def test_dummy_entries_are_as_few_as_possible(bits: int, entries: list[int] | None) -> None:
    assert dummy_entries(bits, frozenset({5, 6, 7})) == entries
    assert dummy_entries(1, frozenset({1})) == [0x00010001]


def test_timing_of_an_event_driven_pdo_and_of_its_watch() -> None:
    timing = Timing(every=0, inhibit_time=5 * MILLISECOND, timeout=300 * MILLISECOND)
    plan = plan_links(TWO, [link("a 2008", "b 2009", timing)])
    assert shown(plan) == ["181 a TPDO 1 type 255 20080020; b RPDO 1 type 255 20090020"]
    assert (0x1400, 5, (300).to_bytes(2, "little")) in plan.writes_of("b")
    assert str(timing) == "event-driven, inhibit 5 ms, timeout 300 ms"


def test_an_event_driven_type_of_the_file_stays() -> None:
    dictionary = with_object(DEVICE, 0x1800, 2, default=254)
    plan = plan_links((member("a", 1, dictionary), member("b", 2)), [link("a 2008", "b 2009", EVENT)])
    assert plan.transfers[0].sender is not None
    assert plan.transfers[0].sender.settings.transmission_type == 254


def test_a_receiver_without_sync_obeys_at_once() -> None:
    plan = plan_links((member("a", 1), member("b", 2, dictionary_with(sync=False))), [link("a 2008", "b 2009")])
    assert shown(plan) == ["181 a TPDO 1 type 1 20080020; b RPDO 1 type 255 20090020"]


# ---- which PDOs, which CAN-IDs


def test_a_pdo_that_loses_nothing_comes_first() -> None:
    dictionary = with_pdo(DEVICE, TPDO, 1, 0x180, 0x20000008, 0x20020010)
    a = member("a", 1, dictionary)
    assert shown(plan_links((a,), [link("a 2008", "master")])) == ["281 a TPDO 2 type 1 20080020 -> master"]
    assert shown(plan_links((a,), [link(["a 2002", "a 2000"], "master")])) == ["181 a TPDO 1 type 1 20020010 20000008 -> master"]


def test_objects_that_a_pdo_does_not_carry_any_longer_are_told() -> None:
    dictionary = with_pdo(dictionary_with(tpdos=1), TPDO, 1, 0x180, 0x20000008, 0x20020010)
    sender = plan_links((member("a", 1, dictionary),), [link("a 2000", "master")]).transfers[0].sender
    assert sender is not None
    assert sender.lost == (0x200200,)


def test_an_rpdo_that_would_set_a_fed_object_too_is_destroyed_or_taken() -> None:
    dictionary = with_pdo(with_pdo(DEVICE, RPDO, 1, 0x200, 0x20090020), RPDO, 2, 0x300, 0x20090020, 0x20030010)
    plan = plan_links((member("a", 1), member("b", 2, dictionary)), [link("a 2008", "b 2009")])
    assert shown(plan) == ["181 a TPDO 1 type 1 20080020; b RPDO 1 type 1 20090020"]
    assert [(pdo.node, pdo.name) for pdo in plan.destroyed] == [("b", "RPDO 2")]
    assert plan.writes_of("b")[0] == (0x1401, 1, (OFF | 0x302).to_bytes(4, "little"))


def test_used_pdos_stay_as_they_are() -> None:
    used = (PdoSettings(1, TPDO, 0x181, 1, (0x20000008,)), PdoSettings(1, RPDO, 0x201, 1, (0x20030010,)))
    a = KnownNode("a", 1, DEVICE, 8, frozenset(), used)
    plan = plan_links((a, member("b", 2)), [link("a 2008", "b 2009"), link("b 2008", "a 2009")])
    assert shown(plan) == [
        "182 b TPDO 1 type 1 20080020; a RPDO 2 type 1 20090020",
        "281 a TPDO 2 type 1 20080020; b RPDO 1 type 1 20090020",
    ]


def test_a_can_id_that_another_node_listens_to_is_not_used() -> None:
    listener = with_pdo(DEVICE, RPDO, 3, 0x181 - 2, 0x20030010)
    plan = plan_links((member("a", 1), member("b", 2, listener)), [link("a 2008", "b 2009")])
    assert shown(plan) == ["281 a TPDO 1 type 1 20080020; b RPDO 1 type 1 20090020"]


def test_can_ids_beyond_the_predefined_ones_belong_to_no_service() -> None:
    dictionary = dictionary_with(rpdos=12, tpdos=12)
    links = [link("a 200C", "b 200D", Timing(every=1))]
    links += [link("a 200C", "master", Timing(every=every)) for every in range(2, 12)]
    plan = plan_links((member("a", 1, dictionary), member("b", 2)), links, node_ids=[127])
    can_ids = [each.can_id for each in plan.transfers]
    assert len(set(can_ids)) == 11
    assert can_ids[8:] == [0x680, 0x681, 0x682]  # a device that is new on the bus has none of them


def test_a_fixed_mapping_is_used_as_it_is() -> None:
    fixed = with_pdo(dictionary_with(tpdos=1), TPDO, 1, 0x180, 0x20000008, 0x20080020, 0x20020010)
    fixed = with_object(fixed, 0x1A00, 0, access=Access.RO)
    a = member("a", 1, fixed)
    plan = plan_links((a, member("b", 2)), [link("a 2008", "b 2009")])
    assert shown(plan) == ["181 a TPDO 1 type 1 20000008 20080020 20020010; b RPDO 1 type 1 00050008 20090020 00060010"]
    assert [f"{index:04X}:{subindex}" for index, subindex, _ in plan.writes_of("a") if index < 0x1A00] == [
        "1800:1",
        "1800:2",
        "1800:1",
    ]
    assert problems((a, member("b", 2, dummies=frozenset())), link("a 2008", "b 2009")) == [
        "b cannot receive from a: its file (DummyUsage) allows no dummy entries for the parts of this PDO that are not for it"
    ]


def test_a_fixed_cob_id_is_used_by_both_ends() -> None:
    dictionary = with_object(with_pdo(dictionary_with(rpdos=1), RPDO, 1, 0x400, 0x20090020), 0x1400, 1, access=Access.RO)
    b = member("b", 2, dictionary)
    plan = plan_links((member("a", 1), b), [link("a 2008", "b 2009")])
    assert plan.transfers[0].can_id == 0x402
    assert [(index, subindex) for index, subindex, _ in plan.writes_of("b")][-1] != (0x1400, 1)
    taken = KnownNode("c", 3, DEVICE, used=(PdoSettings(1, TPDO, 0x402, 1, (0x20000008,)),))
    (text,) = problems((member("a", 1), b, taken), link("a 2008", "b 2009"))
    assert text == "TPDO 1 of a: RPDO 1 of b cannot change its CAN-ID 0x402, which is that of TPDO 1 of c"


# ---- what cannot be


@pytest.mark.parametrize(
    ("wish", "text"),
    [
        (link("x 2008", "b 2009"), "no file describes a node 'x' on this bus; there are a, b"),
        (link("a 5000", "b 2009"), "a: object 0x5000:00 is not in the dictionary"),
        (link("a 1000", "b 2009"), "a: no PDO can carry device type (0x1000:00) (PDOMapping)"),
        (link("a 2009", "b 2009"), "a: no TPDO can carry to integer32 (0x2009:00): it is rww"),
        (link("a 2008", "b 2008"), "b: no RPDO can carry from integer32 (0x2008:00): it is ro"),
        (link("a 2006", "b 2009"), "a from integer16 (0x2006:00) has 16 bits, b to integer32 (0x2009:00) has 32"),
        (link("a 200A", "b 2009"), "a from real32 (0x200A:00) is REAL32, b to integer32 (0x2009:00) is INTEGER32"),
        (link("a 2008", "a 2009"), "a from integer32 (0x2008:00) is on the same node as to integer32 (0x2009:00)"),
    ],
)  # fmt: skip
def test_problems_name_link_node_and_object(wish: Link, text: str) -> None:
    with pytest.raises(LinkError) as caught:
        plan_links(TWO, [wish])
    (problem,) = caught.value.problems
    assert problem.text.startswith(text)
    assert problem.link == str(wish)
    assert problem.node in text


def test_an_object_follows_one_link_only() -> None:
    first, second = link("a 2008", "b 2009"), link("master", "b 2009", name="links[2]")
    assert problems(TWO, first, second) == [
        "b to integer32 (0x2009:00) is fed by links[1] (a 2008 -> b 2009) already: it can follow one of them only"
    ]
    used = KnownNode("b", 2, DEVICE, used=(PdoSettings(2, RPDO, 0x302, 1, (0x20090020,)),))
    assert problems((TWO[0], used), first) == ["b to integer32 (0x2009:00) is in RPDO 2 already, which its chain sends"]


def test_all_problems_are_found_at_once() -> None:
    assert len(problems(TWO, link("a 5000", "b 2009"), link("a 2008", "b 5000"), link("x 2008", "y 2009"))) == 4


def test_a_device_without_enough_pdos() -> None:
    small = member("a", 1, dictionary_with(tpdos=1))
    assert problems((small,), link(["a 200C", "a 2008"], "master")) == ["a has no TPDO left for it: its TPDOs are all taken"]
    none = member("a", 1, dictionary_with(tpdos=0))
    assert problems((none,), link("a 2008", "master")) == ["a has no TPDO left for it: its file describes no TPDO"]


def test_a_device_without_sync_or_times() -> None:
    deaf = member("a", 1, dictionary_with(tpdos=1, sync=False))
    (text,) = problems((deaf,), link("a 2008", "master"))
    assert "does not listen to SYNC (no 0x1005); an event-driven link may do" in text
    fixed = with_pdo(dictionary_with(tpdos=1, sync=False), TPDO, 1, 0x180, 0x20080020)
    fixed = with_object(fixed, 0x1A00, 0, access=Access.RO)
    assert "does not listen to SYNC" in problems((member("a", 1, fixed),), link("a 2008", "master"))[0]
    const = member("a", 1, with_object(dictionary_with(tpdos=1), 0x1800, 3, access=Access.RO))
    assert problems((const,), link("a 2008", "master", EVENT)) == [
        "a has no TPDO left for it: no inhibit time that can be written, subindex 3 (TPDO 1)"
    ]


def test_an_rpdo_that_cannot_be_destroyed() -> None:
    dictionary = with_object(with_pdo(DEVICE, RPDO, 1, 0x200, 0x20090020, 0x20030010), 0x1400, 1, access=Access.RO)
    assert problems((member("a", 1), member("b", 2, dictionary)), link("a 2008", "b 2009")) == [
        "RPDO 1 of b sets to integer32 (0x2009:00) too, and cannot be switched off"
    ]


def test_a_difference_of_sign_is_noted() -> None:
    plan = plan_links(TWO, [link("a 2004", "b 2009")])
    (note,) = plan.notes
    assert note.endswith("is UNSIGNED32, b to integer32 (0x2009:00) is INTEGER32: values of 2147483648 and more differ by sign")


def test_granularity() -> None:
    a = KnownNode("a", 1, DEVICE, granularity=32)
    assert "multiples of 32 bits only" in problems((a,), link("a 2002", "master"))[0]


@pytest.mark.parametrize(
    "timing",
    [{"every": 241}, {"every": -1}, {"inhibit_time": 1}, {"every": 0, "inhibit_time": 50 * MICROSECOND}, {"timeout": MICROSECOND},
     {"every": 0, "event_timer": 65_536 * MILLISECOND}, {"timeout": -MILLISECOND}],
)  # fmt: skip
def test_a_timing_that_no_device_can_keep(timing: dict[str, int]) -> None:
    with pytest.raises(LocalProtocolError):
        Timing(**timing)


@pytest.mark.parametrize(
    ("source", "target", "timing"),
    [("a 2008", MASTER, Timing(timeout=MILLISECOND)), (MASTER, "b 2009", EVENT)],
)
def test_times_that_nobody_would_keep(source: str, target: str, timing: Timing) -> None:
    with pytest.raises(LocalProtocolError, match="master"):
        link(source, target, timing)


@pytest.mark.parametrize(
    ("sources", "targets"),
    [([], ["b 2009"]), (["master"], ["master"]), (["a 2008", "a 2006"], ["b 2009"]), (["master", "a 2008"], ["b 2009"])],
)
def test_links_that_make_no_sense(sources: list[str], targets: list[str]) -> None:
    with pytest.raises(LocalProtocolError):
        link(sources, targets)


def test_two_nodes_with_one_name() -> None:
    with pytest.raises(LocalProtocolError):
        plan_links((TWO[0], member("a", 2)), [])
    with pytest.raises(LocalProtocolError):
        plan_links((member(MASTER, 2),), [])


# ---- what the devices do with it


def test_a_value_written_here_arrives_there() -> None:
    linked = Linked(plan_links((*TWO, member("c", 3)), [link("a 2008", ["b 2009", "c 2009"]), link("a 2000", "c 2001")]))
    linked.nodes["a"].values.store[0x200800] = -123456
    linked.nodes["a"].values.store[0x200000] = 7
    linked.sync()
    assert linked.nodes["b"].values.store.get(0x200900, 0) == 0  # it waits for the next SYNC
    linked.sync()
    assert linked.nodes["b"].values.store[0x200900] == -123456
    assert linked.nodes["c"].values.store[0x200900] == -123456
    assert linked.nodes["c"].values.store[0x200100] == 7
    linked.world.bus().saw("181#C01DFEFF07").times(2)


def test_an_event_driven_value_arrives_at_once() -> None:
    linked = Linked(plan_links(TWO, [link("a 2006", "b 2007", Timing(every=0))]))
    linked.nodes["a"].set_value(0x2006, 0, -5, linked.world.now)
    linked.run()
    assert linked.nodes["b"].values.store[0x200700] == -5


def test_what_the_master_sends_arrives() -> None:
    linked = Linked(plan_links(TWO, [link("master", ["b 2009"])]))
    linked.world.bus().send("202#01000000")
    linked.sync()
    assert linked.nodes["b"].values.store[0x200900] == 1


NAMES = "abcd"
SOURCES = [f"{name} {index:04X}" for name in NAMES for index in OBJECTS]


@st.composite
def wishes(draw: st.DrawFn) -> list[Link]:
    """Links between four nodes and the master, each object fed at most once."""
    free = {f"{name} {index + 1:04X}" for name in NAMES for index in OBJECTS}
    links = []
    for number in range(draw(st.integers(1, 8))):
        timing = draw(st.sampled_from([Timing(), Timing(every=3), EVENT]))
        match draw(st.sampled_from(["node", "node", "to", "from"])):
            case "to":
                sources = draw(st.lists(st.sampled_from(SOURCES), min_size=1, max_size=4, unique=True))
                links.append(link(sources, MASTER, timing, f"links[{number}]"))
                continue
            case "from":
                source, possible = MASTER, sorted(free)
                timing = Timing(0) if timing is EVENT else timing
            case _:
                source = draw(st.sampled_from(SOURCES))
                wanted = f"{int(source[2:], 16) + 1:04X}"
                possible = sorted(each for each in free if each[2:] == wanted and each[0] != source[0])
        if possible:
            targets = draw(st.lists(st.sampled_from(possible), min_size=1, max_size=3, unique=True))
            free.difference_update(targets)
            links.append(link(source, targets, timing, f"links[{number}]"))
    return links


@st.composite
def devices(draw: st.DrawFn) -> tuple[KnownNode, ...]:
    kinds = [DEVICE, dictionary_with(8, 8, valid=True), dictionary_with(2, 6, room=3), dictionary_with(8, 8, sync=False)]
    dummies = st.sampled_from([frozenset({5, 6, 7}), frozenset({5}), frozenset()])
    return tuple(member(name, number, draw(st.sampled_from(kinds)), draw(dummies)) for number, name in enumerate(NAMES, start=1))


@examples(150)
@given(devices(), wishes())
def test_any_links_are_accepted_by_the_devices(members: tuple[KnownNode, ...], links: list[Link]) -> None:
    """No CAN-ID twice, each object fed once, and what a device takes, or an error that names link and node."""
    try:
        plan = plan_links(members, links)
    except LinkError as error:
        assert all(each.link and each.node and each.text for each in error.problems)
        return
    can_ids = [each.can_id for each in plan.transfers]
    assert len(set(can_ids)) == len(can_ids)
    assert all(check_can_id(can_id) is None for can_id in can_ids)
    linked = Linked(plan)  # each write was accepted
    for each in plan.transfers:
        for pdo in each.receivers:
            if each.sender is not None:
                bits = [[mapped(entry)[2] for entry in end.settings.entries] for end in (pdo, each.sender)]
                assert sum(bits[0]) == sum(bits[1])
    for name, node in linked.nodes.items():
        assert node.pdos.faults == {}
        carried = [mux for pdo in node.pdos.consumers.values() if pdo.key is not None for mux in pdo.mapping.muxes]
        assert len(set(carried)) == len(carried)
        keys = [
            machine.key for machine in (*node.pdos.producers.values(), *node.pdos.consumers.values()) if machine.key is not None
        ]
        assert len(set(keys)) == len(keys)
        wanted = {place for each in links for end in each.targets if end.node == name for place in [int(str(end.key), 16) << 8]}
        assert wanted <= set(carried)
        asked = {int(str(end.key), 16) << 8 for each in links for end in each.sources if end.node == name}
        assert asked <= {
            mux for pdo in plan.pdos_of(name) if pdo.settings.direction is TPDO for mux in muxes_of(pdo.settings.entries)
        }
