"""Draw a demonstration: commanded and actual position of each joint. Needs matplotlib, the extra `plot`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from canopen_cli.shared.new_files import check_writable
from canopen_cli.shared.problem import CommandError, ExitCode, usage
from canopen_master.demonstration.recording import JointTrack, Recording

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLUMNS = 2
_COMMANDED = "#9aa5b1"
_ACTUAL = "#0b6e99"
INK = "#243b53"
PALE = "#627d98"
_FAULT = "#ba2525"
_ERROR = "#d9730d"


def check_plot(path: Path) -> None:
    """Raise a CommandError, before anything moves, if no picture could be written: no matplotlib, no folder, an unknown
    format."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
    except ImportError as missing:
        raise usage(
            "CO140",
            f"a picture needs {missing.name or 'matplotlib'}, which is not installed",
            tries=("pip install 'canopen-proto[plot]'",),
        ) from None
    if not path.parent.is_dir():
        raise CommandError(
            ExitCode.BAD_FILE,
            "CO341",
            f"cannot write {path}: the folder {path.parent} does not exist",
            tries=(f"mkdir -p {path.parent}",),
        )
    known = FigureCanvasAgg.get_supported_filetypes()
    if path.suffix.lstrip(".").lower() not in known:
        raise usage("CO140", f"cannot write a picture as {path.name!r}", tries=(f"one of .{', .'.join(sorted(known))}",))
    check_writable(path)


def write_plot(path: Path, recording: Recording, title: str, subtitle: str) -> None:
    """Draw the recording into a file; its suffix tells the format. Raises CommandError if it cannot be written."""
    from matplotlib.figure import Figure

    rows = -(-len(recording.joints) // COLUMNS)
    figure = Figure(figsize=(11, 1.5 + 2.9 * rows), layout="constrained", facecolor="white")
    figure.get_layout_engine().set(w_pad=0.12, h_pad=0.06, rect=(0, 0, 1, 0.985))  # type: ignore[union-attr, call-arg]
    grid: Any = figure.subplots(2 * rows, COLUMNS, sharex=True, squeeze=False, height_ratios=[2.4, 1] * rows)
    cells: list[Axes] = list(grid[0::2].flat)
    strips: list[Axes] = list(grid[1::2].flat)
    for axes, strip, joint in zip(cells, strips, recording.joints, strict=False):
        _draw(axes, recording.times, joint)
        _draw_errors(strip, recording.times, joint)
        if recording.planned_from is not None:
            for each in (axes, strip):
                each.axvline(recording.planned_from, color=PALE, linewidth=0.9, linestyle=":")
            place = axes.get_xaxis_transform()
            axes.text(recording.planned_from, 0.93, " planned move", color=PALE, fontsize=8.5, transform=place)
        if recording.broken is not None:
            time, name = recording.broken
            axes.axvline(time, color=_FAULT, linewidth=1.2, linestyle="--" if name == joint.name else ":")
            if name == joint.name:
                axes.text(time, 0.06, " fault", color=_FAULT, fontsize=9, transform=axes.get_xaxis_transform())
    for axes in (*cells[len(recording.joints) :], *strips[len(recording.joints) :]):
        axes.set_axis_off()
    for axes in strips[max(0, len(recording.joints) - COLUMNS) : len(recording.joints)]:
        axes.set_xlabel("time in s", color=INK, fontsize=9)
        axes.tick_params(labelbottom=True)
    handles, labels = (ours + theirs for ours, theirs in zip(*map(_legend_of, (cells[0], strips[0])), strict=True))
    write_titles(figure, title, subtitle)
    figure.legend(handles, labels, loc="upper right", ncols=3, frameon=False, fontsize=10, bbox_to_anchor=(0.995, 0.995))
    save(figure, path)


def write_titles(figure: Figure, title: str, subtitle: str) -> None:
    """Write the title and the subtitle of a picture."""
    figure.suptitle(f"{title}\n", x=0.012, ha="left", fontsize=15, fontweight="bold", color=INK)
    figure.text(0.012, 1 - 0.52 / figure.get_figheight(), subtitle, fontsize=9.5, color=PALE, va="center")


def save(figure: Figure, path: Path) -> None:
    """Write a picture; its suffix tells the format. Raises CommandError if it cannot be written."""
    try:
        figure.savefig(path, dpi=130)
    except OSError as error:
        raise CommandError(ExitCode.BAD_FILE, "CO341", f"cannot write {path}: {error.strerror}") from None


def style(axes: Axes, unit: str) -> None:
    """Give axes the look of all our pictures. unit: behind each number of its values."""
    gap = "" if unit.startswith("°") else " "
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}{gap}{unit}")
    axes.tick_params(colors="#486581", labelsize=8.5, length=0)
    axes.grid(color="#e4e7eb", linewidth=0.8)
    axes.set_axisbelow(True)
    axes.margins(x=0.01, y=0.12)
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)
    axes.spines["bottom"].set_color("#bcccdc")


def _draw(axes: Axes, times: list[float], joint: JointTrack) -> None:
    count = min(len(times), len(joint.actual), len(joint.commanded))
    axes.plot(times[:count], joint.commanded[:count], color=_COMMANDED, linewidth=4.5, alpha=0.65, label="commanded")
    axes.plot(times[:count], joint.actual[:count], color=_ACTUAL, linewidth=1.5, label="actual")
    axes.set_title(f"{joint.name}", loc="left", fontsize=11, fontweight="bold", color=INK, pad=5)
    note = f"node {joint.node_id} (0x{joint.node_id:02X})   largest following error {joint.largest_error:.3f}°"
    axes.set_title(note, loc="right", fontsize=8.5, color=PALE, pad=5)
    style(axes, "°")


def _draw_errors(axes: Axes, times: list[float], joint: JointTrack) -> None:
    """Draw the strip of the following error below the positions of a joint."""
    errors = [wanted - actual for wanted, actual in zip(joint.commanded, joint.actual, strict=False)]
    axes.axhline(0, color="#bcccdc", linewidth=0.8)
    axes.plot(times[: len(errors)], errors[: len(times)], color=_ERROR, linewidth=1.1, label="following error")
    style(axes, "°")


def _legend_of(axes: Axes) -> tuple[list[Any], list[str]]:
    return axes.get_legend_handles_labels()
