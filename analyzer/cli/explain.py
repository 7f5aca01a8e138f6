"""Explain a frame byte by byte: whose it is, what each byte means, whether the checksum fits, what is wrong.

The frame is hex in any common form (blanks, commas, colons, 0x, or nothing between the bytes), or a line as logs, monitors and
programs print it, with its time and its mark. A CAN frame is written as identifier and data bytes (01 F6 01 40 02 3A) or as
candump does (001#F60140023A). Without --dialect every dialect is
tried; the one whose checksum, command, layout and values fit best is shown.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from typing import Any

from analyzer import dialects as registry
from analyzer.catalogue import Role
from analyzer.cli.option_types import add_model_argument
from analyzer.codec import codec
from analyzer.decoder import physical, slots_of
from analyzer.dialects import code_text
from analyzer.errors import UnreadableError, UsageError
from analyzer.findings import RULES
from analyzer.records import Message
from analyzer.reference.explanation import Explainer, Explanation
from analyzer.reference.explanation_text import explanation_lines
from analyzer.reference.hex_frame import read_frame, write_frame

EXAMPLES = """\
exit status: 0 readable, with or without findings; 2 no frame.

examples:
  servotap explain "FA 01 F6 01 40 02 34"
  servotap explain 01 F6 01 40 02 3A
  servotap explain 001#F60140023A --json
  servotap explain "[12:00:00][D][uart_debug:114]: >>> FA:01:30:2B"
  servotap explain --dialect mks-rs485 --no-checksum "FA 01 F6 01 40 02"
  servotap explain "01 04 02 01 40 B9 50" --request "01 04 00 32 00 01 90 05"
  servotap explain - < frames.txt                a frame a line; # begins a comment
"""

#: Longer lines of standard input are no frames, and are never held as a whole.
_LINE_LIMIT = 1 << 16


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("frame", nargs="+", metavar="FRAME", help="the bytes; - reads standard input, one frame per line")
    parser.add_argument("--dialect", metavar="D", help="read it only in this dialect")
    parser.add_argument("--role", choices=("request", "reply"), help="who sent it, if its bytes do not tell")
    add_model_argument(parser)
    parser.add_argument("--no-checksum", action="store_true", help="the bytes are given without their checksum")
    parser.add_argument("--request", metavar="FRAME", help="the request that this reply answers")
    parser.add_argument("--json", action="store_true", help="one JSON object per line")


def run(arguments: argparse.Namespace) -> int:
    """Explain the frames; return 0, or 2 if one was none."""
    explainer = Explainer(registry.asked_for(arguments.dialect, arguments.model))
    role = Role(arguments.role) if arguments.role else Role.UNKNOWN
    request = read_frame(arguments.request) if arguments.request else None

    def explain(text: str) -> list[Explanation]:
        found, notes = explainer.text(text, role=role, no_checksum=arguments.no_checksum, request=request)
        for note in notes:
            print(f"note: {note}", file=sys.stderr)
        return found

    if arguments.frame != ["-"]:
        for number, found in enumerate(explain(" ".join(arguments.frame))):
            print("\n" * bool(number and not arguments.json), end="")
            _show(found, arguments.json)
        return 0
    status = 0
    for number, line in _lines():
        try:
            several = explain(line)
        except (UnreadableError, UsageError) as error:
            sys.stdout.flush()
            print(f"servotap explain: line {number}: {error}", file=sys.stderr)
            status = 2
            continue
        for found in several:
            if not arguments.json:
                print(f"line {number}: {write_frame(found.sent, found.can_id)}")
            _show(found, arguments.json)
            if not arguments.json:
                print()
    return status


def _lines() -> Iterator[tuple[int, str]]:
    """Yield number and text of the lines of standard input that are neither blank nor a comment."""
    stream = sys.stdin.buffer
    number = 0
    while line := stream.readline(_LINE_LIMIT):
        number += 1
        rest = line
        while len(rest) >= _LINE_LIMIT and not rest.endswith(b"\n"):
            rest = stream.readline(_LINE_LIMIT)
        text = line.decode("utf-8", "replace").lstrip("\ufeff").strip()
        comment = text.find(" #")
        if comment >= 0:
            text = text[:comment].strip()
        if text and not text.startswith("#"):
            yield number, text


def _show(found: Explanation, as_json: bool) -> None:
    print(json.dumps(explained(found)) if as_json else "\n".join(explanation_lines(found)))


def explained(found: Explanation) -> dict[str, Any]:
    """Return an explanation as a JSON object; what is unknown or not given is left out."""
    message = found.message
    shown: dict[str, Any] = {"dialect": found.dialect.name, "role": message.role.value, "address": message.address}
    if found.head.code is not None:
        shown["code"] = code_text(found.head.code, found.head.function)
    elif message.command is not None and message.command.code >= 0:
        shown["code"] = code_text(message.command.code, message.command.function)
    if found.head.function is not None:
        shown["function"] = code_text(found.head.function)
    shown |= _command(message)
    if found.checks:
        shown["checksum"] = _checksum(found)
    shown["findings"] = [
        {"rule": i.rule, "severity": (i.severity or RULES[i.rule].severity).value, "text": i.text} for i in found.issues
    ]
    if message.command is not None:
        shown["section"] = message.command.section
    if found.right is not None:
        shown["frame"] = write_frame(found.right, found.can_id)
    if len(found.readings) > 1:
        shown["readings"] = [{"role": m.role.value, **_command(m)} for m in found.readings]
    if found.maybe_unchecked:
        shown["maybe_unchecked"] = True
    if found.also:
        shown["also"] = list(found.also)
    return shown


def _command(message: Message) -> dict[str, Any]:
    """Return the command and the values of a message, in their units and as sent."""
    name = {} if message.command is None else {"command": message.command.name}
    return {**name, "fields": physical(message), "wire": _wire(message)}


def _wire(message: Message) -> dict[str, Any]:
    command = message.command
    if command is None or command.slots is None or message.form is None:
        return {n: v.hex(" ").upper() if isinstance(v, bytes) else v for n, v in message.values.items()}
    slots = []
    for slot in slots_of(message.frame.dialect, command, message.data):
        shown: dict[str, Any] = {"address": slot.address, "code": slot.code}
        if slot.command is not None and slot.form is not None:
            shown |= {"command": slot.command.name, **codec(slot.form.layout).wire(slot.data)}
        else:
            shown["raw"] = slot.data.hex(" ").upper()
        slots.append(shown)
    return {"slots": slots}


def _checksum(found: Explanation) -> dict[str, Any]:
    """Return the check that does not fit, else the last one."""
    wrong = [c for c in found.checks if c in found.absent or not c.ok]
    check = (wrong or list(found.checks))[0 if wrong else -1]
    shown: dict[str, Any] = {"ok": not wrong, "expected": check.expected.hex(" ").upper()}
    if check not in found.absent:
        shown["got"] = check.got.hex(" ").upper()
    return shown
