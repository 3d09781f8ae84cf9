"""`canopen log plot`: the values of objects in a recording, drawn over time. Needs matplotlib."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import click

from canopen_cli.live.frame_lines import WantedFrames
from canopen_cli.live.log_values import values_in
from canopen_cli.live.source import FILE_OR_INPUT
from canopen_cli.live.window import Window, windowed
from canopen_cli.plot.cycles import INK, check_plot, save, style, write_titles
from canopen_cli.shared.new_files import check_new_file
from canopen_cli.shared.options import FILE, NodeIds, Settings, command
from canopen_cli.shared.problem import CommandError, ExitCode
from canopen_cli.shared.screen import Screen, counted, escape


class Curve(NamedTuple):
    """The values of one object over time. unit: "" for none."""

    label: str
    unit: str
    seconds: list[float]
    values: list[float]


@command("plot")
@click.argument("source", metavar="FILE", type=FILE_OR_INPUT)
@click.argument("objects", metavar="OBJECT...", nargs=-1, required=True)
@click.option("-o", "--output", type=FILE, help="The picture: .png, .svg, .pdf.  [default: FILE.png]")
@click.option("--node", "nodes", type=NodeIds(), help="Only of these nodes: 5, or 3-8.")
@windowed
def plot(
    settings: Settings,
    screen: Screen,
    source: Path,
    objects: tuple[str, ...],
    output: Path | None,
    nodes: tuple[int, ...] | None,
    window: Window,
) -> None:
    """Draw the values of objects in a recording over time: each in a row of its own, as a step from value to value.

    \b
    canopen log plot trace.log statusword 6064
    canopen log plot trace.log 6064 --node 5 --since 10s -o run.svg
    """
    target = source.with_suffix(".png") if output is None else output
    check_plot(target)
    check_new_file(settings, screen, target, str(source))
    curves: dict[tuple[str, str], Curve] = {}  # by bus and object: node 5 of one bus is not node 5 of another
    for value in values_in(settings, screen, source, WantedFrames(nodes, objects=objects), window):
        if value.number is not None:
            curve = curves.setdefault((value.record.channel, value.label), Curve(value.label, value.unit, [], []))
            curve.seconds.append(value.seconds)
            curve.values.append(value.number)
    has_several = len({channel for channel, _ in curves}) > 1
    found = [each._replace(label=f"{channel} {label}") if has_several else each for (channel, label), each in curves.items()]
    if not found:
        raise CommandError(
            ExitCode.BAD_FILE, "CO342", f"there is no number of {', '.join(objects)} in {source}",
            tries=(f"canopen log decode {source}", "-e FILE, which names objects and PDOs"),
        )  # fmt: skip
    _draw(target, str(source), found)
    if settings.json:
        drawn = [{"object": each.label, "unit": each.unit, "values": len(each.values)} for each in found]
        screen.json({"file": str(source), "picture": str(target), "curves": drawn})
    else:
        rows = [(escape(each.label), *map(_shown, (min(each.values), max(each.values), len(each.values)))) for each in found]
        screen.table(("object", "lowest", "highest", "values"), rows, right=("lowest", "highest", "values"))
    screen.say(f"{counted(len(found), 'curve')} drawn: [bold]{escape(str(target))}[/]")


def _draw(path: Path, title: str, curves: list[Curve]) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 1.3 + 1.9 * len(curves)), layout="constrained", facecolor="white")
    grid: Any = figure.subplots(len(curves), 1, sharex=True, squeeze=False)
    for (axes,), curve in zip(grid, curves, strict=True):
        axes.step(curve.seconds, curve.values, where="post", linewidth=1.2)
        axes.set_title(curve.label, loc="left", color=INK, fontsize=9.5)
        style(axes, curve.unit)
    grid[-1][0].set_xlabel("time in s", color=INK, fontsize=9)
    write_titles(figure, title, counted(len(curves), "object"))
    save(figure, path)


def _shown(number: float) -> str:
    return f"{number:.6g}"
