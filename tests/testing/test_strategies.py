"""What the strategies draw is what their docstrings promise: judged by the observer, by devices, and by the checks of files."""

from __future__ import annotations

import inspect
import os
import subprocess
import sys
from contextlib import suppress

import pytest
from hypothesis import find, given
from hypothesis import strategies as st
from hypothesis.errors import InvalidArgument

from canopen_data.checks import check
from canopen_data.describing import describe
from canopen_data.eds.reader import read_eds
from canopen_data.findings import Severity
from canopen_proto.cob_id import check_can_id, check_cob_id
from canopen_proto.datatypes import DataType, decode, encode
from canopen_proto.dictionary import Object, ObjectDictionary, Variable
from canopen_proto.dictionary.concise import from_concise
from canopen_proto.frame import COB_ID_EXTENDED, Frame
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import MILLISECOND, SECOND, LocalProtocolError, Outbox
from canopen_proto.nmt import NmtState, Service
from canopen_proto.observer.observer import Observer
from canopen_proto.pdo.mapping import MAX_BITS, Mapping
from canopen_proto.procedures.objects import UnexpectedLengthError
from canopen_proto.procedures.steps import SdoTransferError
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.settings import DriveSettings
from canopen_proto.testing.faults import Fault
from canopen_proto.testing.world import World
from canopen_testing import strategies
from canopen_testing.strategies import (
    NmtOrder,
    PlannedDevice,
    SdoConversation,
    cob_ids,
    concise_dcfs,
    data_types,
    device_dictionaries,
    drive_behaviours,
    eds_texts,
    fault_plans,
    frames,
    near_valid_frames,
    networks,
    nmt_sequences,
    node_ids,
    pdo_mappings,
    random_frames,
    sdo_conversations,
    values,
    variables,
)
from canopen_testing.strategies.faults import ALL_FAULTS
from tests.core.devices import io_device
from tests.examples import examples

ALL = [name for name in strategies.__all__ if not inspect.isclass(getattr(strategies, name))]
ARGUMENTS = {"fault_plans": ([5, 6],), "values": (DataType.INTEGER16,), "damaged_texts": ("[FileInfo]\nFileVersion=1",)}


@pytest.mark.parametrize("name", ALL)
def test_each_says_what_it_draws_its_bounds_and_towards_what_it_shrinks(name: str) -> None:
    text = " ".join((getattr(strategies, name).__doc__ or "").split())
    assert text.startswith("Return a strategy for "), text
    assert "Shrinks towards" in text
    assert "Bounds:" in text or name == "data_types"


SERVICES = {
    Service.SYNC: "SYNC", Service.TIME: "TIME", Service.NMT: "NMT", Service.EMCY: "EMCY", Service.SDO: "SDO",
    Service.ERROR_CONTROL: "heartbeat", Service.BOOT_UP: "boot-up",
}  # fmt: skip


@given(st.data(), st.sampled_from(sorted(SERVICES, key=str)))
@examples(300, least=60)
def test_a_valid_frame_is_of_its_service_and_nothing_is_wrong_with_it(data: st.DataObject, service: Service) -> None:
    frame = data.draw(frames([service], nodes=st.just(5)))
    observation = Observer().observe(frame, SECOND)
    assert observation.meaning.service == SERVICES[service]
    wrong = [each.rule for each in observation.findings]
    assert wrong == [] or service is Service.SDO  # a frame from the middle of a transfer is alone


@given(frames([Service.PDO], nodes=node_ids(3, 4)))
def test_pdos_have_the_identifiers_of_the_predefined_connection_set(frame: Frame) -> None:
    assert frame.can_id & 0x7F in (3, 4)
    assert 0x180 <= frame.can_id & 0x780 <= 0x500


@given(near_valid_frames())
@examples(200)
def test_a_near_valid_frame_is_one_that_can_can_carry(frame: Frame) -> None:
    assert Frame.parse(str(frame)) == frame
    assert frame.can_id <= 0x7FF


def test_near_valid_frames_have_every_mistake() -> None:
    heartbeats = near_valid_frames([Service.ERROR_CONTROL], nodes=st.just(5))
    for wanted in ("705#", "705#0500", "705#04", "705#01", "705#R1", "00000705#05", "704#05"):
        find(heartbeats, lambda frame, wanted=wanted: str(frame) == wanted, settings=examples(1000, least=1000))


@given(random_frames(extended=False, remote=False))
def test_random_frames_can_be_plain(frame: Frame) -> None:
    assert frame.flags == 0
    assert frame.can_id <= 0x7FF


@given(cob_ids(extended=True))
def test_a_device_accepts_each_cob_id(cob_id: int) -> None:
    assert check_can_id(cob_id) is None
    assert check_cob_id(cob_id, 0x8000_0000, in_use=False) is None


@given(cob_ids())
def test_plain_cob_ids_are_can_ids(cob_id: int) -> None:
    assert cob_id < 0x800
    assert not cob_id & COB_ID_EXTENDED


@pytest.mark.parametrize(("low", "high"), [(0, 5), (1, 128), (9, 3)])
def test_there_are_no_other_node_ids(low: int, high: int) -> None:
    with pytest.raises(InvalidArgument, match=f"no node-IDs from {low} to {high}"):
        node_ids(low, high)


def test_other_wrong_arguments_are_named() -> None:
    for strategy, text in (
        (networks(min_size=3, max_size=2), "no network has 3 to 2 devices"),
        (pdo_mappings(max_bits=65), "max_bits=65"),
    ):
        with pytest.raises(InvalidArgument, match=text):
            find(strategy, lambda each: True)
    with pytest.raises(InvalidArgument, match="frames of no service"):
        frames([])


@given(st.data(), data_types())
@examples(300, least=100)
def test_each_value_is_one_of_its_type(data: st.DataObject, data_type: DataType) -> None:
    value = data.draw(values(data_type))
    again = decode(encode(value, data_type), data_type)
    assert again == value or value != value  # NaN


@given(st.data(), variables(types=st.sampled_from([DataType.INTEGER8, DataType.UNSIGNED16, DataType.REAL32])))
@examples(200)
def test_each_value_of_a_variable_is_within_its_limits(data: st.DataObject, variable: Variable) -> None:
    low, high = variable.low_limit, variable.high_limit
    if low is not None and high is not None and low > high:
        return
    variable.check_limits(data.draw(values(variable)))


@given(pdo_mappings(whole=True))
def test_whole_mappings_are_taken_by_a_dictionary_that_has_their_objects(mapping: Mapping) -> None:
    objects = [
        Object.of(each.name, [Variable(each.index, 0, each.name, each.data_type, pdo_mappable=True)])
        for each in mapping.components
    ]
    assert Mapping.from_parameters(mapping.parameters, ObjectDictionary(objects)).entries == mapping.entries
    assert 0 < mapping.bit_length <= MAX_BITS


@given(sdo_conversations())
@examples(200, least=60)
def test_the_observer_finds_nothing_wrong_with_a_conversation(conversation: SdoConversation) -> None:
    observer = Observer()
    seen = [observer.observe(frame, now * MILLISECOND) for now, frame in enumerate(conversation.frames)]
    assert [each.rule for observation in seen for each in observation.findings] == []
    assert observer.unfinished() == ()
    assert conversation.requests[0] == conversation.frames[0]
    assert {each.can_id for each in conversation.answers} == {0x580 + conversation.node_id}
    assert len(conversation.requests) + len(conversation.answers) == len(conversation.frames)
    if conversation.refusal is not None:
        assert conversation.frames[-1].data[4:] == conversation.refusal.to_bytes(4, "little")


@given(st.data(), device_dictionaries())
@examples(60)
def test_a_device_takes_each_entry_of_a_concise_dcf(data: st.DataObject, dictionary: ObjectDictionary) -> None:
    own = [each for each in dictionary.objects.values() if each.index >= 0x2000]
    entries = from_concise(data.draw(concise_dcfs(ObjectDictionary(own))))
    node = LocalNode(Outbox(), 5, dictionary)
    node.boot(0)
    assert [node.write(index, subindex, value, 0) for index, subindex, value in entries] == [None] * len(entries)


@given(device_dictionaries(), node_ids())
@examples(60)
def test_a_device_runs_by_its_dictionary_and_its_file_is_right(dictionary: ObjectDictionary, node_id: int) -> None:
    node = LocalNode(Outbox(), node_id, dictionary)
    node.boot(0)
    assert node.state is NmtState.PRE_OPERATIONAL
    assert node.pdos.faults == {}
    wrong = [finding for finding in check(describe(dictionary)) if finding.severity is Severity.ERROR]
    assert [str(finding) for finding in wrong] == []


@given(eds_texts(dictionaries=device_dictionaries()))
@examples(20)
def test_an_eds_is_read_without_findings(text: str) -> None:
    assert [each for each in read_eds(text).findings if each.severity is not Severity.NOTICE] == []


@given(drive_behaviours())
@examples(40)
def test_a_drive_of_any_behaviour_boots(settings: DriveSettings) -> None:
    node = DriveNode(Outbox(), 5, settings)
    node.boot(0)
    assert node.state is NmtState.PRE_OPERATIONAL
    assert [str(frame) for frame in node.out.frames if frame.can_id == 0x705] == ["705#00"]


@given(networks(min_size=2, max_size=4, drives=drive_behaviours()))
@examples(40)
def test_the_devices_of_a_network_have_different_node_ids_and_boot(network: tuple[PlannedDevice, ...]) -> None:
    assert [each.node_id for each in network] == sorted({each.node_id for each in network})
    assert 2 <= len(network) <= 4
    for each in network:
        node = each.make(Outbox())
        node.boot(0)
        assert isinstance(node, DriveNode) == (each.drive is not None)


@given(nmt_sequences(min_size=1))
def test_an_nmt_order_is_a_frame(sequence: list[NmtOrder]) -> None:
    assert all(order.frame.data == bytes((order.command, order.node_id)) for order in sequence)


@given(fault_plans([5, 6], kinds=ALL_FAULTS))
@examples(60)
def test_a_world_takes_each_plan_of_faults(plan: list[Fault]) -> None:
    world = World(faults=plan)
    for node_id in (5, 6):
        world.device(io_device(node_id), node_id)
    with suppress(SdoTransferError, UnexpectedLengthError, LocalProtocolError):
        world.master().read(5, 0x1000)
    world.advance(6 * SECOND)
    assert len(world.bus().trace) >= 1


def test_no_plan_without_nodes_or_kinds() -> None:
    for wrong in ([], [5]):
        with pytest.raises(InvalidArgument, match="name kinds, such as Lose, and nodes"):
            fault_plans(wrong, kinds=() if wrong else ALL_FAULTS)


DRAWING = """
import sys, warnings
warnings.simplefilter("ignore")  # an example outside of a test
from hypothesis import given
from tests import conftest  # the profile
from tests.examples import examples
from canopen_testing import strategies
from tests.testing.test_strategies import ALL, ARGUMENTS, shown
for name in ALL:
    @examples(8, least=8)
    @given(getattr(strategies, name)(*ARGUMENTS.get(name, ())))
    def draw(example):
        print(name, shown(example))
    draw()
"""


def shown(example: object) -> str:
    """An example in text, without addresses of memory."""
    if isinstance(example, ObjectDictionary):
        return repr([*example])
    if isinstance(example, Mapping):
        return repr(example.parameters)
    if isinstance(example, tuple):
        return repr([(each.node_id, shown(each.dictionary), each.drive) for each in example])
    text = repr(example)
    return (
        text
        if " at 0x" not in text
        else repr([*example.dictionary])
        if hasattr(example, "dictionary")
        else type(example).__name__
    )


@pytest.mark.thorough
def test_in_each_process_and_with_any_hash_seed_the_same_is_drawn() -> None:
    drawn = []
    for seed in ("1", "77"):
        server = {**os.environ, "PYTHONHASHSEED": seed, "PYTHONPATH": os.pathsep.join(sys.path)}
        run = subprocess.run([sys.executable, "-c", DRAWING], env=server, capture_output=True, text=True, check=True)
        drawn.append(run.stdout)
    assert len(drawn[0].splitlines()) > 8 * len(ALL) // 2
    assert drawn[0] == drawn[1]
