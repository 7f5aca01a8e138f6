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

from analyzer.catalogue import Form, Verb
from conformance.claim import Inconclusive
from conformance.claims import read_back_lk
from conformance.claims.ranges_lk_parameters import read_parameter
from conformance.claims.read_back_lk import TURN
from conformance.model.session import Session
from conformance.motion import motion
from conformance.motion.motion import MS
from conformance.talk.exchange import Exchange

if TYPE_CHECKING:
    pass

#: Hundredths of a degree by which a position may be off; share and rpm by which a speed may.
PLAY, SPEED_SHARE, SPEED_PLAY = 40, 0.03, 2.0
#: The quirk of drives that drop the counted turns when they are turned off.
OFF_CLEARS = "lk-off-clears-turns"
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
        motion.ready_to_move(probe)
        motion.stand_still(probe)
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
        motion.stand_still(self.probe)

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
        rpm = motion.speed(probe).value
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
        before = motion.speed(self.probe).value
        for _ in range(60):
            self.probe.wait(100 * MS)
            now = motion.speed(self.probe).value
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
        self.probe.gate.note_position(motion.position(self.probe).value, self.probe.address)
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
        # That and its neighbour; `_look` reads all.
        self._compare_parameters([form, self.forms[(which + 1) % len(self.forms)]])

    def _compare_parameters(self, forms: list[Form]) -> None:
        for form in forms:
            held, got = self.held[read_back_lk.number_of(form)], self._parameter(form)
            if got != held:
                raise self.differs(f"the parameter {form.name}", held, got)

    def _brake(self) -> None:
        """Hold the standing shaft by the brake, and release it."""
        command = self.dialect.by_verb[Verb.BRAKE]
        for control in (0, 1):
            self._asked(self.probe.ask(command, {"brake_control": control}))
            state = self.probe.read(command, "", {"brake_control": 0x10})
            if state != control:
                raise self.differs("the brake", control, state)

    def _look(self) -> None:
        """Read the angle within the turn, which goes with the position, and all parameters."""
        angle = self.probe.read(Verb.READ_SINGLE_TURN)
        if self.at is not None and not self.running:
            expected = (self.turned + self.at) % TURN
            if min((angle - expected) % TURN, (expected - angle) % TURN) > 2 * PLAY:
                raise self.differs("the angle within the turn", expected, angle)
        if self.held:
            self._compare_parameters(self.forms)


def moderate(form: Form, which: int) -> dict[str, int]:
    """Return moderate values of a parameter with which the motor moves as without."""
    values = read_back_lk.moderate(form, which)
    return {n: _KEPT_STRONG[n][which] if n in _KEPT_STRONG else v for n, v in values.items()}
