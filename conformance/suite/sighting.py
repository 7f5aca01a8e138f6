"""Whether one drive is there, and if not, where it is instead: at another rate, at another address, in another dialect.

    sighting = look(gate, dialect, address)
    sighting.there, sighting.text

And who else is there (`neighbours`), for those who must know that nobody is. Reads only, as in `conformance.tools.scan`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from analyzer import dialects as registry
from analyzer.catalogue import Dialect
from analyzer.errors import UsageError
from conformance.gate.gate import Gate
from conformance.talk.dialogue import MS
from conformance.tools.scan import Asker, Found, Report, scan

#: A drive that moves was seen to take 0.7 s for an answer.
_PATIENT_NS = 1000 * MS
_ATTEMPTS = 3
#: Addresses at which a drive that is not there is looked for.
_NEAR = range(1, 33)


@dataclass(frozen=True)
class Sighting:
    """What came of looking for one drive. `there`: it answered; `elsewhere`: who answered in its place; `text`: in words."""

    there: Found | None
    elsewhere: tuple[Found, ...]
    text: str
    report: Report


def look(gate: Gate, dialect: Dialect, address: int, *, widely: bool = True) -> Sighting:
    """Look for one drive on the line of a gate. `widely` False: say only whether it answers.

    The line is left at the rate it had. Raises LineLost.
    """
    report = Report(kind=dialect.bus)
    asker = Asker(gate, [dialect], _PATIENT_NS)
    for _ in range(_ATTEMPTS):
        found, talk = asker.ask(dialect, address)
        if found is not None and found.address == address:
            return Sighting(found, (), f"{found.name} answers at {_rate(found)}", report)
        if talk.heard:
            break
    heard = talk.heard
    elsewhere = _elsewhere(gate, dialect, address, report) if widely else []
    return Sighting(None, tuple(elsewhere), _text(gate, dialect, address, elsewhere, heard, report), report)


def _elsewhere(gate: Gate, dialect: Dialect, address: int, report: Report) -> list[Found]:
    """Look where a drive may be that is not where it was said: the likeliest place first, until one answers."""
    own = gate.line.endpoint.bits_per_second
    others = [d for d in registry.every() if d.bus == dialect.bus and d.name != dialect.name]
    rates = [r for r in dialect.baud_rates if r != own]
    first = dialect.addresses[0]
    wide = sorted({address, first, *(a for a in _NEAR if a >= first)})
    places = [(others, (address,), (own,)), ([dialect], wide, (own,)), ([dialect, *others], (address,), rates)]
    for dialects, addresses, speeds in places:
        if not dialects or not speeds:
            continue
        try:
            scan(gate, dialects, addresses=addresses, rates=speeds, enough=lambda found: True, report=report, busy=True)
        except UsageError:
            # A line whose speed cannot be set from here has no other rates.
            continue
        if report.found:
            break
    return list(report.found)


def _text(gate: Gate, dialect: Dialect, address: int, elsewhere: Sequence[Found], heard: bytes, report: Report) -> str:
    place = gate.line.endpoint
    asked = f"{dialect.name}@{address} does not answer on {place.text} at {place.bits_per_second} bit/s"
    for found in elsewhere:
        if found.dialect.name != dialect.name:
            return f"{asked}, but {found.name} does at {_rate(found)}: it speaks another dialect"
        if found.speed != place.bits_per_second:
            return f"{asked}, but it does at {_rate(found)}: the line is at another rate than the drive"
        return f"{asked}, but {found.name} does: it has another address"
    noise = f"; {len(heard)} bytes came that are no answer ({heard[:16].hex(' ').upper()})" if heard else "; nothing came"
    return f"{asked}{noise}\n  " + "\n  ".join(report.hints)


def _rate(found: Found) -> str:
    return f"{found.speed} bit/s"


def neighbours(gate: Gate, dialects: Sequence[Dialect], addresses: Iterable[int], own: Iterable[int] = ()) -> list[Found]:
    """Return the drives that answer at these addresses, at the line's rate, those at `own` aside. Raises LineLost."""
    mine = frozenset(own)
    report = scan(gate, dialects, addresses=[a for a in addresses if a not in mine], busy=True)
    return [f for f in report.found if f.address not in mine]
