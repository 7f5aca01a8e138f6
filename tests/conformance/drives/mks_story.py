"""A story of an MKS drive: what a host sends, and all that it sees, for quirks to show in and faults that no claim refutes.

A story is a list of chapters; each begins with a fresh drive and yields all that comes over the bus, with its times. The
frames of a chapter do not depend on what the drive answers.
"""

from __future__ import annotations

from functools import cache

from analyzer import dialects
from analyzer.encoder import build
from conformance.drives.mks.state import is_setting
from tests.collect import crc
from tests.conformance.drives.test_mks_rig import MS, SECOND, frame_of, make
from tests.conformance.drives.test_mks_settings import nearby
from tests.conformance.drives.test_mks_settings import others as beside

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
                story.tell(command.name, **beside(command, field) | {field.name: value})
                yield story


def exceptions(open_story):
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


def updates(open_story):
    for command in ("move_absolute_axis", "move_relative_axis"):
        story = open_story()
        story.tell(command, speed=300, acceleration=254, position=100_000)
        story.wait(500 * MS)
        story.tell(command, speed=600, acceleration=254, position=200_000)
        story.wait(3 * SECOND, 20)
        story.tell("run_speed", speed=60)
        story.wait(20 * SECOND)
        yield story


def runs(open_story):
    for mode, speed, acceleration, direction in (
        (5, 700, 250, 1), (4, 4000, 0, 0), (3, 500, 0, 1), (5, 3001, 0, 0), (5, 3000, 255, 0), (5, 4095, 0, 0),
    ):  # fmt: skip
        story = open_story(mode=mode)
        story.tell("run_speed", speed=speed, acceleration=acceleration, direction=direction)
        story.wait(SECOND, 8)
        story.tell("stop_speed", acceleration=acceleration)
        story.wait(SECOND, 8)
        yield story


def saved_runs(open_story):
    for state in (0xC8, 0xCA):
        story = open_story()
        story.tell("run_speed", speed=120, direction=1)
        story.tell("save_speed", save_state=0xC8)
        story.tell("save_speed", save_state=state)
        story.tell("save_speed", save_state=0xC9)
        story.tell("restart")
        story.wait(5 * SECOND)
        story.wait(100 * MS, 2)
        yield story


def limits(open_story):
    story = open_story()
    story.drive.place_switch("left", -5000)
    story.drive.place_switch("right", 20_000)
    story.tell("set_home", home_speed=600, end_limit=1)
    story.tell("set_limit_remap", limit_remap=1)
    story.tell("home")
    story.wait(5 * SECOND)
    story.tell("read_enabled")
    story.drive.turn_shaft(100)
    story.tell("read_position")
    story.tell("enable", enabled=1)
    story.tell("move_relative_axis", speed=600, position=100_000)
    story.wait(5 * SECOND, 5)
    story.tell("move_relative_axis", speed=600, position=-1000)
    story.wait(SECOND)
    story.tell("move_relative_axis", speed=600, position=-3000)
    story.wait(SECOND, 1)
    story.tell("run_speed", speed=600)
    story.wait(SECOND, 2)
    yield story


def calibration(open_story):
    story = open_story()
    story.tell("calibrate")
    story.wait(6 * SECOND, 6)
    story.wait(20 * SECOND, 2)
    yield story


def others(open_story):
    """Moves in open modes, the most pulses, a frame of another dialect, and what is left of settings behind a restore."""
    for mode in (3, 4):
        story = open_story(mode=mode)
        story.tell("move_relative_axis", speed=600, position=5000)
        yield story
    story = open_story()
    story.tell("move_relative_axis", speed=1800, position=30_000)
    story.wait(5 * SECOND)
    story.tell("read_position")
    widest = story.dialect.by_name["move_relative_pulses"].request_forms[0].layout.named["pulses"].high
    story.tell("move_relative_pulses", speed=60, acceleration=248, pulses=widest)
    story.wait(SECOND, 2)
    if story.dialect is NATIVE:
        story.send(build(MODBUS, "read_speed", 1), dialect=MODBUS)
    yield story
    story = open_story(mode=2)
    story.tell("set_work_mode", work_mode=4)
    story.tell("set_subdivision", subdivision=8)
    story.tell("restore")
    story.tell("read_speed")
    story.wait(5 * SECOND)
    for dialect in (story.dialect, NATIVE) if story.dialect is MODBUS else (story.dialect,):
        story.tell("run_speed", dialect=dialect, speed=100)
        story.tell("set_work_mode", dialect=dialect, work_mode=5)
        story.tell("run_speed", dialect=dialect, speed=100)
        story.wait(100 * MS)
        story.tell("read_speed", dialect=dialect)
    yield story


CHAPTERS = (calibration, reads, updates, saved_runs, runs, limits, exceptions, others, settings)


def told(chapter, name, faults=(), quirks=()):
    """Return all that was seen in a chapter, piece by piece."""

    def open_story(**options):
        return Story(name, faults, quirks, **options)

    for story in chapter(open_story):
        yield tuple(story.seen)


@cache
def conforming(chapter, name):
    return tuple(told(chapter, name))


def differs(name, faults=(), quirks=()):
    """Say whether anything in the whole story differs from that of the conforming drive."""
    for chapter in CHAPTERS:
        pieces = zip(conforming(chapter, name), told(chapter, name, faults, quirks), strict=True)
        if any(expected != got for expected, got in pieces):
            return True
    return False
