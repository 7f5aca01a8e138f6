"""A rig with a drive on a real port: the port is a guard's, and what claims change is put back.

After each claim the drive is stopped, if the claim may have moved it, and proved to stand; then its settings are put back,
so that each claim finds the drive as the one before found it. Claims that follow each other and all make the drive ready to
move are a group: what that sets stays until the first claim that does not name it, and is put back once.

The motor is stopped after every failure: by the rig itself, by a new guard if the old one has died, or by the guard alone if
the rig cannot.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from analyzer.catalogue import Risk, Verb
from analyzer.errors import ServotapError
from analyzer.records import CanFrame
from conformance.bus.line import Line, LineLost
from conformance.claim import Claim, Inconclusive, NotRun, NotStopped, RigFault
from conformance.gate.gate import Gate, Refused
from conformance.gate.permissions import READS, Allowance
from conformance.motion import answering, declared, resting
from conformance.safety import messages as say
from conformance.safety import settings
from conformance.safety.guarded_line import GuardedLine, beginning
from conformance.safety.journal import Entry, Journal
from conformance.safety.keeper import Keeper
from conformance.safety.signals import undisturbed
from conformance.safety.stopping import MAY_MOVE, GuardLost, not_stopped, others_send, stop_or_cut
from conformance.suite import set_otherwise
from conformance.suite.preflight import check, find_drive
from conformance.suite.rig import ClaimRig
from conformance.suite.target import Target
from conformance.talk.dialogue import Dialogue
from conformance.talk.drive_state import read_drive_state
from conformance.talk.noise import QUIET, Noise
from conformance.talk.probe import SECOND_NS, Probe, plain_probe

if TYPE_CHECKING:
    from conformance.suite.plan import Plan
    from conformance.talk.exchange import Exchange

#: Silence of a drive after which the run says so, and after which it searches for the drive: an honest drive is never silent
#: as long, not even while it starts.
_SAID_NS, _LOST_NS = 5 * SECOND_NS, 15 * SECOND_NS
#: As many questions at least: one that goes on for long is not silence.
_UNANSWERED = 3


class LineFlooded(RigFault):
    """More comes than any line brings."""


class DriveSilent(RigFault):
    """The drive answered, and then nothing any more."""


def _clock(ago_ns: int) -> str:
    """Return the time of day that long ago."""
    return time.strftime("%H:%M:%S", time.localtime(time.time() - ago_ns / SECOND_NS))


class RealRig(ClaimRig):
    """A drive on a real port. Raises UsageError where the port cannot be opened, DriveNotFound where no drive answers."""

    emulated = False
    #: The longest move that the manual prints takes 27 s.
    done_ns = 60 * SECOND_NS

    def __init__(self, plan: Plan, target: Target) -> None:
        assert target.endpoint is not None  # a target without one is emulated
        super().__init__(target.dialect.for_model(target.model) if target.model else target.dialect, target.address)
        self.name = f"{target.dialect.name}@{target.address}"
        self.model = target.model
        self.seed = plan.seed
        given = plan.allowance or Allowance(READS)
        self._allowance = replace(given, addresses=frozenset({self.address}))
        self.allowed = self._allowance.risks
        self.alone = self._allowance.alone
        self.named = frozenset(plan.claims)
        self._plan, self._target = plan, target
        known = self._known = settings.known(self.dialect, self.name, plan.settings)
        self.untold = set_otherwise.unreadable(self.dialect) - known.keys()
        if self._allowance.subdivision is None and "subdivision" in known:
            # What the user says the drive is set to also says how fast a speed is.
            self._allowance = replace(self._allowance, subdivision=known["subdivision"] or 256)
        #: Whether something was sent that may have set the drive going, since it was last stopped, and at all.
        self._moved = self._ever_moved = False
        self._journal = self._open_journal() if Risk.SETTING in self.allowed else None
        try:
            self._line = self._open_line()
        except BaseException:
            self._end_journal(done=True)
            raise
        self.began_ns = self._line.now_ns()
        self.gate = self._open_gate()
        self.keeper = Keeper(
            self.gate, self.dialect, self.address, known, self._journal, target.endpoint.text, alone=self.alone
        )
        self._ready = declared.ready_settings(self.dialect)
        #: What makes the drive answer motion, by command, where a user has set it not to; whether it was looked at for that.
        self._loud: dict[str, dict[str, int]] = {}
        self._heard = False
        #: Whether it was told to forget a run kept for power-on.
        self._forgotten = False
        #: Why the drive is not set to answer motion, or nothing.
        self._unheard = ""
        #: Where a claim saw the shaft stand, until something is sent that may move it.
        self._stands_at: float | None = None
        #: The first of the questions that stayed without an answer, and how many did; whether that was said.
        self._silent_ns, self._silent_command, self._unanswered, self._said_silent = 0, "", 0, False
        #: Since when more has come in each exchange than any line brings, None: it does not.
        self._flooded_ns: int | None = None
        #: Why nothing that moves may be sent, or nothing.
        self._unproved = ""
        self._closed = False
        self._not_stopped = False
        try:
            self.firmware = check(self.gate, self.dialect, self.address, alone=self.alone, spoken=given.spoken)
            self._tell(say.DriveFound())
        except BaseException:
            self.close()
            raise

    # --- the port -----------------------------------------------------------------------------------------------------

    def _open_line(self) -> Line:
        assert self._target.endpoint is not None
        return GuardedLine(self._target.endpoint, self._begin())

    def _open_gate(self) -> Gate:
        return Gate(self._line, self._allowance)

    def _tell(self, message: say.DriveFound | say.ReadState | say.Standing | say.AllPutBack) -> None:
        """Tell the guard something, where there is one."""
        if isinstance(self._line, GuardedLine):
            self._line.tell(message)

    def _begin(self) -> say.Begin:
        assert self._target.endpoint is not None
        return msgspec.structs.replace(
            beginning(self._target.endpoint, [(self.dialect, self.address)], self._allowance),
            longest_run_ns=int(self._plan.longest_run * 1e9),
            moving=self._moved,
            journal="" if self._journal is None else str(self._journal.path),
            cut_power=self._plan.cut_power,
        )

    def _open_journal(self) -> Journal | None:
        named = f"servotap-{self.name.replace('@', '-')}-{time.strftime('%Y%m%d-%H%M%S')}.journal"
        return Journal(Path(self._plan.journal or named))

    def _end_journal(self, *, done: bool) -> None:
        if self._journal is None:
            return
        done = done or self._journal.empty
        if not done:
            print(
                f"servotap: {self._journal.path} says what was not put back: servotap restore {self._journal.path}",
                file=sys.stderr,
            )
        self._journal.close(remove=done)

    # --- claims -------------------------------------------------------------------------------------------------------

    def missing(self, claim: Claim) -> str:
        unproved = (self._unproved or self._unheard) if claim.risks & MAY_MOVE else ""
        return super().missing(claim) or unproved or self.keeper.cannot_keep(claim.settings)

    def drop_write_gap(self) -> None:
        """Let settings follow one another at once from now on."""
        self.write_gap_ns = self.keeper.write_gap_ns = 0

    def forbid_motion(self, reason: str) -> None:
        """Let nothing pass from now on that may move the drive: it could not be proved to stand again."""
        self._unproved = f"nothing that moves is sent: {reason}"
        self.gate = self.gate.under(replace(self._allowance, risks=self._allowance.risks - MAY_MOVE))

    @cached_property
    def group(self) -> int | None:
        """The group address of the drive, as the user says it, or as the drive tells."""
        command = self.dialect.by_verb.get(Verb.SET_GROUP_ADDRESS)
        if command is not None and "group_address" not in self._known and settings.readable(self.dialect, command):
            return (settings.read(plain_probe(self.dialect, self.address, self.gate), command, {}) or {}).get("group_address")
        return self._known.get("group_address")

    @cached_property
    def held(self) -> Mapping[str, int]:
        """The settings before the run, as the drive tells them, the keeper knows them, or the user tells them."""
        found, probe = dict(self._known), plain_probe(self.dialect, self.address, self.gate)
        for command in self.dialect.commands:
            if not settings.readable(self.dialect, command) or not settings.changes(command):
                continue
            for values in settings.every_selector(command):
                try:
                    found |= settings.read(probe, command, values) or {}
                except Inconclusive:
                    # What a drive does not tell now is judged by claims of its own.
                    continue
        return found | self.keeper.before

    @cached_property
    def _at_rest(self) -> Noise:
        found = resting.measure(plain_probe(self.dialect, self.address, self.gate))
        if found.latency_ns:
            self.silence_ns = min(self.silence_ns, found.silence_ns)
            self.quiet_ns = self.keeper.quiet_ns = min(self.quiet_ns, found.quiet_ns)
        return found

    def probe(self, claim: Claim) -> Probe:
        if not self._names_what_is_left(claim):
            # What fails is tried again in the end.
            self._put_back()
        bounded = self._allowance.turns is not None or self._allowance.speed is not None
        if bounded and MAY_MOVE & claim.risks:
            # A move to a place is as long as the way there, and a speed is as fast as the subdivision makes it.
            read_drive_state(Dialogue(self.gate, [self.dialect]), self.dialect, self.address)
            self._tell(say.ReadState())
        if MAY_MOVE & claim.risks:
            self._let_stand(claim)
            self._forget_run(claim)
            self._be_heard(claim)
        if self._in_motion is None and resting.can_turn(self.dialect, claim):
            self._in_motion = self._at_rest
            self._be_heard(claim, answering.tells_ends)
            self._in_motion = resting.in_motion(Probe(self, claim))
            self.settle()
        return Probe(self, claim)

    def _let_stand(self, claim: Claim) -> None:
        """Stop and forget a run that was kept for power-on, before the first claim that moves: each restart would begin it."""
        if self._ever_moved or not declared.can_move(self.dialect):
            return
        probe = Probe(self, claim)
        try:
            if resting.let_stand(probe):
                print(f"servotap: {self.name}: it turned by a run kept for power-on, which is forgotten", file=sys.stderr)
        except (Inconclusive, Refused, NotRun):
            # What turns on is judged by claims, and said by the stop behind each.
            return
        finally:
            self.settle(probe)

    def _forget_run(self, claim: Claim) -> None:
        """Forget a run that may be kept for power-on, before the first claim that restarts the drive.

        In a pulse mode it shows only when a claim has set another mode and restarts.
        """
        restart = self.dialect.by_verb.get(Verb.RESTART)
        if self._forgotten or restart is None or not claim.risks >= restart.all_risks:
            return
        self._forgotten = True
        probe = Probe(self, claim)
        try:
            resting.forget_run(probe)
        except (Inconclusive, Refused, NotRun):
            # What is not to be changed, or refuses it, keeps what it has.
            return
        finally:
            self.settle(probe)

    def _be_heard(self, claim: Claim, is_loud: Callable[[Probe], bool] = answering.answers) -> None:
        """Set a drive to answer motion that a user has set not to. Raises NotRun where that cannot be put back."""
        probe = Probe(self, claim)
        if self._loud:
            if not self.keeper.left_at(self._loud):
                answering.set_loud(probe)
            return
        if self._heard and is_loud is answering.answers:
            return
        self._heard = True
        try:
            if is_loud(probe):
                return
            command = self.dialect.by_verb[Verb.SET_RESPOND]
            answering.set_loud(probe)
            if is_loud(probe):
                self._loud = {command.name: dict(answering.LOUD)}
        except Inconclusive:
            return
        except (Refused, NotRun) as error:
            self._unheard = f"{answering.UNHEARD} ({error})"
            raise NotRun(self._unheard) from None
        finally:
            self.settle(probe)

    def before_send(self, item: bytes | CanFrame) -> None:
        """Keep what an item is about to change, and know that it may move the motor."""
        readings = self.gate.interpret(item)
        # What the gate refuses changes nothing, so there is nothing to keep.
        if self.gate.objections(item):
            return
        self.keeper.keep_before(readings)
        if any(reading.risks & MAY_MOVE for reading in readings):
            self._moved, self._ever_moved, self._stands_at = True, True, None

    def exchanged(self, exchange: Exchange) -> None:
        """Raise DriveSilent where the drive has answered nothing for long, and does not when it is looked for.

        Raises LineFlooded where more than any line brings has come for as long.
        """
        if self._line.is_can or not exchange.passed:
            self._flooded_ns = None
        elif self._flooded_ns is None:
            self._flooded_ns = exchange.sent_ns
        elif self._line.now_ns() - self._flooded_ns >= _LOST_NS:
            raise LineFlooded(f"{self.name}: nothing can be judged: {'; '.join(others_send([exchange], self._line))}")
        if exchange.received:
            self._unanswered, self._said_silent = 0, False
        elif exchange.command is not None and exchange.address == self.address:
            if not self._unanswered:
                self._silent_ns, self._silent_command = exchange.sent_ns, exchange.command.name
            self._unanswered += 1
            if self._unanswered >= _UNANSWERED and self._silence() >= _LOST_NS:
                self.still_there()

    def _silence(self) -> int:
        """Return how long the drive has been silent, and say so where that is long."""
        silent_ns = self._line.now_ns() - self._silent_ns
        if silent_ns >= _SAID_NS and not self._said_silent:
            self._said_silent = True
            print(f"servotap: {self.name}: silent since {_clock(silent_ns)}", file=sys.stderr, flush=True)
        return silent_ns

    def still_there(self) -> None:
        """Look for the drive if it did not answer the last question; raise DriveSilent where it stays silent.

        What is judged of a drive whose cable was pulled says nothing about the drive.
        """
        # One that was told to speak otherwise is not looked for here.
        while self._unanswered and not self.keeper.link_changed:
            if find_drive(self.gate, self.dialect, self.address, widely=False).found is not None:
                self._unanswered = 0
            elif (silent_ns := self._silence()) >= _LOST_NS:
                raise DriveSilent(
                    f"{self.name} is silent since {_clock(silent_ns)}, from {self._silent_command} on, and is not found any "
                    "more: look at its power and its wiring; a drive that hangs there hangs again in the next run"
                )

    def stands_at(self, degrees: float) -> None:
        """Take note that a claim saw the shaft stand here."""
        self._stands_at = degrees

    def _names_what_is_left(self, claim: Claim) -> bool:
        """Say whether a claim makes the drive ready as the one before left it: it names all settings that were left."""
        left = self.keeper.left_at(self._ready)
        return all(name in claim.settings for command in left for name in self._ready[command])

    def settle(self, probe: Probe | None = None, *, last: bool = False) -> str:
        """Stop the motor if the claim may have moved it, and put back what it changed.

        What the drive refused to take back is tried again with `last`. Raises NotStopped, LineLost.
        """
        if self._not_stopped:
            return "not put back: nothing more was sent to a drive that could not be stopped" * self.keeper.changed
        failure = self.keeper.put_back(link_only=True) if self.keeper.link_changed else ""
        if self._may_move or (last and self._ever_moved):
            self._stop(last=last)
        if self.keeper.untried or (last and self.keeper.changed):
            failure = self._put_back(again=last, but=() if last else self.keeper.left_at(self._ready))
        return f"not put back: {failure}" if failure else ""

    def _put_back(self, *, again: bool = False, but: Collection[str] = ()) -> str:
        """Put back what was changed, some commands aside; return what was not, or nothing."""
        failure = self.keeper.put_back(again=again, but=but if again else {*but, *self.keeper.left_at(self._loud)})
        if not self.keeper.changed:
            self._is_back()
        return failure

    @property
    def _may_move(self) -> bool:
        """Whether the drive may be moving; the guard knows every frame that was sent."""
        return self._moved or getattr(self._line, "moving", False)

    def _stop(self, *, last: bool) -> None:
        try:
            earlier = getattr(self._line, "not_stopped", None)
            if earlier is not None:
                raise earlier
            stood = None if last else self._stands_at
            noise = self.__dict__.get("_at_rest", QUIET) if self._in_motion is None else self._in_motion
            stop_or_cut(self.gate, self.dialect, self.address, self._plan.cut_power, stood, noise, thoroughly=last)
        except NotStopped as error:
            self._not_stopped = True
            if isinstance(self._line, GuardedLine):
                self._line.not_stopped = error
            raise
        self._moved = False
        self._tell(say.Standing())

    def _is_back(self) -> None:
        """Say that the settings are what they were: the subdivision, which says how fast a speed is, among them."""
        if self._allowance.subdivision is not None:
            self.gate.note_subdivision(self._allowance.subdivision)
        self._tell(say.AllPutBack())

    # --- the end ------------------------------------------------------------------------------------------------------

    def close(self) -> None:
        """Stop, put back, and give the port back. No signal breaks in.

        Raises NotStopped; RigFault where something could not be put back.
        """
        if self._closed:
            return
        self._closed = True
        with undisturbed():
            failure, done = "", False
            try:
                failure = self._last()
                done = True
            finally:
                try:
                    if done or self._not_stopped or not isinstance(self._line, GuardedLine):
                        self._line.close()
                    else:
                        # Something went wrong here, so the guard does it alone.
                        self._believe(self._line.abandon())
                finally:
                    self._end_journal(done=done and not failure)
        if failure and not self._not_stopped:
            raise RigFault(failure)

    def _believe(self, status: int | None) -> None:
        """Take the exit status of a guard that was to stop the drive alone. Raises NotStopped where it does not say so."""
        if status == NotStopped.exit_status:
            raise NotStopped(f"NOT STOPPED: {self.name}: the process that owns the port could not stop it")
        if self._may_move and status != say.STANDS:
            failure = f"the process that owns the port was to stop it, and ended with {status}"
            raise not_stopped(self.dialect, self.address, failure, self._plan.cut_power)

    def _last(self) -> str:
        """Settle for the last time; return what could not be put back. Where the guard has died, by a new one."""
        if (self._may_move or self.keeper.changed) and not self._not_stopped:
            print(f"servotap: {self.name}: stopping it and putting back what it was", file=sys.stderr, flush=True)
        try:
            failure = self.settle(last=True)
        except GuardLost as error:
            if not (self._may_move or self.keeper.changed):
                return ""
            print(f"servotap: {error}; another one takes over", file=sys.stderr, flush=True)
            failure = self._settle_anew()
        except LineLost as error:
            failure = f"not put back: {error}" if self.keeper.changed else ""
        if not failure and self._journal is not None:
            self._journal.tell(Entry(event="end", target=self.name))
        return failure

    def _settle_anew(self) -> str:
        """Open the port again and settle."""
        self._moved = self._may_move
        self._line.close()
        try:
            self._line = self._open_line()
            self._tell(say.DriveFound())
            self.gate = self._open_gate()
            self.keeper.use_gate(self.gate)
            return self.settle(last=True)
        except NotStopped:
            raise
        # There is no third one: what is not proved to stand by now may turn on.
        except ServotapError as error:
            if self._moved:
                self._not_stopped = True
                raise not_stopped(self.dialect, self.address, str(error), self._plan.cut_power) from None
            return f"not put back: {error}" * self.keeper.changed
