"""The model of an MKS drive: mode, settings, enabled, moving, position; and the random steps for it.

    pulse modes     enabling, motion and all that needs a bus mode are refused
    bus modes       disabled: motion is refused; enabled: it begins (1), and ends (2) where the dialect reports the end
    respond 0       motion is not answered         active 0     its end is not told

Rules kept here:
- Positions are counts of the encoder since the last zero. The first move by pulses shows
  the meaning of its direction bit; then the drive must keep to it.
- After a change of mode the manual does not say whether the motor is enabled (CAN: `axis_lock` says it): the model asks.
- After a stop, an ended run or a release, the shaft may rest anywhere: the model asks.
- The manual does not say how a setting affects a current motion. So settings that motion depends on are sent only while the
  shaft stands.
- Values are those of the catalogue; a setting outside them is refused and changes nothing.
- Values of motion are drawn within the bounds of the session. Speeds are as sent: at a finer subdivision than 16 the
  shaft turns slower.
- On hardware some settings stay unchanged (`_STRONG`): those that motion needs, and those that depend on a switch.

Not modelled: limits and homing (the places of a real drive's switches are unknown), the ramp, the link.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy

from analyzer.catalogue import Command, MotionKind, Risk, Verb
from analyzer.layout import Effect
from conformance.model import limits, strategies
from conformance.model.session import MOVING, SETTING, TORQUE, UNBOUNDED, Session, Values, step, up_to
from conformance.motion import motion as moving
from conformance.motion import ramp
from conformance.motion.motion import MS
from conformance.talk import samples, settings
from conformance.talk.acceptance import Acceptance, acceptance, can_refuse, need_reliable_replies, without_repeats
from conformance.talk.exchange import Exchange
from conformance.talk.probe import Until
from conformance.talk.restarts import restart

#: Counts by which a position may be off, and the share and rpm by which a speed may.
PLAY, SPEED_SHARE, SPEED_PLAY = 30, 0.03, 2.0
#: Nothing is said of F1 until so long after a motion.
QUIET_NS = 1_200 * MS
#: How late a reply during motion was seen to come.
LATE_NS = 800 * MS
#: After a ramp a real motor takes so long to come to its speed.
SETTLE_SPEED_NS = 250 * MS
#: The longest move, in turns, and speeds and accelerations of motion where no bound is lower.
LONGEST, SLOWEST, FASTEST, GENTLEST, STEEPEST = 0.5, 30, 300, 200, 249
#: Settings that a motor cannot move without, or that a switch decides.
_STRONG = frozenset({"current", "home_current", "holding_current", "stall_tolerance", "end_limit", "limit_remap", "protection"})
#: Settings that motion depends on. The subdivision changes what most others do, so it is drawn twice as often.
_TELLING = (
    Verb.SET_SUBDIVISION,
    Verb.SET_WORK_MODE,
    Verb.SET_SUBDIVISION,
    Verb.SET_RESPOND,
    Verb.SET_DIRECTION,
    Verb.SET_AXIS_LOCK,
)


# --- what is drawn ----------------------------------------------------------------------------------------------------


def settable(session: MksSession) -> list[Command]:
    """Return the settings that a session may set: none of the link, of power-on or of the flash."""
    found = []
    for command in session.dialect.commands:
        named = command.request_forms[0].layout.named
        stored = command.verb.value.startswith("set_") and bool(named) and can_refuse(command)
        grouped = any(field.effect is Effect.GROUP for field in named.values())
        if not stored or settings.changes_link(command) or grouped or "execute" in named:
            continue
        if command.verb is not Verb.SET_ZERO_MODE and command.all_risks <= session.probe.rig.allowed:
            found.append(command)
    return found


def _values(session: MksSession, command: Command, *, telling: bool) -> Values:
    form = command.request_forms[0]
    drawn: dict[str, Any] = {"command": st.just(command.code)}
    plain = samples.sample(session.dialect, command, form)
    for name, field in form.layout.named.items():
        if name in _STRONG and (session.probe.drive is None or telling):
            drawn[name] = st.just(plain[name])
        elif telling and field.effect is Effect.SUBDIVISION:
            drawn[name] = st.sampled_from([n for n in (128, 0, 16, 64, 32) if field.allows(n)])
        else:
            drawn[name] = strategies.inside(field, session.leeway)
    return st.fixed_dictionaries(drawn)


#: Strategies of settings, which are made once for each dialect, model, set of allowed risks and bounds.
_made: dict[tuple[Any, ...], Values] = {}


def _made_once(make: Callable[[MksSession], Values]) -> Callable[[MksSession], Values]:
    def draw(session: MksSession) -> Values:
        probe = session.probe
        key = (make, session.dialect.name, session.dialect.model, probe.rig.allowed, probe.drive is None, session.leeway)
        if key not in _made:
            _made[key] = make(session)
        return _made[key]

    return draw


@_made_once
def _settings(session: MksSession) -> Values:
    return st.one_of([_values(session, c, telling=False) for c in settable(session)])


@_made_once
def _telling(session: MksSession) -> Values:
    return st.one_of([_values(session, c, telling=True) for v in _TELLING for c in settable(session) if c.verb is v])


@_made_once
def _strays(session: MksSession) -> Values:
    drawn = []
    for command in settable(session):
        layout = command.request_forms[0].layout
        if any(limits.beyond(f) for f in layout.named.values()):
            drawn.append(st.tuples(st.just(command.code), strategies.strays(layout, session.leeway)))
    return st.one_of(drawn).map(lambda pair: {"command": pair[0], **pair[1].values})


def _move_by(unit: str) -> Callable[[MksSession], Mapping[str, SearchStrategy[int]]]:
    def draw(session: MksSession) -> Mapping[str, SearchStrategy[int]]:
        longest = min(LONGEST, session.leeway.bounds.turns or LONGEST)
        # At the subdivision of the suite; the same pulses go less far at finer ones.
        command = session.dialect.by_verb[Verb.MOVE_RELATIVE_AXIS if unit == "counts" else Verb.MOVE_RELATIVE_PULSES]
        per_turn = moving.units_per_turn(session.dialect, command)
        return {unit: up_to(int(longest * per_turn)), **session.paces}

    return draw


# --- the model --------------------------------------------------------------------------------------------------------


class MksSession(Session):
    """One MKS drive and its model.

    `mode`: the work mode by name. `enabled`: None where the manual does not say. `held`: settings by field, as far as they are
    known.
    """

    VARIANTS: ClassVar = {
        "settings": "setting setting stray user_id restart look",
        "motion": (
            "run_speed stop move_relative_pulses move_absolute_pulses move_relative_axis move_absolute_axis "
            "emergency_stop set_zero look"
        ),
        "mixed": (
            "telling telling stray enable enable restart run_speed stop move_relative_pulses move_absolute_axis "
            "move_relative_axis move_absolute_pulses emergency_stop set_zero look"
        ),
    }
    mode: str
    enabled: bool | None
    held: dict[str, int]

    # --- what is drawn --------------------------------------------------------------------------------------------

    @property
    def stands(self) -> bool:
        """Whether the shaft stands."""
        return not self.running

    @property
    def paces(self) -> dict[str, SearchStrategy[int]]:
        """Speed and acceleration within the bounds."""
        bounds = self.leeway.bounds
        fastest = min(FASTEST, int(bounds.speed or FASTEST))
        steepest = min(STEEPEST, int(bounds.acceleration or STEEPEST))
        slowest, gentlest = min(SLOWEST, fastest), min(GENTLEST, steepest)
        return {"speed": st.integers(slowest, fastest), "acceleration": st.integers(gentlest, steepest)}

    @property
    def stops(self) -> tuple[Command, ...]:
        """The stops by a ramp."""
        return tuple(c for c in self.dialect.motions(MotionKind.STOP) if moving.of(c).acceleration)

    @property
    def enables(self) -> SearchStrategy[int]:
        """To enable or to let go. To a motor that may be enabled already, letting go is what changes something."""
        if Risk.TORQUE not in self.probe.rig.allowed:
            return st.just(1)
        return st.sampled_from([0, 1] if self.enabled else [1, 0])

    # --- begin and end --------------------------------------------------------------------------------------------

    def begin(self) -> None:
        """Set a bus mode, 16 subdivisions and both replies, enable, stop, and make this place zero."""
        probe, verbs = self.probe, self.dialect.by_verb
        self.ways: dict[tuple[str, int], int] = {}
        self.quiet_from_ns = 0
        self.mode = moving.bus_modes(self.dialect)[-1]
        moving.set_mode(probe, self.mode)
        probe.do(Verb.ENABLE, {"enabled": 1})
        self.held = {"subdivision": moving.SUBDIVISION, "motor_direction": 0}
        probe.do(Verb.SET_SUBDIVISION, {"subdivision": moving.SUBDIVISION})
        probe.do(Verb.SET_DIRECTION, {"motor_direction": 0})
        if Verb.SET_RESPOND in verbs:
            probe.do(Verb.SET_RESPOND, {"respond": 1, "active": 1})
            self.held |= {"respond": 1, "active": 1}
        moving.stand_still(probe)
        probe.do(Verb.SET_ZERO)
        for command in self.dialect.commands:
            if command.readable:
                self.held |= self._stored(command)
        self.held["work_mode"] = moving.choice(verbs[Verb.SET_WORK_MODE], "work_mode", self.mode)
        self.enabled, self.running, self.at = True, 0.0, 0
        self.compare()

    def end(self) -> None:
        """Stop, and leave the replies to motion on."""
        if "respond" in self.held:
            self.probe.ask(Verb.SET_RESPOND, {"respond": 1, "active": 1})
        if self.by_bus:
            # The end of a stop is told unasked: a request that is sent meanwhile would collide with it.
            self.probe.ask(Verb.STOP_SPEED, {"acceleration": moving.GENTLE}, until=Until.DONE, timeout_ns=5_000 * MS)
        moving.wait_standing(self.probe)

    @property
    def by_bus(self) -> bool:
        """Whether the bus moves the motor."""
        return self.mode in moving.bus_modes(self.dialect)

    @property
    def ready(self) -> bool:
        """Whether motion begins. Asks the drive where the manual does not say."""
        if self.by_bus and self.enabled is None:
            self.enabled = bool(self.probe.read(Verb.READ_ENABLED))
        return self.by_bus and bool(self.enabled)

    def _stored(self, command: Command) -> dict[str, int]:
        """Return what a parameter read says of a setting, nothing where it cannot be read."""
        return settings.read_back(self.probe, command, quiet_ns=0)[0] or {}

    # --- comparing ------------------------------------------------------------------------------------------------

    def compare(self) -> None:
        """Compare position, speed and enabled with the model."""
        probe = self.probe
        speed, rpm = abs(probe.read(Verb.READ_SPEED)), abs(self.running)
        self.expect(f"{rpm:.0f} rpm", f"{speed} rpm", "the speed", holds=abs(speed - rpm) <= SPEED_PLAY + SPEED_SHARE * rpm)
        if not self.running:
            position = probe.read(Verb.READ_POSITION)
            if self.at is None:
                self.at = position
            near = abs(position - self.at) <= PLAY
            self.expect(f"{self.at} counts", f"{position} counts", "the position", holds=near)
        if self.by_bus and self.enabled is not None:
            self.expect(int(self.enabled), probe.read(Verb.READ_ENABLED), "enabled")

    def _expect_answer(self, exchange: Exchange, expected: Acceptance, what: str) -> None:
        answer = acceptance(self.probe, exchange)
        self.expect(expected.value, answer.value, f"{what} is {answer.value}", exchange=exchange)

    # --- settings -------------------------------------------------------------------------------------------------

    @step(_settings, risks=SETTING, name="setting")
    @step(_telling, possible=lambda s: s.stands, risks=SETTING, name="telling")
    @step(_strays, risks=SETTING, name="stray")
    def set_values(self, command: int, **values: int) -> None:
        """Set values, allowed or not; the drive does it or refuses, and what can be read reads as it should."""
        setting = next(c for c in settable(self) if c.code == command)
        form = next(f for f in setting.request_forms if values.keys() == f.layout.named.keys())
        allowed = all(f.allows(values[n]) for n, f in form.layout.named.items()) and (not setting.modes or self.by_bus)
        exchange = self.probe.ask(setting, values, form=form)
        self._expect_answer(exchange, Acceptance.DONE if allowed else Acceptance.REFUSED, setting.name)
        before = dict(self.held)
        if allowed:
            self.held |= values
            self._follow(setting, before)
        if setting.readable:
            self._compare_stored(setting, exchange)

    def _compare_stored(self, command: Command, exchange: Exchange | None) -> None:
        """Compare a setting that can be read with the model."""
        got = {n: v for n, v in self._stored(command).items() if n in self.held}
        self.expect({n: self.held[n] for n in got}, got, f"{command.name} reads", exchange=exchange)

    def _follow(self, command: Command, before: Mapping[str, int]) -> None:
        """Take over what else a setting changes."""
        if command.verb is Verb.SET_WORK_MODE:
            same = before.get("work_mode") == self.held["work_mode"]
            names = command.request_forms[0].layout.named["work_mode"].choice_names
            self.mode = names[self.held["work_mode"]]
            self._rest()
            lock = self.held.get("axis_lock")
            self.enabled = None if lock is None or same else bool(lock)
        elif command.verb is Verb.SET_DIRECTION:
            self.ways = {}

    @step(
        lambda s: {"user_id": st.integers(0, 0xFFFFFFFF)},
        possible=lambda s: Verb.WRITE_USER_ID in s.dialect.by_verb,
        risks=SETTING,
    )
    def user_id(self, user_id: int) -> None:
        """Write the user's number, and read it."""
        self.probe.do(Verb.WRITE_USER_ID, {"user_id": user_id})
        self.expect(user_id, self.probe.read(Verb.READ_USER_ID), "the user's number")

    @step(risks=TORQUE | {Risk.POWER_ON})
    def restart(self) -> None:
        """Restart the drive; what is stored reads as before."""
        restart(self.probe)
        self.running, self.at, self.enabled = 0.0, None, None
        moving.wait_standing(self.probe)
        for command in self.dialect.commands:
            if command.readable:
                self._compare_stored(command, None)

    # --- enabling and stopping ------------------------------------------------------------------------------------

    @step(lambda s: {"enabled": s.enables}, risks=MOVING)
    def enable(self, enabled: int) -> None:
        """Enable the motor, or let the shaft go."""
        exchange = self.probe.ask(Verb.ENABLE, {"enabled": enabled})
        self._expect_answer(exchange, Acceptance.DONE if self.by_bus else Acceptance.REFUSED, f"enable {enabled}")
        if self.by_bus:
            self.enabled = bool(enabled)
            if not enabled:
                self._rest()
                self.at = None

    @step(possible=lambda s: s.by_bus, risks=MOVING)
    def emergency_stop(self) -> None:
        """Stop at once."""
        self._expect_answer(self.probe.ask(Verb.EMERGENCY_STOP), Acceptance.DONE, "emergency_stop")
        self._rest()

    @step(
        lambda s: {"motion": st.integers(0, len(s.stops) - 1), "acceleration": s.paces["acceleration"]},
        possible=lambda s: not s.by_bus or s.enabled is True,
        risks=MOVING,
    )
    def stop(self, motion: int, acceleration: int) -> None:
        """Stop by the stop of one of the motions."""
        verb = self.stops[motion].verb
        self._expect_told(self._begin(verb, {"acceleration": acceleration}), self.ready, verb.value)
        self._rest()

    def _rest(self) -> None:
        """Take it that the shaft comes to rest somewhere."""
        if self.running:
            self.standing()
            self.at = None
        self.running = 0.0
        self.quiet_from_ns = self.probe.gate.now_ns()

    # --- motion ---------------------------------------------------------------------------------------------------

    def _begin(self, verb: Verb, values: Mapping[str, Any], counts: int = 0) -> Exchange:
        """Ask for a motion and listen until it has said all that it will; `counts`: how far it goes."""
        respond, active = self.held.get("respond", 1), self.held.get("active", 1)
        tells = moving.of(self.dialect.by_verb[verb]).tells_end
        lasts_ns = 0.0
        if counts:
            turns = counts / self.dialect.counts_per_turn
            lasts_ns = ramp.move_ns(turns, self._shaft_rpm(values["speed"]), values["acceleration"])
        elif self.running:
            lasts_ns = ramp.ramp_ns(self.running, 0, values["acceleration"])
        # Where the end is not to be told, it is listened for until it is over.
        until = Until.REPLY if not tells else Until.DONE if respond and active else Until.TIMEOUT
        if not respond:
            until = Until.TIMEOUT
        timeout_ns = {Until.TIMEOUT: int(lasts_ns) + 500 * MS, Until.DONE: int(lasts_ns) + 8_000 * MS}.get(until)
        return self.readable(self.probe.ask(verb, values, until=until, timeout_ns=timeout_ns))

    def _expect_told(self, exchange: Exchange, ready: bool, what: str) -> None:
        """Compare the replies to a motion with those that it should get."""
        respond, active = self.held.get("respond", 1), self.held.get("active", 1)
        command = exchange.command
        assert command is not None  # it was asked for
        expected: list[int] = []
        if not respond:
            seen = exchange.status()
        elif moving.of(command).tells_end:
            expected = ([1, 2] if active else [1]) if ready else [0]
            seen = without_repeats(exchange.status())
            # Real drives were seen to answer late while they move, even behind the end of it.
            if len(seen) < len(expected):
                seen += self.probe.listen(LATE_NS).status()
            if sorted(seen) == expected:
                seen = expected
        else:
            seen = [int(acceptance(self.probe, exchange) is Acceptance.DONE)] if exchange.answers else []
            expected = [int(ready)]
        if len(seen) < len(expected):
            need_reliable_replies(self.probe, quiet_ns=0)
        self.expect(_statuses(expected), _statuses(seen), f"{what} is answered {_statuses(seen)}", exchange=exchange)

    @step(lambda s: {"direction": st.integers(0, 1), **s.paces}, risks=UNBOUNDED)
    def run_speed(self, direction: int, speed: int, acceleration: int) -> None:
        """Run at a speed; the first run shows which way a direction means."""
        ready = self.ready
        exchange = self._begin(Verb.RUN_SPEED, {"direction": direction, "speed": speed, "acceleration": acceleration})
        self._expect_told(exchange, ready, "run_speed")
        if not ready:
            return
        rpm = self._shaft_rpm(speed)
        self.probe.wait(int((abs(self.running) + rpm) * ramp.step_ns(acceleration)) + SETTLE_SPEED_NS)
        seen = moving.speed(self.probe).value
        self.running, self.at = rpm, None
        if abs(seen) >= 1:
            same = self._way("run_speed", direction, 1 if seen > 0 else -1) * seen > 0
            what = f"run_speed with direction {direction} turns"
            self.expect("as before", "as before" if same else "the other way", what, exchange=exchange)

    def _shaft_rpm(self, speed: int) -> float:
        highest = self.dialect.mode_speeds.get(self.mode, 3000)
        rule, subdivision = self.dialect.subdivision, self.held["subdivision"]
        assert rule is not None  # every MKS drive has one
        sent = min(speed, highest)
        return sent if subdivision in rule.plain else sent * rule.counted_at / (subdivision or rule.largest)

    def _way(self, name: str, direction: int, seen: int) -> int:
        """Return which way a direction means; learnt from the first motion, the other direction is the opposite."""
        if (name, direction) not in self.ways:
            self.ways[name, direction], self.ways[name, 1 - direction] = seen, -seen
        return self.ways[name, direction]

    @step(_move_by("pulses"), possible=lambda s: s.stands, risks=MOVING)
    def move_relative_pulses(self, pulses: int, speed: int, acceleration: int) -> None:
        """Move by pulses."""
        values = {"direction": int(pulses < 0), "pulses": abs(pulses), "speed": speed, "acceleration": acceleration}
        self._move_pulses(Verb.MOVE_RELATIVE_PULSES, values, pulses)

    @step(_move_by("pulses"), possible=lambda s: s.stands, risks=MOVING)
    def move_absolute_pulses(self, pulses: int, speed: int, acceleration: int) -> None:
        """Move to a place counted in pulses."""
        start = self.probe.read(Verb.READ_PULSES)
        self._note_position(start)
        values = {"position": start + pulses, "speed": speed, "acceleration": acceleration}
        self._move_pulses(Verb.MOVE_ABSOLUTE_PULSES, values, pulses)

    @step(_move_by("counts"), possible=lambda s: s.stands, risks=MOVING)
    def move_relative_axis(self, counts: int, speed: int, acceleration: int) -> None:
        """Move by counts of the encoder."""
        values = {"position": counts, "speed": speed, "acceleration": acceleration}
        self._move(Verb.MOVE_RELATIVE_AXIS, values, counts)

    @step(_move_by("counts"), possible=lambda s: s.stands, risks=MOVING)
    def move_absolute_axis(self, counts: int, speed: int, acceleration: int) -> None:
        """Move to a place counted by the encoder."""
        start = self._start()
        self._note_position()
        values = {"position": start + counts, "speed": speed, "acceleration": acceleration}
        self._move(Verb.MOVE_ABSOLUTE_AXIS, values, counts)

    def _note_position(self, pulses: int | None = None) -> None:
        """Tell the gate where the shaft is, so that it can say how far a move to a place goes."""
        probe = self.probe
        probe.gate.note_position(moving.position(probe).value, probe.address, pulses)

    def _start(self) -> int:
        return self.probe.read(Verb.READ_POSITION) if self.at is None else self.at

    def _move_pulses(self, verb: Verb, values: Mapping[str, int], pulses: int) -> None:
        counts = moving.counts_of(self.dialect, self.dialect.by_verb[verb], abs(pulses), self.held["subdivision"])
        self._move(verb, values, counts, int(pulses < 0))

    def _move(self, verb: Verb, values: Mapping[str, int], counts: int, direction: int | None = None) -> None:
        """Move a standing shaft by counts; `direction`: of a move by pulses, whose way is learnt."""
        ready = self.ready
        start = self._start()
        exchange = self._begin(verb, values, counts)
        self._expect_told(exchange, ready, verb.value)
        if not ready:
            return
        self.standing()
        if direction is not None:
            gone = self.probe.read(Verb.READ_POSITION) - start
            if abs(gone) > PLAY:
                counts *= self._way(verb.value, direction, 1 if gone > 0 else -1)
        self.at, self.running = start + counts, 0.0
        self.quiet_from_ns = self.probe.gate.now_ns()

    # --- looking --------------------------------------------------------------------------------------------------

    @step(possible=lambda s: s.stands, risks=SETTING)
    def set_zero(self) -> None:
        """Make this place zero."""
        self._expect_answer(self.probe.ask(Verb.SET_ZERO), Acceptance.DONE, "set_zero")
        self.at = 0

    @step()
    def look(self) -> None:
        """Read what else there is, once the motor has been let alone for a while."""
        probe = self.probe
        probe.wait(self.quiet_from_ns + QUIET_NS - probe.gate.now_ns())
        status = probe.read(Verb.READ_STATUS)
        if self.by_bus:
            self.expect(4 if self.running else 1, status, "F1")
        self.expect(0, probe.read(Verb.READ_PROTECTION), "3E")
        if not self.running:
            parts = probe.reply(probe.ask(Verb.READ_ENCODER_CARRY)).values
            whole = parts["carry"] * self.dialect.counts_per_turn + parts["encoder"]
            self.expect(self.at, whole, "30", holds=self.at is None or abs(whole - self.at) <= PLAY)


def _statuses(seen: list[int]) -> str:
    return " then ".join(map(str, seen)) or "by silence"
