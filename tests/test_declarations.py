"""What the catalogue says of motion, effects and dialects: each declaration equals the table that a reader kept before."""

from __future__ import annotations

import ast
from collections.abc import Iterator

import pytest

from analyzer import dialects
from analyzer.catalogue import Command, Dialect, Doubt, MotionKind, Risk, Subject, Trait, Verb
from analyzer.layout import Effect, Field
from analyzer.protocols import mks_can, mks_shared
from conformance.drives.mks import paths
from conformance.motion import ramp
from conformance.safety import stopping
from tests import ROOT

ALL = tuple(dialects.every())
MKS = tuple(d for d in ALL if d.family == "mks")
MOVES = (MotionKind.MOVE_BY, MotionKind.MOVE_TO)
EVERY = pytest.mark.parametrize("dialect", ALL, ids=lambda d: d.name)
EVERY_MKS = pytest.mark.parametrize("dialect", MKS, ids=lambda d: d.name)


def having(dialect: Dialect, *wanted: Verb) -> set[Verb]:
    return set(dialect.by_verb) & set(wanted)


def named(command: Command) -> dict[str, Field]:
    return command.request_forms[0].layout.named


# --- motion -----------------------------------------------------------------------------------------------------------


@EVERY
def test_stops_come_gentlest_first(dialect: Dialect) -> None:
    stops = [c.verb for c in dialect.motions(MotionKind.STOP)]
    ramped = [c.verb for c in stopping.ramped_stops(dialect)]
    expected = [Verb(name) for name in mks_shared.STOPS] if dialect.family == "mks" else [Verb.STOP]
    assert ramped == expected
    assert set(stops) - set(ramped) == having(dialect, Verb.EMERGENCY_STOP)
    for command in dialect.commands:
        ends = [c.verb for c in dialect.stops_of(command)]
        assert len(ends) == len(command.motion.stops if command.motion else ())
        if ends and dialect.family == "mks":
            assert ends[-1] is Verb.EMERGENCY_STOP
            assert [verb.value for verb in ends[:-1]] in ([], [command.name.replace("run", "stop").replace("move", "stop")])
        elif ends:
            assert ends == [Verb.STOP]


@EVERY
def test_what_risks_motion_says_which(dialect: Dialect) -> None:
    risky = {c.name for c in dialect.commands if c.moves and c.slots is None}
    assert risky == {c.name for c in dialect.commands if c.motion is not None}


@EVERY
def test_a_motion_names_fields_and_commands_that_are_there(dialect: Dialect) -> None:
    for command in dialect.commands:
        motion = command.motion
        if motion is None:
            continue
        fields = named(command)
        assert {motion.speed, motion.distance, motion.direction, motion.acceleration} - {""} <= fields.keys()
        assert {*motion.stops, motion.counted_by} - {""} <= dialect.by_name.keys()
        assert all(dialect.by_name[s].motion.kind is MotionKind.STOP for s in motion.stops)  # type: ignore[union-attr]
        if motion.kind is MotionKind.STOP:
            continue
        # Nothing that bears on a motion is left unsaid.
        assert motion.speed == next((n for n, f in fields.items() if f.unit in ("rpm", "deg/s")), "")
        assert motion.distance == next((n for n in ("pulses", "position", "angle") if n in fields), "")
        assert bool(motion.direction) == ("direction" in fields)
        assert bool(motion.acceleration) == ("acceleration" in fields)
        assert bool(motion.counted_by) == (motion.kind in (MotionKind.MOVE_TO, MotionKind.MOVE_IN_TURN))


@EVERY
def test_a_motion_whose_end_is_told_has_an_interim_reply(dialect: Dialect) -> None:
    for command in dialect.commands:
        if command.motion is not None:
            assert command.motion.tells_end == bool(command.replies.interim), command.name


@EVERY_MKS
def test_runs_moves_and_stops_of_the_mks_drives(dialect: Dialect) -> None:
    assert len({c.motion.tells_end for c in dialect.motions(*MOVES) if c.motion}) == 1
    assert tuple(c.name for c in dialect.motions(MotionKind.RUN, *MOVES)) == mks_shared.RUNS
    assert tuple(c.name for c in dialect.motions(MotionKind.STOP) if c.motion and c.motion.acceleration) == mks_shared.STOPS


# --- effects ----------------------------------------------------------------------------------------------------------

#: Effect -> the settings that had it, by their fields.
SETTINGS = {
    Effect.ADDRESS: {Verb.SET_ADDRESS: "new_address"},
    Effect.BAUD_RATE: {Verb.SET_BAUD_RATE: "baud_rate", Verb.SET_BIT_RATE: "bit_rate"},
    Effect.GROUP: {Verb.SET_GROUP_ADDRESS: "group_address"},
    Effect.RESPOND: {Verb.SET_RESPOND: "respond"},
    Effect.ACTIVE: {Verb.SET_RESPOND: "active"},
    Effect.DIALECT: {Verb.SET_MODBUS: "modbus"},
    Effect.SUBDIVISION: {Verb.SET_SUBDIVISION: "subdivision"},
    Effect.WORK_MODE: {Verb.SET_WORK_MODE: "work_mode"},
    Effect.HOME_SPEED: {Verb.SET_HOME: "home_speed"},
}


@EVERY
@pytest.mark.parametrize("effect", SETTINGS)
def test_what_a_setting_changes(dialect: Dialect, effect: Effect) -> None:
    expected = {verb: name for verb, name in SETTINGS[effect].items() if verb in dialect.by_verb}
    assert {command.verb: field.name for command, field in dialect.effects(effect)} == expected
    assert (dialect.effect(effect) is None) == (not expected)


@EVERY
def test_currents_are_those_that_the_bounds_knew(dialect: Dialect) -> None:
    expected = {
        (c.name, name)
        for c in dialect.commands
        for form in c.request_forms
        for name, field in form.layout.named.items()
        if field.unit in ("mA", "A") or name.endswith("current") or name in ("torque_limit", "power")
    }
    assert {(c.name, f.name) for c, f in dialect.effects(Effect.CURRENT)} == expected


@EVERY
def test_speeds_of_the_line(dialect: Dialect) -> None:
    found = dialect.effect(Effect.BAUD_RATE)
    if found is None:
        assert not dialect.rates
        return
    field = found[1]
    assert set(dialect.rates) == set(field.choice_names)
    assert field.default is not None
    default = dialect.rates[field.default]
    assert dialect.baud_rates == (default, *(r for r in dialect.rates.values() if r != default))


# --- dialects ---------------------------------------------------------------------------------------------------------


def test_families_and_siblings() -> None:
    assert {d.name: d.family for d in ALL} == {d.name: d.name.split("-")[0] for d in ALL}
    assert {d.name: d.siblings for d in ALL if d.siblings} == {"mks-rs485": ("mks-modbus",), "mks-modbus": ("mks-rs485",)}


@EVERY
def test_a_drive_that_speaks_several_dialects_says_by_which_value(dialect: Dialect) -> None:
    assert bool(dialect.siblings) == (dialect.effect(Effect.DIALECT) is not None)
    if dialect.siblings:
        assert [dialect.switched(value) for value in (0, 1)] == ["mks-rs485", "mks-modbus"]
        assert dialect.chosen_by == int(dialect.name.endswith("modbus"))


def test_sections_of_what_belongs_to_no_command() -> None:
    expected = {"mks-rs485": "4", "mks-modbus": "8", "mks-can": "3", "lk-rs485": "Single motor command"}
    for dialect in ALL:
        assert dialect.sections == dict.fromkeys(Subject, expected[dialect.name])


def test_traits() -> None:
    assert {d.name: set(d.traits) for d in ALL if d.traits} == {
        "mks-rs485": {Trait.LETS_GO_AT_END_LIMIT, Trait.SEEN_WITHOUT_CHECKSUM},
        "mks-modbus": {Trait.LETS_GO_AT_END_LIMIT},
        "mks-can": {Trait.DIRECTION_TURNS_BUS_MOTION, Trait.BACKS_OFF_BY_ANGLE},
    }
    assert {d.name: d.unlisted_codes for d in ALL if d.unlisted_codes} == {"lk-rs485": (0x12,)}


@EVERY
def test_an_unlisted_code_is_that_of_no_command(dialect: Dialect) -> None:
    assert not set(dialect.unlisted_codes) & {c.code for c in dialect.commands}


@EVERY_MKS
def test_the_ramp(dialect: Dialect) -> None:
    law = dialect.ramp
    assert law is not None
    for acceleration in range(1, law.steps):
        expected = (law.steps - acceleration) * law.unit_ns
        assert ramp.step_ns(acceleration) == paths.ramp_step_ns(acceleration) == expected
    assert (law.unit_ns, law.steps) == (50_000, 256)


@EVERY_MKS
def test_the_subdivision(dialect: Dialect) -> None:
    rule = dialect.subdivision
    assert rule is not None
    assert rule.full_steps == 200
    setting = dialect.effect(Effect.SUBDIVISION)
    assert setting is not None
    assert setting[1].default == rule.counted_at


@EVERY
def test_only_a_drive_with_the_setting_has_a_rule(dialect: Dialect) -> None:
    assert (dialect.subdivision is not None) == (dialect.effect(Effect.SUBDIVISION) is not None)


@EVERY_MKS
def test_the_encoder_and_the_speeds_of_the_modes(dialect: Dialect) -> None:
    assert dialect.counts_per_turn == mks_shared.COUNTS_PER_TURN == mks_shared.ENCODER.high + 1
    setting = dialect.effect(Effect.WORK_MODE)
    modes = set(dialect.by_name["run_speed"].modes)
    assert setting is not None
    assert modes <= set(setting[1].choice_names.values())
    if dialect.mode_speeds:
        assert dialect.mode_speeds == mks_shared.MODE_MAXIMUM_SPEEDS
        assert set(dialect.mode_speeds) == set(setting[1].choice_names.values())
    else:
        assert modes == set(mks_can.BUS_MODES)
        assert not modes & mks_shared.MODE_MAXIMUM_SPEEDS.keys()


@EVERY
def test_what_may_not_end_is_declared_so(dialect: Dialect) -> None:
    for command in dialect.motions(*MOVES, MotionKind.MOVE_IN_TURN, MotionKind.HOLD, MotionKind.STOP):
        assert Risk.UNBOUNDED not in command.all_risks
    for command in dialect.motions(MotionKind.RUN, MotionKind.TORQUE, MotionKind.HOME, MotionKind.CALIBRATE):
        assert Risk.UNBOUNDED in command.all_risks


# --- errata -----------------------------------------------------------------------------------------------------------


@EVERY
def test_an_erratum_bears_on_commands_and_fields_that_are_there(dialect: Dialect) -> None:
    fields = {name for c in dialect.commands for form in c.request_forms for name in form.layout.named}
    for erratum in dialect.errata:
        named = {name for names in erratum.bears_on.values() for name in names}
        assert named <= dialect.by_name.keys() | fields, erratum.id


def test_an_erratum_leaves_in_doubt_what_it_names() -> None:
    erratum = next(e for e in dialects.get("mks-can").errata if e.id == "mks-can-42")
    assert erratum.doubts(Doubt.LIMITS, ("write_io", "pend_mask"))
    assert not erratum.doubts(Doubt.LIMITS, ("write_io",))
    assert not erratum.doubts(Doubt.VALUES, ("pend_mask",))
    whole = next(e for e in dialects.get("lk-rs485").errata if e.id == "lk-rs485-28")
    assert whole.doubts(Doubt.SIGN, ())


# --- what nothing but the catalogue says ------------------------------------------------------------------------------

#: Where dialects are declared, and the drives that speak them.
_NAMING = ("analyzer/protocols", "analyzer/dialects.py", "conformance/drives")


def _texts() -> Iterator[tuple[str, str]]:
    """Yield every string in the code, with the path of its module."""
    for package in ("analyzer", "conformance", "servotap"):
        for path in sorted((ROOT / package).rglob("*.py")):
            name = path.relative_to(ROOT).as_posix()
            if not name.startswith(_NAMING):
                nodes = ast.walk(ast.parse(path.read_text()))
                yield from ((name, n.value) for n in nodes if isinstance(n, ast.Constant) and isinstance(n.value, str))


def test_no_code_goes_by_the_name_of_a_dialect_or_the_number_of_an_erratum() -> None:
    names = {d.name for d in ALL} | {e.id for d in ALL for e in d.errata}
    assert [(name, text) for name, text in _texts() if text in names] == []
