"""A stop always gets through, and nothing else does: what left on a port, byte by byte, and whether the shaft stands."""

from __future__ import annotations

import contextlib
import random
from collections.abc import Iterator

import pytest

from analyzer import cli as analyzer_cli
from analyzer import dialects
from analyzer.catalogue import MotionKind
from analyzer.encoder import build
from analyzer.live import endpoint as endpoints
from benchmarks import gate as attack
from conformance.bus import open_line
from conformance.bus.line import Line
from conformance.claim import NotStopped, Outcome
from conformance.cli import restore, scan, send
from conformance.gate.gate import Allowance, Gate
from conformance.gate.permissions import parse_allow
from conformance.safety import messages as say
from conformance.safety import stopping
from conformance.safety.guarded_line import GuardedLine, beginning
from conformance.safety.journal import Entry, Journal
from conformance.suite import engine
from conformance.suite.preflight import Neighbours, neighbours
from tests.conformance.drives.served import LoggedPty, on_logged_pty, wait_for
from tests.conformance.safety.test_guard_stops import claim, open_rig, run_behind_the_probe

MKS = dialects.get("mks-rs485")
MOVING = Allowance(parse_allow("motion,unbounded,torque"), addresses=frozenset({1}))
TURNS = "mks-rs485@1,work_mode=sr_vfoc"
ENABLE = build(MKS, "enable", 1, {"enabled": 1})
RUN = bytes.fromhex("FA 01 F6 00 B4 FC A1")
READ = bytes.fromhex("FA 01 32 2D")
STOP = bytes.fromhex("FA 01 F6 00 00 C8 B9")


@contextlib.contextmanager
def gate_on(port: LoggedPty, allowed: Allowance = MOVING, *, guarded: bool = False) -> Iterator[Gate]:
    endpoint = endpoints.parse(port.on)
    line: Line = open_line(endpoint) if not guarded else GuardedLine(endpoint, beginning(endpoint, [(MKS, 1)], allowed))
    if isinstance(line, GuardedLine):
        line.tell(say.DriveFound())
    with contextlib.closing(line):
        yield Gate(line, allowed)


def turns(port: LoggedPty) -> bool:
    drive = port.bus.drives[0]
    return bool(drive.motor.speed(drive.now_ns))


def set_going(port: LoggedPty, gate: Gate) -> None:
    gate.send(ENABLE)
    gate.wait(30_000_000)
    gate.send(build(MKS, "run_speed", 1, {"speed": 60, "acceleration": 253}))
    assert wait_for(lambda: turns(port))
    gate.wait(30_000_000)
    port.take()


def stands(port: LoggedPty) -> bool:
    return wait_for(lambda: not turns(port), 10)


def harmful(log: bytes) -> list[str]:
    """Return the sound frames of a log, wherever they begin, that do more than read."""
    return [str(seen) for seen in attack.sound([log]) if not seen.risks <= attack.READS]


# --- a stop is never refused ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("guarded", [False, True], ids=["gate", "guard"])
def test_a_stop_leaves_behind_a_run_whose_acceleration_is_the_head_of_a_package(guarded):
    sent = [ENABLE, RUN, *[READ] * 10]
    with on_logged_pty(TURNS, patient=True) as port, gate_on(port, guarded=guarded) as gate:
        for item in sent:
            gate.send(item)
            gate.wait(20_000_000)
        assert turns(port)
        gate.send(STOP)
        assert stands(port)
        assert port.heard == b"".join([*sent, STOP]), "nothing but what was sent, and all of it"


def test_reads_close_what_the_stop_would_complete():
    stop = build(MKS, "emergency_stop", 1)
    chance = random.Random(8)
    with on_logged_pty(TURNS, patient=True) as port:
        for _ in range(40):
            items = attack.bait(chance, 1, stop)
            whole = b"".join([*items, stop])
            if not any(seen.address is None for seen in attack.sound([whole])):
                continue
            with gate_on(port) as gate:
                gate.send(ENABLE)
                gate.wait(20_000_000)
                port.take()
                for item in items:
                    gate.send(item)
                    gate.wait(5_000_000)
                gate.send(stop)
                assert stands(port)
                assert wait_for(lambda: port.heard.endswith(stop))
                log = port.take()
            closing = log[len(whole) - len(stop) : -len(stop)]
            assert log == b"".join(items) + closing + stop
            assert closing
            assert harmful(closing) == []
            assert not any(attack.forbidden(seen, MOVING) for seen in attack.sound([log]))
            return
    raise AssertionError("no such history was drawn")


WAYS = [c for c in MKS.motions(MotionKind.STOP) if c in stopping.ramped_stops(MKS)]
IGNORED = "fault=speed-stop-ignored,fault=move-stop-ignored"


def stop_frames(log: bytes) -> list[str]:
    return [s.command.name for s in attack.sound([log]) if s.command.motion and s.command.motion.kind is MotionKind.STOP]


def test_where_one_way_of_stopping_fails_the_next_is_tried(monkeypatch):
    monkeypatch.setattr("conformance.motion.motion.NO_RAMP_NS", 300_000_000)
    with on_logged_pty(f"{TURNS},{IGNORED}") as port, gate_on(port) as gate:
        set_going(port, gate)
        assert stopping.stop(gate, MKS, 1).failure == ""
        assert stands(port)
        tried = stop_frames(port.take())
    assert set(tried[:-1]) == {c.name for c in WAYS}
    assert tried[-1] == "emergency_stop", "each by a ramp first, then the stop at once"


def test_where_no_way_of_stopping_is_left_all_were_tried_and_the_power_is_cut(tmp_path, monkeypatch, capfd):
    monkeypatch.setattr("conformance.motion.motion.NO_RAMP_NS", 300_000_000)
    with on_logged_pty(f"{TURNS},{IGNORED},fault=emergency-stop-ignored") as port, gate_on(port) as gate:
        set_going(port, gate)
        with pytest.raises(NotStopped, match="NOT STOPPED: mks-rs485@1: speed 60 rpm"):
            stopping.stop_or_cut(gate, MKS, 1, f"touch {tmp_path / 'cut'}")
        assert set(stop_frames(port.take())) == {c.name for c in MKS.motions(MotionKind.STOP)}
    assert (tmp_path / "cut").exists()


def test_a_stop_that_breaks_down_cuts_the_power_too(tmp_path, monkeypatch, capfd):
    """The motor may turn after any failure of the stop, so the power must be cut."""

    def broken(*given, **how):
        raise ZeroDivisionError("a reply that it was not written for")

    monkeypatch.setattr(stopping, "prove_standing", broken)
    with on_logged_pty(TURNS) as port, gate_on(port) as gate, pytest.raises(NotStopped, match="ZeroDivisionError"):
        stopping.stop_or_cut(gate, MKS, 1, f"touch {tmp_path / 'cut'}")
    assert (tmp_path / "cut").exists()


@pytest.mark.parametrize("name", ["emergency_stop", "stop_speed", "stop_relative_axis"])
def test_a_stop_that_is_named_needs_no_permission(name):
    with on_logged_pty(TURNS) as port:
        with gate_on(port) as gate:
            set_going(port, gate)
            port.take()
        assert analyzer_cli._run("send", send, ["mks-rs485@1", name, "--on", port.on]) == 0
        assert stands(port)
        assert stop_frames(port.take()) == [name]


# --- sendings in turn -------------------------------------------------------------------------------------------------


def tail_of_a_package(begun: bytes) -> bytes:
    """Return the rest of a package whose second slot runs drive 1."""
    body = begun.ljust(11, b"\0") + bytes.fromhex("01 F6 01 40 02")
    body = body.ljust(51, b"\0")
    return (body + bytes((sum(body) & 0xFF,)))[len(begun) :]


#: A read of the drive at FCh ends in FC 32 28; no read of it begins no package.
AT_FC = bytes.fromhex("FA FC 32 28")


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("FA 01", "F6 01 40 02 34"),
        ("04 04 FA 01 F6 01 17 27", "30 01 00 00 00 01 F8 2B"),
        ("FA D0 30 FA", "01 F6 01 40 02 34"),
        (AT_FC.hex(" "), tail_of_a_package(AT_FC[1:]).hex(" ")),
    ],
)
def test_two_sendings_in_turn_move_nothing(first, second):
    with on_logged_pty(TURNS, patient=True) as port:
        with gate_on(port) as gate:
            gate.send(ENABLE)
            gate.wait(50_000_000)
        port.take()
        for text in (first, second):
            analyzer_cli._run("send", send, ["--hex", text, "--on", port.on, "--timeout", "60"])
        assert harmful(port.heard) == []
        assert analyzer_cli._run("send", send, ["mks-rs485@1", "read_speed", "--on", port.on]) == 0
        assert not turns(port)


def test_what_a_scan_leaves_open_is_no_beginning_for_the_next_program():
    with on_logged_pty(TURNS, patient=True) as port:
        words = [port.on, "--addresses", "252", "--dialects", "mks-rs485", "--timeout", "5"]
        assert analyzer_cli._run("scan", scan, words) == 1

        def left() -> bytes:
            """Return what stands behind the last beginning of a package."""
            return port.heard.rpartition(b"\xfc")[2]

        def closed() -> bool:
            return len(left()) > 2 and not harmful(port.heard + tail_of_a_package(b"\xfc" + left()[:2]))

        # The drives may still be reading what was written.
        assert wait_for(closed, 10), port.heard.hex(" ")
        assert set(left()[2:]) <= {0x00, 0x55}


# --- a turning shaft is stopped, also one that no claim set going -----------------------------------------------------


def test_a_run_that_no_claim_declared_is_stopped_at_the_end_of_the_claim(tmp_path):
    with on_logged_pty(TURNS) as port:
        rig = open_rig(port.path, tmp_path)
        try:
            rig.probe(claim(lambda p: None)).do("enable", {"enabled": 1})
            port.take()
            assert engine.run_claim(claim(run_behind_the_probe), rig).outcome is Outcome.CONFIRMED
            assert not turns(port)
            acts = [s.command.name for s in attack.sound([port.take()]) if not s.risks <= attack.READS]
            assert acts[0] == "run_speed"
            assert acts[1:]
            assert set(acts[1:]) <= {c.name for c in MKS.motions(MotionKind.STOP)}
        finally:
            rig.close()


def test_all_addresses_are_asked_by_reads_before_a_drive_counts_as_alone():
    with on_logged_pty("mks-rs485@1", "mks-rs485@60") as port, gate_on(port, Allowance()) as gate:
        assert neighbours(gate, [MKS], own=(1,)) == Neighbours(("mks-rs485@60",))
        log = port.take()
    assert harmful(log) == []
    assert {s.address for s in attack.sound([log]) if s.dialect is MKS} >= set(range(2, 256))


def test_restore_stops_a_turning_shaft_before_it_sets_anything(tmp_path, capsys):
    path = tmp_path / "j"
    with on_logged_pty(TURNS) as port:
        with gate_on(port) as gate:
            set_going(port, gate)
        journal = Journal(path)
        journal.write(Entry(event="change", target="mks-rs485@1", on=port.on, command="set_subdivision", address=1,
                            values={"subdivision": 16}, sent=[{"subdivision": 8}]))  # fmt: skip
        journal.close(remove=False)
        port.take()
        assert analyzer_cli._run("restore", restore, [str(path)]) == 0
        assert not turns(port)
        seen = [s for s in attack.sound([port.take()]) if s.dialect is MKS]
    acts = [s.command.name for s in seen if not s.risks <= attack.READS]
    assert seen[0].risks <= attack.READS, "it looks first"
    assert acts[0].startswith("stop_")
    assert acts[-1] == "set_subdivision"
    assert "stopped, and it stands" in capsys.readouterr().out


def test_a_journal_brings_no_permission_to_run_at_power_on(tmp_path):
    """Only forgetting a speed that is kept for the next power-on puts anything back."""
    path = tmp_path / "j"
    with on_logged_pty(TURNS) as port:
        journal = Journal(path)
        journal.write(Entry(event="change", target="mks-rs485@1", on=port.on, command="save_speed", address=1,
                            values={"save_state": 0xC8}, sent=[]))  # fmt: skip
        journal.close(remove=False)
        analyzer_cli._run("restore", restore, [str(path)])
        kept = [s.values for s in attack.sound([port.take()]) if s.command.name == "save_speed"]
    assert kept
    assert {v["save_state"] for v in kept} == {0xCA}
