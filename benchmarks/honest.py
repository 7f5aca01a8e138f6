"""How many honest drives a suite accuses: drives drawn from all traits of realism and all settings, every claim, virtual time.

    python -m benchmarks.honest [--drives 200] [--seed 1] [--jobs 2] [--every 1] [--set bench|poor] [--part /motion/]
                                [--stored 50] [--worn]

Each drive has a dialect, a model, traits and stored settings drawn by its number and the seed. Every second drive that cannot
tell its settings is one of a user who tells them. Nothing may be refuted, but for a line that turns bits over; the exit status
says so.
"""

from __future__ import annotations

import argparse
import random
import sys
import time
from collections import Counter
from collections.abc import Iterator
from fractions import Fraction
from multiprocessing import get_context

from analyzer import dialects
from analyzer.catalogue import Dialect, all_fields
from analyzer.layout import Field
from conformance.claim import Claim, Outcome
from conformance.drives import make
from conformance.suite import engine, set_otherwise
from conformance.suite import plan as suite
from conformance.suite.rig_emulated import EmulatedRig
from conformance.suite.target import parse

#: Each trait but the encoder's noise: how many drives of a hundred have it, and what it is drawn from.
TRAITS: tuple[tuple[str, int, tuple[str, ...]], ...] = (
    ("loop-error", 60, ("1", "2", "3", "4")),
    ("speed-noise", 60, ("0.5%", "1%", "1.5%", "2%")),
    ("tremble", 30, ("1",)),
    ("speed-lag", 25, ("5ms", "20ms")),
    ("hysteresis", 25, ("1", "2")),
    ("creep", 25, ("1", "2")),
    ("stall", 20, ("10ms", "30ms")),
    ("first-late", 20, ("50ms", "200ms")),
    ("dip", 20, ("0.3", "1")),
    ("clock", 50, ("-2%", "-1%", "-0.3%", "+0.5%", "+1%", "+2%")),
    ("settle", 50, ("10ms", "30ms", "50ms", "80ms")),
    ("overshoot", 40, ("2", "4", "6", "8")),
    ("latency", 70, ("0.3..1ms", "0.3..3ms", "0.3..8ms", "2..5ms")),
    ("latency-timer", 25, ("1ms", "2ms", "16ms")),
    ("turnaround-noise", 20, ("FF", "00")),
    ("byte-gap", 25, ("0.5", "1", "1.4")),
    ("voltage-noise", 50, ("0.05", "0.1", "0.3")),
    ("warm", 30, ("",)),
    ("line-errors", 15, ("0.1%", "0.5%", "1%")),
    ("request-errors", 10, ("0.1%", "0.5%", "1%")),
)

#: What a cheap or worn motor and a slow adapter show in place of that.
WORN: dict[str, tuple[str, ...]] = {
    "encoder-noise": ("1", "2", "3", "4"),
    "loop-error": ("6", "8", "12", "20"),
    "speed-noise": ("2%", "3%", "4%"),
    "tremble": ("1", "2", "3"),
    "hysteresis": ("2", "4", "8"),
    "creep": ("2", "4", "6"),
    "stall": ("30ms", "60ms"),
    "settle": ("80ms", "150ms", "300ms"),
    "overshoot": ("8", "14", "20"),
    "latency": ("0.3..12ms", "5..20ms"),
}

#: Of a hundred settings that a drive can store, how many are not the usual ones; how many drives keep a zero or a run.
STORED, _KEEP = 15, 10
#: What a number that is stored is of its default, or of its range where that is 0.
_SHARES = (Fraction(1, 4), Fraction(1, 2), Fraction(3, 4), Fraction(5, 4), Fraction(2))
#: A run that is kept for power-on, in each direction.
_RUNS = tuple({"saved_run": 1, "saved_speed": 100, "saved_acceleration": 100, "saved_direction": way} for way in (0, 1))
#: Without any current no shaft turns.
_LEAST = {"current": 400}


def stored(dialect: Dialect, model: str, chance: random.Random, share: int = STORED) -> list[str]:
    """Return settings that a user may have stored in a drive, several together, as people write them."""
    usual = make.plain_drive(dialect.name, model).settings
    held: dict[str, int] = {}
    for name, field in sorted(set_otherwise.names(dialect.for_model(model) if model else dialect).items()):
        if name in usual.held and chance.randrange(100) < share:
            held[name] = max(_LEAST.get(name, field.low), min(field.high, _value(field, usual.held[name], chance)))
    if share and chance.randrange(100) < _KEEP:
        held |= {n: v for n, v in chance.choice((*set_otherwise.TOGETHER, *_RUNS)).items() if n in usual.held}
    return [f"{name}={usual.text(name, value)}" for name, value in held.items() if value != usual.held[name]]


def _value(field: Field, usual: int, chance: random.Random) -> int:
    if field.choice_names or field.values:
        return chance.choice(tuple(field.choice_names or field.values or ()))
    ends = (field.low, field.high) if field.low >= 0 else ()
    return chance.choice((*ends, *(int((usual or field.high) * share) for share in _SHARES)))


def drawn(number: int, seed: int, share: int = STORED, *, worn: bool = False) -> str:
    """Return an honest drive by its number, as people name it. `share`: of a hundred settings, how many are stored."""
    more = WORN if worn else {}
    chance = random.Random(f"{seed} honest {number}")
    names = sorted(make.KINDS)
    dialect = dialects.get(names[number % len(names)])
    words = [f"{dialect.name}@{chance.randint(1, 30)}"]
    if dialect.models:
        words.append(f"model={chance.choice(dialect.models)}")
    noise = chance.choice(more.get("encoder-noise", ("0", "1", "1", "1", "2")))
    words += [f"encoder-noise={noise}"] if int(noise) else []
    for name, of_hundred, values in TRAITS:
        value = chance.choice(more.get(name, values))
        if chance.randrange(100) < of_hundred:
            words.append(f"{name}={value}" if value else name)
    model = next((word.partition("=")[2] for word in words if word.startswith("model=")), "")
    # Its own chance: the traits of a drive stay those that they were.
    words += stored(dialect, model, random.Random(f"{seed} stored {number}"), share)
    return ",".join(words)


def of_its_line(drive: str, claim: Claim) -> bool:
    """Say whether a claim judges the line of a drive, and that turns bits over: it is refuted, and nothing else is."""
    return "-errors=" in drive and claim.of_line


def accused(
    text: str, seed: int = 0, every: int = 1, part: str = "", tells: bool = True
) -> tuple[str, Counter[str], list[str]]:
    """Run each so many of the claims on a drive, those with a part in their id.

    Returns the drive with what repeats the run, how many came out how, and what was refuted.
    `tells`: the user tells what the drive cannot tell of its settings.
    """
    target = parse(text)
    plan = suite.Plan((target,), seed=seed)
    assert target.specification is not None  # it is emulated
    usual = make.plain_drive(target.dialect.name, target.model).settings.held
    held = {**usual, **make.settings_of(target.specification, {})}
    # What is stored in another dialect cannot be told.
    own = {name for command in target.dialect.commands for name in all_fields(command.request_forms)}
    told = {name: value for name, value in held.items() if tells and name in own}
    rig = EmulatedRig(target.specification, seed=seed, told=told)
    counts: Counter[str] = Counter()
    refuted = []
    wanted = [claim for claim in plan.selected(target) if part in claim.id]
    for verdict in engine.run(wanted[seed % every :: every], rig):
        counts[verdict.outcome.value] += 1
        if verdict.outcome is Outcome.REFUTED and not of_its_line(text, verdict.claim):
            refuted.append(f"{verdict.claim.id}: {verdict.reason} ({verdict.expected}; {verdict.got})")
    return f"{text} (seed {seed}, settings {'told' if tells else 'not told'})", counts, refuted


def _numbered(given: tuple[str, int, int, str, bool]) -> tuple[str, Counter[str], list[str]]:
    return accused(*given)


def drives(
    count: int, seed: int, every: int, of: str = "", part: str = "", share: int = STORED, *, worn: bool = False
) -> Iterator[tuple[str, int, int, str, bool]]:
    """Yield drives with the seed of each and which claims it tries; all with one set of traits where it is named."""
    for number in range(count):
        text = drawn(number, seed, share, worn=worn)
        if of:
            text = ",".join([*(word for word in text.split(",")[:2] if "@" in word or "model=" in word), f"real={of}"])
        # Drives of one dialect follow each other by the number of dialects: all claims are tried in turn.
        turn = number // len(make.KINDS)
        yield text, seed * 100_000 + turn, every, part, turn % 2 == 0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--drives", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument(
        "--every", type=int, default=1, help="of the claims only each so many on each drive, others on the next"
    )
    parser.add_argument("--set", default="", help="bench or poor: this set for all, in place of traits drawn")
    parser.add_argument("--stored", type=int, default=STORED, help="of a hundred settings, how many are not the usual ones")
    parser.add_argument("--worn", action="store_true", help="traits of cheap and worn motors")
    parser.add_argument("--part", default="", help="only claims with this in their id, such as /motion/")
    arguments = parser.parse_args()
    began, guilty = time.monotonic(), 0
    total: Counter[str] = Counter()
    with get_context("spawn").Pool(arguments.jobs) as pool:
        given = (arguments.drives, arguments.seed, arguments.every, arguments.set, arguments.part, arguments.stored)
        drawn_drives = drives(*given, worn=arguments.worn)
        for number, (text, counts, refuted) in enumerate(pool.imap(_numbered, drawn_drives), 1):
            total += counts
            guilty += bool(refuted)
            # A run takes hours: what it has shown so far.
            print(f"{number} drives, {guilty} accused, {time.monotonic() - began:.0f} s", end="\r", file=sys.stderr, flush=True)
            if refuted:
                print(text, *refuted, sep="\n    ", flush=True)
    shown = ", ".join(f"{count} {name}" for name, count in total.most_common())
    print(f"{arguments.drives} honest drives, {guilty} accused; {shown}; {time.monotonic() - began:.0f} s")
    return int(guilty > 0)


if __name__ == "__main__":
    sys.exit(main())
