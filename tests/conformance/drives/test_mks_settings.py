"""Settings of the MKS drives of every model, and what they do beside what claims judge."""

from __future__ import annotations

import pytest

from analyzer import dialects
from analyzer.catalogue import Verb
from analyzer.encoder import build
from analyzer.errors import UsageError
from conformance.drives.mks.state import KEPT, UNPRINTED, is_setting
from tests.conformance.drives.test_mks_rig import MODELS, NAMES, SECOND, Rig, make


def fields_of(name, model):
    """Yield (command, field) of every setting of a dialect."""
    dialect = dialects.get(name)
    dialect = dialect.for_model(model) if model else dialect
    for command in dialect.commands:
        if is_setting(command):
            for field in command.request_forms[0].layout.named.values():
                yield command, field


CASES = [(n, m, c, f) for n in NAMES for m in ("", *MODELS[n]) for c, f in fields_of(n, m)]


def nearby(field):
    """Return values at, beside and beyond the limits, and around each choice."""
    marks = {field.low, field.high, field.wire_minimum, field.wire_maximum}
    marks |= set(field.choice_names) | set(field.values or ())
    around = {value + step for value in marks for step in (-1, 0, 1)}
    return sorted(v for v in around if field.wire_minimum <= v <= field.wire_maximum)


def others(command, field):
    """Return allowed values for the other fields of a setting."""
    layout = command.request_forms[0].layout
    result = {}
    for name, other in layout.named.items():
        if name != field.name:
            allowed = (v for v in range(other.low, other.high + 1) if other.allows(v))
            result[name] = next(allowed) if other.default is None else int(other.default)
    return result


@pytest.mark.parametrize(("name", "model", "command", "field"), CASES, ids=[f"{n}-{m}-{f.name}" for n, m, _, f in CASES])
def test_what_the_manual_allows_is_kept_and_nothing_else(name, model, command, field):
    rig = Rig(name, model=model)
    drive = rig.drive
    start = dict(drive.settings)
    for value in nearby(field):
        drive.settings.update(start)
        drive.tune()
        before = dict(drive.settings)
        values = others(command, field) | {field.name: value}
        said = rig.send(build(drive.dialect, command.name, drive.address, values))
        assert len(said) == 1
        responder = drive.responders[-1] if name == "mks-modbus" else drive.responders[0]
        status = rig.values(said[0], responder.dialect, command.name)["status"]
        if field.allows(value):
            assert status == 1, (field.name, value)
            assert drive.settings[field.name] == value
        else:
            assert status == 0, (field.name, value)
            assert drive.settings == before
        drive.settings.update(start)
        drive.tune()


@pytest.mark.parametrize("name", NAMES)
def test_defaults_are_the_printed_ones(name):
    for model in MODELS[name]:
        drive = make(name, model=model, mode=None)
        fields = {f.name: f for _, f in fields_of("mks-rs485" if name != "mks-can" else name, model)}
        for each, field in fields.items():
            if field.default is not None and not (each == "modbus" and name == "mks-modbus"):
                assert drive.settings[each] == field.default
        assert set(drive.settings) == set(fields) | set(KEPT)
        assert drive.settings["home_speed"] == UNPRINTED["home_speed"]


@pytest.mark.parametrize("name", KEPT)
def test_what_no_setting_stores_is_checked_too(name):
    for value in (0, KEPT[name]):
        assert make("mks-rs485", **{name: value}).settings[name] == value
    for value in (-1, KEPT[name] + 1, 10**400):
        with pytest.raises(UsageError, match=rf"{name}: got -?[1-9][0-9]*, expected 0\.\.{KEPT[name]}"):
            make("mks-rs485", **{name: value})


def test_start_values_are_checked():
    assert make("mks-rs485", mode=None, work_mode=3).mode == "sr_open"
    with pytest.raises(UsageError, match="no setting 'wrok_mode'"):
        make("mks-rs485", mode=None, wrok_mode=3)
    with pytest.raises(UsageError, match=r"current: got 5200, expected 0\.\.3000"):
        make("mks-rs485", model="42D", current=5200)
    with pytest.raises(UsageError, match="work_mode: got 6"):
        make("mks-rs485", mode=6)
    with pytest.raises(UsageError, match="new_address: got 0"):
        make("mks-can", address=0)


# --- what settings do ------------------------------------------------------------------------------------------------


def test_a_drive_changes_between_its_two_dialects():
    rig = Rig("mks-rs485", mode=5)
    native, modbus = dialects.get("mks-rs485"), dialects.get("mks-modbus")
    (said,) = rig.send(build(native, "set_modbus", 1, {"modbus": 1}))
    assert said.data == bytes.fromhex("FB 01 8E 01 8B")
    assert rig.drive.dialect is modbus
    assert rig.send(build(native, "read_speed", 1), dialect=native) == []
    assert rig.ask("read_speed") == [{"speed": 0}]
    assert rig.drive.settings["work_mode"] == 5
    rig.drive.power_cycle(rig.now)
    rig.wait(SECOND)
    assert rig.drive.dialect is modbus
    (said,) = rig.send(build(modbus, "set_modbus", 1, {"modbus": 0}))
    assert said.data == build(modbus, "set_modbus", 1, {"modbus": 0})
    assert rig.drive.dialect is native
    assert rig.ask("read_speed") == [{"speed": 0}]


@pytest.mark.parametrize("name", NAMES)
def test_modes_and_enabling(name):
    rig = Rig(name, mode=2)
    assert rig.value("read_enabled") == 1  # En is low, and low is active
    rig.ask("set_enable_level", enable_level=1)
    assert rig.value("read_enabled") == 0
    rig.drive.set_enable_pin(1)
    assert rig.value("read_enabled") == 1
    rig.drive.set_enable_pin(0)
    rig.ask("set_enable_level", enable_level=2)
    assert rig.value("read_enabled") == 1
    assert rig.status("enable", enabled=0) == 0  # only in bus modes
    rig.ask("set_work_mode", work_mode=5)
    assert rig.status("enable", enabled=0) == 1
    assert rig.value("read_enabled") == 0
    rig.drive.turn_shaft(500)
    assert rig.axis() == 500
    rig.ask("enable", enabled=1)
    rig.drive.turn_shaft(500)
    assert rig.axis() == 500


@pytest.mark.parametrize("name", NAMES)
def test_pulses_from_outside(name):
    rig = Rig(name, mode=2)
    rig.drive.step(3200)
    assert rig.axis() == -16384  # CW is positive by default
    assert rig.value("read_pulses") == 3200
    rig.ask("set_direction", motor_direction=1)
    rig.drive.step(3200)
    assert rig.axis() == 0
    assert rig.value("read_pulses") == 6400
    rig.ask("set_subdivision", subdivision=8)
    assert rig.value("read_pulses") == 6400
    rig.drive.step(1600)
    assert rig.axis() == 16384
    rig.ask("set_work_mode", work_mode=5)
    rig.drive.step(1600)
    assert rig.axis() == 16384


def test_every_setting_command_is_one():
    for name in NAMES:
        for command in dialects.get(name).commands:
            if command.verb.value.startswith("set_"):
                assert is_setting(command) == (command.verb is not Verb.SET_ZERO)
