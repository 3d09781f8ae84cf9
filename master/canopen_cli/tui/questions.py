"""Questions in the view: a line to be typed. Escape, and everything but the answer itself, is no."""

from __future__ import annotations

from typing import ClassVar

from rich.text import Text
from textual import on
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical
from textual.screen import ModalScreen
from textual.widgets import Input, Static

from canopen_master.plain_text import clean

YES = "yes"
"""To be typed in full: no single key writes, or commands."""


class Ask(ModalScreen[str | None]):
    """A question, and a line for its answer: None after Escape. default: what stands in the line."""

    BINDINGS: ClassVar[list[BindingType]] = [Binding("escape", "leave", "back")]

    def __init__(self, question: str, more: str = "", default: str = "") -> None:
        super().__init__()
        self._question, self._more, self._default = question, more, default

    def compose(self) -> ComposeResult:
        """The question, what is to be known, the line, the keys."""
        with Vertical(id="question"):
            yield Static(Text(clean(self._question), style="bold"))
            if self._more:
                yield Static(Text("\n".join(map(clean, self._more.splitlines()))))
            yield Input(self._default, compact=True, id="answer", select_on_focus=False)
            yield Static(Text("Enter: take it   Esc: back, nothing is sent", style="dim"))

    @on(Input.Submitted)
    def take(self, event: Input.Submitted) -> None:
        """Return the answer."""
        event.stop()
        self.dismiss(event.value.strip())

    def action_leave(self) -> None:
        """Return no answer."""
        self.dismiss(None)


class KeysPage(ModalScreen[None]):
    """A text, until a key."""

    BINDINGS: ClassVar[list[BindingType]] = [Binding("escape,q,enter,question_mark,space", "leave", "back")]

    def __init__(self, text: str) -> None:
        super().__init__()
        self._text = text

    def compose(self) -> ComposeResult:
        """The text."""
        with Vertical(id="page"):
            yield Static(Text(self._text))

    def action_leave(self) -> None:
        """End it."""
        self.dismiss(None)
