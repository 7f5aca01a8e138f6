"""The catalogue as a whole: what must hold for every dialect, command and vector."""

from __future__ import annotations

from dataclasses import replace

import pytest

from analyzer import dialects
from analyzer.catalogue import Certainty, Erratum, Risk, Role
from analyzer.codec import codec
from analyzer.layout import FieldKind
from analyzer.reference.objects import concerns
from analyzer.sinks.schemas import forms_of

EVERY = dialects.every()
COMMANDS = [(d, c) for d in EVERY for c in d.commands]
VECTORS = [(d, c, v) for d, c in COMMANDS for v in c.vectors]


def named(item):
    return f"{item[0].name}-{item[1].name}"


def bare(dialect, vector):
    """Return (CAN ID or None, the printed bytes without it)."""
    data = vector.data
    return (data[0], data[1:]) if dialect.bus == "can" else (None, data)


def whole(dialect, vector):
    """Return the frame that we take as true: as printed, corrected, or completed by its check."""
    can_id, data = bare(dialect, vector)
    if vector.corrected:
        corrected = bytes.fromhex(vector.corrected)
        return (corrected[0], corrected[1:]) if dialect.bus == "can" else (None, corrected)
    return can_id, data if vector.checksum else dialect.link.completed(data, can_id)


@pytest.mark.parametrize("item", VECTORS, ids=lambda i: f"{i[0].name}-{i[2].printed}")
def test_every_printed_frame_holds_or_has_an_erratum(item):
    dialect, command, vector = item
    if vector.models:
        dialect = dialect.for_model(vector.models[0])
        command = dialect.by_name[command.name]
    can_id, frame = whole(dialect, vector)
    assert all(check.ok for check in dialect.link.checks(frame, can_id)), "the check does not fit"
    head = dialect.link.parse(frame, can_id)
    data = frame[head.start : head.stop]
    forms = forms_of(dialect, command, vector.role)
    fitting = [f for f in forms if codec(f.layout).matches(data) or (command.slots and f)]
    assert fitting, f"no form of {command.name} fits {data.hex(' ')}"
    if vector.values:
        assert codec(fitting[0].layout).wire(data) == dict(vector.values)
        assert not codec(fitting[0].layout).broken(data)
    if vector.erratum:
        assert vector.erratum in {e.id for e in dialect.errata}
        assert vector.corrected
    else:
        _, printed = bare(dialect, vector)
        assert frame[: len(printed)] == printed
        if vector.role is Role.REQUEST and not vector.checksum:
            assert len(frame) > len(printed)


@pytest.mark.parametrize("item", [(d, c) for d, c in COMMANDS], ids=named)
def test_a_command_is_complete(item):
    _, command = item
    assert command.section
    assert command.summary
    assert command.risk
    assert command.all_risks
    for role in (Role.REQUEST, Role.REPLY):
        declared = {}
        for form in command.request_forms if role is Role.REQUEST else command.reply_forms:
            assert len({f.name for f in form.layout.fields if f.kind is not FieldKind.RESERVED}) == len(form.layout.named)
            for name, field in form.layout.named.items():
                # One channel of the log has one schema: a name means the same in each form.
                first = declared.setdefault(name, field)
                assert (first.unit, first.scale, first.kind) == (field.unit, field.scale, field.kind), name


@pytest.mark.parametrize("item", COMMANDS, ids=named)
def test_no_values_are_without_a_risk(item):
    _, command = item
    for form in command.request_forms:
        assert command.risks({})
        for name, field in form.layout.named.items():
            if field.bit_width and field.bit_width <= 8:
                values = range(field.wire_minimum, field.wire_maximum + 1)
            else:
                values = [v for v in (field.low, field.high, 0, 1, field.wire_minimum, field.wire_maximum) if field.bit_width]
            for value in values:
                assert command.risks({name: value}), (command.name, name, value)


def test_reads_are_only_read_and_nothing_else_is():
    for dialect, command in COMMANDS:
        if command.name.startswith("read_"):
            assert command.all_risks == {Risk.READ}, (dialect.name, command.name)
        elif command.name not in ("brake", "long_package"):
            assert Risk.READ not in command.all_risks, (dialect.name, command.name)


@pytest.mark.parametrize(
    ("dialect", "name", "values", "risks"),
    [
        ("mks-rs485", "run_speed", {"direction": 0, "speed": 1}, {"unbounded"}),
        ("mks-rs485", "stop_speed", {}, {"motion"}),
        ("mks-rs485", "enable", {"enabled": 0}, {"torque"}),
        ("mks-rs485", "save_speed", {"save_state": 0xC8}, {"power-on", "wear"}),
        ("mks-rs485", "set_zero_mode", {"zero_mode": 1}, {"power-on"}),
        ("mks-rs485", "set_home", {"end_limit": 1}, {"torque"}),
        ("mks-rs485", "restore", {}, {"destructive", "power-on"}),
        ("mks-modbus", "restore", {}, {"destructive", "power-on"}),
        ("mks-can", "restore", {}, {"destructive", "power-on"}),
        ("mks-rs485", "set_no_limit_home", {}, {"setting", "torque"}),
        ("mks-can", "set_no_limit_home", {}, {"setting", "torque"}),
        ("mks-can", "set_no_limit_current", {}, {"setting", "torque"}),
        ("mks-rs485", "set_baud_rate", {}, {"link"}),
        ("mks-modbus", "set_address", {}, {"link"}),
        ("mks-can", "calibrate", {}, {"unbounded"}),
        ("lk-rs485", "motor_off", {}, {"torque"}),
        ("lk-rs485", "brake", {"brake_control": 1}, {"torque"}),
        ("lk-rs485", "brake", {"brake_control": 0x10}, {"read"}),
        ("lk-rs485", "set_zero", {}, {"wear"}),
        ("lk-rs485", "write_parameter", {"parameter": 10}, {"torque"}),
        ("lk-rs485", "write_parameter", {"parameter": 12}, {"torque"}),
        ("lk-rs485", "write_parameter", {"parameter": 30}, {"torque"}),
    ],
)
def test_a_risk_follows_the_command_and_its_values(dialect, name, values, risks):
    found = {str(r) for r in dialects.get(dialect).by_name[name].risks(values)}
    assert risks <= found
    if risks == {"read"}:
        assert found == risks


def test_every_code_of_a_package_slot_is_covered_by_its_static_risk():
    native = dialects.get("mks-rs485")
    package = native.by_name["long_package"]
    for command in native.commands:
        if command is not package and not command.name.startswith("read_"):
            assert command.all_risks <= package.all_risks, command.name


def test_errata_are_complete_and_unique():
    for dialect in EVERY:
        ids = [e.id for e in dialect.errata]
        assert len(ids) == len(set(ids))
        for erratum in dialect.errata:
            assert all((erratum.section, erratum.printed, erratum.wrong, erratum.taken_as, erratum.why)), erratum.id
            assert set(erratum.commands) <= set(dialect.by_name), erratum.id


@pytest.mark.parametrize(
    ("place", "section", "expected"),
    [
        ("6.8.1", "6.8.1", True),
        ("6.8.1", "6.8", True),
        ("6.8", "6.8.1", True),
        ("6", "6.8.1", True),
        ("6.8.1", "6.8.2", False),
        ("5.1", "5.10.1", False),
        ("1", "10", False),
        ("3.9, 6.7", "6.7.2", True),
        ("3.9, 6.7", "6.6.2", False),
        ("8.3.3 to 8.3.7", "8.3.3.1", True),
        ("8.3.3 to 8.3.7", "8.3.5", True),
        ("8.3.3 to 8.3.7", "8.3.7.2", True),
        ("8.3.3 to 8.3.7", "8.3.2", False),
        ("8.3.3 to 8.3.7", "8.3.8", False),
        ("5.1.5 to 5.1.10", "5.1.9", True),
        ("5.1.5 to 5.1.10", "5.1.4", False),
        ("5.1.5 to 5.1.10", "5.2.6", False),
        ("2.1, 11 to 17", "14", True),
        ("11 to 17", "1", False),
        ("11 to 17", "Modbus", False),
        ("appendix 1", "appendix 1", True),
        ("appendix 1", "1", False),
        ("Single motor command", "1", False),
    ],
)
def test_an_erratum_concerns_what_its_sections_cover(place, section, expected):
    command = replace(dialects.get("mks-rs485").by_name["set_key_lock"], section=section)
    assert concerns(Erratum("x", place, "p", "w", "t", "y", Certainty.OPEN), command) is expected
    named = Erratum("x", "nowhere", "p", "w", "t", "y", Certainty.OPEN, commands=("set_key_lock",))
    assert concerns(named, command)


@pytest.mark.parametrize(
    ("name", "erratum", "some", "not_one"),
    [
        ("mks-rs485", "mks-rs485-33", {"read_status", "emergency_stop", "move_absolute_axis"}, "set_home"),
        ("mks-rs485", "mks-rs485-35", {"set_subdivision", "run_speed", "move_absolute_pulses"}, "stop_speed"),
        ("mks-rs485", "mks-rs485-46", {"move_absolute_pulses", "stop_absolute_pulses"}, "move_relative_pulses"),
        ("mks-rs485", "mks-rs485-49", {"read_position", "move_relative_axis", "stop_absolute_axis"}, "read_pulses"),
        ("mks-modbus", "mks-modbus-21", {"stop_speed", "stop_absolute_axis"}, "home"),
        ("mks-modbus", "mks-modbus-25", {"move_absolute_pulses", "stop_absolute_pulses"}, "move_absolute_axis"),
        ("mks-modbus", "mks-modbus-29", {"read_position", "move_relative_axis", "move_absolute_axis"}, "run_speed"),
        ("mks-can", "mks-can-68", {"move_absolute_pulses", "stop_absolute_pulses"}, "move_absolute_axis"),
        ("mks-can", "mks-can-70", {"read_position", "move_relative_axis", "move_absolute_axis"}, "run_speed"),
        ("mks-can", "mks-can-73", {"run_speed"}, "save_speed"),
        ("lk-rs485", "lk-rs485-29", {"run_speed", "move_increment_limited"}, "run_torque"),
        ("lk-rs485", "lk-rs485-48", {"read_parameter", "write_parameter"}, "read_encoder"),
    ],
)
def test_errata_reach_their_commands(name, erratum, some, not_one):
    dialect = dialects.get(name)
    found = next(e for e in dialect.errata if e.id == erratum)
    concerned = {c.name for c in dialect.commands if concerns(found, c)}
    assert some <= concerned
    assert not_one not in concerned


def test_counts_do_not_shrink():
    counts = {d.name: (len(d.commands), sum(len(c.vectors) for c in d.commands), len(d.errata)) for d in EVERY}
    least = {"mks-rs485": (49, 61, 50), "mks-modbus": (45, 36, 30), "mks-can": (45, 60, 30), "lk-rs485": (25, 50, 25)}
    for name, numbers in least.items():
        assert all(a >= b for a, b in zip(counts[name], numbers, strict=True)), (name, counts[name])


@pytest.mark.parametrize("dialect", EVERY, ids=lambda d: d.name)
def test_each_model_resolves(dialect):
    for model in dialect.models:
        own = dialect.for_model(model)
        assert own.model == model
        assert own.commands
    with pytest.raises(ValueError, match="has no model"):
        dialect.for_model("99Z")


def test_models_have_their_limits():
    native = dialects.get("mks-rs485")
    limits = {
        m: native.for_model(m).by_name["set_current"].request_forms[0].layout.named["current"].high
        for m in ("42D", "57D", "28D", "35D")
    }
    assert limits == {"42D": 3000, "57D": 5200, "28D": 3000, "35D": 3000}
    lk = dialects.get("lk-rs485")
    scales = {m: float(_torque(lk.for_model(m)).scale) for m in ("MF", "MG")}
    assert scales == {"MF": 33 / 4096, "MG": 66 / 4096}
    assert "power" in lk.for_model("MS").by_name["read_state_2"].reply_forms[0].layout.named


def _torque(dialect):
    return dialect.by_name["read_state_2"].reply_forms[0].layout.named["torque_current"]
