"""The page of some logs: what each holds, as a template takes it, within a size that a browser opens at once."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from analyzer import page
from analyzer.diagnosis.diagnose import Diagnosis
from analyzer.findings import RULES
from analyzer.layout import STATE_UNITS
from analyzer.page import Chart, packed
from analyzer.records import Severity
from analyzer.report.kept import Breaches, Bus, Drive, Integers, Marks, Numbers, Talk, busiest, extremes
from analyzer.report.traffic import Traffic
from analyzer.sources.times import ShownTime, is_dated, is_estimated
from analyzer.values import SECOND_NS

#: Bytes of a page, and by how much all is cut down until it keeps to them.
LARGEST = 3_000_000
_CUTS = (1.0, 0.5, 0.25, 0.1, 0.03, 0.01, 0.0)
#: Of the whole page: points and marks. Each line has so many points at least and at most.
_POINTS, _MARKS = 110_000, 4000
_LEAST_POINTS, _MOST_POINTS = 600, 20_000
#: Drives that are drawn, and of these how many at once; rows of tables; characters of a text that a capture gives.
_DRAWN, _OPEN, _ROWS, _TEXT = 40, 8, 300, 300
#: Commands whose latencies are drawn; bins of a power of ten.
_CURVES, _BINS = 6, 16
#: A pause breaks a line: so many usual steps, and this share of the whole time. Pauses that part a capture into stretches.
_PAUSE_STEPS, _PAUSE_SHARE, _PARTING, _STRETCHES = 20, 0.005, 0.05, 24
_COLOURS = {"position": "--blue", "speed": "--teal", "current": "--amber", "voltage": "--violet", "temperature": "--rose"}
_ORDER = {name: place for place, name in enumerate(STATE_UNITS)}
_LOOKS = {Severity.ERROR: "bad", Severity.WARNING: "doubt", Severity.INFO: "seen"}


@dataclass
class Log:
    """A log that was read, and what its diagnosis says.

    The verdict is `none` where it could not be made. `looked`: of what part of the log it is. `notes`: what a reader should
    know.
    """

    name: str
    traffic: Traffic
    shown: ShownTime
    diagnosis: Diagnosis
    looked: str = ""
    notes: Sequence[str] = ()

    @property
    def state(self) -> str:
        """How it looks at first sight: good, bad or doubt."""
        return {"ok": "good", "trouble": "bad"}.get(self.diagnosis.verdict, "doubt")

    @property
    def verdict(self) -> str:
        """What the diagnosis says, in a line."""
        found = self.diagnosis
        if found.causes:
            return found.causes[0].suspicion.say
        if found.verdict == "ok":
            return "Nothing wrong was found"
        if found.verdict == "none":
            return "No diagnosis was made"
        return found.unexplained[:1].upper() + found.unexplained[1:]


@dataclass
class Unread:
    """A file that could not be read, and why."""

    name: str
    verdict: str
    state: str = "doubt"


def html(logs: Sequence[Log | Unread]) -> str:
    """Return the page of some logs as text, no longer than LARGEST bytes wherever something can be left out."""
    text = ""
    for cut in _CUTS:
        sections = [
            None if isinstance(log, Unread) else _Section(str(number), log, cut / len(logs))
            for number, log in enumerate(logs, 1)
        ]
        text = page.render(
            "analyzer.report", "traffic.html",
            logs=list(zip(logs, sections, strict=True)), looks=_LOOKS, rules=RULES, open_drives=_OPEN, cut_text=_cut,
        )  # fmt: skip
        if len(text.encode(errors="backslashreplace")) < LARGEST:
            break
    return text


class _Axis:
    """What stands below the plots of a log: the time as it is shown, seconds since the start, or numbers of frames."""

    def __init__(self, log: Log) -> None:
        traffic = log.traffic
        self.start_ns = traffic.first_ns
        self._zone_ns = log.shown.zone_ns(traffic.first_ns)
        #: Times that were made up say nothing: the order of the frames does.
        self.timed = not is_estimated(traffic.about.get("time_source", ""))
        self.name = "frames" if not self.timed else "clock" if log.shown.by_clock(traffic.first_ns) else "elapsed"
        self.unit = "" if self.name == "frames" else "s"

    def __call__(self, t_ns: Integers, sequence: Integers) -> Numbers:
        """Return where points stand."""
        if self.name == "frames":
            return sequence.astype(np.float64)
        if self.name == "clock":
            t_ns = t_ns + self._zone_ns
            return t_ns // SECOND_NS + t_ns % SECOND_NS / SECOND_NS
        return (t_ns - self.start_ns) / SECOND_NS


class _Drawn(NamedTuple):
    """A drive with its charts and its marks."""

    drive: Drive
    charts: list[Chart]
    marks: list[dict[str, Any]]
    marked: list[tuple[str, str, int]]
    more: str


class _Row(NamedTuple):
    """Latencies of a command: quantiles in ms; where they stand on the scale of all, in percent."""

    talk: Talk
    least: float
    median: float
    p99: float
    greatest: float
    left: float
    middle: float
    right: float
    end: float


@dataclass
class _Section:
    """What the page says of one log. `cut`: the share of what fits on a page that is its own."""

    number: str
    log: Log
    cut: float

    def __post_init__(self) -> None:
        self.traffic = self.log.traffic
        self.axis = _Axis(self.log)
        self.group = f"log-{self.number}"
        self.rows = max(5, int(_ROWS * min(1.0, 4 * self.cut)))
        self.text = max(40, int(_TEXT * min(1.0, 4 * self.cut)))
        traffic = self.traffic
        self.drives = sorted(traffic.drives.values(), key=lambda drive: drive.order)
        self.with_values = [drive for drive in busiest(self.drives) if drive.states]
        self.has_messages = any(drive.messages for drive in self.drives)
        self.shown_drives = self.with_values[: max(1, int(_DRAWN * self.cut))] if self.cut else []
        lines = sum(len(drive.states) for drive in self.shown_drives) + 3 * len(traffic.buses)
        self.points = int(min(_MOST_POINTS, max(_LEAST_POINTS * min(1, 4 * self.cut), _POINTS * self.cut / max(1, lines))))
        self.drawn = [self._drawn(drive) for drive in sorted(self.shown_drives, key=lambda drive: drive.order)]
        self.bus_charts = [
            (name, charts) for name, bus in sorted(traffic.buses.items()) if (charts := list(self._of_bus(bus)))
        ][: self.rows]
        #: What the plots show at first: from the first message to the last.
        self.whole = self.place(traffic.first_ns, 0), self.place(traffic.last_ns, traffic.last_sequence)
        self.stretches = list(self._stretches())
        #: The date of its beginning and the zone, where it has them.
        self.day = self.log.shown.new_date(traffic.first_ns) if self.axis.name == "clock" else ""

    # --- text ---------------------------------------------------------------------------------------------------------

    def cut_text(self, text: str) -> str:
        """Return a text of the capture, cut where it is long."""
        return _cut(text, self.text)

    def time(self, t_ns: int) -> str:
        """Return a time as people read it; of a capture without times nothing."""
        return self.log.shown.text(t_ns).strip() if self.axis.timed else ""

    def place(self, t_ns: int, sequence: int) -> float:
        """Return where a moment stands on the plots."""
        return float(self.axis(np.array([t_ns]), np.array([sequence]))[0])

    @property
    def tiles(self) -> list[tuple[str, str, str, str]]:
        """The figures that come first: caption, figure, what else, and how it looks."""
        traffic = self.traffic
        found: Counter[Severity] = Counter()
        for each in traffic.breaches.values():
            found[each.severity] += each.count
        worst = next((s for s in (Severity.ERROR, Severity.WARNING) if found[s]), None)
        drives = [drive for drive in self.drives if drive.answers]
        tiles = [("frames", f"{traffic.frames:,}", f"on {_counted(len(traffic.buses), 'bus', 'buses')}", "")]
        if self.axis.timed and traffic.frames:
            span = (traffic.last_ns - traffic.first_ns) / SECOND_NS
            tiles.append(("time", duration(span), f"{traffic.frames / span:,.0f} frames/s" if span >= 1 else "", ""))
        dialects = dict.fromkeys(name for drive in drives for name in drive.dialects)
        tiles.append(("drives that answer", f"{len(drives):,}", ", ".join(dialects), ""))
        loads = [bus.load.columns()[2] for bus in traffic.buses.values() if bus.load.count]
        if loads and self.axis.timed and max(map(np.max, loads)) > 0:
            greatest = max(loads, key=lambda each: float(each.max()))
            tiles.append(("bus load", f"{greatest.max():.1%}", f"at most; {greatest.mean():.1%} on average", ""))
        if latency := max(traffic.talks.values(), key=lambda talk: talk.latencies.count, default=None):
            times = latency.latencies
            if times.count and self.axis.timed:
                more = f"{latency.command}; 99 % within {ms(times.quantile(0.99))} ms"
                tiles.append(("median latency", f"{ms(times.quantile(0.5))} ms", more, ""))
        told = ", ".join(_counted(found[s], s.value) for s in (Severity.ERROR, Severity.WARNING) if found[s])
        tiles.append(("findings", f"{found.total():,}", told or "none", _LOOKS[worst] if worst else "good"))
        return tiles

    @property
    def facts(self) -> dict[str, str]:
        """What was captured, by name."""
        about, traffic = self.traffic.about, self.traffic
        spoken = dict.fromkeys(name for drive in self.drives for name in drive.dialects)
        size = int(about["source_size"][:20]) if about.get("source_size", "")[:20].isdecimal() else None
        when = ""
        if self.axis.timed and traffic.first_ns:
            shown = self.log.shown
            ends = [shown.iso(t) if is_dated(t) else shown.text(t).strip() for t in (traffic.first_ns, traffic.last_ns)]
            when = " to ".join(ends)
        facts = {
            "file": about.get("source", self.log.name),
            "size": f"{size:,} bytes" if size is not None else "",
            "SHA-256": about.get("source_sha256", ""),
            "format": about.get("format", ""),
            "dialect": ", ".join(spoken) + (f" ({why})" if (why := about.get("dialect_reason", "")) else ""),
            "manual": about.get("manual", ""),
            "from": when,
            "times": about.get("time_source", ""),
            "decoded by": f"servotap {about['version']}" if "version" in about else "",
            "incomplete": about.get("incomplete", ""),
        }
        return {name: self.cut_text(text) for name, text in facts.items() if text.strip()}

    # --- plots --------------------------------------------------------------------------------------------------------

    def _chart(self, x: Numbers, values: Numbers, y: str, unit: str, colour: str) -> Chart:
        """Return a line of the group; a pause breaks it."""
        steps = np.diff(x)
        if len(steps) and steps.min() < 0:
            # Buses of a merged log, or a damaged one: a plot needs its points in order.
            order = np.argsort(x, kind="stable")
            x, values = x[order], values[order]
            steps = np.diff(x)
        if len(steps) > 2:
            usual = float(np.median(steps))
            pauses = np.flatnonzero(steps > max(_PAUSE_STEPS * usual, _PAUSE_SHARE * float(x[-1] - x[0]))) + 1
            x = np.insert(x, pauses, (x[pauses - 1] + x[pauses]) / 2)
            values = np.insert(values, pauses, np.nan)
        return Chart(x, {y: values}, y, unit, self.axis.name, self.axis.unit, self.group, "line", colour)

    def _of_bus(self, bus: Bus) -> Iterator[Chart]:
        """Yield the charts of a bus: its load, or frames a second where the speed is not known, and what was wrong."""
        if not self.axis.timed or not bus.frames.count:
            return
        load, frames = bus.load.columns(), bus.frames.columns()
        if len(load[2]) and load[2].max() > 0:
            yield self._seconds(load[0], {"load": load[2] * 100}, "bus load", "%", "--blue")
        else:
            yield self._seconds(frames[0], {"frames": frames[2]}, "frames", "1/s", "--blue")
        errors, warnings = bus.errors.columns()[2], bus.warnings.columns()[2]
        if len(errors) == len(warnings) == len(frames[0]) and (errors.any() or warnings.any()):
            yield self._seconds(frames[0], {"errors": errors, "warnings": warnings}, "findings", "1/s", "--red")

    def _seconds(self, t_ns: Integers, lines: Mapping[str, Numbers], y: str, unit: str, colour: str) -> Chart:
        """Return a chart of counts by second: what was not counted is 0."""
        ends = t_ns + SECOND_NS
        silent = np.flatnonzero(np.append(t_ns[1:] > ends[:-1], True)) + 1
        t_ns = np.insert(t_ns, silent, ends[silent - 1])
        lines = {name: np.insert(values, silent, 0.0) for name, values in lines.items()}
        kept = extremes(np.sum(list(lines.values()), axis=0), self.points)
        t_ns = t_ns[kept].clip(self.traffic.first_ns, self.traffic.last_ns)
        x = self.axis(t_ns, np.zeros(len(t_ns), np.int64))
        kept_lines = {name: values[kept] for name, values in lines.items()}
        return Chart(x, kept_lines, y, unit, self.axis.name, self.axis.unit, self.group, "steps", colour)

    def _drawn(self, drive: Drive) -> _Drawn:
        charts = []
        for number, name in enumerate(sorted(drive.states, key=lambda name: _ORDER.get(name, len(_ORDER)))):
            t_ns, sequence, values = drive.states[name].columns()
            kept = extremes(values, self.points)
            x = self.axis(t_ns[kept], sequence[kept])
            colour = _COLOURS.get(name) or list(_COLOURS.values())[number % len(_COLOURS)]
            charts.append(self._chart(x, values[kept], name, drive.units[name], colour))
        to_all = [
            each for one in self.drives if one.bus == drive.bus and one.address in ("0", "all") for each in one.marks.values()
        ]
        every = sorted([*drive.marks.values(), *to_all], key=lambda each: len(each.t_ns))
        left = int(min(400, _MARKS * self.cut / max(1, len(self.shown_drives))))
        marks, count = [], 0
        for place, each in enumerate(every):
            # The rarest come first: what is left of their share is for the others.
            some = min(len(each.t_ns), left // (len(every) - place))
            if some:
                marks.append(self._marks(each, some))
            left -= some
            count += some
        total = sum(each.count for each in every)
        marked = Counter[tuple[str, str]]()
        for each in every:
            marked[each.kind, each.label] += each.count
        more = f"{count:,} of {total:,} marks are drawn" if count < total else ""
        return _Drawn(drive, charts, marks, [(*key, n) for key, n in marked.items()], more)

    def _marks(self, marks: Marks, count: int) -> dict[str, Any]:
        """Return marks for the plots, spread evenly where there are more than fit."""
        kept = np.unique(np.linspace(0, len(marks.t_ns) - 1, count).round().astype(int))
        x = self.axis(np.array(marks.t_ns)[kept], np.array(marks.sequence)[kept])
        texts = [self.cut_text(marks.text(n))[:100] for n in kept.tolist()]
        return {"kind": marks.kind, "label": self.cut_text(marks.label), "x": packed(x), "texts": texts}

    def _stretches(self) -> Iterator[tuple[str, float, float]]:
        """Yield the stretches of traffic between long pauses, where there are pauses: in words, from, to."""
        tracks = [bus.frames.columns()[0] for bus in self.traffic.buses.values()]
        if not self.axis.timed or not any(map(len, tracks)):
            return
        t_ns = np.unique(np.concatenate(tracks))
        span = self.traffic.last_ns - self.traffic.first_ns
        pauses = np.flatnonzero(np.diff(t_ns) > max(_PARTING * span, 5 * SECOND_NS)) + 1
        if not len(pauses) or len(pauses) >= _STRETCHES:
            return
        for part in np.split(t_ns, pauses):
            first, last = max(int(part[0]), self.traffic.first_ns), min(int(part[-1]) + SECOND_NS, self.traffic.last_ns)
            yield f"{self.time(first)[:8]}, {duration((last - first) / SECOND_NS)}", self.place(first, 0), self.place(last, 0)

    # --- tables -------------------------------------------------------------------------------------------------------

    @property
    def breaches(self) -> list[Breaches]:
        """What is wrong, the worst first."""
        return sorted(self.traffic.breaches.values(), key=lambda each: (-each.severity.rank, -each.count))[:60]

    @property
    def talkers(self) -> list[tuple[Drive, float]]:
        """Who talks how much: drives with their share of all bytes."""
        total = max(1, sum(drive.bytes for drive in self.drives))
        return [(drive, drive.bytes / total) for drive in busiest(self.drives)[: self.rows]]

    @property
    def others(self) -> list[tuple[tuple[str, str], list[int]]]:
        """Nodes that are no drives, those with the most frames first."""
        return sorted(self.traffic.others.items(), key=lambda item: (-item[1][0], item[0]))[: self.rows]

    @property
    def junk(self) -> list[tuple[str, str, int]]:
        """Bytes that belong to no frame: bus, why, how many."""
        found = [(name, why, n) for name, bus in self.traffic.buses.items() for why, n in bus.junk_bytes.items()]
        return sorted(found, key=lambda each: -each[2])[: self.rows]

    @property
    def latencies(self) -> list[_Row]:
        """Latencies by command, those with the most replies first."""
        if not self.axis.timed:
            return []
        talks = sorted(self.traffic.talks.values(), key=lambda talk: -talk.latencies.count)
        talks = [talk for talk in talks if talk.latencies.count][: self.rows]
        figures = [[talk.latencies.quantile(share) / 1e6 for share in (0.01, 0.5, 0.99, 1.0)] for talk in talks]
        if not figures:
            return []
        low, high = math.log(max(1e-4, min(f[0] for f in figures))), math.log(max(1e-4, max(f[3] for f in figures)))
        room = max(high - low, 0.1)

        def place(value: float) -> float:
            return 100 * (math.log(max(value, 1e-4)) - low) / room

        return [_Row(talk, *f, *map(place, (f[0], f[1], f[2], f[3]))) for talk, f in zip(talks, figures, strict=True)]

    @property
    def curves(self) -> Chart | None:
        """How many replies took how long, for the commands with the most of them."""
        talks = [row.talk for row in self.latencies[:_CURVES]]
        if not talks or sum(talk.latencies.count for talk in talks) < 2 * _BINS:
            return None
        binned = [_binned(talk) for talk in talks]
        low, high = min(map(min, binned)) - 1, max(map(max, binned)) + 1
        x = 10 ** (np.arange(low, high + 1) / _BINS - 3)
        several = len({talk.bus for talk in talks}) > 1
        lines = {
            self.cut_text((f"{talk.bus} " if several else "") + talk.command): np.array(
                [100 * counts[n] / talk.latencies.count for n in range(low, high + 1)]
            )
            for talk, counts in zip(talks, binned, strict=True)
        }
        return Chart(x, lines, "replies", "%", "log", "ms", "", "steps")


def _cut(text: str, longest: int = _TEXT) -> str:
    return text if len(text) <= longest else f"{text[:longest]} …"


def _binned(talk: Talk) -> Counter[int]:
    """Return the latencies of a command by the bin that they fall into; bin 0 begins at 1 us."""
    counts: Counter[int] = Counter()
    for ns, count in talk.latencies.counts():
        counts[math.floor(_BINS * math.log10(max(ns, 1) / 1e3))] += count
    return counts


def duration(seconds: float) -> str:
    """Return a time in words: `42.5 s`, `3:07 min`, `14:03:22 h`, `3 d 04:00 h`."""
    if seconds < 60:
        return f"{seconds:.3g} s"
    minutes, second = divmod(round(seconds), 60)
    hours, minute = divmod(minutes, 60)
    if hours < 1:
        return f"{minute}:{second:02d} min"
    days, hour = divmod(hours, 24)
    return f"{days} d {hour:02d}:{minute:02d} h" if days else f"{hour}:{minute:02d}:{second:02d} h"


def ms(value_ns: float) -> str:
    """Return a time in ms with three digits that matter."""
    return f"{value_ns / 1e6:.3g}" if value_ns < 1e9 else f"{value_ns / 1e6:,.0f}"


def _counted(count: int, noun: str, several: str = "") -> str:
    return f"{count:,} {noun if count == 1 else several or noun + 's'}"
