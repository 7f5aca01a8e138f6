"""Plots of a report, as SVG text: latencies by command, and curves. It uses no library, since a report is one page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from math import floor, log10

WIDTH = 760
_LEFT, _RIGHT, _TOP, _ROW = 210, 90, 8, 18
_CURVE_HEIGHT = 220
_POINTS = 400


def latencies(by_command: Mapping[str, Sequence[int]]) -> str:
    """Return a strip for each command: from the shortest to the longest latency, a bar at the median, on a log scale of ms.

    `by_command`: latencies in ns, none of them empty.
    """
    values = [max(v, 1000) for each in by_command.values() for v in each]
    low, high = floor(log10(min(values))), floor(log10(max(values))) + 1
    span = max(1, high - low)
    inner = WIDTH - _LEFT - _RIGHT

    def x(ns: float) -> float:
        return _LEFT + (log10(max(ns, 1000)) - low) / span * inner

    height = _TOP + _ROW * len(by_command) + 26
    parts = [_open(height, "latency of replies by command, in milliseconds on a logarithmic scale")]
    for power in range(low, high + 1):
        at = x(10.0**power)
        parts.append(f'<line class="grid" x1="{at:.1f}" x2="{at:.1f}" y1="{_TOP}" y2="{height - 22}"/>')
        parts.append(f'<text x="{at:.1f}" y="{height - 6}" text-anchor="middle">{10.0**power / 1e6:g} ms</text>')
    for row, (name, each) in enumerate(by_command.items()):
        y = _TOP + _ROW * row + _ROW / 2
        ordered = sorted(each)
        middle = ordered[len(ordered) // 2]
        parts.append(f'<text x="{_LEFT - 8}" y="{y + 4:.1f}" text-anchor="end">{escape(name)}</text>')
        parts.append(f'<line class="range" x1="{x(ordered[0]):.1f}" x2="{x(ordered[-1]):.1f}" y1="{y}" y2="{y}"/>')
        parts.append(f'<line class="median" x1="{x(middle):.1f}" x2="{x(middle):.1f}" y1="{y - 5}" y2="{y + 5}"/>')
        parts.append(f'<text x="{WIDTH - _RIGHT + 6}" y="{y + 4:.1f}">{middle / 1e6:.3g} ms</text>')
    return "".join([*parts, "</svg>"])


def curve(points: Sequence[tuple[float, float]], x_name: str, y_name: str) -> str:
    """Return a curve with its axes. `points`: at least two."""
    step = max(1, len(points) // _POINTS)
    shown = [*points[::step], points[-1]]
    xs, ys = [p[0] for p in shown], [p[1] for p in shown]
    x_low, x_high = min(xs), max(xs)
    y_low, y_high = min(0.0, *ys), max(0.0, *ys)
    x_span, y_span = (x_high - x_low) or 1.0, (y_high - y_low) or 1.0
    left, bottom = 70, 28
    inner, tall = WIDTH - left - 20, _CURVE_HEIGHT - bottom - 10

    def at(point: tuple[float, float]) -> str:
        return f"{left + (point[0] - x_low) / x_span * inner:.1f},{10 + (y_high - point[1]) / y_span * tall:.1f}"

    parts = [_open(_CURVE_HEIGHT, f"{y_name} over {x_name}")]
    for part in range(5):
        y, x = y_low + y_span * part / 4, x_low + x_span * part / 4
        y_at, x_at = 10 + (y_high - y) / y_span * tall, left + (x - x_low) / x_span * inner
        parts.append(f'<line class="grid" x1="{left}" x2="{WIDTH - 20}" y1="{y_at:.1f}" y2="{y_at:.1f}"/>')
        parts.append(f'<text x="{left - 6}" y="{y_at + 4:.1f}" text-anchor="end">{y:.4g}</text>')
        parts.append(f'<text x="{x_at:.1f}" y="{_CURVE_HEIGHT - 10}" text-anchor="middle">{x:.3g}</text>')
    parts.append(f'<polyline class="curve" points="{" ".join(at(p) for p in shown)}"/>')
    parts.append(f'<text x="{WIDTH - 20}" y="{_CURVE_HEIGHT - 22}" text-anchor="end">{escape(x_name)}</text>')
    parts.append(f'<text x="{left + 6}" y="18">{escape(y_name)}</text>')
    return "".join([*parts, "</svg>"])


def _open(height: float, label: str) -> str:
    return f'<svg viewBox="0 0 {WIDTH} {height:.0f}" width="{WIDTH}" role="img" aria-label="{escape(label)}">'
