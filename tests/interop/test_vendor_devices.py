"""Devices made of real devices' files, read by `canopen` 2.4.1 with its own import of the same file.

A sample of each file's objects: the first ones of each data type. (All of them are read by our own client, in virtual time:
tests/data/test_vendor_devices.py.) A file that it cannot import, it reads by our description.
"""

from __future__ import annotations

from collections import Counter

import canopen
import pytest

from canopen_data.descriptions import load_description
from canopen_proto.datatypes import DataType, is_number
from canopen_proto.dictionary import ObjectDictionary, Variable
from canopen_proto.local_node import LocalNode
from tests.interop.driver import Driver
from tests.interop.peer import new_channel, peer_dictionary, peer_network
from tests.vendor_files import ALL_NAMES, XDD_NAMES, needs_vendor_files, path_of

pytestmark = needs_vendor_files

NODE = 5
OF_EACH_TYPE = 3

NOT_IMPORTED = {
    "canopennode-ds301.eds": "it takes an empty number of DeviceInfo for an error",
    "cia-301.eds": "it wants a section DeviceInfo",
    "faulhaber-605.3150.51-V.eds": "it reads UTF-8 only, and this is cp1252",
    **dict.fromkeys(XDD_NAMES, "it reads no XML"),
}
"""What `canopen` 2.4.1 cannot import, and why."""


def sample_of(dictionary: ObjectDictionary) -> list[Variable]:
    seen: Counter[DataType] = Counter()
    chosen = []
    for variable in dictionary:
        if variable.access.readable and variable.index not in (0x1003, 0x1010, 0x1011):
            seen[variable.data_type] += 1
            if seen[variable.data_type] <= OF_EACH_TYPE:
                chosen.append(variable)
    return chosen


def theirs_of(name: str, ours: ObjectDictionary) -> canopen.ObjectDictionary:
    return peer_dictionary(ours, NODE) if name in NOT_IMPORTED else canopen.import_od(str(path_of(name)), NODE)


@pytest.mark.parametrize("name", ALL_NAMES)
def test_the_peer_reads_the_same_values(name: str) -> None:
    dictionary = load_description(path_of(name)).dictionary
    channel = new_channel()
    driver = Driver(channel)
    with peer_network(channel) as peer, driver:
        node = driver.add(lambda out: LocalNode(out, NODE, dictionary))
        remote = peer.add_node(canopen.RemoteNode(NODE, theirs_of(name, dictionary)))
        remote.sdo.RESPONSE_TIMEOUT = 20
        driver.do(node.boot)
        for variable in sample_of(dictionary):
            raw = remote.sdo.upload(variable.index, variable.subindex)
            assert raw == node.values.raw(variable.index, variable.subindex), variable
            if is_number(variable.data_type):
                described = remote.object_dictionary.get_variable(variable.index, variable.subindex)
                if described is not None and described.data_type == variable.data_type:
                    assert described.decode_raw(raw) == variable.decode(raw), variable
