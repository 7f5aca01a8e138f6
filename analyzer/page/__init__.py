"""Pages for the browser: one template, one style sheet and one way to plot, for every report.

A page is one file that needs no network. It follows the light or dark colours of its reader and prints in light ones.
Templates of a package extend `page/base.html`. Jinja escapes every text, so text from the wire cannot act as markup.
Plots are drawn by uPlot (MIT, 50 kB), which is part of the page; `templates/uPlot.LICENSE` is its licence.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Line:
    """A line of a plot: points (x, y) in growing x. `dashed`: what was expected rather than seen."""

    name: str
    points: Sequence[tuple[float, float]]
    dashed: bool = False


@dataclass(frozen=True)
class Plot:
    """Lines over one x axis; both axes have a name and a unit."""

    x: str
    x_unit: str
    y: str
    y_unit: str
    lines: Sequence[Line] = field(default_factory=tuple)

    def columns(self) -> dict[str, Any]:
        """Return it as uPlot takes it: all x in one column, a column of y for each line, null where a line has no point."""
        every = sorted({x for line in self.lines for x, _ in line.points})
        values = [dict(line.points) for line in self.lines]
        return {
            "x": self.x, "xUnit": self.x_unit, "y": self.y, "yUnit": self.y_unit,
            "lines": [{"name": line.name, "dashed": line.dashed} for line in self.lines],
            "data": [every, *([each.get(x) for x in every] for each in values)],
        }  # fmt: skip


def render(package: str, template: str, **values: Any) -> str:
    """Return a template of a package, filled in."""
    from jinja2 import Environment, PackageLoader, PrefixLoader, StrictUndefined
    from markupsafe import Markup

    loader = PrefixLoader({"page": PackageLoader("analyzer.page"), "own": PackageLoader(package)})
    world = Environment(loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)

    def asset(name: str) -> Markup:
        # Not a template: the braces of a script are its own.
        return Markup((Path(__file__).parent / "templates" / name).read_text(encoding="utf-8"))

    world.globals["asset"] = asset
    world.filters["thousands"] = lambda number: f"{number:,}"
    return world.get_template(f"own/{template}").render(values)
