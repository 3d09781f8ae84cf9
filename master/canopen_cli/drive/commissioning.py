"""The person at the terminal to whom `canopen drive commission NODE` speaks; canopen_master has the dialogue."""

from __future__ import annotations

from canopen_cli.node.backup import bit_rate_of, write_dcf
from canopen_cli.node.backup_reading import read_all, tell_unread
from canopen_cli.shared.options import Settings
from canopen_cli.shared.questions import Questions
from canopen_cli.shared.screen import Screen, escape
from canopen_cli.shared.session import BusSession
from canopen_master.commissioning import DriveCommissioning
from canopen_master.commissioning_dialogue import CommissioningDialogue
from canopen_master.way_back import counts_text
from canopen_proto.drives.axis.settings import AxisSettings


class TerminalConversation(Questions):
    """Shows on the terminal, and asks there; see Conversation."""

    halted_by = "Ctrl-C"

    def heading(self, text: str) -> None:
        """See Conversation."""
        self._screen.say(f"\n[bold]{escape(text)}[/]")

    def fact(self, name: str, text: str) -> None:
        """See Conversation."""
        self._screen.fact(name, text)

    def say(self, text: str) -> None:
        """See Conversation."""
        self._screen.say(escape(text))

    def remark(self, text: str) -> None:
        """See Conversation."""
        self._screen.say(f"[dim]{escape(text)}[/]")

    def warn(self, text: str, more: str = "") -> None:
        """See Conversation."""
        self._screen.say(f"[yellow]{escape(text)}[/] {escape(more)}".rstrip())


def dialogue_of(
    settings: Settings, screen: Screen, session: BusSession, node_id: int, dcf: str, done: list[str], *, agrees: bool
) -> CommissioningDialogue:
    """Return the dialogue about a drive. dcf: the file for the drive as it is delivered. done: gets what was done. agrees: nobody
    is asked."""
    node, description = session.node(node_id), session.description_of(node_id)
    joint = session.files.settings.joint(node_id)
    work = DriveCommissioning(session.master, node, AxisSettings() if joint is None else joint.settings, done)

    async def save() -> tuple[str, str]:
        found = await read_all(session, screen, node_id, None, False)
        tell_unread(screen, found, write_dcf(dcf, found, description, bit_rate_of(settings)))
        return dcf, counts_text(found)

    return CommissioningDialogue(TerminalConversation(screen, agrees=agrees), work, description, save)
