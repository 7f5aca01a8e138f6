"""Judge recordings by the claims that need only traffic: about frames, replies and statuses.

Each claim is about the drive, the host or the wire. Exit status: 0 nothing refuted, 1 a claim is refuted, 2 wrong use, a
file that cannot be read, or one without a frame of a drive.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from typing import TYPE_CHECKING, Any

from analyzer.cli.option_types import number
from analyzer.cli.reading import add_reading_arguments, open_reading, progress
from analyzer.errors import UnreadableError, UsageError
from analyzer.values import near, printable, quote, storable
from conformance.claim import Outcome

if TYPE_CHECKING:
    from analyzer.cli.reading import OpenCapture
    from conformance.claim import Verdict
    from conformance.claims.frames.traffic_rules import Count, Example, Judge

EXAMPLES = """\
examples:
  servotap check capture.log
  servotap check night.mcap week/ --about drive          a folder of a recording's parts
  servotap check wire.bin --dialect mks-rs485 --baud 38400 --all
  candump -L can0 | servotap check - --dialect mks-can --json
"""
REFUTED = 1
#: In the order in which they are shown, and their colours.
_COLORS = {Outcome.REFUTED: "31", Outcome.OBSERVED: "33", Outcome.CONFIRMED: "32", Outcome.NOT_RUN: "90"}
#: Bytes of a frame that are shown, and the widest name of a claim.
_SHOWN_BYTES = 24
_PARTIES = ("drive", "host", "wire")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("files", nargs="+", metavar="CAPTURE", help="captures, logs, folders of parts; - reads standard input")
    parser.add_argument(
        "--about", metavar="WHO", default="", help="only claims about these, separated by commas: drive, host, wire"
    )
    parser.add_argument("--all", action="store_true", help="list confirmed claims and those that did not run too")
    parser.add_argument(
        "--examples",
        type=number("a number 0..1000", int, lambda count: 0 <= count <= 1000),
        default=3,
        metavar="N",
        help="findings shown for each claim (default 3)",
    )
    parser.add_argument("--json", action="store_true", help="print the result as JSON, one line per file")
    add_reading_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Judge each file; return 0, 1 where a claim is refuted, 2 for a file that could not be read."""
    about = _about(arguments.about)
    status = 0
    for path in arguments.files:
        try:
            status = max(status, _check(path, arguments, about))
        except UnreadableError as error:
            if len(arguments.files) == 1:
                raise
            print(f"servotap check: {printable(str(error))}", file=sys.stderr)
            status = 2
    return status


def _about(text: str) -> tuple[str, ...]:
    chosen = tuple(word.strip() for word in text.split(",") if word.strip())
    for word in chosen:
        if word not in _PARTIES:
            raise UsageError(f"--about: got {quote(word)}{near(word, _PARTIES)}, expected some of {', '.join(_PARTIES)}")
    return chosen or _PARTIES


def _check(path: str, arguments: argparse.Namespace, about: tuple[str, ...]) -> int:
    """Judge one file, print the result and return the exit status."""
    from conformance.claims.frames import traffic_rules
    from conformance.claims.frames.traffic import verdicts
    from conformance.claims.frames.traffic_rules import Judge, Party

    reading = open_reading(path, arguments)
    try:
        judge = Judge(
            [d for d in reading.possible if d.of_drives], reading.options.groups, first_few=max(arguments.examples, 1)
        )
        pipeline = reading.pipeline((judge,))
        with progress(reading.source, f"checking {printable(path)}"):
            pipeline.run(reading)
    finally:
        reading.source.close()
    spoken = [d for d in judge.dialects if judge.seen[d][traffic_rules.Seen.FRAMES]]
    found = [(v, c) for v, c in verdicts(judge, [Party(w) for w in about]) if not spoken or c.dialect in spoken or c.found]
    show = _show_json if arguments.json else _show
    show(path, reading, judge, found, arguments)
    if any(v.outcome is Outcome.REFUTED for v, _ in found):
        return REFUTED
    if not spoken:
        # What holds for no frame at all holds for any drive.
        print(f"servotap check: {printable(path)}: no frame of a drive is there to judge", file=sys.stderr)
        return 2
    return 0


# --- for people -------------------------------------------------------------------------------------------------------


def _show(
    path: str, reading: OpenCapture, judge: Judge, found: list[tuple[Verdict, Count]], arguments: argparse.Namespace
) -> None:
    print(f"{printable(path)}: {reading.source.title}, {', '.join(judge.dialects)}; {_seen(judge)}")
    if not reading.has_times:
        print(f"  times: {reading.time_source}")
    order = sorted(found, key=lambda pair: list(_COLORS).index(pair[0].outcome))
    wanted = [(v, c) for v, c in order if arguments.all or c.found]
    width = max((len(v.claim.id) for v, _ in wanted), default=0)
    for verdict, count in wanted:
        times = f"{count.found:>7}" if count.found else "       "
        print(
            f"  {_colored(verdict.outcome)} {times}  {verdict.claim.id:<{width}}  {count.row.about.value:<5}  {_said(verdict)}"
        )
        for example in count.examples[: arguments.examples]:
            print(f"             {_example(example, judge)}")
        addresses = _addresses(count)
        if count.found > len(count.examples[: arguments.examples]) and addresses:
            print(f"             {addresses}")
    totals = Counter(v.outcome for v, _ in found)
    print("  " + ", ".join(f"{totals[outcome]} {outcome.word}" for outcome in _COLORS if totals[outcome]))


def _seen(judge: Judge) -> str:
    total = sum(judge.seen.values(), Counter())
    parts = [f"{n} {kind.value if n > 1 else _one(kind.value)}" for kind, n in total.items() if n]
    if judge.foreign:
        parts.append(f"{judge.foreign} not of this dialect")
    return ", ".join(parts) or "no frames"


def _one(word: str) -> str:
    return "reply" if word == "replies" else word.removesuffix("s")


def _said(verdict: Verdict) -> str:
    where = f"  [{verdict.claim.section}]" if verdict.claim.section else ""
    why = f" ({verdict.reason})" if verdict.outcome.value == "not run" else ""
    return f"{verdict.claim.statement}{why}{where}"


def _colored(outcome: Outcome) -> str:
    text = f"{outcome.word:<9}"
    return f"\x1b[{_COLORS[outcome]}m{text}\x1b[0m" if sys.stdout.isatty() else text


def _example(example: Example, judge: Judge) -> str:
    found = example.finding
    who = f"address {found.who}, " if found.address is not None else ""
    data = example.data[:_SHOWN_BYTES].hex(" ").upper() + (" ..." if len(example.data) > _SHOWN_BYTES else "")
    at_s = (found.last_ns - judge.first_ns) / 1e9
    return printable(f"{at_s:12.6f} s  {found.port}: {who}{found.text}" + (f"  {data}" if data else ""))


def _addresses(count: Count) -> str:
    listed = ", ".join(f"{address}: {times}" for address, times in count.addresses.most_common(8))
    return f"by address  {listed}" if listed else ""


# --- for programs -----------------------------------------------------------------------------------------------------


def _show_json(
    path: str, reading: OpenCapture, judge: Judge, found: list[tuple[Verdict, Count]], arguments: argparse.Namespace
) -> None:
    import msgspec

    document: dict[str, Any] = {
        "file": storable(path),
        "format": reading.source.format,
        "dialects": list(judge.dialects),
        "times": reading.time_source,
        "seen": {name: {kind.value: n for kind, n in seen.items()} for name, seen in judge.seen.items()},
        "foreign": judge.foreign,
        "refuted": sum(v.outcome.value == "refuted" for v, _ in found),
        "claims": [_record(verdict, count, judge, arguments.examples) for verdict, count in found],
    }
    print(msgspec.json.encode(document).decode())


def _record(verdict: Verdict, count: Count, judge: Judge, examples: int) -> dict[str, Any]:
    claim = verdict.claim
    return {
        "id": claim.id,
        "outcome": verdict.outcome.value,
        "about": count.row.about.value,
        "rule": count.row.rule,
        "statement": claim.statement,
        "section": claim.section,
        "certainty": claim.certainty.value,
        "findings": count.found,
        "addresses": {str(address): times for address, times in sorted(count.addresses.items())},
        "reason": verdict.reason,
        "examples": [_example_record(example, judge) for example in count.examples[:examples]],
    }


def _example_record(example: Example, judge: Judge) -> dict[str, Any]:
    found = example.finding
    shown = {
        "time": (found.last_ns - judge.first_ns) / 1e9,
        "bus": found.port,
        "text": found.text,
        "offset": found.offset,
        "section": found.section,
        "raw": example.data.hex(" ").upper(),
    }
    return shown if found.address is None else shown | {"address": found.address}
