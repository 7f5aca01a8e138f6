"""The gate knows what the toy's requests do by its declarations alone."""

from __future__ import annotations

import pytest

from analyzer import dialects
from analyzer.encoder import assemble
from analyzer.records import CanFrame
from conformance.gate.gate import Gate, Judge
from conformance.gate.permissions import Allowance, parse_allow
from tests.toy.bus import ToyLine
from tests.toy.drive import ToyDrive

RUNS = "motion,unbounded"


def _gate(allow="", **bounds):
    bounds.setdefault("addresses", frozenset({2}))
    return Gate(ToyLine([ToyDrive()]), Allowance(parse_allow(allow), **bounds))


def _objections(gate, command, address=2, **values):
    item = assemble(dialects.get("toy-can"), command, address, values).item()
    return " ".join(str(objection) for objection in gate.objections(item))


def test_a_run_has_no_end_and_needs_to_be_allowed(toy):
    assert "needs unbounded" in _objections(_gate("motion"), "run", speed=300)
    assert not _objections(_gate(RUNS), "run", speed=300)


@pytest.mark.parametrize("speed", [300, -300])
def test_the_highest_speed_is_in_rpm_whatever_the_field_counts(toy, speed):
    assert not _objections(_gate(RUNS, speed=30), "run", speed=speed)
    assert "30 rpm, above --max-speed 29.9" in _objections(_gate(RUNS, speed=29.9), "run", speed=speed)
    assert "above --max-speed" in _objections(_gate(RUNS, speed=29.9), "move_to", position=0, speed=300)


def test_a_move_to_a_place_is_as_long_as_the_way_there(toy):
    gate = _gate("motion", turns=1)
    assert "cannot be told without the drive's position" in _objections(gate, "move_to", position=0, speed=300)
    gate.note_position(720.0, 2)
    assert not _objections(gate, "move_to", position=108_000, speed=300)
    assert "1.5 turns, above --max-turns 1" in _objections(gate, "move_to", position=126_000, speed=300)
    assert "2 turns, above --max-turns 1" in _objections(gate, "move_to", position=0, speed=300)


def test_a_stop_and_a_read_pass_every_bound(toy):
    gate = _gate("motion", speed=1, turns=0.01, current=1)
    assert not _objections(gate, "stop")
    assert not _objections(_gate(speed=1, turns=0.01), "read_position")


def test_a_current_is_bounded(toy):
    gate = _gate("setting,torque", current=900)
    assert not _objections(gate, "set_current", current=900)
    assert "901 mA, above --max-current 900" in _objections(gate, "set_current", current=901)


def test_frames_of_another_node_need_alone(toy):
    for command, values in (("read_position", {}), ("stop", {}), ("run", {"speed": 10})):
        assert "meant for 3, and the drive is 2" in _objections(_gate(RUNS), command, 3, **values)
        assert not _objections(_gate(RUNS, alone=True), command, 3, **values)


# --- drives of two makers on one bus ----------------------------------------------------------------------------------


def test_a_good_frame_of_one_dialect_is_no_unknown_one_of_another(toy):
    mks = dialects.get("mks-can")
    good = Judge(Allowance(addresses=frozenset({1})))
    for command in ("read_speed", "read_position"):
        assert not good.objections(assemble(mks, command, 1).item())
        assert not Judge(Allowance(addresses=frozenset({2}))).objections(assemble(toy, command, 2).item())


def test_a_frame_that_is_good_in_two_dialects_counts_in_both(toy):
    """Two bytes to MKS drive 11 are the toy's node 0 and its code 11: a current."""
    read = assemble(dialects.get("mks-can"), "read_speed", 11).item()
    assert [o.interpretation.dialect.name for o in Judge(Allowance()).objections(read)] == ["toy-can"]


def test_what_is_good_in_no_dialect_counts_in_all(toy):
    objections = Judge(Allowance()).objections(CanFrame(None, "bus", 0x4D, b"\xf6\x01"))
    assert {o.interpretation.dialect.name for o in objections} == {"mks-can", "toy-can"}
