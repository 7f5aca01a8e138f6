"""The toy dialect as a package of one file: every command of the analyzer works with it."""

from __future__ import annotations

import json

import pytest

from analyzer import dialects
from analyzer.catalogue import Role
from analyzer.detect import choose
from analyzer.encoder import assemble
from analyzer.records import CanFrame
from tests.logs import messages
from tests.plugin_site import servotap

MS = 1_000_000


def _exchanges(dialect, address, count):
    """Return reads and their replies as a recording has them, 2 ms apart."""
    frames = []
    for n in range(count):
        for command in map(dialect.by_name.get, ("read_speed", "read_position")):
            for role in (Role.REQUEST, Role.REPLY):
                form = command.request_forms[0] if role is Role.REQUEST else command.reply_forms[0]
                built = assemble(dialect, command, address, dict.fromkeys(form.layout.named, n % 100), role)
                frames.append(CanFrame(len(frames) * 2 * MS, "can0", built.can_id, built.frame))
    return frames


def test_it_stands_in_the_catalogue_and_is_built_and_explained(site):
    assert "set_current" in servotap(site, "catalogue", "--dialect", "toy-can").stdout
    assert servotap(site, "frame", "toy-can@2", "run", "speed=30").stdout.strip() == "4D 2C 01 00 00"
    assert servotap(site, "frame", "toy-can@2", "read_speed").stdout.strip() == "54"
    assert "expected 0..4000 mA" in servotap(site, "frame", "toy-can@2", "set_current", "current=4001").stderr
    shown = json.loads(servotap(site, "explain", "--json", "--dialect", "toy-can", "04D 2C 01 00 00").stdout)
    assert (shown["command"], shown["address"], shown["fields"]) == ("run", 2, {"speed": 30})


def test_a_recording_is_decoded_and_shown(site):
    rows = [f"({n / 1000:.6f}) can0 049#" for n in range(0, 40, 2)] + ["(0.100000) can0 04D#2C010000", "(0.101000) can0 04D#00"]
    rows += [f"({n / 1000:.6f}) can0 049#{n:02X}000000" for n in range(1, 41, 2)]
    (site / "toy.candump").write_text("\n".join(sorted(rows)) + "\n")
    summary = json.loads(servotap(site, "decode", "toy.candump", "--force", "--json").stdout)
    assert (summary["dialects"], summary["frames"]) == (["toy-can"], 42)
    assert {f["rule"] for f in summary["findings"]} == {"failed_status"}
    assert ("/can0/2/state", {"position": pytest.approx(0.39)}) in messages(site / "toy.candump.mcap")
    assert "read_position" in servotap(site, "show", "toy.candump").stdout


def test_a_frame_without_a_check_is_explained_by_code_and_length(site):
    def told(*words):
        shown = json.loads(servotap(site, "explain", "--json", *words).stdout)
        return shown["dialect"], shown.get("command"), shown["address"]

    assert told("04D 2C 01 00 00") == ("toy-can", "run", 2)
    assert told("001 F6 01 40 02 3A") == ("mks-can", "run_speed", 1)
    assert told("001 F6 01 40 02 3B") == ("mks-can", "run_speed", 1), "its checksum is wrong, and it is no frame of the toy"
    assert "address 0x002, code 0x0D" in servotap(site, "explain", "04D 2C 01 00 00").stdout


# --- which dialect a bus speaks ---------------------------------------------------------------------------------------


def _chosen(*frames):
    every = [d for d in dialects.every() if d.bus == "can"]
    return [d.name for d in choose(every, sorted(frames, key=lambda frame: frame.t_ns)).dialects]


def test_each_dialect_of_can_is_told_from_the_other(toy):
    mks = dialects.get("mks-can")
    assert _chosen(*_exchanges(toy, 2, 20)) == ["toy-can"]
    # Addresses that are codes of the toy's node 0.
    for address in (1, 9, 0x14):
        assert _chosen(*_exchanges(mks, address, 20)) == ["mks-can"]


def test_both_dialects_are_found_on_one_bus(toy):
    frames = [*_exchanges(dialects.get("mks-can"), 1, 20), *_exchanges(toy, 2, 20)]
    assert _chosen(*frames) == ["mks-can", "toy-can"]


def test_a_dialect_without_checks_does_not_claim_the_frames_of_others(toy):
    """Of any traffic some frames have a code and a length of the toy."""
    frames = _exchanges(dialects.get("mks-can"), 1, 20)
    frames += [CanFrame(n * MS, "can0", 37 * n % 0x800, bytes(n * 5 % 9)) for n in range(160)]
    assert _chosen(*frames) == ["mks-can"]
    assert _chosen(*frames[80:]) == [d.name for d in dialects.every() if d.bus == "can"], "none of them, so all are tried"
