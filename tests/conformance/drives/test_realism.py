"""Realism: an honest drive reads within its noise, answers in time, and is ideal without any trait."""

from __future__ import annotations

import contextlib
import math
import random
from dataclasses import replace

import msgspec
import pytest
from msgspec import structs

from analyzer.catalogue import Verb
from analyzer.errors import UsageError
from conformance import claims as registry
from conformance.claim import Inconclusive, Outcome
from conformance.cli import emulate
from conformance.drives import make, realism
from conformance.drives.drive import Fault
from conformance.motion import motion, resting
from conformance.motion.declared import QUICK
from conformance.safety.stopping import MAY_MOVE
from conformance.suite import engine
from conformance.suite.rig_emulated import EmulatedRig
from conformance.talk.dialogue import Until
from conformance.talk.noise import QUIET, Noise
from conformance.talk.probe import MS
from tests.conformance.quirk_runs import run

DRIVES = ("mks-rs485@1", "mks-modbus@1", "mks-can@1", "lk-rs485@1")
#: Claims that a real shaft and a real line would have refuted, by the end of their ids.
_TELLING = ("/sign", "/distance", "/again", "/same-place", "/at-rest", "/read_position/clean", "/answers-raw", "/voltage")


def rig(text: str, seed: int = 0) -> EmulatedRig:
    return EmulatedRig(make.parse(text), seed=seed)


def readings(text: str, name: str = "read_position", count: int = 40) -> set[tuple[tuple[str, int], ...]]:
    probe = rig(text).probe(next(iter(registry.every(make.parse(text).dialect))))
    return {tuple(probe.ask(name).reply.values.items()) for _ in range(count)}


@pytest.mark.parametrize("drive", DRIVES)
def test_an_ideal_drive_has_no_noise(drive):
    assert replace(rig(drive).noise, latency_ns=0, checked=False) == QUIET
    assert len(readings(drive)) == 1


@pytest.mark.parametrize(("counts", "live"), [(0, False), (3, True)])
def test_a_loop_that_rests_still_beside_its_target_shows_after_a_move(counts, live):
    each = rig(f"lk-rs485@1,loop-error={counts}")
    probe = each.probe(next(c for c in registry.every(each.dialect) if resting.can_turn(each.dialect, c)))
    assert probe.noise.live is live
    assert probe.noise.loop <= 4 * 360 / 16384
    assert not resting.measure(probe).live


@pytest.mark.parametrize("drive", DRIVES)
def test_noise_is_measured_and_bounded(drive):
    noise = rig(f"{drive},real=bench").noise
    assert 0 < noise.degrees <= 2 * 360 / 16384
    assert noise.live
    assert noise.place <= 0.3


@pytest.mark.parametrize("drive", DRIVES)
def test_what_is_drawn_depends_on_the_seed_alone(drive):
    def seen(seed: int) -> list[object]:
        each = EmulatedRig(make.parse(f"{drive},real=poor"), seed=seed)
        probe = each.probe(next(iter(registry.every(each.dialect))))
        return [(a.data, a.latency_ns) for _ in range(20) for a in probe.ask("read_position").answers]

    assert seen(1) == seen(1) != seen(2)


def test_turns_and_the_value_within_one_stay_one_number():
    values = readings("mks-rs485@1,encoder-noise=2", "read_encoder_carry")
    assert {dict(v)["carry"] * 16384 + dict(v)["encoder"] for v in values} == {-2, 0, 2}


def test_a_byte_of_the_line_is_no_part_of_a_reply():
    each = rig("mks-rs485@1,turnaround-noise=FF")
    assert each.noise.stray == b"\xff"
    exchange = each.probe(next(iter(registry.every(each.dialect)))).ask("read_speed")
    assert (exchange.received[:1], exchange.junk) == (b"\xfb", [])


@pytest.mark.parametrize(("dialect", "repeats"), [("mks-rs485", 1), ("mks-modbus", 2), ("lk-rs485", 1)])
def test_an_end_of_replies_that_comes_twice_is_one_fault_and_not_one_of_each_command(dialect, repeats):
    each = rig(f"{dialect}@1,fault=checksum-doubled")
    assert each.noise.repeats == repeats
    names = ("read_position/clean", "read_speed/clean", "read_state_2/clean", "resilience/reads/good", "trailing/answered")
    found = {v.claim.id: v.outcome for v in engine.run((c for c in registry.every(each.dialect) if c.id.endswith(names)), each)}
    assert found.pop(f"{dialect}/shape/read_position/clean") is Outcome.REFUTED
    assert set(found.values()) == {Outcome.CONFIRMED}


def moved(text: str, seed: int = 0) -> Noise:
    """Return the noise that a rig knows when a claim has moved the shaft."""
    each = rig(text, seed)
    each.probe(next(c for c in registry.every(each.dialect) if resting.can_turn(each.dialect, c)))
    return each.noise


@pytest.mark.parametrize("drive", DRIVES)
def test_the_speed_of_a_shaft_that_rests_still_is_measured_in_a_move(drive):
    noise = moved(f"{drive},speed-noise=2%")
    assert (rig(f"{drive},speed-noise=2%").noise.live, noise.live) == (False, True)
    # Nothing trembles at rest: only the speed of the move does.
    assert noise.degrees == noise.loop == noise.rpm == 0
    assert 0.01 < noise.share <= 0.021
    assert noise.speed(300) >= 6


@pytest.mark.parametrize(
    ("drive", "seed"), [("mks-rs485@1", 5), ("mks-rs485@1", 18), ("mks-modbus@1", 9), ("mks-modbus@1", 23)]
)
def test_a_line_that_loses_requests_hides_no_noise_of_a_shaft_that_turns(drive, seed):
    # Of these seeds one loses the request of the move, the others reads of its speed.
    assert moved(f"{drive},speed-noise=2%,request-errors=3%", seed).share > 0.01


@pytest.mark.parametrize("drive", DRIVES)
def test_a_shaft_that_creeps_when_it_has_come_to_rest_trembles(drive):
    assert not rig(f"{drive},creep=2").noise.live
    assert moved(f"{drive},creep=2").live


@pytest.mark.parametrize("drive", ["mks-rs485@1", "mks-can@1"])
def test_a_shaft_that_goes_on_after_a_stop_at_once_swings(drive):
    noise = moved(f"{drive},overshoot=12,settle=80ms")
    assert 6 * 360 / 16384 < noise.lag <= 12 * 360 / 16384
    assert (moved(drive).lag, noise.swing > 2 * noise.lag - 0.001) == (0, True)


def test_a_lone_byte_in_a_pause_is_of_the_line_or_of_the_reply():
    each = rig("mks-rs485@1,turnaround-noise=FF,byte-gap=1.4")
    probe = each.probe(next(iter(registry.every(each.dialect))))
    for _ in range(60):
        for name in ("read_speed", "read_position"):
            exchange = probe.ask(name)
            assert (exchange.junk, exchange.received) == ([], exchange.reply.data)


@pytest.mark.parametrize(("more", "is_read"), [("", False), (",quirk=no-checksum", True)])
def test_a_reply_that_lost_a_byte_is_not_taken_for_one_without_a_checksum(more, is_read):
    """Unless the drive has shown that it sends none: then nothing can tell."""
    each = rig(f"mks-rs485@1{more}")
    probe = each.probe(next(iter(registry.every(each.dialect))))
    cut = slice(None) if is_read else slice(None, -1)
    probe.drive.hooks.reply.append(lambda drive, command, out: [structs.replace(out, data=out.data[cut])])
    exchange = probe.ask("read_position")
    assert exchange.is_read is is_read
    assert [j.data for j in exchange.junk] == ([] if is_read else [exchange.received])


def test_a_zero_that_is_told_is_the_zero_that_is_kept():
    each = rig("lk-rs485@1,encoder-noise=2,loop-error=4")
    wanted = [c for c in registry.every(each.dialect) if c.id.endswith("set_zero/offset")]
    assert {v.outcome for v in engine.run(wanted, each)} == {Outcome.CONFIRMED}


def test_replies_are_late_behind_a_hub_and_when_power_comes_on():
    probe = rig("mks-rs485@1,first-late=200ms,stall=30ms").probe(next(iter(registry.every(rig("mks-rs485@1").dialect))))
    late = [probe.ask("read_speed").reply.latency_ns // 1_000_000 for _ in range(200)]
    assert late[0] >= 200
    assert {30 <= ms < 60 for ms in late[1:]} == {True, False}
    assert max(late[1:]) < 60


def test_a_filtered_speed_stays_behind():
    each = rig("mks-rs485@1,speed-lag=100ms")
    probe = each.probe(next(c for c in registry.every(each.dialect) if resting.can_turn(each.dialect, c)))
    motion.ready_to_move(probe)
    motion.speed(probe)
    motion.run_at(probe, 300, 0)
    seen = [motion.speed(probe).value for _ in range(300)]
    assert 0 < abs(seen[0]) < 290
    assert abs(seen[-1]) == 300


@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize("real", ["bench", "poor"])
def test_an_honest_drive_is_not_accused(drive, real):
    wanted = [c for c in registry.every(rig(drive).dialect) if c.id.endswith(_TELLING)]
    verdicts = run(f"{drive},real={real}", wanted).values()
    assert [f"{v.claim.id}: {v.reason}" for v in verdicts if v.outcome is Outcome.REFUTED] == []


def closed(hooks):
    hooks.setup.append(lambda drive: [drive.limit_switch(side) for side in ("left", "right")])


def idle_now_and_then(hooks):
    chance = random.Random(5)
    hooks.reply.append(
        lambda drive, command, each: [msgspec.structs.replace(each, data=b"\xff" * (chance.random() < 0.3) + each.data)]
    )


def beside_the_middle(hooks):
    """Off by seven counts at most in the places of a turn, where no loop mends it."""

    def read(drive, command, asked, values):
        if values and "position" in values and "open" in drive.mode:
            values["position"] += round(7 * math.sin(2 * math.pi * values["position"] / 16384))
        return values

    hooks.result.append(read)


#: Drives of which none contradicts its manual, and a claim that once accused them. No change: the words of the drive are it.
HONEST = [
    ("mks-rs485@1,model=42D", closed, "resilience/settings/at-rest"),
    ("mks-rs485@1,model=57D", closed, "resilience/settings/refused"),
    ("mks-can@1,model=42E", beside_the_middle, "motion/move_relative_pulses/crossed-ends"),
    ("mks-modbus@1", idle_now_and_then, "modbus/register/between"),
    ("mks-modbus@1", idle_now_and_then, "modbus/write_one/echo"),
    *(
        ("lk-rs485@1,model=MF,angle_limit=9000", None, claim)
        for claim in (
            "motion/move_multi_turn/own-speed",
            "ranges/move_multi_turn/position/width",
            "motion/set_position/and-moves",
            "motion/move_multi_turn_limited/reaches",
            "ranges/move_multi_turn_limited/max_speed/width",
        )
    ),
]


@pytest.mark.parametrize(("drive", "change", "claim"), HONEST)
def test_an_honest_drive_of_its_own_kind_is_not_accused(drive, change, claim):
    specification = make.parse(drive)
    if change is not None:
        kind = Fault("honest", (specification.dialect.name,), "as drives are", "", change)
        specification = replace(specification, faults=(kind,))
    each = EmulatedRig(specification)
    (wanted,) = (c for c in registry.every(each.dialect) if c.id.split("/", 1)[1] == claim)
    verdict = engine.run_claim(wanted, each)
    assert verdict.outcome is not Outcome.REFUTED, (verdict.reason, verdict.expected, verdict.got)
    assert "a fault of the claim" not in verdict.reason


@pytest.mark.parametrize("fault", ["speed-low-byte-first", "position-half-width"])
def test_a_lie_is_found_on_a_drive_that_trembles(fault):
    each = rig(f"mks-rs485@1,fault={fault},real=bench")
    wanted = [c for c in registry.every(each.dialect) if "/motion/read_" in c.id]
    assert any(v.outcome is Outcome.REFUTED for v in engine.run(wanted, each))


@pytest.mark.parametrize(
    "text", ["real=great", "encoder-noise=x", "encoder-noise=1..2", "latency=8..1ms", "warm=3", "turnaround-noise=FFF"]
)
def test_traits_that_there_are_not_are_refused(text):
    with pytest.raises(UsageError):
        make.parse(f"mks-rs485@1,{text}")


def test_every_trait_has_an_example_that_is_read(capsys):
    for trait in realism.TRAITS:
        text = f"{trait.name}={trait.example}" if trait.unit else trait.name
        assert make.parse(f"mks-rs485@1,{text}").realism.most(trait.name) > 0
    emulate._print_realism()
    listed = capsys.readouterr().out
    assert [trait.name for trait in realism.TRAITS if trait.name not in listed] == []


@pytest.mark.parametrize(
    ("drive", "judge"),
    [
        ("mks-rs485@1,line-errors=2%", "mks-rs485/resilience/reads/good"),
        ("lk-rs485@1,line-errors=2%", "lk-rs485/resilience/reads/good"),
        ("mks-modbus@1,request-errors=2%", "mks-modbus/timing/replies/every-time"),
        ("lk-rs485@1,request-errors=2%", "lk-rs485/timing/replies/every-time"),
        ("mks-rs485@1,fault=pause-in-frame", "mks-rs485/shape/one-piece"),
        ("lk-rs485@1,fault=pause-in-frame", "lk-rs485/shape/one-piece"),
    ],
)
def test_a_fault_of_the_line_is_one_verdict(drive, judge):
    dialect = rig(drive).dialect
    wanted = [c for c in registry.every(dialect) if c.id == judge or ("/shape/read_" in c.id)]
    verdicts = run(drive, wanted).values()
    assert [v.claim.id for v in verdicts if v.outcome is Outcome.REFUTED] == [judge]


@pytest.mark.parametrize("seed", range(6))
def test_what_the_line_damages_is_no_part_of_what_is_measured(seed):
    each = EmulatedRig(make.parse("mks-rs485@1,speed-noise=2%,turnaround-noise=FF,line-errors=3%"), seed=seed)
    probe = each.probe(next(c for c in registry.every(each.dialect) if resting.can_turn(each.dialect, c)))
    assert probe.noise.stray == b"\xff"
    assert probe.noise.share > 0.005


@pytest.mark.parametrize(("trait", "counted"), [("line-errors", "damaged replies"), ("request-errors", "lost requests")])
def test_a_read_whose_reply_is_damaged_or_lost_is_asked_again_and_counted(trait, counted):
    each = rig(f"mks-rs485@1,{trait}=20%")
    probe = each.probe(next(iter(registry.every(each.dialect))))
    for _ in range(20):
        with contextlib.suppress(Inconclusive):
            probe.read("read_speed")
    assert probe.measured[counted] >= 2
    assert len(probe.traffic) == 20 + probe.measured[counted]


@pytest.mark.parametrize(("until", "lost"), [(Until.REPLY, True), (Until.TIMEOUT, False)])
def test_a_request_is_lost_where_a_reply_was_waited_for(until, lost):
    each = rig("mks-rs485@1,request-errors=100%")
    probe = each.probe(next(iter(registry.every(each.dialect))))
    exchange = probe.ask("read_speed", until=until)
    assert exchange.silent
    assert exchange.unanswered is lost
    assert not each.has_lost(exchange)
    each.answered.add("read_speed")
    assert each.has_lost(exchange) is lost


#: Claims about times and speeds by the clock of the line, by the end of their ids.
_OF_CLOCKS = (
    "/ramp-236",
    "/ramp-240-to-60",
    "/run_speed/speed-60",
    "/run_speed/speed-360",
    "/speed-at-128",
    "is-change",
    "/crossed-course",
)


@pytest.mark.parametrize("clock", ["-2%", "+2%"])
@pytest.mark.parametrize("drive", DRIVES)
def test_a_drive_whose_clock_is_off_by_2_percent_is_not_accused(drive, clock):
    each = rig(f"{drive},clock={clock}")
    wanted = [c for c in registry.every(each.dialect) if c.id.endswith(_OF_CLOCKS)]
    assert {v.outcome for v in engine.run(wanted, each)} == {Outcome.CONFIRMED}


@pytest.mark.parametrize("drive", DRIVES)
def test_a_fast_clock_makes_a_fast_shaft_that_reads_as_it_should(drive):
    each = rig(f"{drive},clock=+2%")
    probe = each.probe(next(c for c in registry.every(each.dialect) if resting.can_turn(each.dialect, c)))
    motion.ready_to_move(probe)
    motion.run_at(probe, 60, QUICK)
    probe.wait(300 * MS)
    assert motion.mean_speed(probe)[0] == pytest.approx(61.2, abs=0.05)
    assert motion.speed(probe).value == 60


def test_a_reply_that_stalls_leaves_a_ramp_uncertain():
    text = "mks-modbus@3,encoder-noise=1,loop-error=3,creep=2,stall=30ms,settle=50ms,latency=0.3..1ms"
    for seed in range(8):
        each = EmulatedRig(make.parse(text), seed=seed)
        wanted = [c for c in registry.every(each.dialect) if c.id.endswith("stop_speed/ramp-236")]
        assert [v.reason for v in engine.run(wanted, each) if v.outcome is Outcome.REFUTED] == []


def test_a_newer_move_is_waited_for_as_long_as_the_older_one_went_on_before_it():
    each = EmulatedRig(make.parse("mks-modbus@22,model=57D,encoder-noise=2,stall=30ms,clock=-2%"), seed=26)
    (wanted,) = (c for c in registry.every(each.dialect) if c.id.endswith("move_absolute_axis/takes-over"))
    verdict = engine.run_claim(wanted, each)
    assert verdict.outcome is Outcome.CONFIRMED, verdict.reason


def test_a_quiet_loop_that_rests_beside_its_target_takes_a_position_as_it_was_sent():
    for seed in range(4):
        each = EmulatedRig(make.parse("lk-rs485@14,model=MS,loop-error=4,hysteresis=2,creep=2"), seed=seed)
        wanted = [c for c in registry.every(each.dialect) if c.id.endswith("framing/start_bytes")]
        assert {v.outcome for v in engine.run(wanted, each)} == {Outcome.CONFIRMED}


def changed(text: str, change) -> EmulatedRig:
    """Return a rig with a drive to which something was done before."""
    specification = make.parse(text)
    before = Fault("before", (specification.dialect.name,), "", "", lambda hooks: hooks.setup.append(change))
    return EmulatedRig(replace(specification, faults=(before,)))


def protected(drive):
    drive.memory.protected = True
    drive.grip()


@pytest.mark.parametrize(
    ("text", "change", "why"),
    [
        ("mks-rs485@1", protected, "protects itself"),
        ("mks-can@1", protected, "protects itself"),
        ("mks-rs485@1", lambda drive: drive.block(), "is held"),
        ("mks-modbus@1", lambda drive: drive.block(), "is held"),
        ("lk-rs485@1", lambda drive: drive.block(), "stalled"),
        ("lk-rs485@1", lambda drive: drive.supply(9.0), "low_voltage"),
        ("lk-rs485@1", lambda drive: drive.motor.hold(braked=True), "brake"),
        ("lk-rs485@1,speed_limit=10000", lambda drive: None, "speed_limit is 10000"),
        ("lk-rs485@1,speed_ramp=5000", lambda drive: None, "speed_ramp is 5000"),
    ],
)
def test_what_hinders_a_drive_by_its_own_word_refutes_nothing(text, change, why):
    each = changed(text, change)
    moving = [c for c in registry.every(each.dialect) if c.risks & MAY_MOVE and "/motion/" in c.id][::20]
    still = [c for c in registry.every(each.dialect) if c.id.endswith("/shape/read_position/clean")]
    assert {why in v.reason for v in engine.run(moving, each) if v.outcome is not Outcome.NOT_RUN} == {True}
    assert {v.outcome for v in engine.run(still, each)} == {Outcome.CONFIRMED}


def test_a_drive_that_refuses_to_move_without_a_reason_is_refuted():
    each = changed("mks-rs485@1", lambda drive: drive.behaviours.update({Verb.MOVE_RELATIVE_AXIS: type(drive).refused}))
    wanted = [c for c in registry.every(each.dialect) if c.id.endswith("ranges/move_relative_axis/speed/inside")]
    assert {v.outcome for v in engine.run(wanted, each)} == {Outcome.REFUTED}


@pytest.mark.parametrize("subdivision", [0, 8, 128])
def test_speeds_of_a_drive_at_another_subdivision_are_not_accused(subdivision):
    each = rig(f"mks-rs485@1,subdivision={subdivision}")
    ends = ("move_absolute_axis/speed", "update-without-stop", "emergency_stop/keeps-torque")
    wanted = [c for c in registry.every(each.dialect) if c.id.endswith(ends)]
    assert {v.outcome for v in engine.run(wanted, each)} == {Outcome.CONFIRMED}
    assert each.noise.rescaled


@pytest.mark.parametrize("drive", ["mks-rs485@1", "mks-modbus@1", "lk-rs485@1"])
def test_a_byte_of_the_line_behind_each_reply_is_no_part_of_it(drive):
    def change(each):
        each.hooks.reply.append(lambda _, command, out: [msgspec.structs.replace(out, data=out.data + b"\xff")])

    each = changed(drive, change)
    assert each.noise.trailing == b"\xff"
    wanted = [c for c in registry.every(each.dialect) if c.id.endswith("/clean")]
    assert {v.outcome for v in engine.run(wanted, each)} <= {Outcome.CONFIRMED, Outcome.NOT_RUN, Outcome.INCONCLUSIVE}
