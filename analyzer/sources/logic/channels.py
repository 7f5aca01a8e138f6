"""Which channels of a capture carry the traffic, what each speaks, and what they are to each other.

Rules, in this order:

1. Two channels with the same edges are one line: a differential pair where their levels differ, or probed twice. One is read.
2. A channel whose edges all stand on another one that has more is a part of that one, as TX is of the bus.
3. A channel with few bytes speaks as its neighbours do, where that fits.
4. Where bytes of one channel are frames of a known dialect, other channels of another rate are named and left out.
5. Two UARTs of one rate are the two directions of one line where their names say so, or they take turns. Others are buses.

What is not clear is said, with the option that decides it.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise

import numpy as np

from analyzer import dialects
from analyzer.catalogue import Role
from analyzer.columns.codec import Integers
from analyzer.detect import weigh
from analyzer.errors import UnreadableError, UsageError
from analyzer.logic import uart
from analyzer.logic.levels import Levels
from analyzer.logic.search import Spoken, as_told, sample, shortest_ns, spoken
from analyzer.logic.uart import Format
from analyzer.records import Chunk
from analyzer.sources.marks import role_of_name
from analyzer.sources.source import Source, quote
from analyzer.values import SECOND_NS, counted

#: Edges of two channels that are compared, the share that must agree, and how near they must be, in shortest runs.
_COMPARED, _AGREE, _BESIDE = 3000, 0.95, 0.25
#: Fewer edges are no traffic.
_LEAST_EDGES = 2
#: A channel with fewer bytes than this is tried at its neighbours' rate; of fewer different bytes it may be a clock.
_FEW, _MONOTONOUS = 16, 2
#: Bytes of a channel that dialects are tried on, and the share that one must explain.
_TRIED, _EXPLAINED = 600, 0.3
#: Two channels that take turns so often, and overlap in so few bytes, are the directions of one line.
_TURNS, _OVERLAP = 0.75, 0.02
#: Silence between the bytes of two frames, in bytes.
_PAUSE = 1.5
#: Samples a bit below which nothing can be told, and below which bytes may be wrong.
FEWEST_SAMPLES, LEAST_SAMPLES = 2.2, 3
_SHOWN = 8


@dataclass(frozen=True)
class Channel:
    """A channel that is read. `place`: among those of the capture; `port`: the name of its bus, None for the only one."""

    place: int
    name: str
    spoken: Spoken
    role: Role = Role.UNKNOWN
    port: str | None = None


@dataclass(frozen=True)
class _Read:
    place: int
    name: str
    levels: Levels
    spoken: Spoken

    @property
    def worth(self) -> tuple[bool, bool, float, int]:
        """How well it is understood. Of two alike, the line that idles high comes first."""
        return not self.monotonous, not self.spoken.form.inverted, self.spoken.quality, self.spoken.count

    @property
    def monotonous(self) -> bool:
        return self.spoken.kind == "serial" and self.spoken.values < _MONOTONOUS and self.spoken.count > _MONOTONOUS


def choose(source: Source, names: Sequence[str], lines: Sequence[Levels], step_ns: float, rated: bool) -> list[Channel]:
    """Return the channels to be read, and note what they are.

    Raises UsageError for a channel that is not there, UnreadableError where none carries traffic, or none is understood.
    """
    wanted = _wanted(source, names)
    live = [place for place in wanted if len(lines[place].edges) >= _LEAST_EDGES]
    if not live:
        raise UnreadableError(_quiet(source, names, lines, wanted))
    alone = _without_twins(source, names, lines, live)
    every = [(place, _spoken(source, lines[place], rated)) for place in alone]
    found = [_Read(place, names[place], lines[place], said) for place, said in every if said is not None]
    found = _as_neighbours(found, [place for place, said in every if said is None], names, lines)
    found = [each for each in found if each.spoken.form.bit_ns >= FEWEST_SAMPLES * step_ns or source.baud]
    if not found and source.baud and len(alone) == 1 and rated:
        found = [_as_told(source, alone[0], names[alone[0]], lines[alone[0]])]
    if not found:
        raise UnreadableError(_not_understood(source, [names[place] for place in alone], [lines[p] for p in alone], step_ns))
    found = _without_parts(source, found)
    only_fd = [each for each in found if each.spoken.kind == "can" and not each.spoken.count]
    if len(only_fd) == len(found):
        raise UnreadableError(
            f"{source.name}: {_listed([f.name for f in found])}: only CAN FD frames, and only classic CAN is read"
        )
    found = [each for each in found if each not in only_fd]
    chosen = _worth_reading(source, found)
    _tell(source, chosen, step_ns, rated)
    return _as_buses(chosen)


def _wanted(source: Source, names: Sequence[str]) -> list[int]:
    places = []
    for name in source.channels:
        exact = [place for place, other in enumerate(names) if other == name]
        folded = exact or [place for place, other in enumerate(names) if other.lower() == name.lower()]
        if not folded:
            near = difflib.get_close_matches(name, names, 1, 0.6)
            hint = f"; did you mean {quote(near[0])}?" if near else ""
            raise UsageError(f"--channel: {source.name} has no channel {quote(name)!r}{hint}; there are {_listed(names)}")
        places.append(folded[0])
    return places or list(range(len(names)))


def _listed(names: Sequence[str]) -> str:
    shown = ", ".join(quote(name) for name in names[:_SHOWN])
    return f"{shown} and {len(names) - _SHOWN} more" if len(names) > _SHOWN else shown


def _quiet(source: Source, names: Sequence[str], lines: Sequence[Levels], wanted: Sequence[int]) -> str:
    others = [names[place] for place, line in enumerate(lines) if place not in wanted and len(line.edges) >= _LEAST_EDGES]
    if len(wanted) < len(names):
        there = f"; there are edges on {_listed(others)}: give one with --channel" if others else ", nor on any other"
        return f"{source.name}: no traffic on channel {_listed([names[place] for place in wanted])}{there}"
    return (
        f"{source.name}: no traffic on any of its {counted(len(names), 'channel')} ({_listed(names)}): look at the probe, its "
        "ground and the threshold, and capture while the host talks"
    )


# --- what is the same line ----------------------------------------------------------------------------------------------


def _on(edges: Integers, others: Integers, near_ns: float) -> float:
    """Return the share of edges that stand beside one of the others, 0..1."""
    first = edges[:_COMPARED]
    after = np.searchsorted(others, first)
    behind = others[np.minimum(after, len(others) - 1)] - first
    before = first - others[np.maximum(after - 1, 0)]
    return float((np.minimum(np.abs(behind), np.abs(before)) <= near_ns).mean())


def _without_twins(source: Source, names: Sequence[str], lines: Sequence[Levels], live: Sequence[int]) -> list[int]:
    """Return the channels without those that have the same edges as another one."""
    left = list(live)
    for one, other in combinations(live, 2):
        if one not in left or other not in left:
            continue
        a, b = lines[one], lines[other]
        near_ns = _BESIDE * min(shortest_ns(sample(a)), shortest_ns(sample(b)))
        beside = min(_on(a.edges, b.edges, near_ns), _on(b.edges, a.edges, near_ns))
        if not 0.9 < len(a.edges) / len(b.edges) < 1.1 or beside < _AGREE:
            continue
        times = (a.edges[:_COMPARED] + 2 * near_ns).astype(np.int64)
        differ = float((a.at(times) != b.at(times)).mean()) > 0.5
        # A line is idle most of the time: the line that is high for longer idles high.
        dropped = other if _high(a) >= _high(b) else one
        kept = one if dropped == other else other
        left.remove(dropped)
        what = "a differential pair" if differ else "the same line"
        source.note(f"{quote(names[one])} and {quote(names[other])} are {what}: {quote(names[kept])} is read")
    return left


def _high(levels: Levels) -> float:
    """Return how much of the time a channel is high."""
    runs = np.diff(np.concatenate(([levels.start_ns], levels.edges, [levels.end_ns])))
    return float(runs[1 - levels.first :: 2].sum())


def _without_parts(source: Source, found: list[_Read]) -> list[_Read]:
    """Return the channels without those that another one has all of."""
    left = list(found)
    for one in found:
        for other in found:
            same = one.spoken.kind == other.spoken.kind and abs(one.spoken.form.bit_ns / other.spoken.form.bit_ns - 1) < 0.05
            more = len(other.levels.edges) > 1.1 * len(one.levels.edges)
            near_ns = 2 * _BESIDE * one.spoken.form.bit_ns
            if one in left and other in left and same and more and _on(one.levels.edges, other.levels.edges, near_ns) >= _AGREE:
                left.remove(one)
                source.note(f"all of {quote(one.name)} is on {quote(other.name)}, too: only the latter is read")
    return left


# --- what they speak ----------------------------------------------------------------------------------------------------


def _spoken(source: Source, levels: Levels, rated: bool) -> Spoken | None:
    return spoken(levels, source.baud if rated else None, True if source.inverted else None, source.uart, rated=rated)


def _as_neighbours(found: list[_Read], silent: Sequence[int], names: Sequence[str], lines: Sequence[Levels]) -> list[_Read]:
    """Return the channels, those with little traffic read as the ones with most where that fits."""
    strongest = max((each for each in found if each.spoken.kind == "serial"), key=lambda each: each.spoken.count, default=None)
    if strongest is None or strongest.spoken.count < _FEW:
        return found
    result = [each for each in found if each.spoken.kind == "can" or each.spoken.count >= _FEW]
    weak = [place for place in range(len(names)) if place in silent or any(place == f.place for f in found if f not in result)]
    for place in weak:
        form = strongest.spoken.form
        said = spoken(lines[place], round(SECOND_NS / form.bit_ns), form.inverted)
        own = next((each for each in found if each.place == place), None)
        if said is not None and said.kind == "serial":
            # Few bytes do not tell seven bits from eight.
            said = replace(said, form=form._replace(bit_ns=said.form.bit_ns))
            result.append(_Read(place, names[place], lines[place], said))
        elif own is not None:
            result.append(own)
    return sorted(result, key=lambda each: each.place)


def _as_told(source: Source, place: int, name: str, levels: Levels) -> _Read:
    """Return a channel as the user says it is, though it does not look so."""
    assert source.baud is not None
    form = as_told(source.uart, SECOND_NS / source.baud, source.inverted)
    bytes_read = uart.read(levels, form)
    count = len(bytes_read)
    source.note(f"at {source.baud} baud {bytes_read.bad} of {counted(count, 'byte')} have a framing error: is that the rate?")
    return _Read(place, name, levels, Spoken("serial", form, count, 1 - bytes_read.bad / max(1, count), count))


def _not_understood(source: Source, names: Sequence[str], lines: Sequence[Levels], step_ns: float) -> str:
    shortest = [shortest_ns(sample(levels)) for levels in lines]
    told = ", ".join(
        f"{quote(name)} ({counted(len(line.edges), 'edge')}, the shortest pulses {_length(each, step_ns)})"
        for name, line, each in list(zip(names, lines, shortest, strict=True))[:_SHOWN]
    )
    few = step_ns and min(shortest) < LEAST_SAMPLES * step_ns
    why = f"too few samples for a bit, at least {LEAST_SAMPLES + 1} are needed" if few else "neither a UART nor CAN fits"
    if source.baud:
        why += f" at {source.baud} baud"
    return f"{source.name}: {why} on {told}; choose with --channel, --baud, --uart or --inverted, or sample faster"


def _length(length_ns: float, step_ns: float) -> str:
    return f"{length_ns / step_ns:.3g} samples" if step_ns else f"{length_ns / 1000:.4g} us"


# --- which are read -----------------------------------------------------------------------------------------------------


def _worth_reading(source: Source, found: list[_Read]) -> list[_Read]:
    """Return the channels that are read; the others are named, with how to read them."""
    if source.channels or len(found) == 1:
        return found
    lively = [each for each in found if not each.monotonous] or [max(found, key=lambda each: each.worth)]
    known = [each for each in lively if each.spoken.kind == "can" or _of_a_dialect(each)]
    chosen = [each for each in lively if not known or each in known or any(_alike(each, other) for other in known)]
    for each in found:
        if each not in chosen:
            source.note(
                f"{quote(each.name)} may carry traffic, too ({each.spoken.words}), which is left out: --channel "
                f"{quote(each.name)} reads it"
            )
    return chosen


def _alike(one: _Read, other: _Read) -> bool:
    return one.spoken.kind == other.spoken.kind and abs(one.spoken.form.bit_ns / other.spoken.form.bit_ns - 1) < 0.05


def _of_a_dialect(each: _Read) -> bool:
    read = uart.read(sample(each.levels)[0], each.spoken.form)
    data = read.values[:_TRIED].tobytes()
    chunks = [Chunk(None, "serial", data)] if data else []
    return any(weigh(dialect, chunks).share >= _EXPLAINED for dialect in dialects.every() if dialect.bus == "serial" and chunks)


def _tell(source: Source, chosen: Sequence[_Read], step_ns: float, rated: bool) -> None:
    for each in chosen:
        said = each.spoken
        what = said.words if rated else f"{said.kind}, {said.form.bit_ns:.4g} samples a bit, {said.form.word}"
        source.note(f"{quote(each.name)}: {what}")
        source.uarts |= {said.form.word} if said.kind == "serial" else set()
        if each.monotonous:
            source.note(f"{quote(each.name)} repeats one byte: it may be a clock and no traffic")
        samples = said.form.bit_ns / step_ns if step_ns else 0
        if samples and samples < LEAST_SAMPLES:
            source.note(f"{quote(each.name)} has only {samples:.2g} samples a bit: bytes may be wrong; sample faster")
    if len(chosen) > 1 and not source.channels:
        source.note(f"{len(chosen)} channels are read: --channel {quote(chosen[0].name)} reads one alone")


# --- what they are to each other ----------------------------------------------------------------------------------------


def _as_buses(chosen: list[_Read]) -> list[Channel]:
    """Return the channels with the buses that they are, and who sends on each."""
    taken: list[Channel] = []
    left = list(chosen)
    for one, other in combinations(chosen, 2):
        if one in left and other in left and one.spoken.kind == "serial" and _alike(one, other) and _two_sides(one, other):
            left = [each for each in left if each not in (one, other)]
            port = None if len(chosen) == 2 else f"{one.name}_{other.name}"
            taken += [Channel(e.place, e.name, e.spoken, role_of_name(e.name), port) for e in (one, other)]
    for each in left:
        alone = len(chosen) == 1
        taken.append(Channel(each.place, each.name, each.spoken, Role.UNKNOWN, None if alone else each.name))
    return sorted(taken, key=lambda each: each.place)


def _two_sides(one: _Read, other: _Read) -> bool:
    """Say whether two channels are the directions of one line: by their names, or as they take turns."""
    roles = {role_of_name(one.name), role_of_name(other.name)}
    if roles == {Role.REQUEST, Role.REPLY}:
        return _stem(one.name) == _stem(other.name)
    if roles != {Role.UNKNOWN}:
        return False
    first, second = (uart.read(sample(each.levels)[0], each.spoken.form) for each in (one, other))
    end = min(int(first.ends[-1]), int(second.ends[-1])) if len(first) and len(second) else 0
    bursts = sorted((*_bursts(first, one.spoken.form, 0, end), *_bursts(second, other.spoken.form, 1, end)))
    if len(bursts) < 4:
        return True
    turns = sum(a[2] != b[2] for a, b in pairwise(bursts)) / (len(bursts) - 1)
    over = sum(a[1] > b[0] for a, b in pairwise(bursts)) / len(bursts)
    return turns >= _TURNS and over <= _OVERLAP


def _stem(name: str) -> str:
    """Return a name without what says who sends."""
    words = "".join(c if c.isalnum() else " " for c in name.lower()).split()
    return " ".join(word for word in words if role_of_name(word) is Role.UNKNOWN)


def _bursts(found: uart.Read, form: Format, side: int, end_ns: int) -> Iterator[tuple[int, int, int]]:
    """Yield start, end and side of what was sent without a pause, up to a time."""
    starts, ends = found.starts[found.starts < end_ns], found.ends[found.starts < end_ns]
    if not len(starts):
        return
    breaks = np.flatnonzero(starts[1:] - ends[:-1] > _PAUSE * form.bits * form.bit_ns)
    for first, last in zip([0, *(breaks + 1).tolist()], [*breaks.tolist(), len(starts) - 1], strict=True):
        yield int(starts[first]), int(ends[last]), side
