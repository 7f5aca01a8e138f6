"""What is known of a port at a moment: open requests, groups, who speaks what.

Transactions write here; the framer and the decoder read. It holds no rules: what a reply means stands in
`analyzer.transactions`, what is wrong in `analyzer.findings`.
"""

from __future__ import annotations

from collections import deque
from enum import StrEnum

from analyzer.catalogue import Command, Form, Role
from analyzer.codec import codec
from analyzer.link import READS, read_bytes
from analyzer.records import Frame, Lane, Message


class State(StrEnum):
    """Where a request stands."""

    WAITING = "waiting"
    RUNNING = "running"
    DONE = "done"


class RequestOutcome(StrEnum):
    """How a request ended."""

    OPEN = "open"
    ANSWERED = "answered"
    FAILED = "failed"
    REFUSED = "refused"
    UNANSWERED = "unanswered"
    RETRIED = "retried"
    SUPERSEDED = "superseded"
    SILENT = "silent"


class Request:
    """A request that was seen, and how far it got.

    The message is built when it is asked for, from what the request was opened with: a message, or a lane and a frame.
    """

    # Of the many requests of a capture most end as they began: what seldom changes stands here and not in each.
    state = State.WAITING
    outcome = RequestOutcome.OPEN
    lane: Lane | None = None
    gave_up = ""
    _message: Message | None = None

    def __init__(self, frame: Frame, address: int, command: Command | None, sequence: int, topic: str) -> None:
        self.frame = frame
        self.address = address
        self.command = command
        self.sequence = sequence
        self.topic = topic
        self.t_ns = frame.last_ns

    @classmethod
    def of(cls, message: Message, sequence: int, topic: str) -> Request:
        """Return the request of a message."""
        request = cls(message.frame, message.address, message.command, sequence, topic)
        request._message = message
        return request

    @property
    def message(self) -> Message:
        """The message of the request."""
        if self._message is None:
            assert self.lane is not None  # a request has a message or a lane
            self._message = self.lane.message(self.frame)
        return self._message


class Context:
    """The state of one port.

    `groups`: addresses that several drives listen to and none answers. `silenced`: addresses whose motion commands are
    not answered (respond = 0). `passive`: addresses that send no completion (active = 0). `speaks`: the dialect of the
    last reply of an address.
    """

    def __init__(self, groups: frozenset[int] = frozenset()) -> None:
        self.groups: set[int] = set(groups)
        self.silenced: set[int] = set()
        self.passive: set[int] = set()
        self.speaks: dict[int, str] = {}
        self.open: dict[int, list[Request]] = {}
        #: Requests given up without a reply, for replies that come after all.
        self.unanswered: deque[Request] = deque(maxlen=16)
        #: Moves that a newer one took the place of; if that one was refused, they end after all.
        self.superseded: deque[Request] = deque(maxlen=8)
        #: Requests to all, newest last.
        self.broadcasts: deque[Request] = deque(maxlen=8)
        self.last_request: Request | None = None
        #: Open requests whose replies carry another command's code.
        self.borrowed = 0
        self.echoes = 0

    def expects(self, address: int, function: int) -> int:
        """Return the data bytes of the Modbus read reply that an open request awaits, 0 for none."""
        if function not in READS:
            return 0
        # The newest: an earlier one that still waits was not answered.
        for request in reversed(self.open.get(address, [])):
            command = request.command
            if command is not None and command.function == function and request.state is State.WAITING:
                quantity: int = request.message.values.get("quantity", command.quantity) or command.quantity
                return read_bytes(function, quantity)
        return 0

    def asked(
        self, dialect: str, address: int, function: int | None, code: int | None, data: bytes
    ) -> tuple[Request, Form] | None:
        """Return the open request that these reply data answer, with the form they have; the oldest first."""
        for request in self.open.get(address, ()):
            if request.frame.dialect.name != dialect:
                continue
            form = answers(request, function, code, data)
            if form is not None:
                return request, form
        return None


def answers(request: Request, function: int | None, code: int | None, data: bytes) -> Form | None:
    """Return the form by which reply data answer a request, or None."""
    command = request.command
    if command is None or command.function != function:
        return None
    for form in command.reply_forms:
        own = command.code if form.code is None else form.code
        if code is not None and own != code:
            continue
        wanted = form.request_values
        if wanted and any(request.message.values.get(n) != v for n, v in wanted.items()):
            continue
        if codec(form.layout).matches(request.message.data + data if form.after_request else data):
            return form
    return None


def is_request(role: Role) -> bool:
    """Say whether a role is the host's."""
    return role is Role.REQUEST
