"""Plots of a capture's table: an axis for each name."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING

from analyzer.errors import UsageError
from analyzer.report.picture import Panel, draw, size
from analyzer.table.columns import Column, Kind
from analyzer.table.extras import needed
from analyzer.table.tables import Wide
from analyzer.values import near, quote

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_NUMBERS = (Kind.INTEGER, Kind.NUMBER)


def plot(table: Wide, names: Sequence[str], title: str) -> list[Axes]:
    """Plot what the names choose. Raises UsageError for a name that chooses no numbers."""
    shown = [_chosen(table.columns[2:], name) for name in names]
    if not shown:
        raise UsageError(f"what? expected names, as 'speed' or 'position'{_there(table.columns[2:], '')}")
    needed("matplotlib")
    from matplotlib import pyplot

    points = table.points({column.name for columns in shown for column in columns})
    panels = [
        Panel(name, [c.unit for c in columns], [(c.name.rpartition(".")[0].strip("/"), *points[c.name]) for c in columns])
        for name, columns in zip(names, shown, strict=True)
    ]
    return draw(pyplot.figure(figsize=size(len(panels)), layout="constrained"), panels, title)


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
