"""Plots: an axis for each name with its unit, a dot for each value that came, lines between them."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING

from analyzer.errors import UsageError
from analyzer.table.columns import Column, Kind
from analyzer.table.extras import needed
from analyzer.table.tables import Wide
from analyzer.values import near, quote

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_NUMBERS = (Kind.INTEGER, Kind.NUMBER)
#: Inches of a plot: its width, and the height of each axis.
_WIDTH, _HEIGHT = 9.0, 2.4


def plot(table: Wide, names: Sequence[str], title: str) -> list[Axes]:
    """Plot what the names choose. Raises UsageError for a name that chooses no numbers."""
    shown = [_chosen(table.columns[2:], name) for name in names]
    if not shown:
        raise UsageError(f"what? expected names, as 'speed' or 'position'{_there(table.columns[2:], '')}")
    needed("matplotlib")
    from matplotlib import pyplot

    points = table.points({column.name for columns in shown for column in columns})
    _, rows = pyplot.subplots(
        len(shown), 1, sharex=True, squeeze=False, figsize=(_WIDTH, 0.8 + _HEIGHT * len(shown)), layout="constrained"
    )
    axes: list[Axes] = [row[0] for row in rows]
    for axis, name, columns in zip(axes, names, shown, strict=True):
        for column in columns:
            label = column.name.rpartition(".")[0].strip("/")
            axis.plot(*points[column.name], marker=".", markersize=4, linewidth=1, label=label)
        units = dict.fromkeys(column.unit for column in columns)
        axis.set_ylabel(f"{name} [{', '.join(units)}]" if any(units) else name)
        axis.grid(visible=True, alpha=0.3)
        axis.legend(loc="best", fontsize="small")
    axes[0].set_title(title)
    axes[-1].set_xlabel("time [s]")
    return axes


def _chosen(columns: Sequence[Column], name: str) -> list[Column]:
    """Return the columns of a name: of the states where they have it, else of all replies and requests."""
    found = [c for c in columns if fnmatchcase(c.field, name) or fnmatchcase(c.name, name)]
    numbers = [c for c in found if c.kind in _NUMBERS]
    if not numbers:
        why = f"{quote(name)} is no number here" if found else f"no field here is {quote(name)}"
        raise UsageError(why + _there(columns, name))
    states = [c for c in numbers if c.name.endswith(f"/state.{c.field}")]
    return states or numbers


def _there(columns: Sequence[Column], name: str) -> str:
    names = sorted({c.field for c in columns if c.kind in _NUMBERS})
    return (near(name, names) if name else "") or f", there are {', '.join(names) or 'none'}"
