"""Pages for the browser: one template, one style sheet and one way to plot, for every report.

A page is one file that needs no network. It follows the light or dark colours of its reader and prints in light ones.
Templates of a package extend `page/base.html`. Jinja escapes every text, so text from the wire cannot act as markup.
Plots are drawn by uPlot (MIT, 50 kB), which is part of the page; `templates/uPlot.LICENSE` is its licence. `Plot` is for
some hundred points as they are, `Chart` for thousands, packed as text.
"""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

#: What a packed value can be; the highest whole number of 32 bits means that there is none.
_STEPS = (1 << 32) - 2


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


@dataclass(frozen=True)
class Chart:
    """Long columns over one x axis: `x` grows, `lines` are as long, NaN where a line has no value.

    `axis`: what x is: `clock` (seconds since 1970, shown as UTC), `elapsed` (seconds), `frames` (their numbers) or `log` (a
    logarithmic scale in `x_unit`). Charts of one `group` are zoomed together. `look`: `line`, or `steps` from each point to the
    next, above 0.
    """

    x: NDArray[np.float64]
    lines: Mapping[str, NDArray[np.float64]]
    y: str
    y_unit: str = ""
    axis: str = "elapsed"
    x_unit: str = ""
    group: str = ""
    look: str = "line"
    colour: str = ""

    def columns(self) -> dict[str, Any]:
        """Return it as `page.js` takes it."""
        return {
            "x": {"frames": "frame", "log": "latency"}.get(self.axis, "time"), "xUnit": self.x_unit, "axis": self.axis,
            "y": self.y, "yUnit": self.y_unit, "group": self.group, "look": self.look, "colour": self.colour,
            "lines": [{"name": name, "dashed": False} for name in self.lines],
            "data": [packed(self.x), *(packed(each) for each in self.lines.values())],
        }  # fmt: skip


def packed(values: NDArray[np.float64]) -> dict[str, Any]:
    """Return a column as text, 32 bits a value between its least and its greatest."""
    import numpy as np

    there = np.isfinite(values)
    low, high = (float(values[there].min()), float(values[there].max())) if there.any() else (0.0, 0.0)
    scale = _STEPS / (high - low) if high > low else 0.0
    whole = np.full(len(values), _STEPS + 1, "<u4")
    whole[there] = np.rint((values[there] - low) * scale)
    return {"low": low, "high": high, "text": b64encode(whole.tobytes()).decode()}


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
