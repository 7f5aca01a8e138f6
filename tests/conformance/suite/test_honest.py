"""Honest drives over a port, in real time: nothing is refuted, although shaft, line and adapter are those of the world."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice

import pytest

from analyzer import dialects
from benchmarks import honest
from conformance import claims as registry
from conformance.bus.python_can import LibraryPort
from conformance.claim import Outcome
from conformance.drives import make
from conformance.drives.can_bus import CanBus
from conformance.motion import motion, resting
from conformance.motion.declared import QUICK
from conformance.safety import stopping
from conformance.suite import engine, set_otherwise
from conformance.suite.plan import Plan, open_rig
from conformance.suite.rig_emulated import EmulatedRig
from conformance.suite.target import parse
from conformance.talk.probe import MS, SECOND_NS
from tests.conformance.drives.served import Bridge, drives, on_can, on_pty
from tests.conformance.safety.test_keeper import EmulatedPort
from tests.conformance.suite.test_confirming import KNOWN
from tests.conformance.suite.test_suite import main

#: Claims that noise would refute, by the end of their ids.
_TELLING = ("read_speed/at-rest", "read_position/clean", "shape/one-piece", "clear_errors/tells-state", "set_position/stands")


@pytest.mark.parametrize(("rpm", "stands"), [(0, True), (1, False), (-1, False)])
@pytest.mark.parametrize("drive", ["lk-rs485@1,real=poor", "mks-rs485@1,work_mode=sr_vfoc,real=poor", "mks-can@1,real=poor"])
def test_a_shaft_that_trembles_stands_and_one_that_creeps_along_does_not(drive, rpm, stands):
    each = EmulatedRig(make.parse(drive))
    probe = each.probe(next(c for c in registry.every(each.dialect) if resting.can_turn(each.dialect, c)))
    motion.ready_to_move(probe)
    if rpm:
        motion.run_at(probe, rpm, QUICK)
        probe.wait(SECOND_NS)
    assert (stopping.prove_standing(probe, 800 * MS) == "") is stands


@contextmanager
def served(drive: str) -> Iterator[str]:
    """Serve a drive on a pseudo-terminal, a CAN drive behind an slcan adapter; yield the endpoint."""
    if not drive.startswith("mks-can"):
        with on_pty(drive) as port:
            yield f"serial:{port},baud={115200 if drive.startswith('lk') else 38400}"
        return
    bridge = Bridge()
    try:
        port = LibraryPort("slcan", bridge.paths[1], sleep_after_open=0, bitrate=500000)
        with on_can(CanBus(drives(drive), speed=port.bitrate), port):
            yield f"can:slcan:{bridge.paths[0]},bitrate=500000,sleep_after_open=0"
    finally:
        bridge.close()


@pytest.mark.parametrize(
    "drive",
    [
        "mks-rs485@1,work_mode=sr_vfoc,real=bench",
        "mks-modbus@1,work_mode=sr_vfoc,real=bench,clock=+1%",
        "mks-can@1,real=bench,clock=-1%",
        "lk-rs485@1,real=poor,latency-timer=1ms",
    ],
)
def test_an_honest_drive_on_a_port_is_not_accused(drive, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    name = drive.partition(",")[0]
    chosen = [c.id for c in registry.every(dialects.get(name.partition("@")[0])) if c.id.endswith(_TELLING)]
    named = [word for claim in chosen for word in ("--claim", claim)]
    allowed = ("--allow", "motion,setting", "--subdivision", "16", "--max-speed", "300")
    with served(drive) as endpoint:
        status = main(["test", name, "--on", endpoint, *allowed, *named])
    out, err = capsys.readouterr()
    assert status == 0, out + err
    assert "noise measured" in out


def judged(rig, claims):
    """Run the claims about a rig's drive whose ids end so."""
    return [engine.run_claim(c, rig) for c in registry.every(rig.dialect) if c.id.endswith(claims)]


def opened(drive, seed=0):
    target = parse(drive)
    return open_rig(Plan((target,), seed=seed), target)


SET_OTHERWISE = [(bus, setting) for bus in ("mks-rs485", "mks-can") for setting in ("respond", "active")]
OF_REPLIES = (
    "ranges/move_relative_axis/position/inside",
    "motion/move_relative_axis/replies",
    "motion/stop_relative_axis/replies",
)


@pytest.mark.parametrize(("dialect", "setting"), SET_OTHERWISE)
def test_a_drive_that_a_user_set_not_to_answer_motion_is_set_to_for_the_claims_and_back(dialect, setting, tmp_path):
    told = {} if dialect == "mks-can" else KNOWN | {setting: "0"}
    rig = EmulatedPort(f"{dialect}@1,{setting}=0", tmp_path, settings=told)
    found = {v.claim.id: v.outcome for v in judged(rig, OF_REPLIES)}
    rig.close()
    assert set(found.values()) == {Outcome.CONFIRMED}, found
    assert rig.setting(setting) == 0


def test_a_drive_that_may_not_be_set_to_answer_motion_is_not_judged_by_its_silence_and_says_what_to_set(tmp_path):
    told = {name: value for name, value in KNOWN.items() if name not in ("respond", "active")}
    rig = EmulatedPort("mks-rs485@1,respond=0", tmp_path, settings=told)
    reasons = {v.reason for v in judged(rig, "/shape/stop_speed/answered")}
    rig.close()
    assert len(reasons) == 1
    assert "set respond and active to 1" in reasons.pop()


@pytest.mark.parametrize("drive", ["mks-rs485@1,respond=0", "mks-can@1,active=0"])
def test_an_emulated_drive_that_is_set_not_to_answer_motion_is_not_refuted(drive):
    found = {v.claim.id: v.outcome for v in judged(opened(drive), OF_REPLIES)}
    assert set(found.values()) == {Outcome.CONFIRMED}, found


@pytest.mark.parametrize(
    "drive", ["mks-rs485@28,group_address=156", "mks-can@28,group_address=156", "mks-rs485@28,group_address=255"]
)
def test_the_group_of_a_drive_is_no_foreign_address(drive):
    found = judged(opened(drive), ("run_speed/other_address", "addressing/other/one_bit", "addressing/other/enable"))
    assert {v.outcome for v in found} == {Outcome.CONFIRMED}


NOT_ACCUSED = [
    # It stands at the end of a move a little before its twin.
    (
        "mks-rs485@21,model=42D,encoder-noise=1,loop-error=2,speed-noise=1.5%,tremble=1,clock=+2%,latency=2..5ms,warm",
        700100001,
        "state/walk/2",
    ),
    # The line loses the request.
    ("mks-rs485@8,model=28D,request-errors=0.5%", 700100013, "shape/home/answered"),
    # A reply is lost while the noise is measured, so that it is measured anew.
    ("mks-rs485@26,model=57D,hysteresis=2,overshoot=4,line-errors=1%", 710200000, "/end-limit-stops-run_speed-right"),
]


@pytest.mark.parametrize(("drive", "seed", "accused_by"), NOT_ACCUSED)
def test_a_drive_that_was_accused_is_not(drive, seed, accused_by):
    assert {v.outcome for v in judged(opened(drive, seed), accused_by)} == {Outcome.CONFIRMED}


LIMITED = [
    ("mks-can@1,axis_lock=0", ("save_speed/restart", "save_speed/as-it-was", "save_speed/power"), "set axis_lock to 1"),
    ("lk-rs485@1,angle_limit=36000", ("state/walk/1",), "angle_limit is 36000: set it to"),
]


@pytest.mark.parametrize(("drive", "claims", "reason"), LIMITED)
def test_what_a_setting_of_the_user_forbids_is_not_judged_and_says_what_to_set(drive, claims, reason):
    found = judged(opened(drive), claims)
    assert len(found) == len(claims)
    assert {v.outcome for v in found} == {Outcome.INCONCLUSIVE}, [(v.claim.id, v.outcome, v.reason) for v in found]
    assert all(reason in v.reason for v in found)


#: Honest drives that were accused once: what they have, their seed, and the claim.
ONCE_ACCUSED = [
    # A speed that a filter shows dies away by the ramp on which the shaft came to rest.
    (
        "mks-can@10,model=57E,encoder-noise=1,loop-error=2,speed-lag=20ms,clock=-1%,latency=0.3..3ms",
        2700006,
        "read_speed/crossed",
    ),
    # The shaft goes on for more than the rest of a turn before a late command comes.
    (
        "lk-rs485@12,model=MH,encoder-noise=1,loop-error=2,speed-noise=1%,stall=30ms,settle=50ms,overshoot=4,latency=0.3..1ms,"
        "latency-timer=16ms,voltage-noise=0.1",
        2700007,
        "motion/move_single_turn_limited/takes-over",
    ),
    # Two short distances have four places that tremble.
    (
        "mks-modbus@20,model=35D,encoder-noise=1,loop-error=4,speed-noise=2%,clock=+1%,settle=80ms,latency=0.3..3ms,"
        "turnaround-noise=00",
        2700009,
        "set_subdivision/power",
    ),
    # The end of a motion is told while a request goes out, and a part of it is lost.
    (
        "mks-rs485@20,model=35D,encoder-noise=1,clock=-1%,latency=2..5ms,turnaround-noise=00,byte-gap=1.4,voltage-noise=0.05",
        2700010,
        "state/walk/3",
    ),
    # The checksum of the package to this address is 0, and so are the bytes that are too many.
    ("mks-rs485@15,model=42D", 0, "addressing/package/length"),
    # A wait ends in a pause of the reply that tells the end of a move.
    (
        "mks-rs485@23,model=35D,loop-error=3,speed-noise=2%,creep=1,clock=+2%,settle=10ms,overshoot=8,latency-timer=2ms,"
        "byte-gap=1.4,voltage-noise=0.1",
        2700047,
        "set_respond/1-answers-again",
    ),
    # Its position was named while its shaft was beside its target: an encoder differs by that from then on.
    (
        "lk-rs485@11,model=MH,encoder-noise=2,loop-error=4,speed-noise=2%,tremble=1,first-late=200ms,dip=0.3,settle=10ms,"
        "overshoot=2,latency=0.3..3ms,warm",
        2800034,
        "state/walk/3",
    ),
    # A filter has long shown the speed of a run when it is read.
    (
        "mks-modbus@8,model=57D,encoder-noise=1,loop-error=1,tremble=1,speed-lag=20ms,first-late=50ms,overshoot=8,"
        "latency=0.3..1ms,latency-timer=16ms,turnaround-noise=00",
        2800003,
        "set_direction/and-the-bus",
    ),
    # A reply pauses before a byte that is the line's and one with which a reply begins.
    (
        "mks-rs485@18,model=42D,encoder-noise=1,speed-noise=0.5%,speed-lag=5ms,clock=+0.5%,settle=50ms,latency=2..5ms,"
        "turnaround-noise=FF,byte-gap=1,end_limit=1,home_speed=0,motor_direction=1,protection=1",
        1200013,
        "read_pulses/counts-moves",
    ),
    # The line turns a bit over now and then, in replies to everything.
    (
        "lk-rs485@24,model=MH,encoder-noise=1,hysteresis=2,creep=1,dip=1,settle=30ms,latency=0.3..3ms,latency-timer=2ms,"
        "byte-gap=1,voltage-noise=0.05,line-errors=0.5%,current_ramp=25000",
        20200000,
        "move_multi_turn_limited/sums",
    ),
    (
        "mks-rs485@14,model=35D,encoder-noise=1,loop-error=1,speed-noise=1.5%,hysteresis=2,latency=0.3..8ms,"
        "turnaround-noise=FF,line-errors=1%,group_address=255,subdivision=32",
        20200001,
        "read_position/each-check",
    ),
    # The shaft is beyond the place of the newer move, for the reply to the older one was damaged and waited for.
    ("mks-rs485@1,model=42D,line-errors=1%", 1, "move_absolute_axis/takes-over"),
    # A frame with a wrong checksum is damaged too, not bytes without a frame alone.
    ("lk-rs485@1,model=MF,line-errors=1%", 2, "crossed-taken"),
    # What the reply to a setting says is that of the one which was asked for again, also where it is a refusal.
    ("mks-modbus@1,model=57D,line-errors=1%", 3, "motor_direction/every"),
    # A reply with another address in it is lost, too.
    ("mks-modbus@1,model=42D,line-errors=1%,encoder-noise=1", 21, "resilience/settings/speeding-up"),
    # Each move to a place begins where the shaft is read to be: what that is off by adds up over several.
    (
        "mks-can@19,model=57E,loop-error=4,speed-noise=1.5%,tremble=1,creep=2,dip=0.3,clock=+2%,settle=80ms,latency=2..5ms,"
        "latency-timer=1ms,warm,active=0,division_level=1,end_limit=1,home_mode=1,subdivision=0",
        40400001,
        "move_absolute_axis/again",
    ),
    # The shaft came to rest in a pause between two looks, over which each mean speed is alike.
    (
        "lk-rs485@21,model=MH,encoder-noise=1,stall=30ms,clock=-2%,overshoot=4,latency=2..5ms,turnaround-noise=00,"
        "voltage-noise=0.05,current_kd=49151",
        40400006,
        "read_state_2/crossed",
    ),
    # A position was named while the shaft of a motor that is off ran out, and the twin's was not quite where the drive's was.
    (
        "lk-rs485@2,model=MF,encoder-noise=2,speed-noise=2%,tremble=1,creep=2,stall=30ms,first-late=200ms,dip=1,clock=+2%,"
        "settle=80ms,overshoot=8,latency=2..5ms,latency-timer=16ms,turnaround-noise=00,voltage-noise=0.3,warm",
        71000,
        "state/walk/2",
    ),
    # The line damaged what was told of the begin of a motion.
    (
        "mks-rs485@21,model=57D,encoder-noise=1,loop-error=1,latency=0.3..3ms,voltage-noise=0.05,group_address=255,"
        "return_angle=2048,line-errors=0.5%",
        912003,
        "state/walk/3",
    ),
    # A move came to its end while a reply was waited for that the line had damaged.
    (
        "lk-rs485@16,model=MF,encoder-noise=1,loop-error=1,first-late=200ms,clock=-0.3%,latency=0.3..8ms,byte-gap=0.5,"
        "angle_ki=40,current_ramp=50000,speed_kd=65535,speed_ki=25,speed_limit=144000,line-errors=1%",
        912004,
        "move_multi_turn/takes-over",
    ),
    # A move under a speed limit came to its end likewise, before its speed was measured.
    (
        "lk-rs485@30,model=MH,loop-error=3,speed-noise=2%,tremble=1,speed-lag=20ms,dip=0.3,latency=0.3..8ms,angle_kd=65535,"
        "current_ramp=200000,line-errors=1%",
        60600007,
        "speed-limit-move_increment-each-way",
    ),
    # A short move had its highest speed between looks: means over them are near each other, and beyond that of its ramp.
    (
        "lk-rs485@25,model=MG,encoder-noise=2,speed-noise=1%,first-late=200ms,settle=10ms,overshoot=6,latency=0.3..3ms,warm,"
        "current_kp=0,speed_limit=144000",
        60600006,
        "read_state_2/crossed",
    ),
    # One reply of 300 was damaged, and as many reads as may be good by chance were.
    (
        "lk-rs485@19,model=MF,encoder-noise=1,tremble=1,creep=1,clock=-1%,settle=80ms,latency=0.3..3ms,byte-gap=0.5,"
        "line-errors=0.1%,torque_limit=1536",
        70700007,
        "move_multi_turn_limited/sums",
    ),
    # An encoder trembled by more than was drawn until then: what is read of a place is held against what was measured.
    ("lk-rs485@1,model=MF,loop-error=4,overshoot=8,encoder-noise=5", 0, "reads/steady"),
    ("lk-rs485@1,model=MF,loop-error=4,overshoot=8,encoder-noise=6", 1, "framing/set_position/other-length"),
    # The shaft was beyond the place of the newer move, for a look at it was damaged and waited for: it comes back.
    (
        "mks-rs485@6,model=57D,encoder-noise=1,speed-lag=20ms,stall=30ms,voltage-noise=0.05,line-errors=0.1%,home_current=300,"
        "motor_direction=1",
        70700003,
        "move_absolute_pulses/takes-over",
    ),
    # So did the speed of a shaft that stood.
    ("mks-modbus@1,work_mode=sr_vfoc,tremble=2", 0, "save_speed/broadcast"),
    # The line damaged what a motion was answered that was to be refused, and what a slow one was.
    (
        "mks-rs485@19,model=35D,encoder-noise=1,dip=0.3,overshoot=4,latency=0.3..8ms,voltage-noise=0.05,work_mode=0,"
        "line-errors=1%",
        44580100013,
        "move_relative_pulses/behind-refusals",
    ),
    (
        "mks-rs485@28,model=28D,loop-error=2,speed-noise=1.5%,dip=1,overshoot=2,latency=0.3..8ms,turnaround-noise=00,"
        "group_address=191,return_angle=0,set_zero=1,line-errors=1%",
        16455100014,
        "move_relative_pulses/lowest-values",
    ),
    # The end of homing was told by a frame that the line damaged.
    (
        "mks-rs485@6,model=42D,encoder-noise=1,speed-noise=1%,speed-lag=20ms,latency=2..5ms,group_address=255,"
        "home_current=600,home_speed=45,line-errors=1%",
        74156100015,
        "home/told-though",
    ),
    # A move that slows down already ends where it would have, although it is stopped: a fast one long before its end.
    (
        "lk-rs485@28,model=MF,encoder-noise=2,speed-lag=5ms,creep=4,stall=50ms,first-late=300ms,clock=+0.5%,settle=100ms,"
        "overshoot=10,latency-timer=16ms,turnaround-noise=00,voltage-noise=0.4,warm,speed_kp=37,speed_limit=144000",
        91400007,
        "move_single_turn/crossed-stopped",
    ),
    # Between two looks the shaft turned farther than the finest encoder tells one way from the other.
    (
        "lk-rs485@30,model=MG,encoder-noise=1,loop-error=4,speed-lag=20ms,creep=4,stall=50ms,first-late=300ms,dip=2,clock=-0.3%,"
        "settle=100ms,latency=0.3..12ms,latency-timer=16ms,turnaround-noise=00,byte-gap=1.4,voltage-noise=0.4,warm,"
        "current_ramp=50000,speed_kd=16383",
        91400005,
        "run_speed/crossed-tells",
    ),
    # A shaft that rests far beside its targets left a slow speed uncertain, which was taken for late replies.
    (
        "mks-modbus@18,model=28D,encoder-noise=1,loop-error=20,speed-lag=5ms,stall=30ms,first-late=200ms,clock=+1%,"
        "latency=0.3..12ms,home_current=400,saved_run=1,saved_speed=100,saved_acceleration=100",
        70100000,
        "run_speed/speed-1",
    ),
    # Shafts beside their targets by 0.3 degrees and more, each by another way than it set off.
    (
        "lk-rs485@8,model=MS,encoder-noise=2,loop-error=12,speed-noise=4%,stall=60ms,settle=80ms,latency=5..20ms,"
        "latency-timer=1ms,turnaround-noise=FF,voltage-noise=0.3,warm",
        61004,
        "move_increment/crossed-tells",
    ),
    ("mks-can@11,model=57E,encoder-noise=2,loop-error=12,clock=+2%,settle=300ms,latency=0.3..12ms", 61001, "axis/distance"),
    ("mks-can@6,model=57E,encoder-noise=1,loop-error=20,tremble=3,settle=80ms", 61009, "set_zero/carry"),
    ("mks-rs485@26,model=57D,encoder-noise=4,speed-lag=20ms,hysteresis=8,settle=300ms", 61003, "settings/leave-motion"),
    ("mks-rs485@26,model=57D,encoder-noise=4,loop-error=20,overshoot=20,settle=300ms", 61003, "set_home/end-limit-off"),
    # A run that a package keeps turns the same way as a run at a positive speed.
    ("mks-rs485@1,quirk=reversed-direction", 0, "save_speed/package"),
]


@pytest.mark.parametrize(("drive", "seed", "claim"), ONCE_ACCUSED, ids=lambda value: value if isinstance(value, str) else "")
def test_an_honest_drive_that_was_accused_once_is_not_accused(drive, seed, claim, monkeypatch):
    once, attempts = engine._once, []
    monkeypatch.setattr(engine, "_once", lambda claim, on: attempts.append(once(claim, on)) or attempts[-1])
    found = judged(opened(drive, seed), claim)
    assert found
    assert [v.reason for v in found if v.outcome is Outcome.REFUTED] == []
    # Nor is it where the line damaged something, and the claim is begun anew.
    assert [v.reason for v in attempts if v.outcome is Outcome.REFUTED and v.damaged] == []


@pytest.mark.parametrize(
    "drive",
    [
        "mks-modbus@1,line-errors=1%",
        "lk-rs485@1,model=MF,line-errors=1%",
        "lk-rs485@1,model=MG,real=poor,line-errors=1%",
        "mks-rs485@1,request-errors=1%",
        "mks-modbus@1,request-errors=1%",
        "lk-rs485@1,model=MF,request-errors=1%",
    ],
)
def test_a_walk_goes_on_where_the_line_damages_replies(drive):
    assert {v.outcome for v in judged(opened(drive), "state/walk/1")} == {Outcome.CONFIRMED}


@pytest.mark.parametrize("trait", ["line-errors=1%", "request-errors=1%"])
@pytest.mark.parametrize(
    ("drive", "part"),
    [
        ("mks-rs485@1,model=57D", "move_relative_axis/crossed"),
        ("mks-modbus@1,model=57D", "work_mode/every"),
        ("lk-rs485@1,model=MF", "move_increment/crossed"),
    ],
)
def test_a_line_that_damages_one_of_a_hundred_leaves_nothing_open(drive, trait, part):
    """A row of which the line damaged one look is judged by the others; a lost request is sent again."""
    for seed in range(2):
        _, counts, refuted = honest.accused(f"{drive},{trait}", seed, part=part)
        assert (refuted, counts[Outcome.INCONCLUSIVE.value]) == ([], 0)
        assert counts[Outcome.CONFIRMED.value]


#: Drives of which the user told all settings, and what accused them.
ONCE_ACCUSED_THOUGH_TOLD = [
    # At its subdivision the shaft was faster than was sent, and was there before its speed had been looked at often enough.
    (
        "mks-rs485@20,model=28D,encoder-noise=2,loop-error=3,speed-noise=1.5%,stall=10ms,clock=+1%,latency=0.3..8ms,"
        "turnaround-noise=FF,warm,home_trigger=1,key_lock=1,subdivision=12",
        60600002,
        "and-the-bus",
    ),
    # A run that was kept began when the walk restarted the drive.
    (
        "mks-can@22,model=57E,encoder-noise=1,loop-error=1,speed-noise=1.5%,hysteresis=2,clock=-1%,latency=0.3..8ms,"
        "voltage-noise=0.3,home_current=150,home_trigger=1,return_angle=16384,saved_run=1,saved_speed=100,"
        "saved_acceleration=100,saved_direction=1",
        60600002,
        "state/walk/2",
    ),
    # The speed in a reply and the speeds before and after it trembled, each by itself.
    (
        "lk-rs485@1,model=MH,speed-noise=0.5%,hysteresis=1,overshoot=2,latency=0.3..1ms,latency-timer=2ms,warm,"
        "line-errors=0.5%,speed_ki=0",
        60600004,
        "crossed-tells",
    ),
    # A motor that is off when the walk restarts the drive does not go back to the zero that is kept.
    (
        "mks-modbus@20,model=35D,loop-error=3,speed-noise=1%,tremble=1,hysteresis=1,first-late=200ms,clock=+0.5%,settle=10ms,"
        "overshoot=8,latency-timer=16ms,interpolation=0,screen_off=1,zero_mode=2,zero_kept=1,zero_point=12000",
        70700006,
        "state/walk/1",
    ),
    # It restarted in a work mode in which it cannot go back to its zero, and no read tells that it is to.
    (
        "mks-rs485@27,model=35D,encoder-noise=1,loop-error=2,tremble=1,latency=2..5ms,voltage-noise=0.3,warm,respond=0,"
        "zero_mode=1,zero_kept=1,zero_point=5000",
        81100004,
        "state/walk/1",
    ),
    # A session that several claims judge was on a line that damaged a reply, for each of them.
    (
        "mks-modbus@21,model=42D,encoder-noise=1,speed-noise=2.4%,speed-lag=20ms,hysteresis=3,first-late=300ms,dip=2,"
        "settle=100ms,overshoot=10,latency=0.3..12ms,latency-timer=16ms,turnaround-noise=FF,voltage-noise=0.4,warm,"
        "line-errors=1%,group_address=255",
        91400000,
        "traffic/",
    ),
    # In a pulse mode a kept run did not show, and began when the claims restarted the drive in another mode.
    (
        "mks-rs485@18,model=35D,encoder-noise=1,loop-error=3,speed-noise=1.5%,speed-lag=5ms,hysteresis=2,stall=10ms,clock=+2%,"
        "latency=0.3..3ms,byte-gap=0.5,voltage-noise=0.1,line-errors=1%,zero_mode=2,saved_run=1,saved_speed=100,"
        "saved_acceleration=100",
        81100020,
        "read-back/settings/restart",
    ),
]


@pytest.mark.parametrize(
    ("drive", "seed", "claims"),
    ONCE_ACCUSED_THOUGH_TOLD,
    ids=["faster", "kept-run", "three-speeds", "kept-zero", "no-way-back", "session", "kept-unseen"],
)
def test_an_honest_drive_whose_settings_were_told_is_not_accused(drive, seed, claims):
    _, counts, refuted = honest.accused(drive, seed, part=claims)
    assert refuted == []
    assert counts


#: Drives that hold what a user has set, and claims that took it for a fault of theirs.
STORED = [
    ("mks-can@1,model=42E,subdivision=32", "reads/move_relative_pulses"),
    ("mks-can@1,model=42E,motor_direction=ccw", "other/set_subdivision"),
    ("mks-can@1,model=42E,work_mode=4", "settings/stay"),
    ("mks-can@1,model=42E,work_mode=0x14", "broadcast/settings"),
    ("mks-can@1,model=42E,limit_remap=1", "read_io/is-enable-pin"),
    ("mks-can@1,model=42E,limit_remap=1,work_mode=0x14", "read_io/shows-enable-pin"),
    ("mks-rs485@1,model=42D,home_mode=1", "home/finds-switch-cw"),
    ("mks-rs485@1,model=42D,home_mode=1", "set_home/home_trigger"),
    ("mks-rs485@1,model=42D,home_mode=1", "set_respond/inactive-home"),
    # Homing ends where the shaft stands.
    ("mks-can@1,model=57E,home_trigger=1,return_angle=0", "group/home"),
    ("mks-can@1,model=57E,home_trigger=1,return_angle=0", "home/guarded"),
    ("mks-can@1,model=57E,home_trigger=1,return_angle=0", "set_home/home_trigger"),
    ("mks-rs485@1,model=42D,zero_mode=2,zero_kept=1,zero_point=5000", "restart/motion-as-before"),
    ("mks-rs485@1,model=42D,zero_mode=1,zero_kept=1,zero_point=5000", "read-back/set_zero_mode/clean"),
    ("mks-modbus@1,work_mode=sr_vfoc,saved_run=1,saved_speed=100,saved_acceleration=100", "restart/ends-motion"),
    # In a pulse mode it does not turn when power comes on.
    ("mks-modbus@1,saved_run=1,saved_speed=100,saved_acceleration=100", "restart/ends-motion"),
    ("mks-can@1,saved_run=1,saved_speed=100,saved_acceleration=100", "restart/motion-as-before"),
]


@pytest.mark.parametrize(("drive", "claim"), STORED)
@pytest.mark.parametrize("told", [True, False], ids=["told", "untold"])
def test_a_drive_that_a_user_has_set_is_judged_as_any_other(drive, claim, told):
    found = judged(EmulatedRig(make.parse(drive), told=None if told else {}), claim)
    assert [(v.outcome, v.reason) for v in found] == [(Outcome.CONFIRMED, "")]


@pytest.mark.parametrize(
    ("drive", "claim", "reason"),
    [
        (
            "lk-rs485@1,model=MF,torque_limit=2",
            "run_speed/speed-360",
            "the drive is set to torque_limit 2, and this claim refutes an ideal drive that is set so",
        ),
        # What is set in the native dialect alone a Modbus drive does not tell.
        (
            "mks-modbus@1,model=57D,work_mode=sr_vfoc,home_mode=1",
            "motion/home/zero",
            "a drive with home_mode 1 does so too: say in --settings FILE what it is set to",
        ),
    ],
)
def test_a_claim_that_an_ideal_drive_with_the_same_settings_fails_judges_nothing_and_says_what_to_set(drive, claim, reason):
    found = judged(EmulatedRig(make.parse(drive), told={}), claim)
    assert [v.outcome for v in found] == [Outcome.INCONCLUSIVE]
    assert reason in found[0].reason


@pytest.mark.parametrize(
    ("drive", "claim"),
    [
        ("mks-can@1,subdivision=32,motor_direction=ccw,fault=move-pulses-doubled", "move_relative_pulses/distance"),
        ("mks-rs485@1,enable_level=1,home_direction=1,fault=set-zero-ignored", "motion/set_zero/position"),
    ],
)
@pytest.mark.parametrize("told", [None, {}], ids=["told", "untold"])
def test_settings_excuse_no_fault(drive, claim, told):
    found = judged(EmulatedRig(make.parse(drive), told=told), claim)
    assert [v.outcome for v in found] == [Outcome.REFUTED], [v.reason for v in found]


def test_what_no_drive_can_be_set_to_is_given_to_no_ideal_drive():
    rig = EmulatedRig(make.parse("mks-can@1"))
    rig._held = {"home_direction": 60, "home_speed": 77}
    assert [str(held) for held in set_otherwise.every(rig) if held.known] == ["home_speed 77"]


@pytest.mark.parametrize("number", range(4))
def test_a_drawn_drive_has_as_many_stored_settings_as_are_asked_for(number):
    none, usual, all_of_them = (honest.drawn(number, 2, *share).split(",") for share in ((0,), (), (100,)))
    assert len(none) <= len(usual) < len(all_of_them)
    assert usual[: len(none)] == all_of_them[: len(none)] == none
    settings = set_otherwise.names(dialects.get(none[0].partition("@")[0]))
    assert not {word.partition("=")[0] for word in none} & set(settings)


@pytest.mark.parametrize("number", range(4))
def test_drawn_drives_with_drawn_settings_are_not_accused(number):
    text, seed, every, part, tells = next(islice(honest.drives(8, 3, 240), number + 4, None))
    _, counts, refuted = honest.accused(text, seed, every, part, tells)
    assert refuted == []
    assert counts[Outcome.CONFIRMED.value] > counts[Outcome.INCONCLUSIVE.value]


# Behind a way back to zero the run has just begun when that is first seen to be over.
@pytest.mark.parametrize(
    ("zero", "powered_ns"),
    [("zero_mode=0", SECOND_NS), ("zero_mode=2,zero_kept=1,zero_point=5000", 100 * MS)],
    ids=["at-once", "behind-the-way-back"],
)
def test_a_run_that_was_kept_for_power_on_is_stopped_and_forgotten_before_the_first_motion(zero, powered_ns, tmp_path, capsys):
    kept = f"saved_run=1,saved_speed=100,saved_acceleration=20,{zero}"
    rig = EmulatedPort(f"mks-rs485@1,work_mode=sr_vfoc,{kept}", tmp_path, settings=KNOWN | {"work_mode": "sr_vfoc"})
    rig.gate.wait(powered_ns)
    found = [v.outcome for v in judged(rig, "restart/ends-motion")]
    rig.close()
    assert found == [Outcome.CONFIRMED]
    assert "a run kept for power-on, which is forgotten" in capsys.readouterr().err
    assert rig.setting("saved_run") == 0


@pytest.mark.parametrize(
    ("fault", "outcome"), [("", Outcome.CONFIRMED), (",fault=restart-lies", Outcome.REFUTED)], ids=["none", "fault"]
)
def test_a_run_that_no_shaft_shows_is_forgotten_before_the_first_restart(fault, outcome, tmp_path):
    kept = "saved_run=1,saved_speed=100,saved_acceleration=200"
    rig = EmulatedPort(f"mks-rs485@1,{kept}{fault}", tmp_path, settings=KNOWN)
    before = rig.setting("work_mode")
    found = [v.outcome for v in judged(rig, "restart/ends-motion")]
    rig.close()
    assert found == [outcome]
    assert (rig.setting("saved_run"), rig.setting("work_mode")) == (0, before)
