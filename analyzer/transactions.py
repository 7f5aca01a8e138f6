"""Transactions: which reply belongs to which request, and what an exchange breaks.

Theory of operation. Each request that the manual lets a drive answer is open until it ends. A reply has a meaning by its
command's `Replies`: interim (it goes on), final, failed. The machine is one table:

    state     reply      next
    waiting   interim    running     (done, where the drive was told to send no completion)
    waiting   final      done
    waiting   failed     done
    running   interim    running     the same reply once more: a duplicate
    running   final      done
    running   failed     done

A drive answers in order, so a reply to a later request ends earlier ones as unanswered; on a half-duplex line the host
has then moved on for all drives. Of equal requests far apart the last is answered by what follows it. A newer motion
command supersedes one that runs. The same request again, with nothing between, is an echo when it comes at once and a retry
when it comes later.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, NamedTuple

import msgspec

from analyzer.catalogue import Command, Role
from analyzer.context import Context, Request, RequestOutcome, State, answers
from analyzer.findings import Issue
from analyzer.layout import Effect
from analyzer.records import Frame, Lane, Message, Severity

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

#: A request is given up for good after this many late limits.
GIVE_UP = 5
#: The same bytes again within this time are an echo: no host repeats a request so soon.
ECHO_NS = 3_000_000
#: A host that asks for the same after so long has given the first up: a reply right behind the last answers that.
APART_NS = 20_000_000
#: So many replies in a row that answer an earlier request are no chance.
BEHIND = 3
#: Open requests kept per address.
MOST_OPEN = 64

#: Meaning of a reply -> the state it leads to, from waiting and from running alike.
NEXT: dict[str, State] = {"interim": State.RUNNING, "final": State.DONE, "failed": State.DONE}


class Late(NamedTuple):
    """An issue about a request that was seen before."""

    request: Request
    issue: Issue


class Paired(msgspec.Struct, gc=False):
    """What a message is in its exchange. `first`: it is the first reply to its request."""

    request: Request | None = None
    latency_ns: int | None = None
    first: bool = False
    issues: tuple[Issue, ...] = ()
    earlier: tuple[Late, ...] = ()


class Transactions:
    """Pairs the messages of one port. `late_ns`: a first reply later than this is late; `timed` False: times say nothing."""

    #: What it knows of the traffic beside its context.
    STATE = ("_answers_motion", "_behind", "_check_ns", "_last", "_last_is_reply", "_last_reply", "_told_silent")

    def __init__(self, context: Context, *, late_ns: int = 1_000_000_000, half_duplex: bool = True, timed: bool = True) -> None:
        self.context = context
        self.late_ns = late_ns
        self.half_duplex = half_duplex
        self._timed = timed
        self._check_ns = 0
        self._last: Frame | None = None
        self._last_is_reply = False
        self._last_reply: dict[int, bytes] = {}
        self._answers_motion: set[int] = set()
        #: Replies in a row that answer an earlier request than the last one.
        self._behind = 0
        self._told_silent: set[int] = set()

    def _latency(self, frame: Frame, request: Request) -> int | None:
        """Return the time from a request to its reply; None where it is not known: both came in one read."""
        latency_ns = frame.first_ns - request.t_ns
        return latency_ns if self._timed and latency_ns > 0 else None

    def observe(self, message: Message, sequence: int, asked: Request | None, topic: str = "") -> Paired:
        """Take the next message of the port and return what it is; `asked` is what the decoder found it answers."""
        now = message.frame.last_ns
        earlier = self._expired(now) if now >= self._check_ns else ()
        if message.role is Role.REPLY:
            paired = self._reply(message, asked)
        elif message.role is Role.REQUEST or message.command is not None:
            paired = self._request(message, sequence, topic)
        else:
            paired = Paired()
        self._last = message.frame
        self._last_is_reply = message.role is Role.REPLY
        if earlier:
            paired.earlier = earlier + paired.earlier
        return paired

    def close(self) -> list[Late]:
        """End the capture: what still waits was not answered."""
        late = []
        for requests in list(self.context.open.values()):
            for request in list(requests):
                if request.state is State.WAITING:
                    is_last = request.frame is self._last
                    severity = Severity.INFO if is_last else None
                    why = "the capture ends here" if is_last else "no reply until the end of the capture"
                    late += self._give_up(request, RequestOutcome.UNANSWERED, why, severity)
        return late

    # --- the plain case -------------------------------------------------------------------------------------------

    def plain_request(self, lane: Lane, frame: Frame, sequence: int) -> bool:
        """Open a request that is nothing but a request; return False, with nothing done, if `observe` must look at it."""
        context, address, last = self.context, lane.address, self._last
        if (
            not lane.plain
            or frame.last_ns >= self._check_ns
            or (last is not None and last.data == frame.data)
            or address in context.groups
            or (lane.command.silenced and address in context.silenced)
            or context.speaks.get(address, lane.dialect) != lane.dialect
        ):
            return False
        waiting = context.open.get(address)
        request = Request(frame, address, lane.command, sequence, lane.topic)
        request.lane = lane
        if waiting is None:
            context.open[address] = [request]
        elif lane.command.moves or len(waiting) >= MOST_OPEN:
            return False
        else:
            waiting.append(request)
        if lane.command.borrows:
            context.borrowed += 1
        context.last_request = request
        self._last = frame
        self._last_is_reply = False
        return True

    def plain_reply(self, lane: Lane, frame: Frame) -> Request | None:
        """End the one open request with its first and final reply; return None, with nothing done, for any other case."""
        context, address = self.context, lane.address
        waiting = context.open.get(address)
        if waiting is None or len(waiting) != 1 or len(context.open) != 1 or frame.last_ns >= self._check_ns:
            return None
        request, command = waiting[0], lane.command
        if (
            request.command is not command
            or request.state is not State.WAITING
            or context.echoes
            or frame.first_ns - request.t_ns > self.late_ns
            or command.changes_answers
        ):
            return None
        if command.judged:
            data = frame.data[lane.start : lane.stop]
            meaning = lane.meanings.get(data)
            if meaning is None:
                meaning = lane.meanings[data] = meaning_of(lane.message(frame), command)[0]
            if meaning != "final":
                return None
        request.state = State.DONE
        request.outcome = RequestOutcome.ANSWERED
        del context.open[address]
        if command.borrows:
            context.borrowed -= 1
        if command.silenced:
            self._answers_motion.add(address)
        self._behind = 0
        context.speaks[address] = lane.dialect
        self._last_reply[address] = frame.data
        self._last = frame
        self._last_is_reply = True
        return request

    # --- many plain cases at once ---------------------------------------------------------------------------------

    def may_follow(self, data: bytes) -> bool:
        """Say whether these bytes are no repetition of the frame before them."""
        return self._last is None or self._last.data != data

    def patient_until_ns(self) -> int | None:
        """Return the time until which no open request is given up while others are asked and answered; None: for ever."""
        times = [r.t_ns for requests in self.context.open.values() for r in requests if r.state is State.WAITING]
        if times and self.half_duplex:
            return 0
        return min(times) + GIVE_UP * self.late_ns if times else None

    def were_answered(
        self, request: Request, reply: Frame, replies: Mapping[int, bytes], moved: Iterable[int], times_ns: NDArray[np.int64]
    ) -> None:
        """Take plain exchanges as done, of which the last is `request` and `reply`.

        `replies`: the last one of each address. `moved`: those that answered a motion command. `times_ns`: of all frames,
        rising.
        """
        for address in replies:
            self.context.speaks[address] = reply.dialect.name
        self._last_reply.update(replies)
        self._answers_motion.update(moved)
        self.context.last_request = request
        self._last, self._last_is_reply = reply, True
        self._behind = 0
        # As `observe` would have looked for requests that have expired; there were none.
        step = GIVE_UP * self.late_ns // 10
        while self._check_ns <= times_ns[-1]:
            self._check_ns = int(times_ns[times_ns.searchsorted(self._check_ns)]) + step

    # --- requests -------------------------------------------------------------------------------------------------

    def _request(self, message: Message, sequence: int, topic: str) -> Paired:
        context, frame, command = self.context, message.frame, message.command
        earlier: list[Late] = []
        same = self._repeated(message)
        if same is not None:
            gap = frame.first_ns - same.t_ns
            # A time that runs backwards says nothing of the time between them.
            timed = self._timed and gap >= 0
            if frame.role is Role.REPLY or (timed and gap <= ECHO_NS):
                context.echoes += 1
                after = f" after {gap / 1e6:.3f} ms" if timed else ""
                return Paired(issues=(Issue("host_echo", f"the request once more{after}"),))
            after = f" after {gap / 1e6:.1f} ms" if timed else ""
            earlier += self._give_up(same, RequestOutcome.RETRIED, f"the host repeated it{after}")
        request = Request.of(message, sequence, topic)
        running = context.open.get(message.address)
        if running and command is not None and command.moves:
            for older in list(running):
                if older.state is State.RUNNING:
                    self._end(older, RequestOutcome.SUPERSEDED)
                    context.superseded.append(older)
        if not self._expects(message):
            request.outcome = RequestOutcome.SILENT
            if self._is_to_many(message):
                context.broadcasts.append(request)
                self._learn(message)
        else:
            waiting = context.open.setdefault(message.address, [])
            waiting.append(request)
            if command is not None and command.borrows:
                context.borrowed += 1
            if len(waiting) > MOST_OPEN:
                earlier += self._give_up(
                    waiting[0], RequestOutcome.UNANSWERED, f"{MOST_OPEN} requests followed without a reply"
                )
        context.last_request = request
        return Paired(earlier=tuple(earlier))

    def _repeated(self, message: Message) -> Request | None:
        """Return the open request that this one repeats with nothing between, or None."""
        last = self._last
        if last is None or last.data != message.frame.data or (last.can and last.can.id != message.address):
            return None
        if self._last_is_reply or not last.checksum_ok:
            return None
        request = self.context.last_request
        if request is None or request.frame.data != message.frame.data or request.state is not State.WAITING:
            return None
        silent = request.outcome is RequestOutcome.SILENT
        if not silent and request.outcome is not RequestOutcome.OPEN:
            return None
        return (
            None
            if silent
            and message.frame.role is not Role.REPLY
            and not (self._timed and message.frame.first_ns - request.t_ns <= ECHO_NS)
            else request
        )

    def _is_to_many(self, message: Message) -> bool:
        command = message.command
        return (
            message.address == message.frame.dialect.broadcast
            or message.address in self.context.groups
            or (command is not None and command.slots is not None)
        )

    def _expects(self, message: Message) -> bool:
        command = message.command
        if not message.frame.checksum_ok:
            return False
        if command is None:
            return False
        if not command.reply_forms or self._is_to_many(message):
            return False
        return not (command.silenced and message.address in self.context.silenced)

    # --- replies --------------------------------------------------------------------------------------------------

    def _reply(self, message: Message, asked: Request | None) -> Paired:
        context = self.context
        asked = asked or self._from_new_address(message)
        if asked is None:
            return self._unasked(message)
        asked = self._nearest(asked)
        if context.echoes >= 2 and self._is_echo(message, asked):
            context.echoes += 1
            return Paired(issues=(Issue("host_echo", "the request once more, before its reply"),))
        first = asked.state is State.WAITING
        latency = self._latency(message.frame, asked)
        earlier = self._overtaken(asked)
        issues: list[Issue] = []
        if first and latency is not None and latency > self.late_ns:
            issues.append(Issue("late_reply", f"after {latency / 1e6:.1f} ms, limit {self.late_ns / 1e6:g} ms"))
        self._behind = self._behind + 1 if first and self.half_duplex and asked is not context.last_request else 0
        if self._behind >= BEHIND:
            issues.append(Issue("late_reply", f"it answers an earlier request, as the {self._behind - 1} before it do"))
        meaning, problem = meaning_of(message, asked.command)
        if problem is not None:
            issues.append(problem)
        if asked.state is State.RUNNING and meaning == "interim":
            issues.append(Issue("duplicate_reply", "the interim reply once more"))
        self._advance(asked, message, meaning)
        return Paired(asked, latency, first, tuple(issues), tuple(earlier))

    def _from_new_address(self, message: Message) -> Request | None:
        """Return the open request that gave the sender of a reply its address: either of the two may answer it."""
        head = message.frame.head
        for requests in self.context.open.values():
            for request in requests:
                field = request.command.sets(Effect.ADDRESS) if request.command is not None else ""
                if field and request.state is State.WAITING and request.message.values.get(field) == message.address:
                    return request if answers(request, head.function, head.code, message.data) is not None else None
        return None

    def _nearest(self, asked: Request) -> Request:
        """Return the equal request right before a reply where the oldest was sent long before it; else the oldest."""
        last = self.context.last_request
        if not (self.half_duplex and self._timed) or last is None or last is asked or last.frame is not self._last:
            return asked
        both_wait = asked.state is last.state is State.WAITING and last.outcome is RequestOutcome.OPEN
        same = last.frame.data == asked.frame.data and last.t_ns - asked.t_ns > APART_NS
        return last if both_wait and same else asked

    def _is_echo(self, message: Message, asked: Request) -> bool:
        """Say whether a reply that is byte for byte its request is the host's echo: only on a bus known to echo."""
        if asked.gave_up == "echoed" or message.frame.data != asked.frame.data:
            return False
        asked.gave_up = "echoed"
        return self._last is asked.frame

    def _advance(self, request: Request, message: Message, meaning: str) -> None:
        context, command = self.context, request.command
        request.state = NEXT[meaning]
        if request.state is State.RUNNING and message.address in context.passive:
            request.state = State.DONE
        if message.frame.checksum_ok:
            context.speaks[message.address] = message.frame.dialect.name
        if command is not None:
            if command.silenced:
                self._answers_motion.add(message.address)
            if meaning == "final" and command.changes_answers:
                self._learn(request.message)
        self._last_reply[message.address] = message.frame.data
        if request.state is State.DONE:
            self._end(request, RequestOutcome.FAILED if meaning == "failed" else RequestOutcome.ANSWERED)

    def _unasked(self, message: Message) -> Paired:
        """Judge a reply that no open request asked for: late, to a broadcast, a duplicate, or out of the blue."""
        context, frame = self.context, message.frame
        head = frame.head
        for request in reversed(context.superseded):
            if request.address == message.address and answers(request, head.function, head.code, message.data):
                context.superseded.remove(request)
                latency = self._latency(frame, request)
                problem = meaning_of(message, request.command)[1]
                return Paired(request, latency, issues=(problem,) if problem else ())
        # A duplicate is the very bytes of the last reply; a later one must not be taken for the reply to an older request.
        for request in reversed(context.unanswered):
            if request.address == message.address and answers(request, head.function, head.code, message.data):
                context.unanswered.remove(request)
                latency = self._latency(frame, request)
                meaning, problem = meaning_of(message, request.command)
                after = "" if latency is None else f" after {latency / 1e6:.1f} ms"
                issues = [Issue("late_reply", f"it came{after}, when the request had been given up")]
                self._advance(request, message, meaning)
                return Paired(request, latency, True, tuple(issues + ([problem] if problem else [])))
        for request in reversed(context.broadcasts):
            near = frame.first_ns - request.t_ns <= self.late_ns
            if near and answers(request, head.function, head.code, message.data):
                kind = "the broadcast" if request.address == frame.dialect.broadcast else f"group {request.message.who}"
                return Paired(request, issues=(Issue("answered_broadcast", f"a reply to {kind}"),))
        if self._last_reply.get(message.address) == frame.data:
            return Paired(issues=(Issue("duplicate_reply", "a repeated reply"),))
        self._last_reply[message.address] = frame.data
        if message.frame.checksum_ok:
            context.speaks.setdefault(message.address, frame.dialect.name)
        name = message.command.name if message.command is not None else "an unknown command"
        return Paired(issues=(Issue("unsolicited_reply", f"no request for {name} is open"),))

    # --- ends -----------------------------------------------------------------------------------------------------

    def _overtaken(self, asked: Request) -> list[Late]:
        """End the requests that a reply to a later one has overtaken."""
        late: list[Late] = []
        open_ = self.context.open
        if len(open_) == 1 and len(open_.get(asked.address, ())) == 1:
            return late
        for address, requests in list(open_.items()):
            if address != asked.address and not self.half_duplex:
                continue
            for request in list(requests):
                if request.state is State.WAITING and request.sequence < asked.sequence:
                    late += self._give_up(request, RequestOutcome.UNANSWERED, "a later request was answered first")
        return late

    def _expired(self, now: int) -> tuple[Late, ...]:
        limit = GIVE_UP * self.late_ns
        self._check_ns = now + limit // 10
        late: list[Late] = []
        for requests in list(self.context.open.values()):
            for request in list(requests):
                if request.state is State.WAITING and now - request.t_ns > limit:
                    late += self._give_up(request, RequestOutcome.UNANSWERED, f"no reply within {limit / 1e9:g} s")
        return tuple(late)

    def _give_up(self, request: Request, outcome: RequestOutcome, why: str, severity: Severity | None = None) -> list[Late]:
        self._end(request, outcome)
        self.context.unanswered.append(request)
        command = request.command
        address = request.address
        if command is not None and command.silenced and address not in self._answers_motion:
            if address in self._told_silent:
                return []
            self._told_silent.add(address)
            text = f"address {request.message.who} does not answer motion commands: respond = 0 or a group address"
            return [Late(request, Issue("silent_address", text))]
        name = command.name if command is not None else "an unknown command"
        return [Late(request, Issue("unanswered", f"{name}: {why}", severity))]

    def _end(self, request: Request, outcome: RequestOutcome) -> None:
        request.outcome = outcome
        requests = self.context.open.get(request.address)
        if requests and request in requests:
            requests.remove(request)
            if request.command is not None and request.command.borrows:
                self.context.borrowed -= 1
            if not requests:
                del self.context.open[request.address]

    def _learn(self, request: Message) -> None:
        """Take from a setting what it changes in who answers and how."""
        command = request.command
        if command is None:
            return
        context, address = self.context, request.address
        for effect, name in command.effects.items():
            value = request.values.get(name)
            if value is None:
                continue
            if effect is Effect.GROUP:
                context.groups.add(value)
            elif effect in (Effect.RESPOND, Effect.ACTIVE):
                chosen = context.silenced if effect is Effect.RESPOND else context.passive
                (chosen.discard if value else chosen.add)(address)
            elif effect is Effect.DIALECT:
                context.speaks[address] = request.frame.dialect.switched(value)
            elif effect is Effect.ADDRESS and address in context.speaks:
                context.speaks[value] = context.speaks[address]


def meaning_of(message: Message, command: Command | None) -> tuple[str, Issue | None]:
    """Return what a reply means (interim, final, failed), and the issue if it failed."""
    form = message.form
    if form is not None and form is message.frame.dialect.exception:
        return "failed", None
    if command is None or form is None or not command.judged:
        return "final", None
    replies = command.replies
    if form.name in replies.failed_forms:
        rule = "refused_write" if command.function is not None else "failed_status"
        return "failed", Issue(rule, f"{command.name} was answered: {form.name}")
    status = message.values.get(replies.status)
    if status in replies.interim:
        return "interim", None
    if status in replies.failed:
        name = form.layout.named[replies.status].choice_names.get(status, "")
        return "failed", Issue("failed_status", f"{command.name}: {replies.status} {status} {name}".rstrip())
    return "final", None
