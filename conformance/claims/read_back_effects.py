"""What is set is what the drive does: for settings that cannot be read, and besides for those that can (MKS).

    work mode     whether the bus can enable the motor          subdivision    how far 200 pulses go
    respond       which replies a move gets                     group          who hears the group's address
    home          speed and way of homing                       enable level   whether the motor holds in a pulse mode
    axis lock     whether it holds when a bus mode begins       ports          what was written is read

What settings do to motion in full (direction, speeds, replies) stands in the theme motion. Currents, keys, screen,
interpolation and pulse delay show nowhere on the bus.

Rules kept here:
- Ways are compared with each other, never with clockwise: which way a real shaft turns is not judged.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from analyzer.catalogue import Certainty, Command, Dialect, Doubt, Risk, Verb
from conformance.claim import Aspect, Claim, Inconclusive, Refuted, Theme
from conformance.claims import effects, ranges
from conformance.claims.declare import declare
from conformance.claims.effects import BY_VERB, Effect
from conformance.motion import motion, moves
from conformance.motion.motion import MS
from conformance.talk.probe import Probe

_HOMING = (Risk.MOTION, Risk.UNBOUNDED, Risk.TORQUE, Risk.SETTING)
_SPEED_SHARE = 0.06


def claims(dialect: Dialect) -> Iterator[Claim]:
    """Make the claims about what settings do."""
    if not moves.is_mks(dialect):
        return
    verbs = dialect.by_verb
    for verb, effect in BY_VERB.items():
        if verb in verbs and effect.expected is not None:
            yield from _effects(dialect, verbs[verb], effect)
    for verb, make in _MORE.items():
        if verb in verbs:
            yield from make(dialect, verbs[verb])


def _effects(dialect: Dialect, command: Command, effect: Effect) -> Iterator[Claim]:
    expected = effect.expected
    assert expected is not None  # only those are asked for
    wanted = expected

    def check(probe: Probe) -> None:
        effect.ready(probe)
        for values in effect.values:
            form = command.request_forms[0]
            if not all(form.layout.named[n].allows(v) for n, v in values.items()):
                continue
            exchange = probe.do(command, ranges.plain(probe, command, form, **values))
            seen, should = effect.see(probe), wanted(dialect, values)
            if not effect.same(should, seen):
                text = " ".join(f"{n} {v}" for n, v in values.items())
                raise Refuted(
                    f"{command.name} {text}: {effect.words(seen)}", expected=effect.words(should), got=effect.words(seen),
                    exchange=exchange, key=f"{command.name} effect",
                )  # fmt: skip

    needs = ranges.needs(dialect, command, effect.values)
    yield declare(
        dialect, Theme.READ_BACK, f"{command.name}/effect", f"{command.name} does what it says.", "another effect, or none",
        check, command=command, aspect=Aspect.STATE, fields=tuple(command.request_forms[0].layout.named),
        risks=needs["risks"] | effect.risks(dialect), alone=needs["alone"] or effect.alone,
        settings=tuple(dict.fromkeys((*needs["settings"], *effect.settings(dialect)))),
        rests_on=(Doubt.EFFECT,),
    )  # fmt: skip


# --- home -------------------------------------------------------------------------------------------------------------


def _home(dialect: Dialect, command: Command) -> Iterator[Claim]:
    def begun(probe: Probe, **values: int) -> tuple[effects.Homing, Any]:
        plain = ranges.plain(probe, command, command.request_forms[0], end_limit=0, home_speed=90)
        exchange = probe.do(command, plain | values)
        return effects.homing(probe), exchange

    def speed(probe: Probe) -> None:
        motion.ready_to_move(probe, subdivision=moves.SUBDIVISION)
        for rpm in (90, 300):
            seen, exchange = begun(probe, home_speed=rpm)
            if abs(seen.rpm - rpm) > max(2.0, rpm * _SPEED_SHARE):
                raise Refuted(
                    f"set_home {rpm} rpm: {seen}", expected=f"homing at {rpm} rpm", got=str(seen), exchange=exchange,
                    key="home_speed effect",
                )  # fmt: skip

    def opposite(name: str) -> Callable[[Probe], None]:
        def check(probe: Probe) -> None:
            motion.ready_to_move(probe, subdivision=moves.SUBDIVISION)
            (one, _), (other, exchange) = (begun(probe, **{name: value}) for value in (0, 1))
            if one.way == other.way:
                raise Refuted(
                    f"{name} 0 and 1 both begin homing the same way", expected="opposite ways", got=str(other),
                    exchange=exchange, key=f"{name} effect",
                )  # fmt: skip

        return check

    claims = (
        ("home_speed", "Homing turns at the speed that was set.", "another speed", speed),
        ("home_direction", "The other direction homes the other way.", "the same way", opposite("home_direction")),
        ("home_trigger", "With the other level the end stop counts as closed, and homing first leaves it.", "the same way",
         opposite("home_trigger")),
    )  # fmt: skip
    for name, statement, refuted_by, check in claims:
        yield declare(
            dialect, Theme.READ_BACK, f"{command.name}/{name}", statement, refuted_by, check, command=command,
            aspect=Aspect.STATE, fields=(name,), at_best=Certainty.CERTAIN if name != "home_trigger" else Certainty.LIKELY,
            risks=motion.risks(dialect, *_HOMING), settings=motion.settings(dialect, *command.request_forms[0].layout.named),
        )  # fmt: skip


# --- holding the shaft ------------------------------------------------------------------------------------------------


def pulse_mode(dialect: Dialect) -> int:
    """Return a work mode in which pulses move the motor, closed loop."""
    field = dialect.by_verb[Verb.SET_WORK_MODE].request_forms[0].layout.named["work_mode"]
    names = {v: n for v, n in field.choice_names.items() if n not in motion.bus_modes(dialect)}
    return next((v for v, n in names.items() if "clos" in n), next(iter(names)))


def _enable_level(dialect: Dialect, command: Command) -> Iterator[Claim]:
    def check(probe: Probe) -> None:
        probe.do(Verb.SET_WORK_MODE, {"work_mode": pulse_mode(dialect)})
        seen = {}
        for value in (0, 1, 2):
            exchange = probe.do(command, {"enable_level": value})
            probe.wait(200 * MS)
            seen[value] = probe.read(Verb.READ_ENABLED)
        shown = ", ".join(f"{v} reads {s}" for v, s in seen.items())
        if seen[2] != 1:
            raise Refuted("enable_level 2 (always) reads disabled", expected="enabled 1", got=shown, exchange=exchange,
                          key="enable_level effect")  # fmt: skip
        if seen[0] == seen[1]:
            raise Refuted("enable_level 0 and 1 read alike", expected="one enabled, the other not", got=shown,
                          exchange=exchange, key="enable_level effect")  # fmt: skip

    setter = dialect.by_verb[Verb.SET_WORK_MODE]
    statement = "In a pulse mode the motor holds at the set level of En, or always."
    yield declare(
        dialect, Theme.READ_BACK, f"{command.name}/effect", statement,
        "a motor that holds at both levels, or lets go", check, command=command, aspect=Aspect.STATE, at_best=Certainty.LIKELY,
        fields=("enable_level",), risks=command.all_risks | setter.all_risks, settings=("enable_level", "work_mode"),
        rests_on=(Doubt.MEANING,),
    )  # fmt: skip


def _axis_lock(dialect: Dialect, command: Command) -> Iterator[Claim]:
    setter = dialect.by_verb[Verb.SET_WORK_MODE]

    def check(probe: Probe) -> None:
        bus = motion.choice(setter, "work_mode", motion.bus_modes(dialect)[-1])
        for value in (0, 1):
            exchange = probe.do(command, {"axis_lock": value})
            probe.do(setter, {"work_mode": pulse_mode(dialect)})
            probe.do(setter, {"work_mode": bus})
            seen = probe.read(Verb.READ_ENABLED)
            if seen != value:
                raise Refuted(
                    f"with axis_lock {value} a bus mode begins with enabled {seen}", expected=f"enabled {value}",
                    got=f"enabled {seen}", exchange=exchange, key="axis_lock effect",
                )  # fmt: skip

    yield declare(
        dialect, Theme.READ_BACK, f"{command.name}/effect", "A bus mode begins with the shaft held or free as axis_lock says.",
        "a shaft that is held with 0, or free with 1", check, command=command, aspect=Aspect.STATE, at_best=Certainty.LIKELY,
        fields=("axis_lock",), risks=command.all_risks | setter.all_risks, settings=("axis_lock", "work_mode"),
    )  # fmt: skip


# --- ports ------------------------------------------------------------------------------------------------------------


def _ports(dialect: Dialect, command: Command) -> Iterator[Claim]:
    def check(probe: Probe) -> None:
        for level in (0, 1):
            exchange = probe.do(command, {"alm_mask": 1, "pend_mask": 1, "alm": level, "pend": 1 - level})
            seen = probe.reply(probe.ask(Verb.READ_IO)).values
            wanted = {"alm": level, "pend": 1 - level}
            got = {n: seen.get(n) for n in wanted}
            if got != wanted:
                raise Refuted(f"ports written {wanted} read {got}", expected=str(wanted), got=str(got), exchange=exchange)
            probe.do(command, {"alm_mask": 2, "pend_mask": 2, "alm": 1 - level, "pend": level})
            kept = probe.reply(probe.ask(Verb.READ_IO)).values
            if {n: kept.get(n) for n in wanted} != wanted:
                raise Refuted("mask 2 does not keep a port", expected=str(wanted), got=str(dict(kept)), exchange=exchange)
        probe.do(command, {"alm_mask": 0, "pend_mask": 0, "alm": 0, "pend": 0})

    yield declare(
        dialect, Theme.READ_BACK, f"{command.name}/effect", "A written port reads as it was written, until it is given back.",
        "another level", check, command=command, aspect=Aspect.STATE, rests_on=(Doubt.EFFECT,),
        fields=tuple(command.request_forms[0].layout.named), risks=command.all_risks,
    )  # fmt: skip


def _remap(dialect: Dialect, command: Command) -> Iterator[Claim]:
    """Make the claim that remapped ports show a second switch, on drives that have one port for switches."""

    def check(probe: Probe) -> None:
        if probe.drive is None or getattr(probe.drive, "model", "").startswith("57"):
            raise Inconclusive("a 57 has a port for each switch, so that nothing shows whether they are remapped")
        motion.ready_to_move(probe)
        probe.drive.limit_switch("right", False)  # type: ignore[attr-defined]
        seen = []
        for value in (0, 1):
            exchange = probe.do(command, {"limit_remap": value})
            levels = []
            for pressed in (False, True):
                probe.drive.limit_switch("right", pressed)  # type: ignore[attr-defined]
                levels.append(probe.reply(probe.ask(Verb.READ_IO)).values.get("in_2"))
            seen.append(levels[0] != levels[1])
        if seen != [False, True]:
            raise Refuted(
                f"limit_remap 0 and 1: the right switch shows {seen}", expected="not with 0, and with 1", got=str(seen),
                exchange=exchange, key="limit_remap effect",
            )  # fmt: skip

    models = tuple(m for m in (command.models or dialect.models) if not m.startswith("57"))
    yield declare(
        dialect, Theme.READ_BACK, f"{command.name}/effect", "With the ports remapped the right switch shows at in_2.",
        "a switch that does not show", check, command=command, aspect=Aspect.STATE, at_best=Certainty.LIKELY, emulated=True,
        models=models, fields=("limit_remap",), risks=command.all_risks | motion.risks(dialect),
        settings=motion.settings(dialect, "limit_remap"), rests_on=(Doubt.EFFECT,),
    )  # fmt: skip


_Make = Callable[[Dialect, Command], Iterator[Claim]]
#: What is claimed of settings that show in ways of their own.
_MORE: Mapping[Verb, _Make] = {
    Verb.SET_HOME: _home,
    Verb.SET_ENABLE_LEVEL: _enable_level,
    Verb.SET_AXIS_LOCK: _axis_lock,
    Verb.WRITE_IO: _ports,
    Verb.SET_LIMIT_REMAP: _remap,
}
