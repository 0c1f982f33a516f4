"""The installers' sheet: a page A3 with the plan to a round scale, every beacon's place, nearest wall and side."""

from __future__ import annotations

import io
from math import ceil, cos, radians, sin
from typing import TYPE_CHECKING, Any

import numpy as np

from driftplan.files import head
from driftplan.layouts.layout import Layout
from driftplan.layouts.layout_files import installer_columns, installer_table
from driftplan.report.figures import style
from driftplan.report.figures.layouts import found_in_words, map_box
from driftplan.report.figures.maps import plot_world
from driftplan.tables import counted

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PAGE_MM = np.array([420.0, 297.0])
_PLAN_MM = np.array([28.0, 30.0, 240.0, 240.0])  # left, bottom, and the most that the plan may take
_TABLE_MM = np.array([280.0, 30.0, 128.0, 240.0])
_SCALES = (10, 20, 25, 50, 75, 100, 125, 150, 200, 250, 300, 400, 500, 750)  # and a hundred times these
_BARS_M = (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000)
_BAR_MM, _ARROW_MM = 30.0, 6.0
_MM_PER_INCH = 25.4
_ROW_MM, _LEAST_ROW_MM = 5.0, 2.4


def layout_pdf(layout: Layout) -> bytes:
    """The sheet as PDF, one page A3, to be printed as it is: `layout_sheet`.

    >>> from driftplan import BeaconKind, OdometryNoise, place_beacons
    >>> noise, tag = OdometryNoise(heading_var_per_m=1e-3), BeaconKind.rfid(range_m=1.5, position_std_m=0.1)
    >>> layout = place_beacons(None, [(0, 0), (10, 0)], noise, 0.5, tag)
    >>> layout_pdf(layout)[:4]
    b'%PDF'
    """
    page = io.BytesIO()
    layout_sheet(layout).savefig(page, format="pdf", metadata={"CreationDate": None, "Subject": head("map")[2:-1]})
    return page.getvalue()


def layout_sheet(layout: Layout) -> Figure:
    """The plan with ids and the way to the nearest wall, the table and a scale bar, on a figure of the page's size.

    Of more beacons than the page has room for (some 95) the table lists those whose failure hurts most.
    """
    from matplotlib.figure import Figure

    width, height = _PAGE_MM / _MM_PER_INCH
    figure = Figure(figsize=(width, height))
    low, high = map_box(layout)
    size = np.maximum(high - low, 0.1)
    scale = _scale(float((1000 * size / _PLAN_MM[2:]).max()))
    left, bottom, _, most = _PLAN_MM
    across, up = 1000 * size / scale
    ax = _panel(figure, np.array([left, bottom + most - up, across, up]))
    _plan(layout, ax, _ARROW_MM * scale / 1000)
    ax.set(xlim=(low[0], low[0] + size[0]), ylim=(low[1], low[1] + size[1]))
    _table(layout, _panel(figure, _TABLE_MM))
    _words(layout, figure, scale)
    return figure


def _panel(figure: Figure, mm: Any) -> Axes:
    left, bottom, width, height = (mm / np.tile(_PAGE_MM, 2)).tolist()
    return figure.add_axes((left, bottom, width, height))


def _scale(least: float) -> int:
    """The first round scale that shows no more than so many metres per metre of paper."""
    return next(round for power in (1, 100, 10_000, 10**6) for n in _SCALES if (round := n * power) >= least)


def _plan(layout: Layout, ax: Axes, arrow_m: float) -> None:
    if layout.scenario.world is not None:
        plot_world(layout.scenario.world, ax=ax)
    for drift in layout.drifts:
        ax.plot(*drift.xy.T, color="0.6", linewidth=0.6, zorder=2)
    for row in installer_table(layout):
        ax.plot([row.x_m, row.wall_x_m], [row.y_m, row.wall_y_m], color="0.3", linewidth=0.5, zorder=3)
        look = style.BEACON if row.new else style.OTHER_BEACON
        ax.plot(row.x_m, row.y_m, linestyle="none", **{**look, "markersize": 5}, zorder=4)
        if np.isfinite(row.facing_deg):
            ahead = radians(row.facing_deg)
            head = row.x_m + arrow_m * cos(ahead), row.y_m + arrow_m * sin(ahead)
            arrow = {"arrowstyle": "->", "linewidth": 0.8, "shrinkA": 0, "shrinkB": 0}
            ax.annotate("", head, (row.x_m, row.y_m), arrowprops=arrow)
        ax.annotate(row.id, (row.x_m, row.y_m), (4, 4), textcoords="offset points", fontsize=8, weight="bold", zorder=5)
    style.in_metres(ax)
    ax.xaxis.label.set_fontsize(8)
    ax.yaxis.label.set_fontsize(8)
    ax.tick_params(labelsize=7)


def _table(layout: Layout, ax: Axes) -> None:
    columns = installer_columns(installer_table(layout))
    columns = {name: columns[name] for name in ("id", "kind", "x m", "y m", "nearest wall m", "mounted")}
    count = len(columns["id"])
    room = _TABLE_MM[3] - 1.2 * _ROW_MM
    row = min(max(room / max(count, 1), _LEAST_ROW_MM), _ROW_MM)
    fit = int(room / row)
    ax.set(xlim=(0, 1), ylim=(-_TABLE_MM[3], 0.0))
    ax.set_axis_off()
    widths = np.array([max(len(str(cell)) for cell in (name, *cells[:fit])) + 2 for name, cells in columns.items()])
    size = min(9.0, 2.0 * row)
    for left, (name, cells) in zip(np.cumsum(widths) - widths, columns.items(), strict=True):
        for k, cell in enumerate((name, *cells[:fit])):
            place = left / widths.sum(), -1.2 * _ROW_MM * (k > 0) - row * max(k - 1, 0)
            ax.text(*place, str(cell), fontsize=size, va="top", weight="bold" if k == 0 else "normal")
    ax.plot([0, 1], [-0.9 * _ROW_MM] * 2, color="0.3", linewidth=0.6)
    if count > fit:
        ax.text(0, -_TABLE_MM[3] - 2, f"and {count - fit} more, in the CSV table", fontsize=8, va="top")


def _words(layout: Layout, figure: Figure, scale: int) -> None:
    keep = f"{counted(len(layout.drifts), 'route')} under {max(layout.max_drift):.3g} m of drift"
    across, up = _PAGE_MM

    def say(x: float, y: float, text: str, **look: Any) -> None:
        figure.text(x / across, y / up, text, **look)

    title = f"Beacon layout: {found_in_words(layout)} keep {keep}"
    say(_PLAN_MM[0], 282, title, fontsize=13, weight="bold", va="center")
    frame = "Metres in the frame map, x to the right, y up; directions counter-clockwise from +x."
    say(_TABLE_MM[0], 10, f"{frame}\nGrey lines: routes, and the way to the nearest wall.", fontsize=7)
    bar_m = next((bar for bar in _BARS_M if 1000 * bar / scale >= _BAR_MM), _BARS_M[-1])
    bar = _panel(figure, np.array([_PLAN_MM[0], 10.0, 1000 * bar_m / scale, 2.0]))
    for k in range(4):
        bar.axvspan(k / 4, (k + 1) / 4, facecolor="black" if k % 2 == 0 else "white", edgecolor="black", linewidth=0.6)
    bar.set(xlim=(0, 1), yticks=[], xticks=[])
    say(_PLAN_MM[0], 6, f"{bar_m:g} m", fontsize=8)
    say(_PLAN_MM[0] + ceil(1000 * bar_m / scale) + 6, 10, f"scale 1 : {scale} on A3", fontsize=9)
