"""Hypothesis strategies from the catalogue: values of fields, of layouts and whole requests, inside, at and outside the limits.

    inside(field)           integers as sent that the manual allows       edges(field)    the limits, or every choice
    outside(field)          forbidden values that the bits can hold   beyond(field)   the nearest of them, and the last
    layouts(layout)         {name: value}, all inside                     strays(layout)  exactly one of them outside
    reserved_set(layout)    data whose reserved bits are not all 0
    requests(dialect, risks, leeway)     whole requests with allowed risks only
    packages(dialect, risks, leeway)     packages of such requests

All take a `leeway`: bounds (speed, distance, acceleration and current of a motion) and the known facts about the drive. Values
are drawn within it and within the risks; no draw is thrown away. A bound narrows only its own fields. If a field uses all
values of its bits, `beyond` is empty and `outside` draws nothing.

    @given(strategies.requests(dialect, {Risk.READ, Risk.MOTION}, Leeway(Bounds(speed=300, turns=2))))
    def test_mine(request):
        probe.ask(request.command, request.values, form=request.form)

Numbers are integers as sent, as everywhere in the catalogue. Links and the behaviour of drives are unknown here.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy

from analyzer.catalogue import Command, Dialect, Form, MotionKind, Risk
from analyzer.layout import Field, FieldKind, Layout
from conformance.gate.bounds import NO_BOUNDS, Bounds, Leeway, Span, never_within
from conformance.model.limits import allowed, beyond, edges, forbidden, reserved_masks, with_bits

__all__ = [
    "NO_BOUNDS",
    "Bounds",
    "Leeway",
    "Request",
    "Stray",
    "beyond",
    "edges",
    "inside",
    "layouts",
    "outside",
    "packages",
    "request",
    "requests",
    "reserved_masks",
    "reserved_set",
    "strays",
    "with_bits",
]

#: The longest bytes that are drawn for a field without a length.
_LONGEST = 64


class Request(NamedTuple):
    """A request to draw from. `values`: integers as sent, of all fields of `form`."""

    command: Command
    form: Form
    values: dict[str, Any]


class Stray(NamedTuple):
    """Values of a layout of which one, `field`, is outside its limits."""

    field: str
    values: dict[str, Any]


# --- fields -----------------------------------------------------------------------------------------------------------


def inside(field: Field, leeway: Leeway = NO_BOUNDS) -> SearchStrategy[Any]:
    """Draw a value that the manual allows, the limits more often than others."""
    return _from(allowed(field, leeway), field)


def outside(field: Field) -> SearchStrategy[int]:
    """Draw a value that the manual forbids and the bits can hold; nothing where there is none."""
    return _from(forbidden(field), field)


# --- layouts ----------------------------------------------------------------------------------------------------------


def layouts(layout: Layout, leeway: Leeway = NO_BOUNDS) -> SearchStrategy[dict[str, Any]]:
    """Draw values of a layout, all of them allowed."""
    return st.fixed_dictionaries({name: inside(field, leeway) for name, field in layout.named.items()})


def strays(layout: Layout, leeway: Leeway = NO_BOUNDS) -> SearchStrategy[Stray]:
    """Draw values of a layout of which exactly one is forbidden; nothing where all bits are used."""
    wrong = [name for name, field in layout.named.items() if beyond(field)]
    return st.one_of([_stray(layout, name, leeway) for name in wrong]) if wrong else st.nothing()


def _stray(layout: Layout, name: str, leeway: Leeway) -> SearchStrategy[Stray]:
    drawn = {n: outside(f) if n == name else inside(f, leeway) for n, f in layout.named.items()}
    return st.fixed_dictionaries(drawn).map(lambda values: Stray(name, values))


def reserved_set(layout: Layout) -> SearchStrategy[bytes]:
    """Draw data of a layout, all named values allowed and some reserved bits set; nothing where none are reserved."""
    masks = reserved_masks(layout)
    if not masks:
        return st.nothing()
    drawn = st.lists(st.sampled_from(masks), min_size=1, unique=True).map(sum)
    return st.builds(lambda values, mask: with_bits(layout, values, mask), layouts(layout), drawn)


# --- requests ---------------------------------------------------------------------------------------------------------


def requests(
    dialect: Dialect, risks: Collection[Risk], leeway: Leeway = NO_BOUNDS, *, commands: Collection[str] | None = None
) -> SearchStrategy[Request]:
    """Draw requests of a dialect with allowed values, every risk of which is among `risks`.

    `commands`: only these, by name. Packages are left out (see `packages`). Draws nothing where nothing is allowed.
    """
    leeway = replace(leeway, dialect=dialect)
    chosen = [c for c in dialect.commands if c.slots is None and (commands is None or c.name in commands)]
    drawn = [s for c in chosen for s in (request(c, f, risks, leeway) for f in c.request_forms) if s is not None]
    return st.one_of(drawn) if drawn else st.nothing()


def request(
    command: Command, form: Form, risks: Collection[Risk], leeway: Leeway = NO_BOUNDS
) -> SearchStrategy[Request] | None:
    """Return the strategy of one form of a request, None where no values of it are allowed."""
    open_ended = any(f.kind is FieldKind.BYTES for f in form.layout.named.values())
    closed = [rule for rule in command.risk if not rule.risks <= {*risks, Risk.READ}]
    if open_ended or any(not rule.field for rule in closed) or never_within(command, form, leeway.bounds):
        return None
    reserved = _values_of_other_forms(command, form)
    drawn: dict[str, SearchStrategy[Any]] = {}
    for name, field in form.layout.named.items():
        without = [(rule.low, rule.high) for rule in closed if rule.field == name]
        runs = command.motion is not None and command.motion.kind is MotionKind.RUN and name == command.motion.speed
        if runs and leeway.bounds.turns is not None:
            without.append((0, 0))  # a run that does not turn: to the gate, one whose end is not known
        left = allowed(field, leeway, [*without, *((v, v) for v in reserved.get(name, ()))], command)
        if not left:
            return None
        drawn[name] = _from(left, field)
    if any(rule.field not in drawn for rule in closed):
        return None  # a rule about a field that this form does not have counts as the worst case
    return st.fixed_dictionaries(drawn).map(lambda values: Request(command, form, values))


def packages(
    dialect: Dialect, risks: Collection[Risk], leeway: Leeway = NO_BOUNDS, *, addresses: Sequence[int] = (1,)
) -> SearchStrategy[Request]:
    """Draw packages whose slots hold requests to these addresses, at most one slot for each."""
    package = next((c for c in dialect.commands if c.slots is not None), None)
    if package is None or package.slots is None:
        return st.nothing()
    size = package.slots.size - 2
    fitting = {
        c.name for c in dialect.commands if c.slots is None and all(f.layout.byte_length <= size for f in c.request_forms)
    }
    slot = requests(dialect, risks, leeway, commands=fitting)
    places = st.lists(st.sampled_from(addresses), unique=True, min_size=1, max_size=package.slots.count)
    form, command = package.request_forms[0], package

    def packed(places: list[int], asked: list[Request]) -> Request:
        slots = [{"address": a, "command": r.command.name, **r.values} for a, r in zip(places, asked, strict=False)]
        return Request(command, form, {"slots": slots})

    count = package.slots.count
    return st.builds(packed, places, st.lists(slot, min_size=count, max_size=count))


def _values_of_other_forms(command: Command, form: Form) -> dict[str, set[int]]:
    """Return the values by which earlier forms of a command are known: with these the data would be one of them."""
    found: dict[str, set[int]] = {}
    for other in command.request_forms:
        if other is form:
            break
        for name, field in other.layout.named.items():
            mine = form.layout.named.get(name)
            if field.fixed is not None and mine is not None and mine.fixed is None:
                found.setdefault(name, set()).add(field.fixed)
    return found


def _from(spans: Sequence[Span], field: Field) -> SearchStrategy[Any]:
    """Draw from spans of values, their ends more often than values between."""
    if field.kind is FieldKind.BYTES:
        return st.binary(max_size=_LONGEST)
    if not spans:
        return st.nothing()
    ends = sorted({end for each in spans for end in each})
    wide = [st.integers(low, high) for low, high in spans if high - low > 1]
    return st.one_of(st.sampled_from(ends), *wide) if wide else st.sampled_from(ends)
