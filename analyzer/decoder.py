"""The decoder: a frame becomes a message. Unknown codes and bad values survive; nothing raises.

The first of these that says it tells the sender of a frame: its head, the capture's mark, the length of its data, its
values, the open requests. Without a context the sender may stay `unknown`. The open request decides a reply's command and form.
Without an open request the first form that fits is taken.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from analyzer.catalogue import Command, Dialect, Form, Role
from analyzer.codec import Codec, Violation, codec
from analyzer.context import Context, Request, State
from analyzer.link import EXTENDED_ID, Head
from analyzer.records import Frame, Lane, Message

#: Heads of frames that are known to have no lane; of more, each frame is looked at anew.
_MOST_HEADS = 1 << 16

_Entry = tuple[Command, Form, Codec]
#: By function and code.
_Entries = dict[tuple[int | None, int], list[_Entry]]


class Slot(NamedTuple):
    """One used slot of a package: a request of its own. `command` None: the code is not in the catalogue."""

    address: int
    code: int
    command: Command | None
    form: Form | None
    data: bytes
    violations: tuple[Violation, ...]


def _entries(dialect: Dialect) -> tuple[_Entries, _Entries]:
    """Return the forms of requests and of replies; worked out once, and kept with the dialect."""
    kept: tuple[_Entries, _Entries] | None = dialect.__dict__.get("_entries")
    if kept is None:
        kept = dialect.__dict__["_entries"] = {}, {}
        for command in dialect.commands:
            for form in command.request_forms:
                _add(kept[0], command, form)
            for form in command.reply_forms:
                _add(kept[1], command, form)
    return kept


def _add(table: _Entries, command: Command, form: Form) -> None:
    code = command.code if form.code is None else form.code
    table.setdefault((command.function, code), []).append((command, form, codec(form.layout)))


class Decoder:
    """Decodes the frames of one dialect (as one model speaks it, if `Dialect.for_model` was used)."""

    def __init__(self, dialect: Dialect) -> None:
        self.dialect = dialect
        self._link = dialect.link
        self._head_bytes = dialect.link.deciding_bytes
        #: By head and length; None: such frames have no lane.
        self._lanes: dict[tuple[bytes | int, int, int], Lane | tuple[Lane, Lane] | _Several | None] = {}
        self._requests, self._replies = _entries(dialect)

    def decode(self, frame: Frame, context: Context | None = None) -> tuple[Message, Request | None]:
        """Return the message of a frame, and the open request that it answers if it is a reply to one."""
        can = frame.can
        can_id = None if can is None else can.id | EXTENDED_ID if can.extended else can.id
        head = self._link.parse(frame.data, can_id)
        data = frame.data[head.start : head.stop]
        role = head.role
        if role is Role.UNKNOWN:
            role = frame.role if frame.role is not Role.UNKNOWN else self._role(head, data, context)
        if role is Role.REPLY:
            return self._reply(frame, head, data, context)
        return self._request(frame, role, head, data), None

    def lane(self, frame: Frame, context: Context) -> Lane | None:
        """Return the lane of a frame, or None if it must be looked at more closely.

        While a request is open whose reply carries another command's code, the caller must not use it.
        """
        data, can = frame.data, frame.can
        size = len(data)
        width = self._head_bytes or self._link.deciding(data)
        if not width:
            return None
        key = (data[:width], size, 0) if can is None else (can.id, size, data[0] if size else 0)
        try:
            lane = self._lanes[key]
        except KeyError:
            lane = self._new_lane(frame)
            if lane is not None or len(self._lanes) < _MOST_HEADS:
                self._lanes[key] = lane
        if lane is None or lane.__class__ is Lane:
            return lane
        return lane.choose(data, context) if isinstance(lane, _Several) else _chosen(lane, data, context)  # type: ignore[arg-type]

    def lanes(self, frame: Frame) -> tuple[Lane, ...]:
        """Return every lane that frames of this head and length can have; none if each must be looked at."""
        found = self._new_lane(frame)
        if found is None or isinstance(found, Lane):
            return () if found is None else (found,)
        return found if isinstance(found, tuple) else found.lanes

    def _asked_lanes(self, frame: Frame) -> Iterator[Lane]:
        """Yield the lanes of frames of which a reply tells what it is only together with its request, right before it."""
        head = self._link.parse(frame.data)
        size, is_request = head.stop - head.start, head.role is Role.REQUEST
        if head.role is Role.UNKNOWN or head.exception is not None or (is_request and head.code is None):
            return
        tables = self._requests if is_request else self._replies
        for (function, code), entries in tables.items():
            if function != head.function or head.code not in (None, code):
                continue
            for command, form, _ in entries:
                if not form.layout.fits(size):
                    continue
                odd = form.layout.open_ended or command.slots is not None or (is_request and not _asks_all(command, head))
                if odd or form.request_values:
                    # Not told here: nor are those behind it, for the first that fits counts.
                    break
                yield Lane(self.dialect, head.role, head.address, command, form, head.start, head.stop)

    def _new_lane(self, frame: Frame) -> Lane | tuple[Lane, Lane] | _Several | None:
        """Return the lane of frames like this, or those that are chosen from.

        That is a request's and a reply's, where the two look alike; or those of several commands, of which a request's values
        or the open request tell the one.
        """
        if not self._head_bytes:
            asked = tuple(self._asked_lanes(frame))
            return _Several(asked) if asked else None
        head = self._link.parse(frame.data, frame.can.id if frame.can is not None else None)
        if head.code is None or head.exception is not None or head.quantity is not None:
            return None
        size = head.stop - head.start
        tables = {Role.REQUEST: self._requests, Role.REPLY: self._replies}
        fitting = [
            (role, entry)
            for role, table in tables.items()
            if head.role in (role, Role.UNKNOWN)
            for entry in table.get((head.function, head.code), ())
            if entry[1].layout.fits(size) and not (entry[1].needs_request and entry[1].code is not None)
        ]
        lanes = []
        for role, (command, form, _) in fitting:
            if command.slots is not None or form.layout.open_ended:
                return None
            lanes.append(Lane(self.dialect, role, head.address, command, form, head.start, head.stop))
        chosen = any(coder.fixed or form.needs_request for _, (_, form, coder) in fitting)
        if len(lanes) == 1 and not chosen:
            return lanes[0]
        if lanes and len({role for role, _ in fitting}) == 1:
            return _Several(tuple(lanes))
        if chosen:
            return None
        alike = len(lanes) == 2 and lanes[0].is_request and not lanes[1].is_request
        return (lanes[0], lanes[1]) if alike else None

    # --- who sent it ----------------------------------------------------------------------------------------------

    def _role(self, head: Head, data: bytes, context: Context | None) -> Role:
        if head.code is None:
            return self._role_by_requests(head, context)
        key = (head.function, head.code)
        request = _first(self._requests.get(key, ()), data)
        reply = self._any_reply(key, head, data, context)
        if request is None and reply is None:
            return self._role_of_unknown(head, context)
        if reply is None:
            return Role.REQUEST
        if request is None or reply[1].needs_request:
            # A form that needs an open request was only found because that request is open.
            return Role.REPLY
        request_valid, reply_valid = request[2].valid(data), reply[2].valid(data)
        if request_valid != reply_valid:
            return Role.REQUEST if request_valid else Role.REPLY
        return self._role_by_requests(head, context, data)

    def _any_reply(self, key: tuple[int | None, int], head: Head, data: bytes, context: Context | None) -> _Entry | None:
        """Return the reply that an open request awaits, else a reply that fits and needs none."""
        asked = None
        if context is not None:
            asked = context.asked(self.dialect.name, head.address, head.function, head.code, data)
        if asked is not None and asked[0].command is not None:
            return asked[0].command, asked[1], codec(asked[1].layout)
        for command, form, coder in self._replies.get(key, ()):
            if coder.matches(data) and not form.needs_request:
                return command, form, coder
        return None

    def _role_by_requests(self, head: Head, context: Context | None, data: bytes = b"") -> Role:
        if context is None:
            return Role.UNKNOWN
        if head.code is None:
            return Role.REPLY if self._same_function(head, context) else Role.REQUEST
        asked = context.asked(self.dialect.name, head.address, head.function, head.code, data)
        return Role.REPLY if asked is not None else Role.REQUEST

    def _role_of_unknown(self, head: Head, context: Context | None) -> Role:
        """Tell the role of a frame whose code or length is not catalogued, where an open request of its code says."""
        if context is None:
            return Role.UNKNOWN
        if any(self._is_of(head, request) for request in context.open.get(head.address, ())):
            return Role.REPLY
        known = (head.function, head.code) in self._requests or (head.function, head.code) in self._replies
        return Role.REQUEST if known else Role.UNKNOWN

    # --- what it says ---------------------------------------------------------------------------------------------

    def _request(self, frame: Frame, role: Role, head: Head, data: bytes) -> Message:
        key = (head.function, -1 if head.code is None else head.code)
        entry = _first(self._requests.get(key, ()), data)
        if entry is None and role is Role.UNKNOWN:
            entry = _first(self._replies.get(key, ()), data)
        if entry is None:
            return self._unfitting(frame, role, head, data, self._requests.get(key, []), request=True)
        command, form, coder = entry
        violations = coder.broken(data)
        if command.quantity and head.quantity is not None and head.quantity != command.quantity:
            text = f"quantity: expected {command.quantity} registers, got {head.quantity}"
            violations += (Violation("wrong_length", text, "quantity"),)
        if command.slots is not None:
            for number, slot in enumerate(slots_of(self.dialect, command, data), 1):
                violations += tuple(Violation(v.rule, f"slot {number}: {v.text}", v.field) for v in slot.violations)
            expected = command.slots.count * command.slots.size
            if len(data) != expected:
                text = f"package of {len(data)} bytes in its slots, expected {expected}: zeros were lost"
                violations += (Violation("short_package", text),)
        return Message(frame, role, head.address, command, form, data, violations)

    def _reply(self, frame: Frame, head: Head, data: bytes, context: Context | None) -> tuple[Message, Request | None]:
        request, entry = self._asked(head, data, context)
        if head.exception is not None and self.dialect.exception is not None:
            command = request.command if request else self.dialect.fallbacks.get(head.function or 0)
            form = self.dialect.exception
            coder = codec(form.layout)
            if coder.matches(data):
                return Message(frame, Role.REPLY, head.address, command, form, data, coder.broken(data)), request
        if entry is None and head.code is not None:
            candidates = self._replies.get((head.function, head.code), ())
            entry = next((e for e in candidates if not e[1].needs_request and e[2].matches(data)), None)
        if entry is None:
            known = self._replies.get((head.function, -1 if head.code is None else head.code), [])
            fits = request if request is not None and request.command and not self._is_general(request.command) else None
            return self._unfitting(frame, Role.REPLY, head, data, known, request=False, asked=fits), request
        command, form, coder = entry
        if form.after_request and request is not None:
            data = request.message.data + data
        elif self._is_general(command):
            # Its own data begin after the function.
            data = frame.data[2 : head.stop]
        message = Message(frame, Role.REPLY, head.address, command, form, data, coder.broken(data))
        return message, request

    def _asked(self, head: Head, data: bytes, context: Context | None) -> tuple[Request | None, _Entry | None]:
        """Return the open request that a reply answers, and the entry by which it does; either may be None."""
        if context is None:
            return None, None
        if head.exception is None:
            found = context.asked(self.dialect.name, head.address, head.function, head.code, data)
            if found is not None:
                request, form = found
                command = request.command
                assert command is not None  # answers() found its form
                return request, (command, form, codec(form.layout))
        if head.code is None:
            return self._same_function(head, context), None
        return next((each for each in context.open.get(head.address, ()) if self._is_of(head, each)), None), None

    def _is_of(self, head: Head, request: Request) -> bool:
        """Say whether a frame has the function and the code of an open request."""
        command = request.command
        if command is None or command.function != head.function:
            return False
        # A write to a register that the manual does not list is answered with the same register.
        general = self._is_general(command) and request.state is State.WAITING
        return head.code == (self._link.parse(request.frame.data).code if general else command.code)

    def _is_general(self, command: Command) -> bool:
        """Say whether a command stands for all that the manual does not list."""
        return command is self.dialect.fallbacks.get(command.function or 0)

    def _same_function(self, head: Head, context: Context) -> Request | None:
        """Return the oldest request that waits for a reply of this function, which carries no register."""
        for request in context.open.get(head.address, ()):
            waits = request.state is State.WAITING and request.frame.dialect.name == self.dialect.name
            if waits and self._link.parse(request.frame.data).function == head.function:
                return request
        return None

    def _unfitting(
        self,
        frame: Frame,
        role: Role,
        head: Head,
        data: bytes,
        known: list[_Entry],
        *,
        request: bool,
        asked: Request | None = None,
    ) -> Message:
        """Return the message of a frame that fits no form: the length is wrong, or the code is not catalogued."""
        violations: tuple[Violation, ...]
        # What a reply says only behind its request, it does not say alone.
        alone = asked is None and any(form.after_request for _, form, _ in known)
        known = [] if alone else known
        # If commands share a code, the one without fixed fields stands for the code.
        general = next((entry for entry in known if not entry[2].fixed), known[0] if known else None)
        command = general[0] if general else (asked.command if asked else None)
        if command is not None:
            forms = command.request_forms if request else command.reply_forms
            sizes = sorted({f.layout.byte_length for f in forms})
            text = f"{command.name} {role}: expected {_either(sizes)} bytes of data, got {len(data)}"
            violations = (_misfit(forms, data, asked) or Violation("wrong_length", text),)
            if not forms:
                violations = (Violation("wrong_length", f"{command.name} has no {role}, got {len(data)} bytes"),)
        elif head.code is not None and not alone:
            shown = f"0x{head.code:04X}" if head.function is not None else f"0x{head.code:02X}"
            where = f" of function 0x{head.function:02X}" if head.function is not None else ""
            violations = (Violation("unknown_command", f"{shown}{where} is not in the catalogue"),)
        else:
            text = f"function 0x{head.function or 0:02X}: no request of it is open"
            violations = (Violation("unknown_command", text),)
        fallback = self.dialect.fallbacks.get(head.function or 0)
        form: Form | None = None
        if fallback is not None and (command is None or role is Role.REPLY):
            body = frame.data[2 : head.stop]
            for candidate in fallback.request_forms if request else fallback.reply_forms:
                if codec(candidate.layout).matches(body):
                    form, data = candidate, body
                    command = command or fallback
                    break
        return Message(frame, role, head.address, command, form, data, violations)


# --- packages -----------------------------------------------------------------------------------------------------


def slots_of(dialect: Dialect, command: Command, data: bytes) -> list[Slot]:
    """Return the used slots of a package; a slot that is cut short counts as filled up with zeros."""
    assert command.slots is not None
    size = command.slots.size
    result = []
    for start in range(0, len(data), size):
        raw = data[start : start + size].ljust(size, b"\0")
        if any(raw):
            result.append(_slot(dialect, raw[0], raw[1], raw[2:]))
    return result


def _slot(dialect: Dialect, address: int, code: int, body: bytes) -> Slot:
    for command in dialect.by_code.get(code, ()):
        for form in command.request_forms:
            size, coder = form.layout.byte_length, codec(form.layout)
            if command.slots is None and coder.matches(body[:size]):
                violations = coder.broken(body[:size])
                if any(body[size:]):
                    got = body[size:].hex(" ").upper()
                    violations += (Violation("reserved_bits", f"expected zeros behind {command.name}, got {got}"),)
                return Slot(address, code, command, form, body[:size], violations)
    text = f"0x{code:02X} is not in the catalogue"
    return Slot(address, code, None, None, body, (Violation("unknown_command", text),))


def physical(message: Message) -> dict[str, Any]:
    """Return a message's fields in their units, with name twins; empty where no form fits."""
    if message.form is None:
        return {}
    if message.command is not None and message.command.slots is not None:
        slots = slots_of(message.frame.dialect, message.command, message.data)
        return {"slots": [slot_fields(slot) for slot in slots]}
    return codec(message.form.layout).physical(message.data)


def units_of(message: Message) -> dict[str, Any]:
    """Return the units of what `physical` returns, by name; of a package a list, under `slots`."""
    if message.form is None:
        return {}
    if message.command is not None and message.command.slots is not None:
        slots = slots_of(message.frame.dialect, message.command, message.data)
        return {"slots": [{} if slot.form is None else slot.form.layout.units for slot in slots]}
    return message.form.layout.units


def state_of(message: Message, shown: Mapping[str, Any]) -> dict[str, float]:
    """Return the quantities of the drive's state that a sound reply carries, in its units. `shown`: as by `physical`."""
    found: dict[str, float] = {}
    if message.form is not None and message.role is Role.REPLY and message.frame.checksum_ok and "slots" not in shown:
        for name, field in message.form.layout.named.items():
            if field.state is not None:
                found[field.state.quantity] = found.get(field.state.quantity, 0.0) + shown[name] * field.state.factor
    return found


def slot_fields(slot: Slot) -> dict[str, Any]:
    """Return one slot of a package as an object: address, command and the command's fields."""
    shown: dict[str, Any] = {"address": slot.address, "code": slot.code}
    if slot.command is not None and slot.form is not None:
        shown["command"] = slot.command.name
        shown.update(codec(slot.form.layout).physical(slot.data))
    else:
        shown["raw"] = slot.data.hex(" ").upper()
    return shown


class _Several:
    """Lanes of one role: of commands that share a code (run and stop), of values or of open requests that tell them apart."""

    def __init__(self, lanes: tuple[Lane, ...]) -> None:
        self.lanes = lanes
        self._first = lanes[0]
        self._of_command: dict[int, list[Lane]] = {}
        for lane in lanes:
            self._of_command.setdefault(id(lane.command), []).append(lane)

    def choose(self, data: bytes, context: Context) -> Lane | None:
        """Return the first lane whose layout fits; for replies, the lane that the drive's only open request awaits."""
        first = self._first
        lanes: Sequence[Lane] = self.lanes
        if not first.is_request:
            waiting = context.open.get(first.address)
            if waiting is None or len(waiting) != 1:
                return None
            lanes = self._of_command.get(id(waiting[0].command), ())
        own = data[first.start : first.stop]
        for lane in lanes:
            if lane.codec.matches(own):
                return lane
        return None


def _chosen(lanes: tuple[Lane, Lane], data: bytes, context: Context) -> Lane | None:
    """Tell a request from a reply where the two look alike, as far as it is plain: by the one open request."""
    request, reply = lanes
    own = data[request.start : request.stop]
    waiting = context.open.get(request.address)
    if not waiting:
        return request if request.valid(own) else None
    if len(waiting) == 1 and waiting[0].command is reply.command and reply.valid(own):
        return reply
    return None


def _misfit(forms: tuple[Form, ...], data: bytes, asked: Request | None) -> Violation | None:
    """Return why a reader cannot read data that are long enough: that says more than that no form fits."""
    for form in forms:
        whole = asked.message.data + data if form.after_request and asked is not None else data
        if form.layout.fits(len(whole)) and (misfit := codec(form.layout).misfit(whole)) is not None:
            return misfit
    return None


def _asks_all(command: Command, head: Head) -> bool:
    """Say whether a request asks for as much as the command has."""
    return not command.quantity or head.quantity in (None, command.quantity)


def _first(entries: list[_Entry] | tuple[_Entry, ...], data: bytes) -> _Entry | None:
    for entry in entries:
        if entry[2].matches(data):
            return entry
    return None


def _either(sizes: list[int]) -> str:
    return " or ".join(str(n) for n in sizes) or "no"
