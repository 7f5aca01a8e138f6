"""A drive from Python: emulated in virtual time, or real at an endpoint.

What is sent passes the gate of `servotap send`: reads and stops always, anything else with the risks that are allowed, within
the bounds. A real port belongs to a guard process: it knows what may be moving, and stops it should this program just end.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import partial
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import Any

import msgspec

from analyzer import dialects as registry
from analyzer.catalogue import Command, MotionKind, Risk
from analyzer.dialects import find_command
from analyzer.encoder import Built, assemble
from analyzer.errors import ServotapError, UsageError
from analyzer.records import Finding
from analyzer.values import SECOND_NS
from conformance.bus.emulated import EmulatedLine
from conformance.bus.line import Line
from conformance.claim import Inconclusive, NotStopped
from conformance.drives import make
from conformance.gate.gate import Allowance, Gate, Refused, parse_allow
from conformance.motion import motion
from conformance.safety import messages as say
from conformance.safety.guarded_line import GuardedLine, beginning
from conformance.safety.stopping import MAY_MOVE, GuardLost, not_stopped, stop, stop_or_cut, stopping
from conformance.serve.log import BusLog
from conformance.suite.preflight import check
from conformance.suite.target import Target, one
from conformance.talk.dialogue import MS, Dialogue, Until
from conformance.talk.drive_state import read_drive_state
from conformance.talk.exchange import Answer, Completion, Exchange
from conformance.talk.probe import plain_probe
from conformance.talk.request import Request
from servotap import arguments
from servotap.captures import Frame, frame_of

#: How long is listened behind the reply to a command for one more, and where none is due.
_QUIET_NS = 20 * MS
#: How long a command may take to its last reply.
_DONE_NS = 120 * SECOND_NS
#: Between two settings: real drives were seen to drop hasty ones.
_SETTING_GAP_NS = 500 * MS


@dataclass(frozen=True)
class Reply:
    """What a drive answered.

    `outcome`: done, failed, running (its end was not waited for) or silent. `fields`: of the last reply, in their units,
    choices by their names. `frames`: all that came. `latency_ns`: from the end of the request to the first reply.
    """

    command: str
    outcome: str
    fields: Mapping[str, Any]
    units: Mapping[str, Any]
    frames: tuple[Frame, ...]
    findings: tuple[Finding, ...]
    latency_ns: int | None

    def __getitem__(self, name: str) -> Any:
        return self.fields[name]


class NotDone(ServotapError):
    """The drive refused a command, or did not answer it. `reply`: what came."""

    exit_status = 1

    def __init__(self, text: str, reply: Reply) -> None:
        super().__init__(text)
        self.reply = reply


class Drive:
    """A drive: an emulated one, a real one at an endpoint (`serial:/dev/ttyUSB0,baud=38400`), or one of a profile.

    Leaving its `with` stops it and gives the port back. `emulated`: time passes only while something is waited for.

    Only reads and stops are sent, besides what is allowed here or with each command; bounds as for `servotap send`. A guard
    process owns a real port. It stops the drive if this program dies, and a run without an end after `max_run` seconds.
    `timeout`: of a reply, in seconds. `log`: a file for all that is sent and comes, which `servotap.open` reads.
    Raises UsageError; DriveNotFound where a real drive does not answer.
    """

    def __init__(
        self,
        name: str,
        on: str = "",
        *,
        allow: Collection[str] = (),
        max_speed: float | None = None,
        max_turns: float | None = None,
        max_acceleration: float | None = None,
        max_current: float | None = None,
        subdivision: int | None = None,
        alone: bool = False,
        max_run: float = 30.0,
        cut_power: str = "",
        timeout: float = 1.0,
        log: str | PathLike[str] | None = None,
        replace_log: bool = False,
    ) -> None:
        arguments.check(
            name=name, on=on, allow=allow, alone=alone, max_run=max_run, cut_power=cut_power, timeout=timeout, log=log
        )
        arguments.check(max_speed=max_speed, max_turns=max_turns, max_acceleration=max_acceleration, max_current=max_current)
        arguments.check(subdivision=subdivision)
        target = one(name, on)
        bounds = {"speed": max_speed, "turns": max_turns, "acceleration": max_acceleration, "current": max_current}
        if target.named is not None:
            said = target.named.entry
            bounds = {name: getattr(said, f"max_{name}") if value is None else value for name, value in bounds.items()}
            subdivision = said.subdivision if subdivision is None else subdivision
        self.dialect = target.dialect.for_model(target.model) if target.model else target.dialect
        self.address = target.address
        self.name = f"{self.dialect.name}@{self.address}"
        self.emulated = target.emulated
        self._timeout_ns = int(timeout * 1e9)
        self._allowance = Allowance(
            _risks(allow),
            bounds["speed"],
            bounds["turns"],
            bounds["acceleration"],
            bounds["current"],
            frozenset({self.address}),
            alone,
            subdivision=subdivision,
        )
        self._moving = False
        self._closed = False
        self._spoken = registry.for_model(registry.every(), target.model or None)
        self._cut_power = cut_power
        self._open_line = partial(self._open, target, max_run, cut_power)
        self._line = self._open_line()
        self._log: BusLog | None = None
        try:
            if log is not None:
                self._log = self._logged(str(log), replace_log=replace_log)
            take = None if self._log is None else self._log.take
            self._gate = Gate(self._line, self._allowance, dialects=self._spoken, log=take)
            others = [d for d in self._spoken if d.bus == self.dialect.bus and d.name != self.dialect.name]
            self._dialogue = Dialogue(self._gate, [self.dialect, *others])
            if isinstance(self._line, GuardedLine):
                check(self._gate, self.dialect, self.address, alone=alone)
                self._line.tell(say.DriveFound())
        except BaseException:
            self._end_log()
            self._line.close()
            raise

    def _logged(self, path: str, *, replace_log: bool) -> BusLog:
        if Path(path).exists() and not replace_log:
            raise UsageError(f"{path} exists; replace_log=True replaces it")
        endpoint = self._line.endpoint
        return BusLog(
            endpoint.name,
            path,
            [self.dialect],
            speed=endpoint.bits_per_second,
            byte_ns=self._line.byte_ns,
            anchor_ns=time.time_ns() if self.emulated else self._line.anchor_ns,
            force=True,
            format="servotap.drive",
        )

    def _end_log(self) -> None:
        if self._log is not None:
            self._log.finish({"source": f"{self.name} on {self._line.endpoint.text}"})
            self._log = None

    def _open(self, target: Target, max_run: float, cut_power: str) -> Line:
        if target.endpoint is None:
            assert target.specification is not None  # a target without an endpoint is emulated
            return EmulatedLine([make.make(target.specification)])
        # Each command brings its own risks, which are judged here; the guard holds the bounds and looks after what moves.
        everything = replace(self._allowance, risks=frozenset(Risk))
        begin = beginning(target.endpoint, [(self.dialect, self.address)], everything)
        # A program may sleep while the drive moves, and a person at a prompt thinks.
        begin = msgspec.structs.replace(
            begin, longest_run_ns=int(max_run * 1e9), longest_silence_ns=say.NO_END_NS, cut_power=cut_power
        )
        return GuardedLine(target.endpoint, begin)

    def __repr__(self) -> str:
        return f"<Drive {self.name} on {self._line.endpoint.text}>"

    def __enter__(self) -> Drive:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    @property
    def commands(self) -> tuple[str, ...]:
        """The commands of its dialect; `servotap catalogue NAME` describes one."""
        return tuple(command.name for command in self.dialect.commands)

    # --- asking -------------------------------------------------------------------------------------------------------

    def read(self, command: str, field: str = "", **values: Any) -> Any:
        """Ask for a value and return it in its unit, a choice by its name.

        `field`: which one, where the reply has several. Raises UsageError for a command that does more than read, NotDone.
        """
        arguments.check(field=field)
        fields = self.ask(command, **values)
        if not field and len(fields) == 1:
            return next(iter(fields.values()))
        if field not in fields:
            asked = f"no field {field!r}" if field else "several fields"
            raise UsageError(f"the reply to {command} has {asked}: name one of {', '.join(fields) or 'none'}")
        return fields[field]

    def ask(self, command: str, **values: Any) -> dict[str, Any]:
        """Ask and return all fields of the reply. Raises as `read`."""
        built = self._build(command, values)
        if not built.risks <= {Risk.READ}:
            raise UsageError(f"{built.command.name} does more than read ({_words(built.risks)}): use send")
        return dict(self._send(built, frozenset(), wait=False, must=True).fields)

    def send(
        self,
        command: str,
        *,
        allow: Collection[str] = (),
        wait: bool = False,
        must: bool = True,
        force: bool = False,
        **values: Any,
    ) -> Reply:
        """Send a command and return the reply.

        Values are in the units of their fields, choices by name (`direction="cw"`); `allow`: risks that this command may have,
        besides those of the drive. `wait`: to the reply that says it is done. `must` False: a refusal or no answer raises
        nothing. `force`: also what the manual forbids. Raises Refused with nothing sent, UsageError, NotDone.
        """
        arguments.check(allow=allow)
        return self._send(self._build(command, values, force=force), _risks(allow), wait=wait, must=must)

    def _build(self, command: str, values: Mapping[str, Any], *, force: bool = False) -> Built:
        arguments.check(command=command)
        arguments.check_values(values)
        given = {name: _value(value) for name, value in values.items()}
        built = assemble(self.dialect, find_command(self.dialect, command), self.address, given, physical=True, complete=True)
        if built.refusals and not force:
            raise UsageError("; ".join(built.refusals))
        return built

    def _send(self, built: Built, allow: frozenset[Risk], *, wait: bool, must: bool) -> Reply:
        if self._closed:
            raise UsageError(f"{self.name} is closed")
        request = Request(built.item(), self._dialogue.dialects, frozenset({self.address}), built.command, self.address)
        allowance = request.allowance(replace(self._allowance, risks=self._allowance.risks | allow))
        try:
            request.check(allowance, self._spoken)
        except Refused as error:
            missing = sorted(risk.value for risk in built.risks - allowance.risks)
            if missing:
                error.add_note(f"from Python: allow={missing}")
            raise
        self._keep_distance(built)
        self._dialogue.gate = gate = self._gate.under(allowance)
        if request.acts:
            read_drive_state(self._dialogue, self.dialect, self.address)
        # Noted before it leaves: an error behind that must not hide that the drive may be moving.
        self._moving |= bool(built.risks & MAY_MOVE) and not _stops(built.command)
        until, done_ns = (Until.DONE, _DONE_NS) if wait else (Until.REPLY, 0)
        if request.answered:
            quiet_ns = _QUIET_NS if request.acts else 0
            exchange = self._dialogue.ask(request.item, self._timeout_ns, until=until, done_ns=done_ns, quiet_ns=quiet_ns)
        else:
            exchange = self._dialogue.ask(request.item, _QUIET_NS, quiet_ns=_QUIET_NS)
        if Risk.SETTING in built.risks:
            self._line.setting_ns = self._line.now_ns()
        gate.end_stream(next(iter(request.meant), None))
        self._tick()
        reply = _reply(built.command, exchange)
        if must and request.answered:
            self._expect(reply, wait)
        return reply

    def _tick(self) -> None:
        if self._log is not None:
            self._log.tick(self._line.now_ns())

    def _keep_distance(self, built: Built) -> None:
        before_ns = self._line.setting_ns
        if Risk.SETTING in built.risks and before_ns is not None:
            left_ns = before_ns + _SETTING_GAP_NS - self._line.now_ns()
            if left_ns > 0:
                self._dialogue.listen(left_ns)

    def _expect(self, reply: Reply, wait: bool) -> None:
        """Raise NotDone for a reply that is none, or says no."""
        if reply.outcome == Completion.SILENT:
            raise NotDone(f"{reply.command}: {self.name} did not answer within {self._timeout_ns / 1e6:g} ms", reply)
        if reply.outcome == Completion.FAILED:
            said = ", ".join(f"{name} {value}" for name, value in reply.fields.items())
            told = "; ".join(found.text for found in reply.findings)
            raise NotDone(f"{reply.command}: {self.name} refused it or failed ({said or told})", reply)
        if wait and reply.outcome == Completion.RUNNING:
            raise NotDone(f"{reply.command}: {self.name} has begun and did not say that it is done", reply)

    # --- the shaft ----------------------------------------------------------------------------------------------------

    def position(self) -> float:
        """Return where the shaft is, in degrees over all turns. Raises NotDone."""
        return self._looked(motion.position)

    def speed(self) -> float:
        """Return how fast the shaft turns, in rpm. Raises NotDone."""
        return self._looked(motion.speed)

    def _looked(self, look: Any) -> float:
        try:
            return float(look(plain_probe(self.dialect, self.address, self._gate)).value)
        except Inconclusive as error:
            raise NotDone(f"{self.name}: {error}", Reply("", Completion.SILENT.value, {}, {}, (), (), None)) from None

    def wait(self, seconds: float) -> list[Frame]:
        """Let time pass and return the frames that came; an emulated drive's time passes at once."""
        arguments.check(seconds=seconds)
        exchange = self._dialogue.listen(int(seconds * 1e9))
        self._tick()
        return [frame_of(answer.entry) for answer in exchange.answers]

    def stop(self) -> None:
        """Stop the drive, by a ramp if that works, and prove that the shaft stands. Raises NotStopped."""
        failure = stop(self._gate.under(stopping(self.address)), self.dialect, self.address).failure
        if failure:
            raise NotStopped(f"NOT STOPPED: {self.name}: {failure}")
        self._moving = False
        if isinstance(self._line, GuardedLine):
            self._line.tell(say.Standing())

    def _stop_anew(self) -> None:
        """Stop the drive by another guard where the first has gone. Raises NotStopped, after the power command."""
        self._line.close()
        try:
            self._line = self._open_line()
            gate = Gate(self._line, self._allowance, dialects=self._spoken)
            stop_or_cut(gate, self.dialect, self.address, self._cut_power)
        except NotStopped:
            raise
        except ServotapError as error:
            raise not_stopped(self.dialect, self.address, str(error), self._cut_power) from None
        if isinstance(self._line, GuardedLine):
            self._line.tell(say.Standing())

    def close(self) -> None:
        """Stop the drive if it may be moving, and give the port back. Raises NotStopped."""
        if self._closed:
            return
        self._closed = True
        try:
            if self._moving:
                try:
                    self.stop()
                except GuardLost:
                    self._stop_anew()
        finally:
            self._end_log()
            # A guard that was not told that the drive stands stops it by itself.
            self._line.close()


def _risks(words: Collection[str]) -> frozenset[Risk]:
    if isinstance(words, str):
        words = [words]
    return parse_allow(",".join(words))


def _words(risks: frozenset[Risk]) -> str:
    return ", ".join(sorted(risk.value for risk in risks - {Risk.READ}))


def _stops(command: Command) -> bool:
    return command.motion is not None and command.motion.kind is MotionKind.STOP


def _value(value: Any) -> Any:
    return int(value) if isinstance(value, bool) else value


def _reply(command: Command, exchange: Exchange) -> Reply:
    answers: list[Answer] = exchange.replies
    frames = tuple(frame_of(answer.entry) for answer in answers)
    last = frames[-1] if frames else None
    return Reply(
        command.name,
        exchange.completion.value,
        {} if last is None else last.fields,
        {} if last is None else last.units,
        frames,
        tuple(exchange.findings),
        answers[0].latency_ns if answers else None,
    )
