"""What `mypy --strict` has to refuse: each line with an ignore is a mistake, and an ignore without one is reported too."""

from __future__ import annotations

from canopen_proto import RemoteNode, mux, routing_key


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
