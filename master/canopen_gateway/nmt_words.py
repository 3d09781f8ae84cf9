"""NMT commands, as clients name them, and as text gateways do."""

from __future__ import annotations

from typing import Any, Final

from canopen_proto import NmtCommand
from canopen_proto.gateway import GatewayCommand

NMT_COMMANDS: Final = {
    "start": NmtCommand.START,
    "stop": NmtCommand.STOP,
    "preoperational": NmtCommand.ENTER_PRE_OPERATIONAL,
    "reset-node": NmtCommand.RESET_NODE,
    "reset-communication": NmtCommand.RESET_COMMUNICATION,
}
NMT_OF: Final = {
    GatewayCommand.START: NmtCommand.START,
    GatewayCommand.STOP: NmtCommand.STOP,
    GatewayCommand.PRE_OPERATIONAL: NmtCommand.ENTER_PRE_OPERATIONAL,
    GatewayCommand.RESET_NODE: NmtCommand.RESET_NODE,
    GatewayCommand.RESET_COMMUNICATION: NmtCommand.RESET_COMMUNICATION,
}
"""By the command of a text gateway."""


def nmt_command(word: Any) -> NmtCommand:
    """Return the command of a word. Raises ValueError for another word, or something else."""
    command = NMT_COMMANDS.get(word) if isinstance(word, str) else None
    if command is None:
        raise ValueError(f"{str(word)[:40]!r} is no NMT command; there are {', '.join(NMT_COMMANDS)}")
    return command
