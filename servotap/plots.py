"""Plots of a capture's table: an axis for each name."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from analyzer.errors import UsageError
from analyzer.report.picture import Panel, draw, size
from analyzer.report.series import is_meant, listed, unknown_field
from analyzer.table.columns import Column, Kind
from analyzer.table.extras import needed
from analyzer.table.tables import Wide
from analyzer.values import quote

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_NUMBERS = (Kind.INTEGER, Kind.NUMBER)


def plot(table: Wide, names: Sequence[str], title: str) -> list[Axes]:
    """Plot what the names choose. Raises UsageError for a name that chooses no numbers."""
    shown = [_chosen(table.columns[2:], name) for name in names]
    if not shown:
        raise UsageError(f"what? expected names, as 'speed' or 'position'; there are {listed(_fields(table.columns[2:]))}")
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
    named = [c for c in columns if is_meant(name, c.name.removesuffix(f".{c.field}"), c.field)]
    found = [c for c in named if c.kind in _NUMBERS]
    if named and not found:
        raise UsageError(f"{quote(name)} is no number here; there are {listed(_fields(columns))}")
    if not found:
        raise unknown_field(name, _fields(columns))
    states = [c for c in found if c.name.endswith(f"/state.{c.field}")]
    return states or found


def _fields(columns: Sequence[Column]) -> list[str]:
    return sorted({c.field for c in columns if c.kind in _NUMBERS})
