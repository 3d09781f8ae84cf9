"""NMT commands, as clients name them."""

from __future__ import annotations

from typing import Any, Final

from canopen_proto import NmtCommand

NMT_COMMANDS: Final = {
    "start": NmtCommand.START,
    "stop": NmtCommand.STOP,
    "preoperational": NmtCommand.ENTER_PRE_OPERATIONAL,
    "reset-node": NmtCommand.RESET_NODE,
    "reset-communication": NmtCommand.RESET_COMMUNICATION,
}


def nmt_command(word: Any) -> NmtCommand:
    """Return the command of a word. Raises ValueError for another word, or something else."""
    command = NMT_COMMANDS.get(word) if isinstance(word, str) else None
    if command is None:
        raise ValueError(f"{str(word)[:40]!r} is no NMT command; there are {', '.join(NMT_COMMANDS)}")
    return command
