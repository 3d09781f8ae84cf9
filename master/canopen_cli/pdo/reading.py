"""The PDOs that a command is about, as they are named on the command line; canopen_master/pdo_reading.py reads them."""

from __future__ import annotations

import re
from typing import Final

from canopen_cli.shared.problem import usage
from canopen_cli.shared.session import BusSession
from canopen_master.node import Node
from canopen_master.pdo_reading import PdoRead, read_pdos
from canopen_proto.dictionary import Direction
from canopen_proto.pdo.settings import MAX_PDOS

_NAME: Final = re.compile(r"([rt])(?:x)?[ _-]?pdo[ _-]?([0-9]{1,3})", re.IGNORECASE)


def pdo_of(text: str) -> tuple[Direction, int]:
    """Return the PDO of a device that a text names: "tpdo1", "RPDO 2". Raises a CommandError."""
    found = _NAME.fullmatch(text.strip())
    if found is None or not 1 <= int(found[2]) <= MAX_PDOS:
        raise usage("CO001", f"{text!r} is no PDO", seen=f"PDOs are tpdo1, rpdo2 ... up to {MAX_PDOS}")
    return (Direction.RPDO if found[1].lower() == "r" else Direction.TPDO), int(found[2])


async def read_all_pdos(session: BusSession, node: Node) -> list[PdoRead]:
    """Read all PDOs of a node; see `read_pdos`."""
    description = session.description_of(node.node_id)
    return await read_pdos(session.master, node, None if description is None else description.dictionary)
