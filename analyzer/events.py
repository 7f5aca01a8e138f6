"""Events: what can happen to a recording, what each means for the traffic, and which become findings.

An event is a row here. `cuts`: what waits on its port ends there, for bytes are missing or the line was not watched. Texts
are made from the values alone, so that a log that is decoded again says the same.

Not known here: who notices these things, and how they are stored.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated, Any, Literal, NamedTuple

import msgspec

from analyzer.findings import Issue
from analyzer.records import Event, Severity
from analyzer.values import SECOND_NS, counted, identifier

#: Topic of the events in a log.
TOPIC = "/recording"
#: How a bus is to be read from here on: dialects, offset, time of a byte.
PORT = "port"
DIALECT = "dialect"
#: The line runs at another speed from here on.
SPEED = "speed"
#: Of a log that is read from the midst on: where a bus goes on.
RESUMED = "resumed"
SETUPS = frozenset((PORT, DIALECT, SPEED, RESUMED))
#: Identifiers of drives that a text names.
_IDS_SHOWN = 8

Values = Mapping[str, Any]
#: A count or a place; the time of a byte; seconds, as many as fit into the nanoseconds of a clock; a time of day, in words.
Whole = Annotated[int, msgspec.Meta(ge=0, le=(1 << 63) - 1)]
Nanoseconds = Annotated[int, msgspec.Meta(ge=0, le=1_000_000_000)]
Seconds = Annotated[float, msgspec.Meta(ge=-9.22e9, le=9.22e9)]
BusKind = Literal["", "can", "serial"]
Moment = Annotated[str, msgspec.Meta(description="UTC")]


class Details(msgspec.Struct, rename={"from_": "from"}, omit_defaults=True):
    """What an event can hold beside its name, bus and text. Counters of a driver are those that rose."""

    endpoint: str = ""
    kind: BusKind = ""
    direction: str = ""
    reason: str = ""
    cause: str = ""
    what: str = ""
    stem: str = ""
    precision: str = ""
    host: str = ""
    system: str = ""
    version: str = ""
    recording: str = ""
    previous: str = ""
    model: str = ""
    speed: Whole = 0
    byte_ns: Nanoseconds = 0
    offset: Whole = 0
    bytes: Whole = 0
    frames: Whole = 0
    count: Whole = 0
    overrun: Whole = 0
    buf_overrun: Whole = 0
    frame: Whole = 0
    parity: Whole = 0
    brk: Whole = 0
    doubtful: Whole = 0
    part: Whole = 0
    records: Whole = 0
    gap: Seconds = 0.0
    step: Seconds = 0.0
    drift: Seconds = 0.0
    late: Seconds = 0.0
    from_: Moment = ""
    to: Moment = ""
    dialects: list[str] = []
    notes: list[str] = []
    groups: list[Whole] = []
    ids: list[Whole] = []


#: Type of each value that is known, by name.
TYPES: dict[str, Any] = {field.encode_name: field.type for field in msgspec.structs.fields(Details)}


def checked(values: Mapping[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """Return the valid values of an event, and in words what is wrong with each other one.

    The others are kept as they came, in `details`: nothing is judged by them.
    """
    good: dict[str, Any] = {}
    wrong: list[str] = []
    for name, value in values.items():
        try:
            msgspec.convert(value, TYPES.get(name, Any))
        except msgspec.ValidationError as error:
            wrong.append(f"{name}: {error}")
            good.setdefault("details", {})[name] = value
        else:
            good[name] = value
    return good, wrong


class EventKind(NamedTuple):
    """One kind of event: its text, the rule of its finding (empty: none), and whether waits end at it."""

    text: Callable[[Values], str]
    rule: str = ""
    cuts: bool = False


def _of(*names: str) -> Callable[[Values], str]:
    """Return a text that names these values as far as they are there."""

    def text(values: Values) -> str:
        parts = []
        for name in names:
            value = values.get(name)
            if value not in (None, "", [], ()):
                shown = ", ".join(map(str, value)) if isinstance(value, (list, tuple)) else str(value)
                parts.append(shown if name in _SELF_EVIDENT else f"{name.replace('_', ' ')} {shown}")
        return ", ".join(parts)

    return text


#: Values that need no word before them.
_SELF_EVIDENT = frozenset(("text", "reason", "cause", "what", "endpoint", "dialects", "precision", "notes", "kind"))
#: Counters of the kernel, and of a reader of levels: what each counts, and where.
_COUNTERS = {
    "overrun": ("overrun", " of the hardware's buffer"),
    "buf_overrun": ("overrun", " of the kernel's buffer"),
    "frame": ("framing error", ""),
    "parity": ("parity error", ""),
    "brk": ("break", ""),
    "doubtful": ("byte", " with a doubtful bit"),
}


def _port(values: Values) -> str:
    named = ", ".join(values.get("dialects") or ()) or "dialect to be found out"
    speed = f", {values['speed']} bit/s" if values.get("speed") else ""
    direction = values.get("direction", "unknown")
    heard = f", {direction} direction" if direction not in ("unknown", "") else ""
    return f"{values.get('endpoint', '')}{speed}{heard}, {named}{_drives(values)}"


def _drives(values: Values) -> str:
    """Say who is a drive, where that was said."""
    ids = values.get("ids")
    if not isinstance(ids, (list, tuple)):
        return ""
    shown = [identifier(n) if values.get("kind") == "can" else str(n) for n in ids if isinstance(n, int)]
    more = f" and {len(shown) - _IDS_SHOWN} more" if len(shown) > _IDS_SHOWN else ""
    return f", drives: {', '.join(shown[:_IDS_SHOWN]) or 'none'}{more}"


def _back(values: Values) -> str:
    why = f" ({values['reason']})" if values.get("reason") else ""
    return f"gone for {values.get('gap', 0.0):.3f} s, from {values.get('from', '?')} on{why}"


def _counted(values: Values) -> str:
    rose = [counted(values[name], noun) + where for name, (noun, where) in _COUNTERS.items() if values.get(name)]
    since = f", since {values['from']}" if values.get("from") else ""
    return f"{', '.join(rose) or 'the counters rose'}{since}"


def _amount(values: Values) -> str:
    return next((counted(values[noun + "s"], noun) for noun in ("byte", "frame") if noun + "s" in values), "an unknown amount")


def _dropped(values: Values) -> str:
    span = f", from {values['from']} to {values['to']}" if values.get("from") and values.get("to") else ""
    return f"{_amount(values)} received but not stored{span}" + (f" ({values['reason']})" if values.get("reason") else "")


def _kernel_dropped(values: Values) -> str:
    return f"{_amount(values)} dropped by the kernel" + (f" since {values['from']}" if values.get("from") else "")


def _bus_error(values: Values) -> str:
    count = values.get("count", 1)
    return f"{values.get('reason', 'trouble')}" + (f", {counted(count, 'time')}" if count not in (0, 1) else "")


def _step(values: Values) -> str:
    return f"the wall clock went {values.get('step', 0.0):+.3f} s: {values.get('cause', '')}; timestamps do not follow"


def _stalled(values: Values) -> str:
    span = f" from {values.get('from', '?')} to {values.get('to', '?')}"
    return f"the log could not be written{span} ({values.get('reason', '')}); traffic was stored next to it meanwhile"


def _restarted(values: Values) -> str:
    who = f" of {values['stem']}" if values.get("stem") else ""
    return f"the {values.get('what', 'process')} process{who} died and was restarted ({values.get('reason', '')})"


def _part(values: Values) -> str:
    return f"part {values.get('part', '?')}" + (f", after {values['previous']}" if values.get("previous") else "")


KINDS: dict[str, EventKind] = {
    RESUMED: EventKind(lambda values: f"read from byte {values.get('offset', 0)} on"),
    SPEED: EventKind(lambda values: f"{values.get('speed', '?')} bit/s from here on"),
    "begin": EventKind(_of("host", "system", "version")),
    "part": EventKind(_part),
    PORT: EventKind(_port),
    DIALECT: EventKind(lambda values: f"{', '.join(values.get('dialects') or ())} ({values.get('reason', '')})"),
    "open": EventKind(_of("precision", "notes")),
    "note": EventKind(_of("text")),
    "lost": EventKind(_of("reason"), "port_lost", cuts=True),
    "back": EventKind(_back, "port_back", cuts=True),
    "overrun": EventKind(_counted, "overrun"),
    "kernel_dropped": EventKind(_kernel_dropped, "dropped", cuts=True),
    "dropped": EventKind(_dropped, "dropped", cuts=True),
    "missing": EventKind(lambda values: f"{_amount(values)} missing in the stored data", "dropped", cuts=True),
    "bus_error": EventKind(_bus_error, "bus_error"),
    "clock_step": EventKind(_step, "clock_step"),
    "clock_drift": EventKind(
        lambda values: f"wall clock minus the clock of the recording: {1000 * values.get('drift', 0.0):+.3f} ms"
    ),
    "restarted": EventKind(_restarted, "restarted"),
    "stalled": EventKind(_stalled, "log_stalled"),
    "damaged": EventKind(
        lambda values: f"{_amount(values)} damaged in the data stored next to the log", "spool_damaged", cuts=True
    ),
    "fault": EventKind(_of("text"), "decoder_fault", cuts=True),
    "closed": EventKind(_of("reason")),
    "end": EventKind(_of("reason")),
}
_UNKNOWN = EventKind(_of("text", "reason"))


def text_of(event: Event) -> str:
    """Return what happened in words."""
    return KINDS.get(event.name, _UNKNOWN).text(event.values)


def cuts(event: Event) -> bool:
    """Say whether what waits on the port ends at this event."""
    return KINDS.get(event.name, _UNKNOWN).cuts


def issue_of(event: Event) -> Issue | None:
    """Return the issue of an event, None for one that is nothing to worry about."""
    kind = KINDS.get(event.name, _UNKNOWN)
    if not kind.rule:
        return None
    text = text_of(event)
    severe = kind.rule == "bus_error" and "bus off" in text.lower()
    return Issue(kind.rule, text, Severity.ERROR if severe else None)


def span_ns(event: Event) -> tuple[int, int]:
    """Return the times that an event is about."""
    gap = event.values.get("gap", 0.0)
    return event.t_ns - (int(gap * SECOND_NS) if isinstance(gap, (int, float)) and gap > 0 else 0), event.t_ns
