"""The model of an LK drive: on or off, positions, control parameters, brake; and the random steps for it.

    off     motion commands are answered but never executed, also not when the motor is on again
    on      0x81 stops and leaves it on

Rules kept here:
- Positions are hundredths of a degree over all turns, clockwise up; the angle within the turn goes with them.
- A motor that was released or stopped during a move may rest anywhere: the model asks the drive.
- The manual says only that 0x93 clears the turns of the position: the model asks for the rest.
- Control parameters are moderate, and such that the motor can still move. On hardware the gains of the loops are left alone.
- Values are drawn within the bounds of the session; positions start from the shaft. A move within the turn never goes to the
  current angle: the manual does not say whether that is no distance or a turn.

Not modelled: torque, limits at their ends, errors, what 0x19 stores.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy

from analyzer.catalogue import Form, Verb
from conformance.claim import Inconclusive
from conformance.model import lk_parameters
from conformance.model.lk_parameters import number_of, read_parameter
from conformance.model.session import MOVING, SETTING, TORQUE, UNBOUNDED, Session, step, up_to
from conformance.motion import motion
from conformance.motion.motion import MS
from conformance.talk.acceptance import need_reliable_replies
from conformance.talk.exchange import Exchange

#: Hundredths of a degree in a turn, and of a degree per second in an rpm.
TURN, RPM = 36_000, 600
#: Hundredths of a degree by which a position may be off; share and rpm by which a speed may.
PLAY, SPEED_SHARE, SPEED_PLAY = 40, 0.03, 2.0
#: Speeds in rpm, of runs and of moves, and the longest move in turns, where no bound is lower.
FASTEST, FASTEST_RUN, FASTEST_MOVE, SLOWEST, LONGEST = 300, 100, 60, 20, 0.75
#: The quirk of drives that drop the counted turns when they are turned off.
OFF_CLEARS = "lk-off-clears-turns"
#: Limits that are moderate all the same: the motor moves with them as it would without.
_KEPT_STRONG = {"torque_limit": (1500, 1900), "speed_limit": (0x02_2345, 0x02_0F23), "angle_limit": (0x2134_5678, 0x1134_5678)}


def _moderate(form: Form, which: int) -> dict[str, int]:
    """Return moderate values of a parameter with which the motor moves as without."""
    values = lk_parameters.moderate(form, which)
    return {n: _KEPT_STRONG[n][which] if n in _KEPT_STRONG else v for n, v in values.items()}


# --- the model --------------------------------------------------------------------------------------------------------


class LkSession(Session):
    """One LK drive and its model. `turned`: the angle within the turn at position 0; `held`: parameters by number."""

    VARIANTS: ClassVar = {
        "settings": "parameter_step parameter_step set_position clear_turns brake motor_on motor_off look",
        "motion": (
            "run_speed stop move_increment move_increment_limited move_multi_turn_limited move_single_turn_limited "
            "set_position look"
        ),
        "mixed": (
            "motor_on motor_on motor_off stop run_speed move_increment_limited move_multi_turn_limited "
            "move_single_turn_limited set_position clear_turns parameter_step brake look"
        ),
    }
    on: bool
    held: dict[int, dict[str, int]]

    # --- what is drawn --------------------------------------------------------------------------------------------

    @property
    def stands(self) -> bool:
        """Whether the shaft stands at a known position."""
        return not self.running and self.at is not None

    @property
    def fastest(self) -> int:
        """The highest speed that is drawn, rpm."""
        return min(FASTEST, int(self.leeway.bounds.speed or FASTEST))

    @property
    def runs(self) -> SearchStrategy[int]:
        """Speeds of runs, either way."""
        top, least = min(FASTEST_RUN, self.fastest) * RPM, SLOWEST * RPM // 2
        return st.one_of(st.integers(least, top), st.integers(-top, -least))

    @property
    def speed_limits(self) -> SearchStrategy[int]:
        """Speed limits of moves."""
        return st.integers(min(SLOWEST, self.fastest) * RPM, min(FASTEST_MOVE, self.fastest) * RPM)

    @property
    def distances(self) -> SearchStrategy[int]:
        """Distances of moves, either way."""
        return up_to(int(min(LONGEST, self.leeway.bounds.turns or LONGEST) * TURN))

    @property
    def angles(self) -> SearchStrategy[int]:
        """Angles within the turn, none near that of the shaft."""
        now = (self.turned + (self.at or 0)) % TURN
        return st.integers(TURN // 16, TURN - TURN // 16).map(lambda away: (now + away) % TURN)

    @property
    def writable(self) -> SearchStrategy[int]:
        """Parameters that may be written, by their place in the list."""
        rig, drive = self.probe.rig, self.probe.drive
        command = self.dialect.by_verb[Verb.WRITE_PARAMETER]
        which = [
            n
            for n, form in enumerate(self.forms)
            if command.risks({"parameter": number_of(form)}) <= rig.allowed
            and (drive is not None or form.name.endswith(("_limit", "_ramp")))
        ]
        return st.sampled_from(which)

    # --- begin and end --------------------------------------------------------------------------------------------

    def begin(self) -> None:
        """Turn on, stop, and call this place zero; read the parameters."""
        probe = self.probe
        self.forms = lk_parameters.listed_in(self.dialect)
        lk_parameters.need_room(probe)
        motion.ready_to_move(probe)
        motion.stand_still(probe)
        probe.do("set_position", {"position": 0})
        self.on, self.running, self.at = True, 0.0, 0
        self.turned = probe.read(Verb.READ_SINGLE_TURN)
        self.held = {}
        if not probe.ask(Verb.READ_PARAMETER, {"parameter": number_of(self.forms[0])}).silent:
            self.held = {number_of(f): read_parameter(probe, number_of(f)) for f in self.forms}
        self.before = dict(self.held)
        self.compare()

    def end(self) -> None:
        """Turn on, stop, and put the parameters back."""
        for form in self.forms:
            number = number_of(form)
            if self.held.get(number) != self.before.get(number):
                self.probe.ask(Verb.WRITE_PARAMETER, self.before[number], form=form)
        self.probe.ask(Verb.MOTOR_ON)
        motion.stand_still(self.probe)

    # --- comparing ------------------------------------------------------------------------------------------------

    def compare(self) -> None:
        """Compare state, speed and position with the model."""
        probe = self.probe
        state = probe.reply(probe.ask(Verb.READ_STATE_1, quiet_ns=0)).values
        if "state" not in state:
            raise Inconclusive("read_state_1 has no state")
        self.expect(f"{0x00 if self.on else 0x10:#04x}", f"{state['state']:#04x}", "the state")
        rpm = motion.speed(probe).value
        near = abs(rpm - self.running) <= SPEED_PLAY + SPEED_SHARE * abs(self.running)
        self.expect(f"{self.running:.0f} rpm", f"{rpm:.0f} rpm", "the speed", holds=near or not self.on)
        if not self.running:
            self._compare_position()

    def _compare_position(self) -> None:
        now = self.probe.read(Verb.READ_POSITION)
        off = 0 if self.at is None else now - self.at
        if abs(off) > PLAY:
            cleared = not self.on and OFF_CLEARS in self.probe.claim.quirks and (off + PLAY) % TURN <= 2 * PLAY
            self.expect(self.at, now, "the position", holds=cleared)
            self.probe.meets(OFF_CLEARS)
            self._renamed(now)
        elif self.at is None:
            self.at = now

    def _renamed(self, position: int) -> None:
        """Take it that the place of the shaft has another position now."""
        if self.at is not None:
            self.turned = (self.turned + self.at - position) % TURN
        self.at = position

    # --- on, off, stop --------------------------------------------------------------------------------------------

    def _answered(self, exchange: Exchange) -> None:
        self.readable(exchange)
        if exchange.silent:
            need_reliable_replies(self.probe, quiet_ns=0)
            assert exchange.command is not None  # it was asked for
            self.expect("a reply", "silence", f"{exchange.command.name} is not answered", exchange=exchange)

    @step(lambda s: {"which": s.writable, "values": st.integers(0, 1)}, possible=lambda s: bool(s.held), risks=SETTING)
    def parameter_step(self, which: int, values: int) -> None:
        """Write a parameter, and read it and its neighbour; `look` reads all."""
        form = self.forms[which % len(self.forms)]
        wanted = _moderate(form, values)
        self._answered(self.probe.ask(Verb.WRITE_PARAMETER, wanted, form=form))
        self.held[number_of(form)] = wanted
        self._compare_parameters([form, self.forms[(which + 1) % len(self.forms)]])

    def _compare_parameters(self, forms: list[Form]) -> None:
        for form in forms:
            number = number_of(form)
            self.expect(self.held[number], read_parameter(self.probe, number), f"the parameter {form.name}")

    @step(risks=MOVING)
    def motor_on(self) -> None:
        """Turn the motor on."""
        self._answered(self.probe.ask(Verb.MOTOR_ON))
        self.on = True
        self.probe.wait(200 * MS)

    @step(risks=TORQUE)
    def motor_off(self) -> None:
        """Let the shaft go."""
        self._answered(self.probe.ask(Verb.MOTOR_OFF))
        self.on = False
        self._rest()

    @step(possible=lambda s: s.on, risks=MOVING)
    def stop(self) -> None:
        """Stop and hold the shaft."""
        self._answered(self.probe.ask(Verb.STOP))
        self._rest()

    def _rest(self) -> None:
        self.standing()
        if self.running:
            self.at = None
        self.running = 0.0

    # --- motion ---------------------------------------------------------------------------------------------------

    @step(lambda s: {"speed": s.runs}, risks=UNBOUNDED)
    def run_speed(self, speed: int) -> None:
        """Run at a speed, and wait until that no longer changes."""
        self._answered(self.probe.ask(Verb.RUN_SPEED, {"speed": speed}))
        if not self.on:
            self.probe.wait(200 * MS)
            return
        self.running, self.at = speed / RPM, None
        before = motion.speed(self.probe).value
        for _ in range(60):
            self.probe.wait(100 * MS)
            now = motion.speed(self.probe).value
            if abs(now - before) < 0.5:
                return
            before = now

    def _move(self, name: str, values: Mapping[str, int], distance: int) -> None:
        self._answered(self.probe.ask(name, values))
        start = self.at
        self.standing()
        if self.on and start is not None:
            self.at = start + distance

    @step(lambda s: {"position": s.distances}, possible=lambda s: s.stands and s.leeway.bounds.speed is None, risks=MOVING)
    def move_increment(self, position: int) -> None:
        """Move by a distance."""
        self._move("move_increment", {"position": position}, position)

    @step(lambda s: {"position": s.distances, "max_speed": s.speed_limits}, possible=lambda s: s.stands, risks=MOVING)
    def move_increment_limited(self, position: int, max_speed: int) -> None:
        """Move by a distance, no faster than a limit."""
        self._move("move_increment_limited", {"position": position, "max_speed": max_speed}, position)

    @step(lambda s: {"distance": s.distances, "max_speed": s.speed_limits}, possible=lambda s: s.stands, risks=MOVING)
    def move_multi_turn_limited(self, distance: int, max_speed: int) -> None:
        """Move to a position, no faster than a limit."""
        target = (self.at or 0) + distance
        self.probe.gate.note_position(motion.position(self.probe).value, self.probe.address)
        self._move("move_multi_turn_limited", {"position": target, "max_speed": max_speed}, distance)

    @step(
        lambda s: {"direction": st.integers(0, 1), "angle": s.angles, "max_speed": s.speed_limits},
        possible=lambda s: s.stands,
        risks=MOVING,
    )
    def move_single_turn_limited(self, direction: int, angle: int, max_speed: int) -> None:
        """Move to an angle within the turn, no faster than a limit."""
        now = (self.turned + (self.at or 0)) % TURN
        way = (angle - now) % TURN if direction == 0 else -((now - angle) % TURN)
        self._move("move_single_turn_limited", {"direction": direction, "angle": angle, "max_speed": max_speed}, way)

    # --- positions, brake, looking --------------------------------------------------------------------------------

    @step(lambda s: {"position": st.integers(-10 * TURN, 10 * TURN)}, possible=lambda s: s.stands, risks=SETTING)
    def set_position(self, position: int) -> None:
        """Give the place of the shaft a position."""
        self._answered(self.probe.ask("set_position", {"position": position}))
        self._renamed(position)

    @step(possible=lambda s: s.stands, risks=SETTING)
    def clear_turns(self) -> None:
        """Clear the counted turns; less than a turn is left."""
        self._answered(self.probe.ask(Verb.CLEAR_TURNS))
        now = self.probe.read(Verb.READ_POSITION)
        self.expect("less than a turn", now, "the position after 0x93", holds=abs(now) <= TURN + PLAY)
        self._renamed(now)

    @step(possible=lambda s: s.stands and s.on, risks=TORQUE)
    def brake(self) -> None:
        """Hold the standing shaft by the brake, and release it."""
        command = self.dialect.by_verb[Verb.BRAKE]
        for control in (0, 1):
            self._answered(self.probe.ask(command, {"brake_control": control}))
            self.expect(control, self.probe.read(command, "", {"brake_control": 0x10}), "the brake")

    @step()
    def look(self) -> None:
        """Read the angle within the turn, which goes with the position, and all parameters."""
        angle = self.probe.read(Verb.READ_SINGLE_TURN)
        if self.at is not None and not self.running:
            expected = (self.turned + self.at) % TURN
            near = min((angle - expected) % TURN, (expected - angle) % TURN) <= 2 * PLAY
            self.expect(expected, angle, "the angle within the turn", holds=near)
        if self.held:
            self._compare_parameters(self.forms)
