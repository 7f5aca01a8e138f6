"""Send one frame to a drive, through the gate, and show the reply decoded.

Reads and stops are sent as they are; anything else needs --allow with every risk it has. Bytes are judged as they leave: all
that can be read in them has to be allowed. Bytes that end in the beginning of a frame are refused, for what is sent next could
complete it; where a whole frame ends like one, a read goes behind it. Values are written as for 'servotap frame'.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from typing import Any

from analyzer import dialects as registry
from analyzer.catalogue import Command, Dialect
from analyzer.cli.frame import filled_text, parse_target, parse_values
from analyzer.cli.option_types import add_model_argument, number
from analyzer.cli.show import names_of
from analyzer.decoder import physical
from analyzer.dialects import find_command
from analyzer.encoder import assemble
from analyzer.entries import Entry
from analyzer.errors import UsageError
from analyzer.live import profile
from analyzer.records import CanFrame
from analyzer.reference.hex_frame import read_frame
from analyzer.values import printable
from conformance.cli.endpoint import add_on_argument, at_own_rate, endpoint_of, gate_to, rate_text
from conformance.gate.gate import Allowance, Item, Judge, add_gate_arguments, allowance_from, shown
from conformance.gate.permissions import narrow
from conformance.talk.dialogue import MS, Dialogue, Until
from conformance.talk.drive_state import read_drive_state
from conformance.talk.exchange import Answer, Completion, Exchange, said
from conformance.talk.request import Request

EXAMPLES = """\
exit status: 0 answered (or nothing answers it), 1 no answer or a refusal by the drive, 2 wrong use or not allowed.

examples:
  servotap send mks-rs485@1 read_speed --on serial:/dev/ttyUSB0,baud=38400
  servotap send mks-can@1 read_parameter parameter=current --on can:socketcan:can0
  servotap send mks-rs485@1 run_speed direction=cw speed=60 acceleration=200 --on tcp:127.0.0.1:5000 --allow motion,unbounded
  servotap send mks-rs485@1 stop_speed acceleration=200 --on tcp:127.0.0.1:5000 --wait
  servotap send --hex "FA 01 31 2C" --on serial:/dev/ttyUSB0,baud=38400
  servotap send lk-rs485@1 move_increment position=90 --dry-run
  servotap send arm read_speed                     a drive of a profile, servotap.toml (see servotap init)
"""
_DEFAULT_TIMEOUT = 1000.0
_DONE_NS = 120_000 * MS
#: How long is listened where nothing answers, and behind an answer for another one.
_QUIET_NS = 60 * MS


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument(
        "target", nargs="?", metavar="DRIVE", help="the recipient: mks-rs485@1, mks-rs485@all, or a name of a profile"
    )
    parser.add_argument("command", nargs="?", metavar="COMMAND", help="its name, or a code that only one command has")
    parser.add_argument("values", nargs="*", metavar="FIELD=VALUE", help="values of its fields")
    add_on_argument(parser)
    parser.add_argument("--hex", metavar="BYTES", help="these bytes instead of a command (CAN: 001#F60140023A)")
    parser.add_argument("--form", metavar="NAME", help="the form, if the fields do not determine it")
    add_model_argument(parser)
    parser.add_argument("--wire", action="store_true", help="numbers are integers as sent")
    parser.add_argument("--force", action="store_true", help="send also what the manual forbids, if its bits hold it")
    milliseconds = number("milliseconds above 0, at most 600000", float, lambda ms: 0 < ms <= 600_000)
    parser.add_argument("--timeout", type=milliseconds, default=_DEFAULT_TIMEOUT, metavar="MS", help="default 1000")
    parser.add_argument("--wait", action="store_true", help="wait for the reply that says it is done, two minutes at most")
    parser.add_argument("--dry-run", action="store_true", help="show the bytes and what can be read in them; open nothing")
    parser.add_argument("--json", action="store_true", help="one JSON object")
    add_gate_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Send; return 0 if it was answered well, 1 if not."""
    named = profile.drive(arguments.target) if arguments.target and arguments.hex is None else None
    if named is not None:
        # Its bus is where it is, unless another place is named.
        arguments.on = arguments.on or arguments.target
        narrow(arguments, (named,))
    request = _hex(arguments) if arguments.hex is not None else _command(arguments)
    allowance = request.allowance(allowance_from(arguments, addresses=request.addresses))
    if arguments.dry_run:
        return _dry_run(request, allowance, arguments)
    endpoint = endpoint_of(arguments)
    if request.dialect is not None:
        endpoint = at_own_rate(endpoint, request.dialect)
    if endpoint.bus_kind != ("can" if isinstance(request.item, CanFrame) else "serial"):
        raise UsageError(f"{shown(request.item)} is a frame of another kind of bus than {endpoint.text}")
    # Risks that are not allowed are refused before a port is opened. Bounds may depend on where the drive is: they come later.
    request.check(allowance, _known_dialects(arguments))
    with gate_to(endpoint, allowance, _known_dialects(arguments)) as gate:
        dialogue = Dialogue(gate, request.dialects)
        if request.dialect is not None and request.address is not None and request.acts:
            read_drive_state(dialogue, request.dialect, request.address)
        exchange = _ask(dialogue, request, arguments)
        gate.end_stream(next(iter(request.meant), None))
        echoes = getattr(gate.line, "echo", None)
    if arguments.json:
        print(json.dumps(_object(request, exchange)))
    else:
        _show(request, exchange, rate_text(endpoint, gate.line.endpoint.bits_per_second), bool(echoes and echoes.dropped))
    return 0 if _succeeded(request, exchange, arguments.wait) else 1


def _command(arguments: argparse.Namespace) -> Request:
    if arguments.target is None or arguments.command is None:
        raise UsageError('what? expected DIALECT@ADDRESS COMMAND FIELD=VALUE..., or --hex "FA 01 31 2C"')
    dialect, address = parse_target(arguments.target, arguments.model)
    command = find_command(dialect, arguments.command)
    values = parse_values(arguments.values)
    built = assemble(dialect, command, address, values, form=arguments.form, physical=not arguments.wire, complete=True)
    if built.filled and not arguments.json:
        print(filled_text(built), file=sys.stderr)
    if built.refusals and not arguments.force:
        raise UsageError("; ".join(built.refusals))
    others = [d for d in registry.every() if d.bus == dialect.bus and d.name != dialect.name]
    return Request(built.item(), [dialect, *others], frozenset({address}), command, address)


def _hex(arguments: argparse.Namespace) -> Request:
    if arguments.target is not None:
        raise UsageError(f"--hex: expected the bytes alone, got {arguments.target} beside them")
    frame = read_frame(arguments.hex)
    on_can = arguments.on is not None and profile.endpoint(arguments.on).bus_kind == "can"
    can_id, data = frame.can_id, frame.data
    if on_can and can_id is None:
        if not data:
            raise UsageError("--hex: expected an identifier and data bytes, as 001#F60140023A")
        can_id, data = data[0], data[1:]
    item: Item = data if can_id is None else CanFrame(None, "host", can_id, data)
    kind = "serial" if can_id is None else "can"
    dialects = registry.for_model([d for d in registry.every() if d.bus == kind], arguments.model)
    return Request(item, dialects, None)


def _known_dialects(arguments: argparse.Namespace) -> list[Dialect]:
    """Return all dialects, those that know the model as it speaks them: some units are known only so."""
    return registry.for_model(registry.every(), arguments.model)


def _dry_run(request: Request, allowance: Allowance, arguments: argparse.Namespace) -> int:
    judge = Judge(replace(allowance, budget=allowance.budget.rehearsal()), _known_dialects(arguments))
    readings, objections = judge.interpret(request.item), judge.objections(request.item)
    beside = request.beside(allowance)
    if arguments.json:
        listed = [{"reading": str(r), "risk": sorted(r.risks)} for r in readings]
        refused = [{"reading": str(o.interpretation), "reasons": list(o.reasons), "hint": o.hint} for o in objections]
        refused += [{"reading": shown(request.item), "reasons": [beside], "hint": ""}] * bool(beside)
        print(json.dumps({"sent": shown(request.item), "readings": listed, "refused": refused}))
    else:
        print(shown(request.item))
        for reading in readings:
            print(f"  {reading}: {', '.join(sorted(reading.risks))}")
        for objection in [*objections, *filter(None, (beside,))]:
            print(f"  not allowed: {objection}")
        if not objections and not beside:
            print("  it may be sent")
    return 2 if objections or beside else 0


def _ask(dialogue: Dialogue, request: Request, arguments: argparse.Namespace) -> Exchange:
    timeout_ns = int(arguments.timeout * MS)
    if not request.answered:
        return dialogue.ask(request.item, _QUIET_NS, quiet_ns=_QUIET_NS)
    until, done_ns = (Until.DONE, _DONE_NS) if arguments.wait else (Until.REPLY, 0)
    try:
        return dialogue.ask(request.item, timeout_ns, until=until, done_ns=done_ns, quiet_ns=_QUIET_NS)
    except KeyboardInterrupt:
        if request.acts:
            print("servotap send: no longer waiting; the drive goes on with its command", file=sys.stderr)
        raise


def _succeeded(request: Request, exchange: Exchange, wait: bool) -> bool:
    if not request.answered:
        return not exchange.received
    if request.command is None and not exchange.replies:
        return bool(exchange.others)
    if exchange.completion is Completion.RUNNING:
        return not wait
    return exchange.completion is Completion.DONE


# --- what is shown ------------------------------------------------------------------------------------------------


def _show(request: Request, exchange: Exchange, rate: str, echoed: bool) -> None:
    requests = [e.message for e in exchange.requests]
    texts = [said(m) for m in requests] or ["bytes that are no frame"]
    print(f"> {shown(request.item)}   {'; '.join(texts)}")
    parts = [(a.first_ns, _line(a)) for a in exchange.answers]
    parts += [(j.first_ns, f"! {j.data.hex(' ').upper()}   {j.reason.value}: no frame") for j in exchange.junk]
    for _, line in sorted(parts, key=lambda part: part[0]):
        print(line)
    if not parts:
        waited = (exchange.until_ns - exchange.sent_ns) / 1e6
        if request.answered:
            print(f"  nothing came within {waited:.0f} ms at {rate} (servotap scan finds what is there)")
        else:
            print("  nothing answers it, and nothing came")
    if echoed:
        print("  (the adapter hands back what it sends; that is left out)")
    if exchange.completion is Completion.RUNNING:
        print("  it has begun; its end was not waited for (--wait)" if not request.command else _running(request.command))


def _running(command: Command) -> str:
    return f"  {command.name} has begun; the reply that says it is done has not come"


def _line(answer: Answer) -> str:
    frame = answer.message.frame
    item: Item = frame.can if frame.can is not None else frame.data
    text = f"< {shown(item)}   {said(answer.message)}   after {answer.latency_ns / 1e6:.2f} ms"
    notes = [f"{f.rule}: {printable(f.text)}" for f in answer.entry.findings]
    return "\n    ".join([text, *notes])


def _object(request: Request, exchange: Exchange) -> dict[str, Any]:
    def named(entry: Entry) -> dict[str, Any]:
        return names_of(entry, physical(entry.message))

    replies = [{**named(a.entry), "latency": a.latency_ns / 1e9, "meaning": a.meaning} for a in exchange.replies]
    return {
        "sent": shown(request.item),
        "outcome": exchange.completion.value,
        "requests": [named(e) for e in exchange.requests],
        "replies": replies,
        "others": [named(a.entry) for a in exchange.others],
        "junk": [{"raw": j.data.hex(" ").upper(), "reason": j.reason.value} for j in exchange.junk],
        "findings": [{"rule": f.rule, "severity": f.severity.value, "text": f.text} for f in exchange.findings],
    }
