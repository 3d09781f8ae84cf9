"""The view of a running demonstration: on a terminal a picture that is drawn again and again, elsewhere a line for each step."""

from __future__ import annotations

import enum
from dataclasses import dataclass, field
from types import TracebackType
from typing import Final

from rich.cells import cell_len
from rich.console import Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.spinner import Spinner
from rich.table import Table
from rich.text import Text

from canopen_cli.shared.screen import Screen, escape, node_text

TRACK_WIDTH: Final = 41
"""Characters of the line that shows a joint's position, where there is room; odd, so that it has a middle."""
LEAST_TRACK_WIDTH: Final = 9
STATE_WIDTH: Final = 22
POSITION_WIDTH: Final = 9


class Mark(enum.Enum):
    """The state of a step."""

    RUNNING = ""
    DONE = "[green]✔[/]"
    FAILED = "[red]✘[/]"


@dataclass
class ViewStep:
    """One step: boot, home, move. progress: 0 to 1, None if it is not known."""

    name: str
    text: str
    mark: Mark = Mark.RUNNING
    progress: float | None = None


@dataclass
class JointView:
    """The row of a joint. position, error: degrees."""

    name: str
    node_id: int
    state: str = ""
    position: float | None = None
    error: float | None = None


@dataclass
class DemoView:
    """The view of a run; use it as a context manager around the run. range: degrees that the position line spans to each side."""

    screen: Screen
    title: str
    range: float
    joints: list[JointView] = field(default_factory=list)
    steps: list[ViewStep] = field(default_factory=list)
    _live: Live | None = None
    _spinner: Spinner = field(default_factory=lambda: Spinner("dots", style="cyan"))

    def __enter__(self) -> DemoView:
        self.screen.say(f"[bold]{escape(self.title)}[/]")
        if self.screen.draws:
            self._live = Live(console=self.screen.err, auto_refresh=False, transient=True)
            self._live.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if kind is not None and self.steps and self.steps[-1].mark is Mark.RUNNING:
            self._end(self.steps[-1], Mark.FAILED)
        self._stop()

    def _stop(self) -> None:
        if self._live is not None:
            self._live.stop()
            self._live = None

    def begin(self, name: str, text: str, progress: float | None = None) -> ViewStep:
        """Begin a step."""
        step = ViewStep(name, text, progress=progress)
        self.steps.append(step)
        self.refresh()
        return step

    def done(self, step: ViewStep, text: str) -> None:
        """End a step that succeeded."""
        step.text = text
        self._end(step, Mark.DONE)

    def _end(self, step: ViewStep, mark: Mark) -> None:
        step.mark = mark
        line = f"{mark.value} {step.name:<6} {escape(step.text)}"
        if self._live is not None:
            self._live.console.print(line)  # above the picture
            self.refresh()
        else:
            self.screen.say(line)

    def refresh(self) -> None:
        """Draw the picture again; does nothing without a terminal."""
        if self._live is not None:
            self._live.update(self._picture(), refresh=True)

    def _picture(self) -> Group:
        running = [step for step in self.steps if step.mark is Mark.RUNNING]
        lines = Table.grid(padding=(0, 1))
        for step in running:
            bar = ProgressBar(total=1.0, completed=step.progress, width=30) if step.progress is not None else ""
            lines.add_row(self._spinner, f"{step.name:<6}", bar, Text(step.text))
        names = max((cell_len(joint.name) for joint in self.joints), default=0)
        nodes = max((len(node_text(joint.node_id)) for joint in self.joints), default=0)
        width = self.screen.err.width - names - nodes - STATE_WIDTH - POSITION_WIDTH - 8  # 2 between the columns
        width = min(TRACK_WIDTH, max(LEAST_TRACK_WIDTH, (width - 1) | 1))
        joints = Table.grid(padding=(0, 2))
        joints.add_column(style="bold", no_wrap=True)
        joints.add_column(style="dim", no_wrap=True)
        joints.add_column(no_wrap=True, min_width=STATE_WIDTH)
        joints.add_column(no_wrap=True)
        joints.add_column(justify="right", no_wrap=True, min_width=POSITION_WIDTH)
        for joint in self.joints:
            position = "" if joint.position is None else f"{joint.position:+.2f}°"
            joints.add_row(escape(joint.name), node_text(joint.node_id), _state(joint.state), self._track(joint, width), position)
        return Group(lines, Text(""), joints) if self.joints else Group(lines)

    def _track(self, joint: JointView, width: int) -> Text:
        """Draw the position on a line, with 0 in its middle."""
        track = Text("─" * width, style="grey37")
        middle = width // 2
        track.stylize("grey62", middle, middle + 1)
        if joint.position is None:
            return track
        place = middle + round(joint.position / self.range * middle)
        place = min(max(place, 0), width - 1)
        low, high = min(place, middle), max(place, middle)
        track.stylize("cyan", low, high + 1)
        return Text.assemble(track[:place], ("●", "bold cyan"), track[place + 1 :])


def _state(state: str) -> Text:
    style = "green" if state == "operation enabled" else "red" if state.startswith("fault") else ""
    return Text(state, style=style)
