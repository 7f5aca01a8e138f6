"""The DBC file of a dialect, read by cantools, decodes frames as this project does."""

from __future__ import annotations

import cantools
import pytest
from cantools.database.can import Database

from analyzer import dialects
from analyzer.catalogue import Dialect, Role
from analyzer.cli import main
from analyzer.codec import codec
from analyzer.layout import FieldKind
from analyzer.reference.dbc import dbc, shapes, signal_name
from tests.toy.dialect import DIALECT as TOY

MKS = dialects.get("mks-can")
ROLES = (Role.REQUEST, Role.REPLY)


def read(dialect: Dialect, address: int, role: Role) -> Database:
    database = cantools.database.load_string(dbc(dialect, [address], role), "dbc", strict=True)
    assert isinstance(database, Database)
    return database


@pytest.mark.parametrize("role", ROLES)
@pytest.mark.parametrize("dialect", [MKS, TOY], ids=["mks-can", "toy-can"])
def test_every_form_decodes_as_here(dialect: Dialect, role: Role) -> None:
    address = 5
    database = read(dialect, address, role)
    found, _ = shapes(dialect, address, role)
    assert found
    for shape in found:
        layout = shape.form.layout
        for fill in (0x00, 0x5A, 0x80, 0xA5, 0xFF):
            data = bytes([fill]) * layout.byte_length
            frame = dialect.link.build(shape.command, shape.form, address, data, role)
            signals = database.decode_message(shape.identifier, frame, decode_choices=False, scaling=True, allow_truncated=True)
            assert isinstance(signals, dict)
            code = signals.pop("code", None)
            assert code is None or code == shape.command.code
            ours = codec(layout).physical(data)
            names = [f for f in layout.fields if f.kind is not FieldKind.RESERVED]
            expected = {(signal_name(shape.command, f) if shape.head else f.name): ours[f.name] for f in names}
            assert signals == pytest.approx(expected), shape


@pytest.mark.parametrize("role", ROLES)
def test_every_printed_frame_is_read_or_left_out(role: Role) -> None:
    database = read(MKS, 1, role)
    has, lacks = shapes(MKS, 1, role)
    read_so = 0
    for command in MKS.commands:
        for vector in command.vectors:
            identifier, frame = vector.taken_on("can")
            if vector.role is not role or identifier != 1:
                continue
            shape = next((s for s in has if s.head == frame[:1] and codec(s.form.layout).matches(frame[1:-1])), None)
            if shape is None or shape.command is not command:
                assert command in [entry.command for entry in lacks], vector
                continue
            signals = database.decode_message(1, frame, decode_choices=False, scaling=False, allow_truncated=True)
            assert isinstance(signals, dict)
            for name, value in vector.values.items():
                assert signals[signal_name(command, shape.form.layout.named[name])] == value, vector
            read_so += 1
    assert read_so


def test_the_names_of_values_and_the_units_go_along() -> None:
    signals = {signal.name: signal for signal in read(MKS, 1, Role.REQUEST).get_message_by_name("drive_1").signals}
    assert signals["run_speed_direction"].choices == {0: "ccw", 1: "cw"}
    assert signals["set_current_current"].unit == "mA"


def test_what_is_no_can_is_refused(cli) -> None:
    assert main(["dbc", "mks-rs485"]) == 2
    assert "mks-can has 1 to 2047, got 0" in cli("dbc", "mks-can", "--address", "0", status=2).err
