"""The encoder: a command with values becomes the bytes of its frame.

    build(dialect, "run_speed", 1, {"speed": 320})      FA 01 F6 01 40 00 32

Rules kept here:
- `build` refuses only what cannot be bytes: a value too large for its bits, a name the command does not have. What the
  manual forbids is told by `refusals`, before anything is built.
- A form is chosen by the names and values given: the first that has all the names and none of whose fixed fields is
  given another value. Forms of a refusal come last, so that a reply built from nothing is a good one. A reply that only
  answers a request of certain values (a parameter read) is also chosen by those values.
- A package takes `slots`: a list of objects with `address`, `command` and that command's fields, as decoding yields them.

On CAN the result is the data bytes; the link makes the identifier from the address (`Built.can_id`).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from analyzer.catalogue import Command, Dialect, Form, MotionKind, Risk, Role, all_fields
from analyzer.codec import codec
from analyzer.dialects import find_command
from analyzer.errors import UsageError
from analyzer.layout import Field
from analyzer.records import CanFrame
from analyzer.values import counted, near, parse_value, quote, range_text, refusal, value_text

__all__ = ["Built", "address_refusal", "assemble", "build", "choose_form", "parse_value", "refusals"]

#: A value for a field: the integer as sent, bytes, or a text as people write it.
Value = int | bytes | str

#: Words of a slot that are no fields.
_SLOT_WORDS = frozenset({"address", "command", "code"})
#: The words by which a package's values are given.
SLOTS = "slots"


@dataclass(frozen=True)
class Built:
    """A frame and what it is made of.

    `can_id`: the identifier of a CAN frame, else None. `values`: integers as sent, of all fields. `refusals`: what the manual
    forbids. `filled`: fields that were left out and took the default that the manual states, as texts.
    """

    frame: bytes
    can_id: int | None
    command: Command
    form: Form
    role: Role
    address: int
    values: Mapping[str, Any]
    risks: frozenset[Risk]
    refusals: tuple[str, ...]
    filled: Mapping[str, str] = field(default_factory=dict)

    def item(self, frame: bytes | None = None) -> bytes | CanFrame:
        """Return the frame, or other bytes in its place, as a bus carries it: on CAN with the identifier."""
        data = self.frame if frame is None else frame
        return data if self.can_id is None else CanFrame(None, "bus", self.can_id, data)


def build(
    dialect: Dialect,
    command: Command | str,
    address: int,
    values: Mapping[str, Any] | None = None,
    role: Role = Role.REQUEST,
    form: Form | str | None = None,
    *,
    physical: bool = False,
) -> bytes:
    """Return the bytes of a frame with its check; on CAN its data bytes.

    `values`: integers as sent, or texts as people write them; `physical`: numbers are in the unit of their field.
    Fields left out take their default or 0. Raises UsageError for a name that is none or a value that its bits cannot hold.
    """
    return assemble(dialect, command, address, values, role, form, physical=physical).frame


def assemble(
    dialect: Dialect,
    command: Command | str,
    address: int,
    values: Mapping[str, Any] | None = None,
    role: Role = Role.REQUEST,
    form: Form | str | None = None,
    *,
    physical: bool = False,
    complete: bool = False,
) -> Built:
    """Build as `build` does, and return with the frame what it is made of and what the manual forbids in it.

    `complete`: that a field of a request was left out for which the manual states no default is forbidden too.
    """
    if isinstance(command, str):
        command = find_command(dialect, command)
    forbidden = [*address_refusal(dialect, address)]
    values = {} if values is None else values
    if command.slots is not None and SLOTS in values:
        form = command.request_forms[0]
        if len(values) > 1 or role is not Role.REQUEST:
            raise UsageError(f"{command.name}: expected {SLOTS} alone, in a request")
        data, slots, told = _package(dialect, command, values[SLOTS], physical, complete)
        risks, shown = frozenset[Risk]().union(*(slot.risks for slot in slots)), values
        filled = {f"slot {n} {name}": text for n, slot in enumerate(slots, 1) for name, text in slot.filled.items()}
        forbidden = told
    else:
        form, sent = choose_form(command, role, values, form, physical=physical)
        filled, missing = _left_out(command, form, sent) if complete and role is Role.REQUEST else ({}, [])
        data = _encode(form, sent)
        shown = codec(form.layout).wire(data)
        forbidden += [*refusals(command, form, data), *missing]
        risks = command.risks(shown) if role is Role.REQUEST else frozenset()
    head_limit = max(dialect.addresses[1], 0xFF if dialect.bus == "serial" else 0)
    if not 0 <= address <= head_limit:
        raise UsageError(f"address {address} does not fit the frame, expected 0..{head_limit}")
    frame = dialect.link.build(command, form, address, data, role)
    can_id = dialect.link.identifier(command, address)
    return Built(frame, can_id, command, form, role, address, shown, risks, tuple(forbidden), filled)


# --- what the manual allows -------------------------------------------------------------------------------------------


def address_refusal(dialect: Dialect, address: int) -> Iterable[str]:
    """Yield why no drive of a dialect can be addressed so, if that is the case."""
    first, last = dialect.addresses
    if not first <= address <= last and address != dialect.broadcast:
        everyone = "" if dialect.broadcast is None else f", or {dialect.broadcast} for all"
        yield f"address: got {address}, expected {first}..{last}{everyone}"


def refusals(command: Command, form: Form, data: bytes) -> list[str]:
    """Return what in the data of a form the manual forbids, each by the name of its field."""
    values = codec(form.layout).wire(data)
    found = [text for name, field in form.layout.named.items() if (text := refusal(field, values[name]))]
    if command.slots is not None and len(data) != command.slots.count * command.slots.size:
        found.append(f"{command.name}: got {len(data)} bytes, expected {command.slots.count * command.slots.size}")
    return found


# --- one form ---------------------------------------------------------------------------------------------------------


def choose_form(
    command: Command, role: Role, values: Mapping[str, Value], form: Form | str | None = None, *, physical: bool = False
) -> tuple[Form, dict[str, int | bytes]]:
    """Return the form that fits the names and values given, and the values as sent.

    Raises UsageError where there is none.
    """
    forms = _ordered(command, role, form)
    named = [f for f in forms if values.keys() <= f.layout.named.keys() | (f.request_values or {}).keys()]
    if not named:
        raise UsageError(_strange(command, role, forms, values.keys()))
    problem: UsageError | None = None
    found: list[tuple[Form, dict[str, int | bytes]]] = []
    for candidate in named:
        try:
            sent = _all_sent(command, candidate, values, physical)
        except UsageError as error:
            problem = problem or error
            continue
        if sent is not None and (len(named) == 1 or not _contradicted(candidate, sent)):
            return candidate, sent
        found += [] if sent is None else [(candidate, sent)]
    if problem is not None or not found:
        raise problem or UsageError(f"{command.name} has no {role} for these values")
    return found[0]


def _all_sent(command: Command, form: Form, values: Mapping[str, Value], physical: bool) -> dict[str, int | bytes] | None:
    """Return the values of a form as sent, or None if the form answers a request of other values than those given."""
    sent: dict[str, int | bytes] = {}
    for name, value in values.items():
        field = form.layout.named.get(name)
        if field is not None:
            sent[name] = _sent(field, value, physical)
        elif _sent(all_fields(command.request_forms)[name], value, physical) != (form.request_values or {})[name]:
            return None
    return sent


def _left_out(command: Command, form: Form, sent: Mapping[str, int | bytes]) -> tuple[dict[str, str], list[str]]:
    """Return the fields that were left out: those that have a default, with it, and why the others must be given."""
    left = [f for name, f in form.layout.named.items() if f.fixed is None and f.bit_width and name not in sent]
    if command.motion is not None and command.motion.kind is MotionKind.STOP:
        # A stop must not wait for words: 0 stops at once.
        return {f.name: value_text(f, f.default or 0) for f in left}, []
    missing = [f"{f.name} ({range_text(f, 6)})" for f in left if f.default is None]
    told = [f"{command.name} needs {', '.join(missing)}: the manual states no default"] * bool(missing)
    return {f.name: value_text(f, f.default) for f in left if f.default is not None}, told


def _contradicted(form: Form, sent: Mapping[str, int | bytes]) -> bool:
    """Say whether a value differs from that which makes the layout what it is."""
    return any(f.fixed is not None and sent.get(n, f.fixed) != f.fixed for n, f in form.layout.named.items())


def _ordered(command: Command, role: Role, form: Form | str | None) -> tuple[Form, ...]:
    if isinstance(form, Form):
        return (form,)
    forms = command.reply_forms if role is Role.REPLY else command.request_forms
    if not forms:
        raise UsageError(f"{command.name} has no {role}")
    if form is not None:
        chosen = tuple(f for f in forms if f.name == form)
        if not chosen:
            names = [f.name for f in forms]
            raise UsageError(f"{command.name} has no form {quote(form)}, expected {' or '.join(names)}")
        return chosen
    return tuple(sorted(forms, key=lambda f: f.name in command.replies.failed_forms))


def _strange(command: Command, role: Role, forms: Sequence[Form], names: Collection[str]) -> str:
    known = list(dict.fromkeys(n for f in forms for n in f.layout.named))
    strange = [n for n in names if n not in known]
    if not strange:
        return f"{command.name}: no form of its {role} has {', '.join(names)} together"
    listed = f"; it has {', '.join(known)}" if known else "; it takes none"
    return f"the {role} of {command.name} has no field {quote(strange[0])}{near(strange[0], known) or listed}"


def _sent(field: Field, value: Any, physical: bool) -> int | bytes:
    if isinstance(value, str):
        return parse_value(field, value, as_sent=not physical)
    if isinstance(value, bytes):
        return value
    return field.wire(value) if physical else int(value)


def _encode(form: Form, sent: Mapping[str, int | bytes]) -> bytes:
    try:
        return codec(form.layout).encode(sent)
    except ValueError as error:
        raise UsageError(str(error)) from None


# --- packages ---------------------------------------------------------------------------------------------------------


def _package(
    dialect: Dialect, package: Command, slots: Sequence[Mapping[str, Any]], physical: bool, complete: bool
) -> tuple[bytes, list[Built], list[str]]:
    """Return the data of a package, what its slots hold, and what the manual forbids in them."""
    assert package.slots is not None
    count, size = package.slots.count, package.slots.size
    if len(slots) > count:
        raise UsageError(f"{package.name}: got {len(slots)} slots, expected at most {count}")
    data, made, forbidden = b"", list[Built](), list[str]()
    seen: set[int] = set()
    for number, slot in enumerate(slots, 1):
        command = find_command(dialect, str(slot["command"]))
        if command.slots is not None:
            raise UsageError(f"slot {number}: {command.name} cannot stand in a slot")
        address = int(slot["address"])
        values = {n: v for n, v in slot.items() if n not in _SLOT_WORDS}
        try:
            built = assemble(dialect, command, address, values, physical=physical, complete=complete)
        except UsageError as error:
            raise UsageError(f"slot {number}: {error}") from None
        body = _encode(built.form, built.values)
        raw = bytes((address, command.code if built.form.code is None else built.form.code)) + body
        if len(raw) > size:
            raise UsageError(f"slot {number}: {command.name} has {counted(len(raw), 'byte')}, expected at most {size}")
        forbidden += [f"slot {number}: {text}" for text in built.refusals]
        if address in seen:
            forbidden.append(f"slot {number}: address {address} again; of two slots for one only the first is executed")
        seen.add(address)
        made.append(built)
        data += raw.ljust(size, b"\0")
    return data.ljust(count * size, b"\0"), made, forbidden
