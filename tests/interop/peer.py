"""What both sides of an interoperability test need: a channel of its own, and our dictionary as the peer's."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from contextlib import contextmanager

import canopen
from canopen.objectdictionary import ODArray, ODRecord, ODVariable

from canopen_proto.dictionary import ObjectDictionary, Variable
from canopen_proto.dictionary.model import ObjectType
from tests.interop.driver import LIMIT

_CHANNELS = itertools.count(1)


def new_channel() -> str:
    """A bus that no other test is on."""
    return f"interop-{next(_CHANNELS)}"


def peer_dictionary(dictionary: ObjectDictionary, node_id: int) -> canopen.ObjectDictionary:
    """Our description as one of `canopen`."""
    theirs = canopen.ObjectDictionary()
    for each in dictionary.objects.values():
        if each.object_type is ObjectType.VAR:
            theirs.add_object(_variable(each.variables[0], node_id, each.name))
            continue
        container = (ODArray if each.object_type is ObjectType.ARRAY else ODRecord)(each.name, each.index)
        for variable in each.variables.values():
            container.add_member(_variable(variable, node_id, f"{variable.name}_{variable.subindex}"))
        theirs.add_object(container)
    return theirs


def _variable(variable: Variable, node_id: int, name: str) -> ODVariable:
    theirs = ODVariable(name, variable.index, variable.subindex)
    theirs.data_type = int(variable.data_type)
    theirs.access_type = str(variable.access)
    theirs.default = variable.default_of(node_id)
    theirs.pdo_mappable = variable.pdo_mappable
    return theirs


@contextmanager
def peer_network(channel: str) -> Iterator[canopen.Network]:
    """A network of `canopen` on a channel, shut down in the end with all its threads, for which it does not wait itself."""
    network = canopen.Network()
    network.NOTIFIER_CYCLE = 0.01  # its thread looks that often whether it is to end
    network.NOTIFIER_SHUTDOWN_TIMEOUT = LIMIT
    network.connect(interface="virtual", channel=channel)
    try:
        yield network
    finally:
        readers, senders = network.notifier._readers, [task.thread for task in network.bus._periodic_tasks]
        for node in network.nodes.values():
            if isinstance(node, canopen.LocalNode):
                node.nmt.stop_heartbeat()
        network.sync.stop()
        network.bus.stop_all_periodic_tasks()
        for sender in senders:
            sender.join(LIMIT)
        network.disconnect()
        assert not any(thread.is_alive() for thread in (*readers, *senders))
