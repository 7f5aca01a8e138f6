"""Plots as a picture: an axis for each name with its unit, a dot for each value that came, lines between them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from analyzer.values import printable

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Inches of a plot: its width, and the height of each axis.
_WIDTH, _HEIGHT = 9.0, 2.4
#: Points of a line that are shown as dots, too.
_DOTS = 500
#: Lines whose list stands inside of their axis.
_LISTED_INSIDE = 6


class Panel(NamedTuple):
    """What one name shows: its units, and lines as (label, x, values)."""

    name: str
    units: Sequence[str]
    lines: Sequence[tuple[str, Sequence[Any], Sequence[Any]]]


def size(panels: int) -> tuple[float, float]:
    """Return the width and the height of a picture of some panels, in inches."""
    return _WIDTH, 0.8 + _HEIGHT * panels


def draw(figure: Figure, panels: Sequence[Panel], title: str, x: str = "time [s]") -> list[Axes]:
    """Draw panels, one below the other. Return their axes."""
    from matplotlib.ticker import FuncFormatter

    # Matplotlib takes a common factor or summand out of its numbers, which is easily overlooked.
    whole = FuncFormatter(lambda value, _: f"{value:,.12g}")
    rows = figure.subplots(len(panels), 1, sharex=True, squeeze=False)
    axes: list[Axes] = [row[0] for row in rows]
    for axis, panel in zip(axes, panels, strict=True):
        for label, at, values in panel.lines:
            # Where there are many points, their dots would hide the line.
            dots = "." if len(at) <= _DOTS else ""
            axis.plot(at, values, marker=dots, markersize=4, linewidth=1, label=_plain(label))
        units = [unit for unit in dict.fromkeys(panel.units) if unit]
        axis.set_ylabel(_plain(f"{panel.name} [{', '.join(units)}]" if units else panel.name))
        axis.yaxis.set_major_formatter(whole)
        axis.grid(visible=True, alpha=0.3)
        # A long list of lines would hide them.
        beside = {"loc": "center left", "bbox_to_anchor": (1, 0.5)} if len(panel.lines) > _LISTED_INSIDE else {"loc": "best"}
        axis.legend(fontsize="small", **beside)
    axes[0].set_title(_plain(title))
    axes[-1].set_xlabel(x)
    return axes


def _plain(text: str) -> str:
    """Return a text as Matplotlib shows it as it is: a dollar sign would begin a formula."""
    return printable(text).replace("$", r"\$")
