#!/usr/bin/env python3
"""How often diagnosis names the cause first, on made traffic of many seeds, and whom it accuses of sound traffic.

    python benchmarks/troubles.py [--seeds N] [--only WORD ...] [--show]

A host polls one to three drives, whose values change; then the traffic is spoiled, as levels on a line where the line is the
cause. `host`: the requests are shown as sent, and what is read is spoiled. `listener`: all is spoiled, and nothing tells who
sent. Each row is a cause in a dialect; `named`: it came first; `other`: another cause did.
"""

from __future__ import annotations

import argparse
import random
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from analyzer import dialects
from analyzer.catalogue import Role
from analyzer.codec import codec
from analyzer.detect import choose
from analyzer.diagnosis.diagnose import Diagnosis, of_traffic
from analyzer.records import Chunk
from tests.diagnosis.spoiled_line import BYTES, STEPS, Format, both, levels, received

Row = tuple[str, bytes]
Chance = random.Random
PERIOD_NS = 10_000_000


class Poll(NamedTuple):
    """What a host asks: a drive's address, the request, and a function that draws a reply."""

    address: int
    request: bytes
    reply: Callable[[], bytes]


def polls(name: str, chance: Chance) -> list[Poll]:
    """Return what a host asks again and again: some reads of one to three drives."""
    dialect = dialects.get(name)
    reads = [
        c for c in dialect.commands
        if c.verb.startswith("read_") and c.reply_forms and not c.models and c.name != "read_parameter"
        and not c.request_forms[0].layout.byte_length and len([f for f in c.reply_forms if not f.layout.open_ended]) == 1
    ]  # fmt: skip
    chosen = chance.sample(reads, min(len(reads), chance.randint(2, 4)))
    found = []
    for address in chance.sample(range(1, 12), chance.randint(1, 3)):
        for command in chosen:
            form = command.reply_forms[0]
            request = dialect.link.build(command, command.request_forms[0], address, b"", Role.REQUEST)

            def reply(address: int = address, command=command, form=form) -> bytes:  # type: ignore[no-untyped-def]
                values = {}
                for field_name, field in form.layout.named.items():
                    if field.fixed is None and field.bit_width:
                        allowed = sorted(field.values or field.choice_names)
                        low, high = max(field.low, -3000), min(field.high, 3000)
                        values[field_name] = chance.choice(allowed) if allowed else chance.randint(low, high)
                return dialect.link.build(command, form, address, codec(form.layout).encode(values), Role.REPLY)

            found.append(Poll(address, request, reply))
    return found


def traffic(name: str, chance: Chance) -> list[Row]:
    """Return rows of requests and replies."""
    asked = polls(name, chance)
    return [
        row for _ in range(chance.randint(4, 12)) for poll in asked for row in ((">", poll.request), ("<", poll.reply()))
    ]  # fmt: skip


# --- what spoils it -------------------------------------------------------------------------------------------------------


def spike(data: bytes, chance: Chance) -> bytes:
    """Return bytes that a spike of one to three bits hits anywhere, heads and start bits too."""
    line = [1] * (2 * STEPS) + levels(data)
    size = chance.randint(STEPS // 2, 3 * STEPS)
    at = chance.randrange(len(line))
    line[at : at + size] = [chance.randint(0, 1)] * len(line[at : at + size])
    return received(line)


def on_line(sent: Format = BYTES, **how: object) -> Callable[[bytes, Chance], bytes]:
    """Return what spoils bytes by a receiver that is set up otherwise than the sender."""
    return lambda data, chance: received(levels(data, sent), **how)  # type: ignore[arg-type]


def rarely(spoil: Callable[[bytes, Chance], bytes], share: float) -> Callable[[bytes, Chance], bytes]:
    """Return what spoils a share of the frames."""
    return lambda data, chance: spoil(data, chance) if chance.random() < share else data


def of_host(rows: list[Row], spoil: Callable[[bytes, Chance], bytes], chance: Chance) -> list[Row]:
    """Return rows whose replies are spoiled."""
    return [(mark, spoil(data, chance) if mark == "<" else data) for mark, data in rows]


def of_listener(rows: list[Row], spoil: Callable[[bytes, Chance], bytes], chance: Chance) -> list[Row]:
    """Return rows of which all are spoiled, and no sender is told."""
    return [("", spoil(data, chance)) for _, data in rows]


def both_sides(spoil: Callable[[bytes, Chance], bytes]) -> Iterator[tuple[str, Callable[[list[Row], Chance], list[Row]]]]:
    """Yield what a host and a listener see."""
    yield "host", lambda rows, chance: of_host(rows, spoil, chance)
    yield "listener", lambda rows, chance: of_listener(rows, spoil, chance)


def of_one_address(rows: list[Row], chance: Chance) -> list[Row]:
    """Return rows of which one drive's replies are damaged at times."""
    heads = [data[:3] for mark, data in rows if mark == ">"]
    one = chance.choice(heads)
    found, own = [], False
    for mark, data in rows:
        if mark == ">":
            own = data[:2] == one[:2] if one[0] == 0xFA else data[:1] == one[:1] if one[0] != 0x3E else data[:3:2] == one[::2]
        found.append((mark, spike(data, chance) if mark == "<" and own and chance.random() < 0.4 else data))
    return found


def doubled(rows: list[Row], chance: Chance) -> list[Row]:
    """Return rows in which two drives answer each request, with other values and a little apart."""
    replies = [data for mark, data in rows if mark == "<"]
    found = []
    for number, (mark, data) in enumerate(rows):
        if mark == "<":
            others = [r for r in replies if len(r) == len(data) and r[:3] == data[:3]]
            other = others[(number * 7 + 3) % len(others)]
            data = received(both(levels(data), [1] * chance.randint(0, 40) + levels(other)))
        found.append((mark, data))
    return found


SPEEDS = {"1/4": 4.0, "1/2": 2.0, "2/3": 1.5, "3/2": 2 / 3, "2": 0.5, "4": 0.25}


def shorter(cut: slice) -> Callable[[list[Row], Chance], list[Row]]:
    """Return what takes a part of each reply."""
    return lambda rows, chance: of_host(rows, lambda data, c: data[cut], chance)


SEVEN, SEVEN_EVEN = Format(7), Format(7, even=True)
#: Ways in which a line is set up, with their cause.
LINES: list[tuple[str, str, Callable[[bytes, Chance], bytes]]] = [
    *((f"noise {share}", "noise", rarely(spike, share)) for share in (0.08, 0.2, 0.35)),
    ("7E1 reads 8N1", "wrong_parity", on_line(form=SEVEN_EVEN)),
    ("8N1 reads 7E1", "wrong_parity", on_line(SEVEN_EVEN)),
    ("7N1 reads 8N1", "wrong_parity", on_line(form=SEVEN)),
    ("inverted", "inverted_lines", on_line(inverted=True)),
    *((f"read at {name} of the speed", "wrong_baud", on_line(ratio=ratio)) for name, ratio in SPEEDS.items()),
    ("sound", "", lambda data, chance: data),
]
#: Each: its name, the causes that are right, and what spoils the rows.
CASES: list[tuple[str, tuple[str, ...], Callable[[list[Row], Chance], list[Row]]]] = [
    *((f"{name} {who}", (cause,), how) for name, cause, spoil in LINES for who, how in both_sides(spoil)),
    ("noise of one address", ("noise", "duplicate_address"), of_one_address),
    *((f"{size} lost at the start", ("lost_start",), shorter(slice(size, None))) for size in (1, 2, 3)),
    *((f"{size} read of each reply", ("reply_cut",), shorter(slice(size))) for size in (1, 2, 4)),
    ("two drives at each address", ("duplicate_address",), doubled),
]


def diagnosed(rows: list[Row]) -> Diagnosis:
    """Return the diagnosis of rows, each sent at once."""
    roles = {">": Role.REQUEST, "<": Role.REPLY, "": Role.UNKNOWN}
    items = [Chunk(number * PERIOD_NS, "bus", data, roles[mark], True) for number, (mark, data) in enumerate(rows) if data]
    return of_traffic(items, choose(dialects.every(), items).dialects)


def main() -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--only", nargs="*", default=[])
    parser.add_argument("--dialect", nargs="*", default=["mks-rs485", "mks-modbus", "lk-rs485"])
    parser.add_argument("--show", action="store_true", help="print what was told where another cause came first")
    arguments = parser.parse_args()
    total = named = 0
    for case, causes, spoil in CASES:
        if arguments.only and not any(word in case for word in arguments.only):
            continue
        for name in arguments.dialect:
            told: Counter[str] = Counter()
            for seed in range(arguments.seeds):
                chance = Chance(f"{case} {name} {seed}")
                rows = spoil(traffic(name, chance), chance)
                found = diagnosed(rows)
                first = found.causes[0].suspicion.cause if found.causes else ""
                told[first] += 1
                if arguments.show and first not in causes:
                    print(f"  seed {seed}: {first} {found.causes[0].suspicion.evidence if found.causes else found.verdict}")
                    print("".join(f"    {mark:1} {data.hex(' ')}\n" for mark, data in rows[:12]), end="")
            right = sum(told[cause] for cause in causes)
            total, named = total + arguments.seeds, named + right
            others = ", ".join(f"{cause or 'none'} {count}" for cause, count in told.most_common() if cause not in causes)
            print(f"{case:<32} {name:<11} {right:>3} of {arguments.seeds:<3} {others}", flush=True)
    print(f"{named} of {total}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
