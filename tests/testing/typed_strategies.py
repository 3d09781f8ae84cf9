"""What `mypy --strict` sees of each strategy: the type of what it draws. Checked as a user's file, outside of this tree."""

from __future__ import annotations

from typing import assert_type

from hypothesis.strategies import SearchStrategy

from canopen_data.description import DeviceDescription
from canopen_proto.datatypes import DataType, Value
from canopen_proto.dictionary import Object, ObjectDictionary, Variable
from canopen_proto.frame import Frame
from canopen_proto.pdo.mapping import Mapping
from canopen_proto.simulation.drive.settings import DriveSettings
from canopen_proto.testing import World
from canopen_proto.testing.faults import Fault
from canopen_testing import strategies as st


def each_strategy_has_its_type(data_type: DataType, variable: Variable) -> None:
    assert_type(st.node_ids(), SearchStrategy[int])
    assert_type(st.cob_ids(flags=True), SearchStrategy[int])
    assert_type(st.frames(), SearchStrategy[Frame])
    assert_type(st.near_valid_frames(), SearchStrategy[Frame])
    assert_type(st.random_frames(extended=False), SearchStrategy[Frame])
    assert_type(st.data_types(), SearchStrategy[DataType])
    assert_type(st.values(DataType.BOOLEAN), SearchStrategy[bool])
    assert_type(st.values(DataType.INTEGER24), SearchStrategy[int])
    assert_type(st.values(DataType.REAL32), SearchStrategy[float])
    assert_type(st.values(DataType.VISIBLE_STRING), SearchStrategy[str])
    assert_type(st.values(DataType.DOMAIN), SearchStrategy[bytes])
    assert_type(st.values(data_type), SearchStrategy[Value])
    assert_type(st.values(variable), SearchStrategy[Value])
    assert_type(st.texts(), SearchStrategy[str])
    assert_type(st.variables(0x2000, 1), SearchStrategy[Variable])
    assert_type(st.objects(0x2000), SearchStrategy[Object])
    assert_type(st.object_dictionaries(), SearchStrategy[ObjectDictionary])
    assert_type(st.device_dictionaries(), SearchStrategy[ObjectDictionary])
    assert_type(st.device_descriptions(), SearchStrategy[DeviceDescription])
    assert_type(st.eds_texts(), SearchStrategy[str])
    assert_type(st.damaged_texts(""), SearchStrategy[str])
    assert_type(st.pdo_mappings(), SearchStrategy[Mapping])
    assert_type(st.nmt_sequences(), SearchStrategy[list[st.NmtOrder]])
    assert_type(st.sdo_conversations(), SearchStrategy[st.SdoConversation])
    assert_type(st.concise_dcfs(), SearchStrategy[bytes])
    assert_type(st.drive_behaviours(), SearchStrategy[DriveSettings])
    assert_type(st.networks(), SearchStrategy[tuple[st.PlannedDevice, ...]])
    assert_type(st.fault_plans([5]), SearchStrategy[list[Fault]])


def mistakes() -> None:
    st.node_ids("1")  # type: ignore[arg-type]
    st.frames(nodes=5)  # type: ignore[arg-type]
    st.values("UNSIGNED8")  # type: ignore[call-overload]


class MyDevice(st.MasterAgainstDevice):
    dictionary = ObjectDictionary(())

    def join(self, world: World) -> None:
        world.drive(self.node_id)


class MyMaster(st.MasterAgainstDevices):
    def network(self) -> SearchStrategy[tuple[st.PlannedDevice, ...]]:
        return st.networks(max_size=2)

    def start(self, world: World, network: tuple[st.PlannedDevice, ...]) -> None:
        world.master()
