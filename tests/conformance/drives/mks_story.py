"""A story of an MKS drive: what a host sends to it, and all that it sees, for faults and quirks to show in.

A story is a list of chapters; each begins with a fresh drive and yields all that comes over the bus, with its times. The
frames of a chapter do not depend on what the drive answers.
"""

from __future__ import annotations

from functools import cache

from analyzer import dialects
from analyzer.encoder import build
from conformance.drives.mks.state import is_setting
from tests.conformance.drives.mks_motion_story import (
    calibration,
    conditions,
    homing,
    limits,
    moves,
    reads_in_motion,
    runs,
    saved_runs,
    states,
    stops,
    subdivisions,
    updates,
    zero_modes,
)
from tests.conformance.drives.test_mks_decisions import package
from tests.conformance.drives.test_mks_rig import MS, SECOND, frame_of, make
from tests.conformance.drives.test_mks_settings import nearby, others

NATIVE, MODBUS = dialects.get("mks-rs485"), dialects.get("mks-modbus")


class Story:
    """One drive and what its host sees."""

    def __init__(self, name, faults=(), quirks=(), **options):
        self.name = name
        self.drive = make(name, faults=faults, quirks=quirks, **options)
        self.dialect = dialects.get(name)
        self.now = 0
        self.seen = []

    def has(self, command):
        return command in self.dialect.by_name

    def send(self, data, address=1, dialect=None):
        dialect = dialect or self.dialect
        can_id = address if dialect.bus == "can" else None
        self._see(self.drive.receive(frame_of(dialect, data, self.now, can_id), self.now))
        self.wait(5 * MS)

    def tell(self, command, address=1, dialect=None, **values):
        dialect = dialect or self.dialect
        if command in dialect.by_name:
            self.send(build(dialect, command, address, values), address, dialect)

    def wait(self, duration, polls=0):
        """Let time pass, asking for position, speed and status so many times on the way."""
        end = self.now + duration
        for n in range(polls):
            self._advance(self.now + (end - self.now) // (polls - n))
            for command in ("read_position", "read_speed", "read_status"):
                data = build(self.dialect, command, 1)
                can_id = 1 if self.dialect.bus == "can" else None
                self._see(self.drive.receive(frame_of(self.dialect, data, self.now, can_id), self.now))
        self._advance(end)

    def _advance(self, t_ns):
        while (due := self.drive.next_ns()) is not None and due <= t_ns:
            self.now = due
            self._see(self.drive.advance(due))
        self.now = t_ns
        self._see(self.drive.advance(t_ns))

    def _see(self, said):
        self.seen += [(self.now, o.at_ns, o.data, o.can_id) for o in said]


# --- the chapters ----------------------------------------------------------------------------------------------------


def reads(open_story):
    story = open_story()
    for counts in (70_000, -150_000, -5):
        story.drive.motor.jump(story.now, counts)
        for command in story.dialect.commands:
            if command.all_risks == {"read"} and command.name != "read_parameter":
                story.tell(command.name)
    story.drive.limit_switch("left")
    story.tell("read_io")
    yield story


def settings(open_story):
    """Each field at, beside and beyond its limits."""
    for command in open_story().dialect.commands:
        if not is_setting(command):
            continue
        for field in command.request_forms[0].layout.named.values():
            for value in nearby(field):
                story = open_story()
                story.tell(command.name, **others(command, field) | {field.name: value})
                yield story


def read_back(open_story):
    story = open_story()
    for command in story.dialect.commands:
        if command.readable:
            for field in command.request_forms[0].layout.named.values():
                for value in [v for v in nearby(field) if field.allows(v)][-3:]:
                    if field.name not in ("new_address", "group_address"):
                        story.tell(command.name, **others(command, field) | {field.name: value})
                        story.tell("read_parameter", parameter=command.code)
    for command in story.dialect.commands:
        story.tell("read_parameter", parameter=command.code)
    story.tell("write_user_id", user_id=1234567)
    story.tell("read_user_id")
    yield story


def refused_settings(open_story):
    story = open_story()
    story.drive.place_switch("left", -20_000)
    story.tell("set_home", home_speed=300, home_direction=2)
    story.tell("home")
    story.wait(SECOND, 2)
    yield story


def hearing(open_story):
    story = open_story(group_address=80)
    dialect = story.dialect
    good = build(dialect, "read_position", 1)
    link = dialect.link
    story.send(good)
    for place in range(len(good)):
        story.send(good[:place] + bytes((good[place] ^ 0x40,)) + good[place + 1 :])
        story.send(good)
    for address in (0, 2, 80, 3, 255, 0x101):
        if address < 256 or dialect.bus == "can":
            story.tell("read_position", address)
            story.tell("run_speed", address, speed=60)
            story.wait(100 * MS, 1)
            story.tell("stop_speed")
    if dialect.bus == "can":
        story.send(link.completed(b"\x77", 1))
    elif dialect is NATIVE:
        story.send(link.completed(bytes.fromhex("FA 01 77")))
        story.send(link.completed(bytes.fromhex("FB 01 31")))
        story.send(build(MODBUS, "read_speed", 1), dialect=MODBUS)
    bad = bytearray(build(dialect, "run_speed", 1, {"speed": 100}))
    bad[-1] ^= 1
    story.send(bytes(bad))
    story.wait(100 * MS, 1)
    story.tell("set_group_address", group_address=81)
    story.tell("read_position")
    story.tell("run_speed", 81, speed=60)
    story.wait(100 * MS, 1)
    yield story
    for address in (0, 80):
        story = open_story(group_address=80)
        story.tell("run_speed", speed=60)
        story.tell("stop_speed", address)
        story.wait(100 * MS, 1)
        yield story


def packages(open_story):
    def told(data, **options):
        story = open_story(**options)
        story.send(data, dialect=NATIVE)
        story.wait(300 * MS, 3)
        return story

    if open_story().dialect is not NATIVE:
        return
    fast, slow = "F6 02 58 00", "F6 00 64 00"
    yield told(package("01 " + fast, "01 " + slow))
    yield told(package("02 " + fast, "01 " + slow, "03 " + fast))
    yield told(package("02 " + fast, "00 " + slow))
    yield told(package("02 " + fast, "05 " + fast))
    yield told(package("02 " + fast, "03 " + fast, "04 " + fast, "05 " + fast, "01 " + slow))
    good = package("01 " + fast)
    yield told(good[:40] + good[-1:])
    yield told(package("01 31"))
    for slot in ("F6 00 00 00", "92"):
        story = open_story()
        story.tell("run_speed", speed=60)
        story.wait(100 * MS)
        story.send(package("01 " + slot), dialect=NATIVE)
        story.wait(100 * MS, 1)
        yield story


def exceptions(open_story):
    from tests.collect import crc

    story = open_story()
    if story.dialect is not MODBUS:
        return
    for frame in (
        "01 03 00 32 00 01", "01 2B 0E 01", "01 04 00 77 00 01", "01 04 00 32 00 02", "01 06 00 77 00 01",
        "01 10 00 F6 00 02 06 00 00 00 00 00 00", "01 10 00 90 00 03 06 00 00 00 64 00 00", "01 04 01 32 00 01",
        "01 06 00 82 00 09", "01 10 00 90 00 03 05 00 02 00 64 00", "01 04 00 30 00 03", "01 06 00 82 00 05",
        "01 10 00 94 00 04 08 00 00 20 00 00 00 02 58",
    ):  # fmt: skip
        story.send(bytes.fromhex(crc(frame)))
    story.send(bytes.fromhex("FA 01 31 2C"), dialect=NATIVE)
    yield story


def respond(open_story):
    for respond_, active in ((0, 1), (1, 0), (0, 0)):
        story = open_story()
        story.tell("set_respond", respond=respond_, active=active)
        story.tell("move_relative_axis", speed=600, position=1000)
        story.wait(SECOND)
        story.tell("read_position")
        story.tell("run_speed", speed=600)
        story.tell("stop_speed")
        story.wait(SECOND)
        story.tell("set_subdivision", subdivision=16)
        yield story
        for way in (lambda s: s.tell("restart"), lambda s: s.drive.power_cycle(s.now)):
            way(story)
            story.wait(5 * SECOND)
            story.tell("run_speed", speed=600)
            yield story


def beside(open_story):
    """What differs from its neighbours: a whole turn, a slow run, a fast move, a coarse subdivision, a port given back."""
    story = open_story()
    story.drive.motor.jump(story.now, 16384)
    story.tell("read_encoder_carry")
    story.tell("read_position")
    story.tell("enable", enabled=0)
    story.drive.turn_shaft(500)
    story.tell("read_position")
    story.tell("set_enable_level", enable_level=1)
    story.tell("enable", enabled=1)
    story.tell("read_enabled")
    for mask in (1, 0):
        story.tell("write_io", alm_mask=mask, pend_mask=mask, alm=0, pend=0)
        story.tell("read_io")
    for subdivision in (7, 99, 250):
        story.tell("set_subdivision", subdivision=subdivision)
    story.tell("set_respond", respond=0, active=0)
    story.tell("run_speed", speed=20)
    story.wait(SECOND, 3)
    story.tell("set_respond", respond=1, active=1)
    story.wait(SECOND, 3)
    story.tell("restore")
    story.wait(SECOND, 4)
    yield story
    story = open_story(subdivision=8)
    story.tell("set_direction", motor_direction=1)
    story.tell("move_relative_pulses", 2, speed=60, pulses=3200)
    for command, values in (("move_relative_pulses", {"pulses": 3200}), ("move_relative_axis", {"position": 1_000_000})):
        story.tell(command, speed=1800, acceleration=0, **values)
        story.wait(SECOND, 6)
    story.wait(3 * SECOND)
    story.tell("read_position")
    story.tell("move_relative_axis", speed=60, position=0)
    story.tell("home")
    story.wait(100 * MS, 1)
    yield story
    story = open_story(subdivision=25)
    story.tell("run_speed", speed=3000)
    story.wait(SECOND, 3)
    story.tell("stop_speed", 0, acceleration=0)
    story.wait(100 * MS, 1)
    story.tell("run_speed", speed=3000)
    story.wait(SECOND, 3)
    story.tell("write_io", alm_mask=1, pend_mask=2, alm=1, pend=1)
    story.tell("read_io")
    story.tell("move_relative_pulses", speed=600, pulses=70_000)
    story.wait(20 * SECOND, 1)
    story.tell("read_pulses")
    story.tell("move_relative_pulses", speed=600, pulses=70_000)
    story.tell("emergency_stop")
    story.wait(SECOND, 2)
    yield story
    for mode in (3, 4):
        story = open_story(mode=mode)
        story.tell("move_relative_axis", speed=600, position=5000)
        yield story


def each_state(open_story):
    """Reads while disabled and homing; damaged commands; the group's settings; far and newer moves; the ports."""
    story = open_story()
    story.tell("enable", enabled=0)
    story.tell("read_angle_error")
    yield story
    story = open_story()
    story.drive.place_switch("left", -20_000)
    story.tell("home")
    for command in ("read_pulses", "read_enabled"):
        story.tell(command)
    yield story
    for command, values in (("home", {}), ("enable", {"enabled": 0}), ("set_subdivision", {"subdivision": 8})):
        story = open_story()
        bad = bytearray(build(story.dialect, command, 1, values))
        bad[-1] ^= 1
        story.send(bytes(bad))
        story.wait(100 * MS, 1)
        story.tell("read_enabled")
        story.tell("read_parameter", parameter=0x84)
        yield story
    story = open_story()
    story.tell("set_group_address", group_address=0x150 if story.dialect.bus == "can" else 80)
    for address, level in ((0x50, 1), (0x150, 2)) if story.dialect.bus == "can" else ():
        story.tell("set_enable_level", address, enable_level=level)
        story.tell("read_parameter", parameter=0x85)
    yield story
    story = open_story()
    widest = story.dialect.by_name["move_relative_pulses"].request_forms[0].layout.named["pulses"].high
    story.tell("move_relative_pulses", speed=60, acceleration=248, pulses=widest)
    story.wait(SECOND, 2)
    yield story
    story = open_story()
    story.drive.set_enable_pin(1)
    story.tell("read_io")
    yield story


def restarts(open_story):
    """What is left of settings after a restart, a power cycle, a restore."""

    def look(story, address=1):
        story.tell("read_position", address)
        story.tell("run_speed", address, speed=100)
        story.wait(200 * MS, 1)
        story.tell("stop_speed", address)
        story.tell("read_user_id", address)
        story.tell("run_speed", 80, speed=200)
        story.wait(200 * MS, 1)
        story.tell("emergency_stop", address)
        story.tell("home", address)
        story.wait(200 * MS, 1)
        for code in (0x82, 0x83, 0x84, 0x8C, 0x90):
            story.tell("read_parameter", address, parameter=code)

    for way in ("restart", "restore", ""):
        story = open_story(mode=2)
        story.tell("write_user_id", user_id=77)
        story.tell("set_work_mode", work_mode=4)
        story.tell("set_current", current=900)
        story.tell("set_subdivision", subdivision=8)
        story.tell("set_home", home_speed=333, home_direction=1)
        story.tell("set_group_address", group_address=80)
        story.tell("run_speed", speed=100)
        if way:
            story.tell(way)
            story.tell("read_speed")
        else:
            story.drive.power_cycle(story.now)
        story.wait(5 * SECOND)
        look(story)
        if story.dialect is MODBUS:
            story.tell("read_position", dialect=NATIVE)
            story.tell("run_speed", dialect=NATIVE, speed=100)
            story.tell("set_work_mode", dialect=NATIVE, work_mode=5)
            story.tell("run_speed", dialect=NATIVE, speed=100)
            story.wait(100 * MS)
            story.tell("read_speed", dialect=NATIVE)
            story.tell("move_relative_pulses", dialect=NATIVE, speed=100, pulses=3200)
            story.wait(5 * SECOND)
            story.tell("read_position", dialect=NATIVE)
        else:
            story.tell("set_work_mode", work_mode=5)
            story.tell("move_relative_pulses", speed=100, pulses=3200)
            story.wait(5 * SECOND)
            story.tell("read_position")
        yield story
        story = open_story()
        story.tell("set_address", new_address=9)
        story.tell("read_position", 1)
        story.tell("read_position", 9)
        if way:
            story.tell(way, 9)
        else:
            story.drive.power_cycle(story.now)
        story.wait(5 * SECOND)
        for dialect in (story.dialect, NATIVE) if story.dialect is MODBUS else (story.dialect,):
            story.tell("read_position", 1, dialect=dialect)
            story.tell("read_position", 9, dialect=dialect)
        yield story


def hasty(open_story):
    story = open_story()
    story.tell("set_subdivision", subdivision=32)
    story.tell("set_current", current=500)
    story.wait(SECOND)
    yield story


def bad_checks(open_story):
    """Requests with the checks that lazy firmware lets pass, to the drive and to all."""
    for command, values in (
        ("home", {}),
        ("run_speed", {"direction": 0, "speed": 60, "acceleration": 0}),
        ("emergency_stop", {}),
    ):
        for address in (1, 0):
            story = open_story()
            if command == "emergency_stop":
                story.tell("run_speed", direction=0, speed=60, acceleration=0)
            frame = build(story.dialect, command, address, values)
            check = story.dialect.link.checks(frame, address)[-1]
            size = len(check.expected)
            number = int.from_bytes(check.expected, "big") + 1 & (1 << 8 * size) - 1
            for wrong in (b"\xff" * size, bytes(size), number.to_bytes(size, "big"), check.expected[::-1],
                          check.expected[:1] + bytes(size - 1)):  # fmt: skip
                if wrong != check.expected:
                    story.send(frame[: check.start] + wrong, address)
                    story.wait(100 * MS, 1)
            yield story


def links(open_story):
    """Another speed of the line, another dialect, settings of a neighbour, motion to the group and in packages."""
    story = open_story(group_address=80)
    story.tell("run_speed", 80, direction=0, speed=60, acceleration=0)
    story.tell("stop_speed", 80, direction=0, speed=0, acceleration=0)
    story.tell("set_subdivision", 2, subdivision=8)
    story.tell("read_position")
    story.tell("move_relative_pulses", direction=0, speed=300, acceleration=0, pulses=3200)
    story.wait(SECOND, 1)
    if story.has("long_package"):
        for command, values in (
            ("enable", {"enabled": 0}),
            ("enable", {"enabled": 1}),
            ("run_speed", {"direction": 0, "speed": 300, "acceleration": 1}),
        ):
            story.send(build(story.dialect, "long_package", 0, {"slots": [{"address": 1, "command": command, **values}]}))
            story.tell("read_enabled")
            story.wait(100 * MS, 2)
    if story.name == "mks-modbus":
        story.send(story.dialect.link.completed(bytes.fromhex("01 06 00 F6 00 3C")))
        story.wait(100 * MS, 2)
    for values in (0, 1, 2, 3, 250):
        story.drive.motor.jump(story.now, values)
        story.tell("read_position")
    story.tell("set_baud_rate", baud_rate=2)
    story.seen.append(story.drive.speed)
    story.drive.power_cycle(story.now)
    story.wait(SECOND)
    story.seen.append(story.drive.speed)
    yield story
    if story.name == "mks-rs485":
        story = open_story()
        story.tell("set_modbus", modbus=1)
        story.drive.power_cycle(story.now)
        story.wait(SECOND)
        story.seen.append(story.drive.dialect.name)
        yield story


CHAPTERS = (
    hasty, conditions, bad_checks, links,
    beside, reads, settings, runs, moves, hearing, exceptions, packages, reads_in_motion, read_back, stops, updates,
    respond,
    states, each_state, subdivisions, homing, limits, refused_settings, restarts, saved_runs, zero_modes, calibration,
)  # fmt: skip


#: Where a fault of a theme is likely to show: these chapters are told first.
LIKELY = {
    "limit": (settings, moves, limits, runs), "choice": (settings,), "stored": (restarts, settings, saved_runs),
    "restart": (restarts, respond, saved_runs), "restore": (restarts,), "package": (packages,), "exception": (exceptions,),
    "quantity": (exceptions, moves), "echo": (hasty, exceptions), "byte count": (reads, exceptions), "function": (exceptions,),
    "ramp": (runs, moves), "direction": (runs, moves, states, zero_modes, saved_runs), "target": (moves,),
    "homing": (homing, limits), "protection": (states, reads_in_motion), "completion": (moves, stops, homing, calibration),
    "zero": (zero_modes, stops, restarts), "calibration": (calibration,), "respond": (respond,), "update": (updates,),
    "group": (hearing,), "broadcast": (hearing,), "address": (hearing, reads, exceptions), "read-back": (read_back,),
    "stop": (stops, runs), "scale": (reads, subdivisions, moves, runs), "sign": (reads, moves), "width": (reads, runs, moves),
    "frozen": (reads, reads_in_motion, states, zero_modes), "enable": (states, stops), "mode": (states,),
    "byte order": (reads, read_back), "status": (hasty, settings, runs, homing, calibration, states), "unknown": (hearing,),
}  # fmt: skip


def told(chapter, name, faults=(), quirks=()):
    """Return all that was seen in a chapter, piece by piece."""

    def open_story(**options):
        return Story(name, faults, quirks, **options)

    for story in chapter(open_story):
        yield tuple(story.seen)


@cache
def conforming(chapter, name):
    return tuple(told(chapter, name))


def differs(name, theme="", faults=(), quirks=()):
    """Say whether anything in the whole story differs from that of the conforming drive."""
    likely = LIKELY.get(theme, ())
    for chapter in (*likely, *(c for c in CHAPTERS if c not in likely)):
        pieces = zip(conforming(chapter, name), told(chapter, name, faults, quirks), strict=True)
        if any(expected != got for expected, got in pieces):
            return True
    return False
