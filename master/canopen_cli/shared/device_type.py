"""Whether a device is of the type that a file describes, asked before something is written by that file."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from canopen_cli.shared.problem import CommandError, ExitCode
from canopen_cli.shared.screen import node_text
from canopen_cli.shared.session import BusSession
from canopen_proto import indices
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.manager.parameters.backup import upload_again
from canopen_proto.procedures.objects import unless_refused

_TYPE: Final = ((1, "vendor-ID"), (2, "product code"))
"""Subindices of 0x1018 that show it."""


async def check_type(session: BusSession, node_id: int, dictionary: ObjectDictionary, path: str | Path) -> None:
    """Raise a CommandError if the device is not of the type that its file describes. dictionary: that of the file. path: of the
    file, for people. A number that either lacks is no difference."""
    node = session.node(node_id)
    for subindex, name in _TYPE:
        variable = dictionary.get(indices.IDENTITY_OBJECT, subindex)
        expected = 0 if variable is None else variable.initial_of(node_id)
        if not isinstance(expected, int) or not expected:
            continue
        data = await session.master.run(unless_refused(upload_again(node.remote, indices.IDENTITY_OBJECT, subindex, False)))
        found = int.from_bytes(data or b"", "little")
        if found and found != expected:
            raise CommandError(
                ExitCode.DIFFERENT,
                "CO207",
                f"{node_text(node_id)} is not of the type that {path} describes; nothing was written",
                seen=f"{name} 0x{found:08X}, in the file 0x{expected:08X}",
                tries=(f"canopen info {node_id}", "--any-device, if that is what you want"),
                node=node_id,
                index=indices.IDENTITY_OBJECT,
                subindex=subindex,
            )
