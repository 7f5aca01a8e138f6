"""The model of an LK drive: on or off, positions, control parameters, brake.

    off     motion commands are answered and not obeyed, neither then nor when the motor is on again
    on      0x81 stops and leaves it on

Rules kept here:
- Positions are hundredths of a degree over all turns, clockwise up; the angle within the turn goes with them.
- A motor that was let go or stopped on its way stands wherever it comes to rest: the model asks.
- What 0x93 leaves of the position is open, but for the turns: the model asks.
- Control parameters are moderate, and such that the motor can still move.

Not modelled: torque, limits at their ends, errors, what 0x19 stores.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from analyzer.catalogue import Form, Risk, Verb
from conformance import moving
from conformance.claim import Inconclusive
from conformance.claims import read_back_lk
from conformance.claims.ranges_lk import MODERATE, read_parameter
from conformance.claims.read_back_lk import TURN
from conformance.exchange import Exchange
from conformance.moving import MS
from conformance.session import Kind, Session

if TYPE_CHECKING:
    from hypothesis.strategies import SearchStrategy

#: Hundredths of a degree by which a position may be off; share and rpm by which a speed may.
PLAY, SPEED_SHARE, SPEED_PLAY = 40, 0.03, 2.0
#: The quirk of drives that drop the counted turns when they are turned off.
OFF_CLEARS = "lk-off-clears-turns"
FASTEST, SLOWEST, LONGEST = 300, 20, 0.75
#: Limits that are moderate all the same: the motor moves with them as it would without.
_KEPT_STRONG = {"torque_limit": (1500, 1900), "speed_limit": (0x02_2345, 0x02_0F23), "angle_limit": (0x2134_5678, 0x1134_5678)}


class LkSession(Session):
    """One LK drive and its model. `on`; `running`: rpm; `at`: position, None while it is not known; `held`: parameters."""

    on: bool
    running: float
    at: int | None
    held: dict[int, dict[str, int]]

    # --- begin and end --------------------------------------------------------------------------------------------

    def begin(self) -> None:
        """Turn on, stop, and call this place zero; read the parameters."""
        probe = self.probe
        self.forms = [
            f for f in self.dialect.by_verb[Verb.WRITE_PARAMETER].request_forms if f.layout.named["parameter"].fixed is not None
        ]
        moving.ready_to_move(probe)
        moving.stand_still(probe)
        probe.do("set_position", {"position": 0})
        self.on, self.running, self.at = True, 0.0, 0
        self.turned = probe.read(Verb.READ_SINGLE_TURN)
        self.held = {}
        if not self._has_parameters():
            self.before: dict[int, dict[str, int]] = {}
        else:
            self.held = {read_back_lk.number_of(f): self._parameter(f) for f in self.forms}
            self.before = dict(self.held)
        self.compare()

    def end(self) -> None:
        """Turn on, stop, and put the parameters back."""
        for form in self.forms:
            number = read_back_lk.number_of(form)
            if self.held.get(number) != self.before.get(number):
                self.probe.ask(Verb.WRITE_PARAMETER, self.before[number], form=form)
        self.probe.ask(Verb.MOTOR_ON)
        moving.stand_still(self.probe)

    def _has_parameters(self) -> bool:
        return not self.probe.ask(Verb.READ_PARAMETER, {"parameter": read_back_lk.number_of(self.forms[0])}).silent

    def _parameter(self, form: Form) -> dict[str, int]:
        return read_parameter(self.probe, read_back_lk.number_of(form))

    # --- comparing ------------------------------------------------------------------------------------------------

    def compare(self) -> None:
        """Compare state, speed and position with the model."""
        probe = self.probe
        state = probe.reply(probe.ask(Verb.READ_STATE_1, quiet_ns=0)).values
        if "state" not in state:
            raise Inconclusive("read_state_1 has no state")
        expected = 0x00 if self.on else 0x10
        if state["state"] != expected:
            raise self.differs("the state", f"{expected:#04x}", f"{state['state']:#04x}")
        rpm = moving.speed(probe).value
        if self.on and abs(rpm - self.running) > SPEED_PLAY + SPEED_SHARE * abs(self.running):
            raise self.differs("the speed", f"{self.running:.0f} rpm", f"{rpm:.0f} rpm")
        if not self.running:
            self._compare_position()

    def _compare_position(self) -> None:
        now = self.probe.read(Verb.READ_POSITION)
        if self.at is None:
            self.at = now
            return
        if abs(now - self.at) > PLAY:
            if not self.on and OFF_CLEARS in self.probe.claim.quirks and (now - self.at + PLAY) % TURN <= 2 * PLAY:
                self.probe.meets(OFF_CLEARS)
                self.turned = (self.turned + self.at - now) % TURN
                self.at = now
                return
            raise self.differs("the position", self.at, now)

    # --- on, off, stop --------------------------------------------------------------------------------------------

    def _asked(self, exchange: Exchange) -> None:
        self.clean(exchange)
        if exchange.silent:
            self.sound()
            assert exchange.command is not None  # it was asked for
            raise self.differs(f"{exchange.command.name} is not answered", "a reply", "silence", exchange)

    def _motor_on(self) -> None:
        self._asked(self.probe.ask(Verb.MOTOR_ON))
        self.on = True
        self.probe.wait(200 * MS)

    def _motor_off(self) -> None:
        self._asked(self.probe.ask(Verb.MOTOR_OFF))
        self.on = False
        self._rest()

    def _stop(self) -> None:
        self._asked(self.probe.ask(Verb.STOP))
        self._rest()

    def _rest(self) -> None:
        self.standing()
        if self.running:
            self.at = None
        self.running = 0.0

    # --- motion ---------------------------------------------------------------------------------------------------

    def _run_speed(self, speed: int) -> None:
        self._asked(self.probe.ask(Verb.RUN_SPEED, {"speed": speed}))
        if not self.on:
            self.probe.wait(200 * MS)
            return
        self.running, self.at = speed / 600, None
        self._settle_speed()

    def _settle_speed(self) -> None:
        """Wait until the speed no longer changes."""
        before = moving.speed(self.probe).value
        for _ in range(60):
            self.probe.wait(100 * MS)
            now = moving.speed(self.probe).value
            if abs(now - before) < 0.5:
                return
            before = now

    def _move(self, name: str, values: Mapping[str, int], distance: int) -> None:
        self._asked(self.probe.ask(name, values))
        start = self.at
        self.standing()
        if self.on and start is not None:
            self.at = start + distance

    def _move_increment_limited(self, position: int, max_speed: int) -> None:
        self._move("move_increment_limited", {"position": position, "max_speed": max_speed}, position)

    def _move_increment(self, position: int) -> None:
        self._move("move_increment", {"position": position}, position)

    def _move_multi_turn_limited(self, distance: int, max_speed: int) -> None:
        target = (self.at or 0) + distance
        self.probe.gate.note_position(moving.position(self.probe).value, self.probe.address)
        self._move("move_multi_turn_limited", {"position": target, "max_speed": max_speed}, distance)

    def _move_single_turn_limited(self, direction: int, angle: int, max_speed: int) -> None:
        now = (self.turned + (self.at or 0)) % TURN
        way = (angle - now) % TURN if direction == 0 else -((now - angle) % TURN)
        self._move("move_single_turn_limited", {"direction": direction, "angle": angle, "max_speed": max_speed}, way)

    # --- positions, parameters, brake -----------------------------------------------------------------------------

    def _set_position(self, position: int) -> None:
        self._asked(self.probe.ask("set_position", {"position": position}))
        if self.at is not None:
            self.turned = (self.turned + self.at - position) % TURN
        self.at = position

    def _clear_turns(self) -> None:
        before = self.at
        self._asked(self.probe.ask(Verb.CLEAR_TURNS))
        now = self.probe.read(Verb.READ_POSITION)
        if abs(now) > TURN + PLAY:
            raise self.differs("the position after 0x93", "less than a turn", now)
        if before is not None:
            self.turned = (self.turned + before - now) % TURN
        self.at = now

    def _parameter_step(self, which: int, values: int) -> None:
        form = self.forms[which % len(self.forms)]
        number = read_back_lk.number_of(form)
        wanted = moderate(form, values)
        self._asked(self.probe.ask(Verb.WRITE_PARAMETER, wanted, form=form))
        self.held[number] = wanted
        for each in self.forms:
            held, got = self.held[read_back_lk.number_of(each)], self._parameter(each)
            if got != held:
                raise self.differs(f"the parameter {each.name}", held, got)

    def _brake(self) -> None:
        """Hold the standing shaft by the brake, and release it."""
        command = self.dialect.by_verb[Verb.BRAKE]
        for control in (0, 1):
            self._asked(self.probe.ask(command, {"brake_control": control}))
            state = self.probe.read(command, "", {"brake_control": 0x10})
            if state != control:
                raise self.differs("the brake", control, state)

    def _look(self) -> None:
        """Read the angle within the turn, which goes with the position."""
        angle = self.probe.read(Verb.READ_SINGLE_TURN)
        if self.at is not None and not self.running:
            expected = (self.turned + self.at) % TURN
            if min((angle - expected) % TURN, (expected - angle) % TURN) > 2 * PLAY:
                raise self.differs("the angle within the turn", expected, angle)


def moderate(form: Form, which: int) -> dict[str, int]:
    """Return moderate values of a parameter with which the motor moves as without."""
    values = read_back_lk.moderate(form, which)
    return {n: _KEPT_STRONG[n][which] if n in _KEPT_STRONG else v for n, v in values.items()}


# --- what is drawn ----------------------------------------------------------------------------------------------------


def _nothing(session: LkSession) -> SearchStrategy[dict[str, int]]:
    from hypothesis import strategies as st

    return st.just({})


def _fastest(session: LkSession) -> int:
    return min(FASTEST, int(session.room.bounds.speed or FASTEST))


def _limits(session: LkSession) -> SearchStrategy[int]:
    from hypothesis import strategies as st

    return st.integers(min(SLOWEST * 600, _fastest(session) * 600), min(MODERATE, _fastest(session) * 600))


def _distances(session: LkSession) -> SearchStrategy[int]:
    from hypothesis import strategies as st

    units = int(min(LONGEST, session.room.bounds.turns or LONGEST) * TURN)
    return st.one_of(st.integers(units // 8, units), st.integers(-units, -units // 8))


def _draw_run(session: LkSession) -> SearchStrategy[dict[str, int]]:
    from hypothesis import strategies as st

    top = min(100, _fastest(session)) * 600
    return st.fixed_dictionaries({"speed": st.one_of(st.integers(SLOWEST * 300, top), st.integers(-top, -SLOWEST * 300))})


def _draw_increment(session: LkSession) -> SearchStrategy[dict[str, int]]:
    from hypothesis import strategies as st

    return st.fixed_dictionaries({"position": _distances(session), "max_speed": _limits(session)})


def _draw_free_increment(session: LkSession) -> SearchStrategy[dict[str, int]]:
    from hypothesis import strategies as st

    return st.fixed_dictionaries({"position": _distances(session)})


def _draw_multi(session: LkSession) -> SearchStrategy[dict[str, int]]:
    from hypothesis import strategies as st

    return st.fixed_dictionaries({"distance": _distances(session), "max_speed": _limits(session)})


def _draw_single(session: LkSession) -> SearchStrategy[dict[str, int]]:
    """Draw an angle that is not where the shaft is: nobody can say whether that is no way or a turn."""
    from hypothesis import strategies as st

    now = (session.turned + (session.at or 0)) % TURN
    angles = st.integers(TURN // 16, TURN - TURN // 16).map(lambda away: (now + away) % TURN)
    return st.fixed_dictionaries({"direction": st.integers(0, 1), "angle": angles, "max_speed": _limits(session)})


def _draw_position(session: LkSession) -> SearchStrategy[dict[str, int]]:
    from hypothesis import strategies as st

    return st.fixed_dictionaries({"position": st.integers(-10 * TURN, 10 * TURN)})


def _draw_parameter(session: LkSession) -> SearchStrategy[dict[str, int]]:
    from hypothesis import strategies as st

    allowed = session.probe.rig.allowed
    command = session.dialect.by_verb[Verb.WRITE_PARAMETER]
    which = [
        n
        for n, form in enumerate(session.forms)
        if command.risks({"parameter": read_back_lk.number_of(form)}) <= allowed
        and (session.probe.drive is not None or form.name.endswith(("_limit", "_ramp")))
    ]
    return st.fixed_dictionaries({"which": st.sampled_from(which), "values": st.integers(0, 1)})


def _stands(session: LkSession) -> bool:
    return not session.running and session.at is not None


def _writes(session: LkSession) -> bool:
    return bool(session.held)


def _unbounded_speed(session: LkSession) -> bool:
    return _stands(session) and session.room.bounds.speed is None


_MOVING = frozenset({Risk.MOTION})
_SETTING = frozenset({Risk.SETTING})
_TORQUE = frozenset({Risk.TORQUE})

_EVERY = (
    Kind("parameter_step", _draw_parameter, _writes, _SETTING),
    Kind("motor_on", _nothing, risks=_MOVING),
    Kind("motor_off", _nothing, risks=_TORQUE),
    Kind("stop", _nothing, lambda s: s.on, _MOVING),
    Kind("run_speed", _draw_run, risks=_MOVING | {Risk.UNBOUNDED}),
    Kind("move_increment", _draw_free_increment, _unbounded_speed, _MOVING),
    Kind("move_increment_limited", _draw_increment, _stands, _MOVING),
    Kind("move_multi_turn_limited", _draw_multi, _stands, _MOVING),
    Kind("move_single_turn_limited", _draw_single, _stands, _MOVING),
    Kind("set_position", _draw_position, _stands, _SETTING),
    Kind("clear_turns", _nothing, _stands, _SETTING),
    Kind("brake", _nothing, lambda s: _stands(s) and s.on, _TORQUE),
    Kind("look", _nothing),
)
KINDS: Mapping[str, Kind] = {kind.name: kind for kind in _EVERY}
LkSession.kinds = KINDS

#: Which kinds of steps each variant draws; a name that stands twice is drawn twice as often.
VARIANTS: Mapping[str, tuple[str, ...]] = {
    "settings": ("parameter_step", "parameter_step", "set_position", "clear_turns", "brake", "motor_on", "motor_off", "look"),
    "motion": (
        "run_speed", "stop", "move_increment", "move_increment_limited", "move_multi_turn_limited", "move_single_turn_limited",
        "set_position", "look",
    ),
    "mixed": (
        "motor_on", "motor_on", "motor_off", "stop", "run_speed", "move_increment_limited", "move_multi_turn_limited",
        "move_single_turn_limited", "set_position", "clear_turns", "parameter_step", "brake", "look",
    ),
}  # fmt: skip
