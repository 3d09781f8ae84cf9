"""What `mypy --strict` has to refuse: each line with an ignore is a mistake, and an ignore without one is reported too."""

from __future__ import annotations

from canopen_proto import RemoteNode, mux, routing_key
from canopen_proto.datatypes import DataType
from canopen_proto.declared import DeclaredDevice, Nameplate, Tpdo, array, variable


def writes_at_an_index(node: RemoteNode) -> None:
    node.values.store[mux(0x6040)] = 15
    node.values.store[0x6040] = 15  # type: ignore[index]


def asks_for_an_index(node: RemoteNode) -> None:
    node.fresh(mux(0x6041), 0)
    node.fresh(0x6041, 0)  # type: ignore[arg-type]


def takes_a_routing_key_for_a_mux(node: RemoteNode) -> None:
    node.add_sdo_channel(routing_key(0x61A), routing_key(0x59A))
    node.add_sdo_channel(mux(0x6041), routing_key(0x59A))  # type: ignore[arg-type]
    node.fresh(routing_key(0x181), 0)  # type: ignore[arg-type]


def declares_what_cannot_be() -> None:
    class Station(DeclaredDevice):
        nameplate = Nameplate("Station")
        row = variable(0x2000, "Row", DataType.UNSIGNED8, 1)
        names = array(0x2001, "Name", DataType.VISIBLE_STRING, 2, "a")
        wrong = variable(0x2002, "Wrong", DataType.UNSIGNED8, "one")  # type: ignore[call-overload]
        pdos = (Tpdo(1, row), Tpdo(2, names[1]), Tpdo(3, 0x2000))  # type: ignore[arg-type]

        def sets_what_the_objects_cannot_hold(self) -> str:
            self.row = 2
            self.row = "2"  # type: ignore[assignment]  # pyright takes it
            self.names[1] = "b"
            self.names[1] = 2  # type: ignore[assignment]
            self.names = ["b", "c"]  # type: ignore[assignment]  # pyright takes it
            self.nams[1] = "b"  # type: ignore[attr-defined]
            return self.row  # type: ignore[return-value]  # pyright takes it
