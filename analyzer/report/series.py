"""Values of chosen fields in a log, by their names: `speed` of the drives' states, `read_speed.speed`, `latency`.

A name is a quantity of the state, a field of any command, or `command.field`; with `*` for any text. A quantity is taken from
the states where they have it, since its unit is the same there for every drive.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any

import msgspec

from analyzer.errors import UsageError
from analyzer.findings import RULES
from analyzer.report.kept import number_of, properties_of
from analyzer.report.traffic import LATEST_NS
from analyzer.sources.mcap_scan import LogMessage
from analyzer.sources.source import Source, describe
from analyzer.system.decoding import UNDECODABLE
from analyzer.values import near, quote, raw_text

if TYPE_CHECKING:
    from mcap.records import Channel

#: Series of one plot; more would not be told apart.
MOST = 40
_STATE = "state"
#: What every value is below, by far.
_HIGHEST = 1e300


@dataclass
class Series:
    """Values of one field of one topic. `label`: whose they are; times in nanoseconds, and the numbers of the messages."""

    label: str
    unit: str
    t_ns: array[int] = field(default_factory=lambda: array("q"))
    sequence: array[int] = field(default_factory=lambda: array("q"))
    values: array[float] = field(default_factory=lambda: array("d"))


class _Topic:
    """A topic with the fields that are wanted of it: (name, field, factor, series)."""

    def __init__(self, channel: Channel, properties: Mapping[str, Any]) -> None:
        _, self.bus, self.address, *rest = [*channel.topic.split("/"), "", ""]
        self.label = channel.topic.strip("/")
        self.metadata = channel.metadata
        self.is_state = rest[0] == _STATE
        self.command, self.role = (_STATE, "") if self.is_state else (rest[0], rest[1])
        #: What can be plotted: each field with its unit, and how many of that unit one of the log is.
        self.fields: dict[str, tuple[str, str, float]] = {}
        for key, about in properties.items():
            kind, unit = about.get("type"), str(about.get("unit", ""))
            if kind in ("integer", "number") and (not key.startswith("_") or key == "_latency"):
                latency = key == "_latency"
                self.fields[key.removeprefix("_")] = (key, "ms", 1e3) if latency else (key, unit, 1.0)
        self.wanted: list[tuple[str, str, float, Series]] = []
        self.meant = False

    def want(self, name: str) -> None:
        """Take the fields that a name chooses."""
        for known, (key, unit, factor) in self.fields.items():
            if is_meant(name, f"/{self.label}", known):
                label = f"{self.bus}/{self.address}" if self.is_state else f"{self.label}.{known}"
                self.wanted.append((name, key, factor, Series(label, unit)))


def is_meant(name: str, topic: str, known: str) -> bool:
    """Say whether a name chooses a field of a topic: `speed`, `read_speed.speed` or `/left/1/state.speed`."""
    _, _, _, command, *_ = [*topic.split("/"), "", "", ""]
    return any(fnmatchcase(text, name) for text in (known, f"{command}.{known}", f"{topic}.{known}"))


def unknown_field(name: str, there: Sequence[str], commands: Iterable[str] = ()) -> UsageError:
    """Return what is said of a name that chooses nothing. `there`: fields; `commands`: fields with their commands."""
    return UsageError(f"no field here is {quote(name)}{near(name, {*there, *commands})}; there are {listed(there)}")


def series(
    source: Source,
    names: Sequence[str],
    *,
    since_ns: int,
    until_ns: int,
    drive: Callable[[str, str], bool] = lambda bus, address: True,
    wanted: Callable[[Mapping[str, Any]], bool] | None = None,
) -> tuple[dict[str, list[Series]], str]:
    """Return the values of each name, and where the log's times come from.

    `drive`: says of a bus and an address whether it is meant; `wanted`: of a message.

    Raises UsageError for a name that chooses nothing, and where there is no name, with the fields that there are.
    """
    from mcap.records import Channel, Metadata, Schema

    from analyzer.sources.mcap_records import records

    time_source = ""
    decode = msgspec.json.Decoder(dict[str, Any]).decode
    schemas: dict[int, Mapping[str, Any]] = {}
    topics: dict[int, _Topic] = {}
    by_name: dict[str, _Topic] = {}
    passed = -1
    for record in records(source):
        if isinstance(record, LogMessage):
            topic = topics.get(record.channel_id)
            if topic is None or not (topic.wanted or wanted) or not since_ns <= record.log_ns <= min(until_ns, LATEST_NS):
                continue
            # A state has the number of the reply that it is from, and stands behind it.
            if wanted is not None and topic.is_state and record.sequence != passed:
                continue
            try:
                values = decode(record.data)
                if wanted is not None and not topic.is_state:
                    if not wanted(_names(topic, record, values)):
                        continue
                    passed = record.sequence
            except UNDECODABLE as error:
                source.problem(f"a message of {topic.label}: {describe(error)}")
                continue
            if values.get("_checksum_ok") is False:
                continue
            for _, key, factor, kept in topic.wanted:
                value = values.get(key)
                if isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < _HIGHEST:
                    kept.t_ns.append(record.log_ns)
                    kept.sequence.append(record.sequence)
                    kept.values.append(value * factor)
        elif isinstance(record, Schema):
            schemas[record.id] = properties_of(record.data)
        elif isinstance(record, Metadata):
            time_source = record.metadata.get("time_source", time_source)
        elif isinstance(record, Channel):
            known = by_name.get(record.topic)
            if known is None and _is_field_topic(record.topic):
                known = by_name[record.topic] = _Topic(record, schemas.get(record.schema_id, {}))
                known.meant = drive(known.bus, known.address)
                for name in names if known.meant else ():
                    known.want(name)
            if known is not None:
                topics[record.id] = known
    every = list(by_name.values())
    if every and not any(topic.meant for topic in every):
        there = dict.fromkeys(f"{topic.bus}/{topic.address}" for topic in every)
        raise UsageError(f"no such drive here, there are {listed(list(there))}")
    if not names:
        raise UsageError(f"which field? there are {listed(_fields(every))}")
    return {name: _chosen(name, every) for name in names}, time_source


def _is_field_topic(topic: str) -> bool:
    parts = topic.split("/")
    return (len(parts), parts[-1]) in ((5, "request"), (5, "reply"), (5, "message"), (4, _STATE))


def _chosen(name: str, topics: Sequence[_Topic]) -> list[Series]:
    """Return the series of a name: of the states where they have it, else of all messages."""
    found = [(topic, each) for topic in topics for asked, _, _, each in topic.wanted if asked == name and each.values]
    states = [each for topic, each in found if topic.is_state]
    if not found:
        there = _fields(topics)
        commands = {f"{topic.command}.{known}" for topic in topics for known in topic.fields}
        if any(asked == name for topic in topics for asked, *_ in topic.wanted):
            raise UsageError(
                f"{quote(name)} has no values here, there may be {listed([each for each in there if each != name])}"
            )
        raise unknown_field(name, there, commands)
    return (states or [each for _, each in found])[:MOST]


def _fields(topics: Sequence[_Topic]) -> list[str]:
    return sorted({known for topic in topics for known in topic.fields if topic.meant})


def listed(words: Sequence[str]) -> str:
    """Return words to choose from, the first of many."""
    return ", ".join(words[:24]) + (" ..." if len(words) > 24 else "") if words else "none"


def _names(topic: _Topic, record: LogMessage, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a filter can name of a message, as for `servotap show`."""
    logged = values.get("_findings")
    found = [rule for rule in logged if isinstance(rule, str)] if isinstance(logged, list) else []
    can_id = values.get("_can_id")
    flags = values.get("_can_flags")
    extended = isinstance(flags, list) and "extended" in flags
    names = {key: value for key, value in values.items() if not key.startswith("_")} | {
        "time": record.log_ns / 1e9,
        "bus": topic.bus,
        "dialect": topic.metadata.get("dialect", ""),
        "address": number_of(topic.address),
        "role": topic.role,
        "command": topic.command,
        "checksum_ok": values.get("_checksum_ok", True),
        "findings": [*found, *{RULES[rule].severity for rule in found if rule in RULES}],
        "raw": raw_text(str(values.get("_raw", "")), can_id if isinstance(can_id, int) else None, extended=extended),
        "offset": values.get("_offset", 0),
        "sequence": record.sequence,
        "section": topic.metadata.get("section", ""),
    }
    latency = values.get("_latency")
    if isinstance(latency, (int, float)) and abs(latency) < _HIGHEST:
        names["latency"] = latency * 1e3
    return names
