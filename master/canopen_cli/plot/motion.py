"""Draw curves of joints: position, velocity, acceleration and following error, one above the other. Needs matplotlib."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from canopen_cli.plot.curves import JointCurves, MotionCurves
from canopen_cli.plot.cycles import INK, PALE, save, style, write_titles

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLOURS: Final = (
    "#0b6e99", "#d9730d", "#0f7b6c", "#ad1a72", "#6940a5", "#9b6a00", "#e03e3e", "#3f51b5", "#5f7a00", "#64473a",
)  # fmt: skip
_DASHES: Final = ("-", "--", ":")
"""Joints beyond the colours have them again, with other lines."""
_LATE: Final = "#ba2525"
_LATE_LABEL: Final = "late or skipped cycle: it makes the steps there"
_ROWS: Final = (
    ("position", "", "wanted", "actual"),
    ("velocity", "/s", "velocities", "actual_velocities"),
    ("acceleration", "/s²", "accelerations", ""),
    ("following error", "", "", "errors"),
)
"""Of each row: name, what is added to the unit, the quantity that was wanted, and the one that came."""
_SHORT: Final = {"degree": "°", "radian": "rad", "millimetre": "mm", "count": "counts", "turn": "turns"}


def write_motion_plot(path: Path, curves: MotionCurves) -> None:
    """Draw the curves into a file; its suffix tells the format. Raises CommandError if it cannot be written."""
    from matplotlib.figure import Figure

    units = list(dict.fromkeys(joint.unit for joint in curves.joints))
    rows = [row for row in _ROWS if any(_known(joint, row) for joint in curves.joints)]
    figure = Figure(figsize=(5.5 * max(2, len(units)), 1.3 + 2.2 * len(rows)), layout="constrained", facecolor="white")
    figure.get_layout_engine().set(w_pad=0.12, h_pad=0.06, rect=(0, 0, 1, 0.985))  # type: ignore[union-attr, call-arg]
    grid: Any = figure.subplots(len(rows), len(units), sharex=True, squeeze=False)
    styles = {
        joint.name: {"color": _COLOURS[number % len(_COLOURS)], "linestyle": _DASHES[number // len(_COLOURS) % len(_DASHES)]}
        for number, joint in enumerate(curves.joints)
    }
    for line, row in zip(grid, rows, strict=True):
        for axes, unit in zip(line, units, strict=True):
            _draw(axes, row, curves, [joint for joint in curves.joints if joint.unit == unit], styles)
    for axes in grid[-1]:
        axes.set_xlabel("time in s", color=INK, fontsize=9)
    for axes in grid.flat if curves.late else ():  # in each row: a step of a velocity there is the cycle's, not the motion's
        marks, place = [0.02] * len(curves.late), axes.get_xaxis_transform()
        axes.plot(curves.late, marks, "|", color=_LATE, markersize=9, transform=place, label=_LATE_LABEL)
    handles = [*grid[0][0].get_legend_handles_labels()[0]]
    if len(units) > 1:
        handles = [handle for axes in grid[0] for handle in axes.get_legend_handles_labels()[0]]
    late = [handle for handle in handles if handle.get_label() == _LATE_LABEL]
    handles = [handle for handle in handles if handle not in late] + late[:1]
    write_titles(figure, curves.title, curves.subtitle)
    figure.legend(handles=handles, loc="outside right upper", frameon=False, fontsize=9.5)
    save(figure, path)


def _known(joint: JointCurves, row: tuple[str, str, str, str]) -> bool:
    """Return whether a row has anything of a joint to show."""
    return any(name and len(getattr(joint, name)) > 0 for name in row[2:])


def _draw(
    axes: Axes,
    row: tuple[str, str, str, str],
    curves: MotionCurves,
    joints: Sequence[JointCurves],
    styles: dict[str, dict[str, str]],
) -> None:
    title, per, wanted, actual = row
    for joint in joints:
        points: Sequence[float] = getattr(joint, wanted) if wanted else ()
        came: Sequence[float] = getattr(joint, actual) if actual else ()
        look: dict[str, Any] = styles[joint.name]
        if len(points) and len(came):  # the wanted one broad and pale behind what came
            axes.plot(curves.times, points, linewidth=4.5, alpha=0.3, **look)
        elif len(points):
            axes.plot(curves.times, points, linewidth=1.3, label=joint.name, **look)
        if len(came):
            axes.plot(curves.times, came, linewidth=1.3, label=joint.name, **look)
    unit = _SHORT.get(joints[0].unit, joints[0].unit)
    axes.set_title(title, loc="left", fontsize=11, fontweight="bold", color=INK, pad=5)
    note = "broad: wanted, thin: actual" if wanted and actual and len(getattr(joints[0], actual)) else ""
    axes.set_title(note, loc="right", fontsize=8.5, color=PALE, pad=5)
    style(axes, f"{unit}{per}")
