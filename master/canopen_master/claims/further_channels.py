"""The further SDO channels of a device (0x1201 to 0x127F), for a program that finds the first one in use.

A channel is used only if the program knows that it is this node's, and free. So

1. the file of the node gives both of its COB-IDs, valid, and not handed out by an SDO manager (bit 30); sub 3 names no client;
2. its requests do not go out on a CAN-ID of the predefined PDOs, SYNC, TIME or EMCY: if the file is wrong, such a frame could be
   a set-point of another drive;
3. the device itself says so, over that very channel: sub 1 and 2 are those of the file, and sub 3 names no client. The first
   channel is not touched. A device that does not have the channel does not answer;
4. it is this node that answers. Devices of one type may have the same COB-IDs by default: the CAN-ID of its first channel
   (0x1200) tells the node-ID, or without 0x1200 that of its EMCY. A device with neither is trusted if the file adds the node-ID
   to both COB-IDs.

Source: CiA 301 v4.2.0, 7.5.2.33; the predefined CAN-IDs: 7.3.5.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Final

from canopen_master.errors import SdoError, SdoRefusedError
from canopen_master.node import Node, number_if_present
from canopen_proto import indices
from canopen_proto.cob_id import is_valid
from canopen_proto.dictionary import ObjectDictionary, Values
from canopen_proto.frame import EMCY, KEY_EXTENDED, SDO_CLIENT_TO_SERVER, SDO_SERVER_TO_CLIENT, key_of_cob_id
from canopen_proto.multiplexer import mux
from canopen_proto.sdo.channels import DYNAMIC, FURTHER_SERVERS, OTHER_NODE, TO_CLIENT, TO_SERVER, channel_of
from canopen_proto.sdo.transfer import Channel
from canopen_transports.loop import protected

_TELL_THE_NODE_ID: Final = ((indices.SDO_SERVER_PARAMETER, TO_SERVER, SDO_CLIENT_TO_SERVER), (indices.COB_ID_EMERGENCY, 0, EMCY))
"""Objects whose CAN-ID is this plus the node-ID."""


class FurtherChannels:
    """The further channels that the files of a node give it. node: whose `remote.sdo` uses one of them, after `enter`.

    tell: is called with a line for people when one is used. unusable: why a channel was not used, by index.
    """

    def __init__(self, node: Node, files: Iterable[ObjectDictionary], tell: Callable[[str], object]) -> None:
        """files: those that describe this one node, best first; not the data files, which know no device."""
        self.node = node
        self.tell = tell
        self.unusable: dict[int, str] = {}
        self._channels: dict[int, tuple[Channel, bool]] = {}
        """Each channel, and whether the file adds the node-ID to its COB-IDs."""
        for file in files:
            values = Values(file, node.node_id)
            for index in sorted(file.objects.keys() & set(FURTHER_SERVERS) - self._channels.keys()):
                self._add(index, file, values)

    @property
    def candidates(self) -> tuple[int, ...]:
        """The indices of those that may be used, as far as is known."""
        return tuple(index for index in self._channels if index not in self.unusable)

    async def enter(self, index: int, holder: Callable[[], str]) -> bool:
        """Have the node's client use a channel, and tell it, if the device has it; else the client stays on the first one.

        holder: says who uses the first one. Sends reads over that channel alone. Open requests of the client end. Raises
        BusError, MasterClosedError.
        """
        self._move(self._channels[index][0])
        is_there = False
        try:
            why = await self._why_not(index)
            is_there = not why
        finally:
            if not is_there:
                self.leave()
        if why:
            self.unusable[index] = why
        else:
            self.tell(f"the first SDO channel of node {self.node.node_id} is in use by {holder()}: 0x{index:04X} is used")
        return is_there

    def leave(self) -> None:
        """Have the node's client use the first channel again."""
        self._move(None)

    @protected
    def _move(self, channel: Channel | None) -> None:
        self.node.remote.move_sdo(channel, self.node.now())

    def _add(self, index: int, file: ObjectDictionary, values: Values) -> None:
        cob_ids = [values.store.get(mux(index, each)) for each in (TO_SERVER, TO_CLIENT)]
        channel = channel_of(values, index)
        if channel is None or any(isinstance(each, int) and each & DYNAMIC for each in cob_ids):
            return
        variables = [file.variable((index, each)) for each in (TO_SERVER, TO_CLIENT)]
        adds = all(each.adds_node_id if each.configured is None else each.configured_adds_node_id for each in variables)
        self._channels[index] = channel, adds
        request = channel[0]
        if not request & KEY_EXTENDED and request < SDO_SERVER_TO_CLIENT:
            self.unusable[index] = f"has CAN-ID 0x{request:X} in the file, of the predefined PDOs, SYNC, TIME or EMCY"
        elif client := values.store.get(mux(index, OTHER_NODE)):
            self.unusable[index] = f"is for the client with node-ID {client!r}, says the file"

    async def _why_not(self, index: int) -> str:
        """Return why the channel that the client now uses may not be used; "" if it may."""
        channel, adds_node_id = self._channels[index]
        try:
            for subindex, key in zip((TO_SERVER, TO_CLIENT), channel, strict=True):
                cob_id = await number_if_present(self.node, index, subindex)
                if cob_id is None or not is_valid(cob_id) or cob_id & DYNAMIC or key_of_cob_id(cob_id) != key:
                    return "is another one in the device than in the file"
            client = await number_if_present(self.node, index, OTHER_NODE)
            if client:
                return f"is for the client with node-ID {client}, says the device"
            for index_of_id, subindex, base in _TELL_THE_NODE_ID:
                cob_id = await number_if_present(self.node, index_of_id, subindex)
                if cob_id is not None:
                    is_own = cob_id & 0x1FFF_FFFF == base + self.node.node_id
                    return "" if is_own else f"answered, but its 0x{index_of_id:04X} is not that of node {self.node.node_id}"
        except SdoError as error:
            refused = isinstance(error, SdoRefusedError)
            return f"refused to be read: abort 0x{error.abort_code:08X}" if refused else "of the file did not answer"
        return "" if adds_node_id else "answered, but not whose it is: the device has neither 0x1200 nor 0x1014"
