"""Causes in what is asked and answered, on made traffic: exceptions, timing, reads, settings, values."""

from __future__ import annotations

from itertools import pairwise, product

import pytest
from msgspec.structs import replace

from analyzer import dialects as registry
from analyzer.catalogue import Role
from analyzer.diagnosis import haste
from analyzer.diagnosis.scene import Confidence
from analyzer.encoder import build
from analyzer.records import CanFrame, Chunk
from tests.collect import rtu
from tests.diagnosis.test_diagnosis import READS, diagnosed, exchanged, first, told

NATIVE, MODBUS, CAN, LK = (registry.get(n) for n in ("mks-rs485", "mks-modbus", "mks-can", "lk-rs485"))


# --- exceptions, and units whose registers are not known ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("asked", "refused", "cause"),
    [
        ("11 03 01 00 00 02", "11 83 01", "wrong_function"),
        ("11 03 01 00 00 02", "11 83 02", "wrong_register"),
        ("11 06 01 00 FF FF", "11 86 03", "value_out_of_range"),
        ("11 03 01 00 00 02", "11 83 06", "too_fast"),
        (None, "11 84 02", "wrong_register"),
    ],
)
def test_an_exception_says_what_is_wrong(asked, refused, cause):
    rows = [(">", rtu(asked))] if asked else []
    assert first(*rows, ("<", rtu(refused))) == cause


def test_a_register_that_another_function_writes():
    whole = exchanged("mks-modbus@1", rtu("01 10 00 F6 00 02 04 01 02 01 40"))
    one = rtu("01 06 00 F6 01 40"), rtu("01 86 02")
    (found,) = told(*one, *one, *(data for _, data in whole))
    assert (found.cause, "function 10, not 06" in found.say) == ("wrong_function", True)


def test_one_exception_in_good_traffic_is_an_answer():
    good = [(">", rtu("11 03 01 00 00 01")), ("<", rtu("11 03 02 00 07"))] * 4
    refused = [(">", rtu("11 03 02 00 00 01")), ("<", rtu("11 83 02"))]
    assert told(*good, *refused, *good) == []


def test_a_request_that_is_answered_elsewhere_asks_for_no_wrong_register():
    asked = (">", rtu("11 03 01 00 00 01"))
    assert told(asked, ("<", rtu("11 03 02 00 07")), asked, ("<", rtu("11 83 02"))) == []
    assert first(asked, ("<", rtu("11 03 02 00 07")), asked, ("<", rtu("11 83 06"))) == "too_fast"


def test_a_register_of_another_device_is_in_order():
    assert told((">", rtu("11 03 01 00 00 01")), ("<", rtu("11 03 02 00 07"))) == []


def test_the_function_that_nobody_answers():
    good = [(">", rtu("11 04 01 00 00 01")), ("<", rtu("11 04 02 00 07"))]
    found = told(*good, *good, *[(">", rtu("11 03 01 00 00 01"))] * 2, *good)
    assert found[0].cause == "wrong_function"
    assert found[0].frames[0].right == rtu("11 04 01 00 00 01").hex(" ").upper()


# --- when the host writes and reads ----------------------------------------------------------------------------------------

MS = 1_000_000
POLLS = {
    "mks-rs485@1": [build(NATIVE, n, 1) for n in ("read_encoder_carry", "read_speed", "read_pulses", "read_protection")] * 2,
    "mks-modbus@1": [build(MODBUS, n, 1) for n in ("read_encoder_carry", "read_speed", "read_pulses")] * 3,
    "lk-rs485@1,baud=38400": [build(LK, n, 1) for n in ("read_state_1", "read_state_2", "read_state_3")] * 3,
}


@pytest.mark.parametrize("drive", POLLS)
def test_replies_one_behind(drive):
    rows = exchanged(drive, *POLLS[drive])
    sent, received = rows[::2], rows[1::2]
    behind = [sent[0], *(row for pair in zip(sent[1:], received, strict=False) for row in pair)]
    for rows in (behind, [*behind, received[-1]]):
        found = told(*rows)
        assert (found[0].cause, found[0].confidence) == ("late_reply", "certain")


@pytest.mark.parametrize("drive", POLLS)
@pytest.mark.parametrize("stray", [b"\x00", b"\xff\xff\xff"])
def test_reads_out_of_step(drive, stray):
    rows = exchanged(drive, *POLLS[drive][:1] * 8)
    stream = stray + b"".join(data for mark, data in rows if mark == "<")
    size = len(rows[1][1])
    reads = [stream[at : at + size] for at in range(0, len(stream) - size, size)]
    shifted = [row for (_, sent), read in zip(rows[::2], reads, strict=False) for row in ((">", sent), ("<", read))]
    assert first(*shifted) == "read_misaligned"


def test_one_short_read_puts_all_behind_it_out_of_step():
    rows = exchanged("mks-modbus@1", *POLLS["mks-modbus@1"][:1] * 8)
    size = len(rows[1][1])
    stream = b"".join(data for mark, data in rows if mark == "<")
    cuts = [0, *range(size, len(stream), size)][:2]
    cuts += range(cuts[-1] + size - 3, len(stream), size)
    reads = [stream[a:b] for a, b in pairwise(cuts)]
    out = [row for (_, sent), read in zip(rows[::2], reads, strict=False) for row in ((">", sent), ("<", read))]
    assert first(*out) == "read_misaligned"


def test_reads_of_lk_that_begin_with_the_end_of_the_reply_before():
    """The end is no glitch, whose bytes are those of a pulse; the first read begins with what was left."""
    rows = exchanged("lk-rs485@1,baud=38400", *[build(LK, "read_state_2", 1)] * 6)
    sizes = {len(data) for mark, data in rows if mark == "<"}
    size = sizes.pop()
    stream = b"\x12\x9a\x40" + b"".join(data for mark, data in rows if mark == "<")
    out = [row for n, (_, sent) in enumerate(rows[::2]) for row in ((">", sent), ("<", stream[n * size : (n + 1) * size]))]
    assert [each.cause for each in told(*out)] == ["read_misaligned"]
    assert sizes == set()


def test_a_driver_that_is_on_too_long_at_each_reply():
    """No reply came whole; the head that was asked for makes the CRC fit."""
    rows = exchanged("mks-modbus@1", *POLLS["mks-modbus@1"])
    cut = [(mark, bytes((0, data[1] & 0x40)) + data[2:] if mark == "<" else data) for mark, data in rows]
    assert first(*cut) == "collision"


def test_a_field_is_missing_on_can_where_the_sum_is_right():
    short, whole = bytes.fromhex("F60150"), bytes.fromhex("F6015005")
    for sent, cause in ((short + bytes((sum(short) + 3 & 0xFF,)), "wrong_length"), (whole, "missing_checksum")):
        frames = [CanFrame(n * 10**8, "can0", 3, sent, Role.REQUEST) for n in range(3)]
        assert diagnosed(frames).causes[0].suspicion.cause == cause


@pytest.mark.parametrize("drive", POLLS)
def test_a_host_that_reads_too_early(drive):
    rows = exchanged(drive, *POLLS[drive][:1] * 8)
    size = len(rows[1][1])
    stream = b"".join(data for mark, data in rows if mark == "<")
    cuts = [0, *range(size - 3, len(stream), size)]
    # A host that reads so many bytes each time is out of step. One that reads what is there gets more or fewer.
    assert told_of(rows, stream, cuts) == ["read_misaligned", "reply_cut"]
    uneven = [cut + number % 2 for number, cut in enumerate(cuts)]
    assert told_of(rows, stream, [0, *uneven[1:]]) == ["reply_cut"]


def told_of(rows, stream, cuts):
    reads = [stream[a:b] for a, b in pairwise(cuts)]
    out = [row for (_, sent), read in zip(rows[::2], reads, strict=False) for row in ((">", sent), ("<", read))]
    return [each.cause for each in told(*out)]


@pytest.mark.parametrize("at", [1, 2, 5])
def test_requests_in_two_parts(at):
    sent = [part for frame in POLLS["mks-modbus@1"][:3] for part in ((">", frame[:at]), (">", frame[at:]))]
    assert first(*sent) == "split_frame"


def test_a_reply_in_two_reads_whose_first_part_checks():
    assert first("> 01 04 00 00 00 01 31 CA", "< 01 04 02 03 01 78", "< 00") == "split_frame"
    asked = [(">", READS[0])] + [("<", part) for part in (b"\xfb\x01\x30\x00\x00", b"\x00\x01\x20\x00\x4d")]
    assert told(*asked) == []
    assert first(*asked * 3) == "split_frame"
    whole = asked[1][1] + asked[2][1]
    assert first(*[asked[0], *(("<", part) for part in (whole[:4], whole[4:8], whole[8:]))] * 3) == "split_frame"


def burst(pause_ms, gap_ms):
    """Return items: after each pause four requests, a gap between them, of which the first is answered."""
    items, now = [], 0
    for _ in range(4):
        now += pause_ms * MS
        start = now
        for number, data in enumerate(READS[:4]):
            now = start + number * gap_ms * MS
            items.append(Chunk(now, "bus", data, Role.REQUEST, True))
        items.append(Chunk(now + 3 * MS, "bus", exchanged("mks-rs485@1", READS[0])[1][1], Role.REPLY, True))
    return items


@pytest.mark.parametrize(("gap_ms", "cause"), [(1, ["too_fast"]), (200, [])])
def test_the_second_of_two_requests_that_follow_each_other_at_once(gap_ms, cause):
    """The same request is answered after a pause. Replies to a read look alike, so that pairs are one behind."""
    asked, other = rtu("05 04 00 32 00 01"), rtu("05 04 00 3A 00 01")
    items, now = [], 0
    for number in range(8):
        for each in (asked, other) if number % 2 else (other,):
            at_once = number % 2 and each == other
            now += (gap_ms if at_once else 200) * MS
            items.append(Chunk(now, "bus", each, Role.REQUEST, True))
            if not at_once or gap_ms > 5:
                items.append(Chunk(now + 5 * MS, "bus", rtu(f"05 04 02 00 {number:02X}"), Role.REPLY, True))
    found = diagnosed(sorted(items, key=lambda item: item.t_ns)).causes
    assert [each.suspicion.cause for each in found][:1] == cause


@pytest.mark.parametrize(("gap_ms", "other", "cause"), [(2, 5, "too_fast"), (200, 5, "no_reply"), (2, 6, "wrong_address")])
def test_none_of_two_requests_that_follow_each_other_at_once(gap_ms, other, cause):
    """A read alone is answered. What comes after a pause, or is sent to a unit that never answers, is silent by itself."""
    items, now = [], 0
    for number in range(4):
        for each in (
            rtu("05 04 00 F1 00 01"),
            rtu(f"{other:02X} 06 00 F3 00 01"),
            rtu(f"05 10 00 F6 00 02 04 00 14 00 {number:02X}"),
        ):
            now += gap_ms * MS if each[1] == 0x10 else 500 * MS
            items.append(Chunk(now, "bus", each, Role.REQUEST, True))
            if each[1] == 0x04:
                items.append(Chunk(now + 5 * MS, "bus", rtu("05 04 02 00 01"), Role.REPLY, True))
    assert [each.suspicion.cause for each in diagnosed(items).causes][:1] == [cause]


def test_requests_that_come_too_soon():
    causes = diagnosed(burst(100, 1)).causes
    assert causes[0].suspicion.cause == "too_fast"
    assert "none later than 1 ms" in causes[0].suspicion.evidence
    slow = diagnosed(burst(1000, 300)).causes
    assert "too_fast" not in [each.suspicion.cause for each in slow]


# --- settings after which a drive is asked as before ------------------------------------------------------------------------

READ = READS[0]


@pytest.mark.parametrize(
    ("setting", "values", "cause"),
    [
        ("set_baud_rate", {"baud_rate": 6}, "wrong_baud"),
        ("set_modbus", {"modbus": 1}, "wrong_dialect"),
        ("set_address", {"new_address": 9}, "address_changed"),
    ],
)
def test_a_setting_after_which_nobody_answers(setting, values, cause):
    changing = build(NATIVE, setting, 1, values)
    rows = [*exchanged("mks-rs485@1", READ), (">", changing), ("<", b"\xfb\x01" + changing[2:3] + b"\x01")]
    rows[-1] = ("<", NATIVE.link.completed(rows[-1][1]))
    found = told(*rows, (">", READ), (">", READS[1]))[0]
    assert (found.cause, "asked at 1" in found.say) == (cause, cause == "address_changed")
    assert told(*rows, *exchanged("mks-rs485@1", READ, READ)) == []


def test_respond_is_switched_off_in_the_capture():
    off = build(NATIVE, "set_respond", 1, {"respond": 0, "active": 0})
    run = build(NATIVE, "run_speed", 1, {"speed": 100, "acceleration": 2})
    rows = exchanged("mks-rs485@1,work_mode=sr_vfoc", READ, off, run, READ, run, READ)
    assert first(*rows) == "respond_off"
    assert told(*exchanged("mks-rs485@1,work_mode=sr_vfoc", READ, off, READ)) == []


def test_motion_commands_that_are_wrong_themselves_say_nothing_of_respond():
    read, run = "FA 01 30 2B", [build(NATIVE, "run_speed", 1, {"speed": n, "acceleration": 2}) for n in (80, 160, 240)]
    reply = "FB 01 30 00 00 00 00 00 00 2C"
    rows = [f"> {read}", f"< {reply}", *((">", frame) for frame in run), f"> {read}", f"< {reply}"]
    assert "respond_off" in {each.cause for each in told(*rows)}
    for wrong in (
        [frame[:-1] + b"\x77" for frame in run],
        [frame[:5] + frame[6:-1] + bytes((sum(frame[:5]) + 2 & 0xFF,)) for frame in run],
    ):
        rows[2:5] = [(">", frame) for frame in wrong]
        assert "respond_off" not in {each.cause for each in told(*rows)}


def test_a_drive_that_answers_at_times():
    one, other = exchanged("mks-rs485@1", READ), [(">", READ)]
    found = told(*one, *other, *one, *other, *other, *one)
    assert (found[0].cause, found[0].confidence) == ("no_reply", "possible")
    found = told(*one, *one, *other, (">", READS[1]), (">", READS[2]))
    assert "then stops" in found[0].say
    assert told(*one, *other, *one, *one) == []


def test_an_address_that_no_unit_can_have():
    assert first(*[(">", rtu("F8 04 00 00 00 01"))] * 2) == "wrong_address"


# --- what no manual says ----------------------------------------------------------------------------------------------------


def test_a_second_reply_to_settings():
    settings = [build(NATIVE, "set_current", 1, {"current": mA}) for mA in (800, 1200)]
    rows = exchanged("mks-rs485@1", READ, *settings, READ)
    twice = [row for mark, data in rows for row in [(mark, data)] * (1 + (mark == "<" and data[2] == 0x83))]
    assert first(*twice) == "firmware_quirk"


@pytest.mark.parametrize("reply", ["01 03 00 00 07 00 08", "01 03 00 04 00 07 00 09"])
def test_a_byte_count_that_lies(reply):
    assert first((">", rtu("01 03 00 00 00 02")), ("<", rtu(reply))) == "firmware_quirk"


def test_a_command_that_is_never_answered():
    rows = exchanged("mks-rs485@1", *READS[:3])
    silent = (">", build(NATIVE, "read_angle_error", 1))
    assert first(*rows, silent, *rows, silent, *rows) == "firmware_quirk"


# --- values -----------------------------------------------------------------------------------------------------------------


def word(frame, at, data, dialect=NATIVE):
    """Return a frame with other bytes at a place, and its check anew."""
    size = 2 if dialect is MODBUS else 1
    return dialect.link.completed((frame[:at] + data + frame[at + len(data) :])[:-size])


RUNS = [build(NATIVE, "run_speed", 1, {"speed": 300, "acceleration": 2}), build(NATIVE, "set_current", 1, {"current": 800})]


def test_a_value_out_of_range():
    found = told((">", word(RUNS[1], 3, b"\x17\x70")))
    assert found[0].cause == "value_out_of_range"
    assert "0..5200 mA" in found[0].say


def test_a_value_that_a_model_does_not_take():
    rows = [
        row
        for current in (5000, 4000)
        for row in ((">", build(NATIVE, "set_current", 1, {"current": current})), "< FB 01 83 00 7F")
    ]
    found = told(*rows)
    assert [(each.cause, each.confidence) for each in found] == [("value_out_of_range", Confidence.LIKELY)]
    assert "42D" in found[0].say
    # A drive that takes such a value has another reason.
    assert "value_out_of_range" not in {each.cause for each in told(*rows, rows[0], "< FB 01 83 01 80")}
    low = [row for current in (1000, 2000) for row in ((">", build(NATIVE, "set_current", 1, {"current": current})), rows[1])]
    assert "value_out_of_range" not in {each.cause for each in told(*low)}


def test_a_choice_that_is_not_listed():
    assert first((">", word(build(NATIVE, "set_work_mode", 1, {"work_mode": 5}), 3, b"\x0b"))) == "value_out_of_range"


@pytest.mark.parametrize(
    "rows",
    [
        [word(RUNS[0], 3, b"\x2c\x01"), word(RUNS[1], 3, b"\xe8\x03")],
        [word(RUNS[1], 3, b"\x40\x06")],
        [word(build(LK, "run_speed", 1, {"speed": 0}), 5, speed, LK) for speed in (b"\0\0\x8c\xa0", b"\0\0\x46\x50")],
        [word(build(MODBUS, "set_current", 1, {"current": 0}), 4, b"\x40\x06", MODBUS)],
    ],
)
def test_swapped_bytes(rows):
    found = told(*((">", row) for row in rows))
    assert found[0].cause == "wrong_byte_order"
    assert found[0].frames[0].right


@pytest.mark.parametrize(
    ("speeds", "cause"), [((800, 100, 1352), "wrong_byte_order"), ((0x0320, 0x8C80, 0x0FA0), "value_out_of_range")]
)
def test_reserved_bits_that_are_set_are_those_of_a_number(speeds, cause):
    """Speeds of 800, 100 and 1352 rpm with their bytes swapped; and speeds that are too high alone."""
    order = "little" if cause == "wrong_byte_order" else "big"
    frames = [NATIVE.link.completed(b"\xfa\x01\xf6" + speed.to_bytes(2, order) + b"\x02") for speed in speeds]
    assert (
        told(*((mark, row) for frame in frames for mark, row in ((">", frame), ("<", bytes.fromhex("FB 01 F6 01 F3")))))[
            0
        ].cause
        == cause
    )


@pytest.mark.parametrize(
    ("angle", "cause"),
    [(36000, "value_out_of_range"), (41000, "value_out_of_range"), (-9000, "unit_or_sign"), (-113, "unit_or_sign")],
)
def test_more_than_a_turn_is_no_negative_angle(angle, cause):
    sent = word(build(LK, "move_single_turn", 1, {"angle": 0}), 6, (angle & 0xFFFF).to_bytes(2, "little"), LK)
    assert first((">", sent)) == cause


@pytest.mark.parametrize("speed", [-300, -50, -1])
@pytest.mark.parametrize("dialect", [NATIVE, MODBUS], ids=lambda d: d.name)
def test_a_negative_speed_as_two_s_complement(dialect, speed):
    right = build(dialect, "run_speed", 1, {"speed": -speed, "acceleration": 2, "direction": 1})
    at = 9 if dialect is MODBUS else 3
    wrong = word(right, at, speed.to_bytes(2, "big", signed=True), dialect)
    wrong = word(wrong, 7, b"\0", dialect) if dialect is MODBUS else wrong
    found = told((">", wrong))
    assert (found[0].cause, found[0].frames[0].right) == ("unit_or_sign", right.hex(" ").upper())


@pytest.mark.parametrize("dialect", [NATIVE, MODBUS, LK], ids=lambda d: d.name)
def test_round_values_are_in_order(dialect):
    speeds = [(">", build(dialect, "run_speed", 1, {"speed": speed})) for speed in (1, 100, 256, 1000, 2560, 3000)]
    rows = [row for pair in speeds for row in (pair,)]
    assert {each.cause for each in told(*rows)} <= {"no_reply"}


def test_sizes_are_packed_each_in_one_way():
    moves = [
        build(NATIVE, "move_relative_pulses", 1, {"speed": speed, "acceleration": 2, "pulses": 0}) for speed in (300, 600, 900)
    ]
    found = told(*((">", word(f, 6, (3200 * n).to_bytes(4, "little"))) for n, f in enumerate(moves, 1)))
    assert found[0].cause == "wrong_byte_order"
    assert (
        found[0].frames[0].right
        == build(NATIVE, "move_relative_pulses", 1, {"speed": 300, "acceleration": 2, "pulses": 3200}).hex(" ").upper()
    )


# --- units whose registers are not known ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "cause"),
    [(lambda frame: frame[:-2], "missing_checksum"), (lambda frame: frame[:-1] + bytes((frame[-1] ^ 0x5A,)), "wrong_checksum")],
)
def test_checks_of_other_devices(change, cause):
    assert first((">", change(rtu("11 03 01 00 00 02"))), (">", change(rtu("11 04 00 6B 00 03")))) == cause


def test_a_reply_of_another_device_that_is_cut():
    assert first((">", rtu("11 03 01 00 00 02")), ("<", rtu("11 03 04 00 07 00 08")[:6])) == "reply_cut"


@pytest.mark.parametrize("mark", ["<", ""])
def test_another_device_answers_from_its_new_address(mark):
    asked = Chunk(0, "bus", rtu("01 06 00 10 00 17"), Role.REQUEST if mark else Role.UNKNOWN, True)
    answer = Chunk(9 * MS, "bus", rtu("17 06 00 10 00 17"), Role.REPLY if mark else Role.UNKNOWN, True)
    assert diagnosed([asked, answer]).causes[0].suspicion.cause == "address_changed"


# --- sound frames, which accuse nobody -------------------------------------------------------------------------------------

LK_POLL = ["> 3E 9A 01 00 D9", "< 3E 9A 01 07 E0 1E 00 00 00 00 00 00 1E"]
#: A request without its CRC, as some libraries log it, and its sound reply.
BARE = [(">", bytes.fromhex("11 03 00 6D 00 01")), ("<", rtu("11 03 02 00 1A"))]


@pytest.mark.parametrize(
    "rows",
    [
        # A right check rules out every trouble of the line, such as an inverted bit 7.
        [*LK_POLL, "> 3E 12 01 00 51", "< 3E 12 01 02 53 01 02 03"],
        # A function without fields, and its reply.
        [(">", rtu("01 11")), ("<", rtu("01 11 03 0A FF 00"))],
        # A request that is answered had its check, even if the log leaves it out. So it is beside others without a reply.
        BARE,
        [*BARE, (">", bytes.fromhex("12 03 00 6D 00 01")), *BARE],
        [*BARE[:1], ("<", rtu("11 83 02")), (">", bytes.fromhex("11 03 00 6E 00 01"))],
        [(mark, data[:5]) if mark == "<" else (mark, data) for mark, data in BARE * 2],
    ],
)  # fmt: skip
def test_sound_frames_are_not_accused(rows):
    assert {each.cause for each in told(*rows)} <= {"wrong_register", "unknown_command"}


def test_bare_requests_that_are_not_answered_lack_their_check():
    assert first(BARE[0], BARE[0]) == "missing_checksum"


@pytest.mark.parametrize("frame", ["01 11 05 0A FF 00", "01 11 02 0A FF 00"])
def test_a_count_that_is_not_that_of_the_bytes(frame):
    asked = rtu("01 11")
    assert first((">", asked), ("<", rtu(frame))) == "firmware_quirk"
    assert first((">", rtu(frame))) == "wrong_length"


@pytest.mark.parametrize("unit", ["F8", "FE", "FF"])
def test_a_general_address_is_not_certainly_wrong(unit):
    asked, came = (">", rtu(f"{unit} 04 00 00 00 01")), ("<", rtu(f"{unit} 04 02 00 E6"))
    assert told(asked, came, asked, came) == []
    assert [(each.cause, each.confidence) for each in told(asked, asked)] == [("wrong_address", "possible")]
    other = (">", rtu("FA 04 00 00 00 01"))
    assert [(each.cause, each.confidence) for each in told(other, other)] == [("wrong_address", "certain")]


@pytest.mark.parametrize(
    ("positions", "cause"),
    [((-886_699,), None), ((-886_699, -912_004), "unit_or_sign"), ((-1600,), "unit_or_sign")],
    ids=["once", "twice", "small"],
)
def test_one_large_number_may_be_no_negative_one(positions, cause):
    sent = [
        build(MODBUS, "move_relative_pulses", 1, {"acceleration": 8, "speed": 1000, "pulses": pulses & 0xFFFF_FFFF})
        for pulses in positions
    ]
    found = told(*((">", frame) for frame in sent))
    assert [each.cause for each in found if each.cause == "unit_or_sign"] == ([cause] if cause else [])


def test_replies_in_two_reads_are_named_where_a_log_shows_most_of_them_so():
    turns = [(rtu(f"01 04 00 3{n} 00 01"), rtu(f"01 04 02 00 1{n}")) for n in (2, 4, 5)]
    apart = [row for asked, whole in turns for row in ((">", asked), ("<", whole[:3]), ("<", whole[3:]))]
    together = [row for asked, whole in turns for row in ((">", asked), ("<", whole))]
    (found,) = told(*apart)
    assert (found.cause, found.confidence) == ("split_frame", Confidence.POSSIBLE)
    assert not told(*apart[:3], *together)


def test_data_bits_that_are_missing():
    # What a receiver of five bits makes of it: all below 20 is right.
    sent, came = rtu("01 03 00 00 00 0A"), bytes.fromhex("01 03 00 00 00 0A 05 1E")
    assert [each.cause for each in told((">", sent), ("<", came))] == ["wrong_parity", "noise"]
    assert "wrong_parity" not in {each.cause for each in told((">", sent), ("<", came[:4] + b"\x08" + came[5:]))}


def rows_of_requests(requests, replies, gap_ms, rounds=4):
    """Return requests that follow each other at a pace, and replies that come 5 ms behind the last of them."""
    items, now = [], 0.0
    for _ in range(rounds):
        for role, frames, pause in ((Role.REQUEST, requests, gap_ms), (Role.REPLY, replies, 5)):
            for frame in frames:
                now += pause
                items.append(Chunk(int(now * MS), "bus", bytes.fromhex(frame), role, True))
        now += 200
    return items


SPEEDS_OF_THREE = ("FA 05 32 31", "FA 06 32 32", "FA 07 32 33")
REPLIES_OF_THREE = ("FB 05 32 00 28 5A", "FB 06 32 00 29 5C", "FB 07 32 00 2A 5E")


@pytest.mark.parametrize(
    ("requests", "replies", "gap_ms", "too_fast"),
    [
        (SPEEDS_OF_THREE, REPLIES_OF_THREE[2:], 1.5, True),
        # A host that waits longer than the reply takes finds two drives that are not there.
        (SPEEDS_OF_THREE, REPLIES_OF_THREE[2:], 40, False),
        # One drive answers some of a row, and no others.
        ((SPEEDS_OF_THREE[0], "FA 05 31 30", "FA 05 F1 F0"), REPLIES_OF_THREE[:1], 1.5, True),
        # Two of three drives are there.
        (SPEEDS_OF_THREE, REPLIES_OF_THREE[1:], 1.5, False),
        # All answer in the end.
        (SPEEDS_OF_THREE, REPLIES_OF_THREE, 1.5, False),
        # Motion commands that no drive answers, by its setting, and a read behind them.
        (("FA 05 F6 00 50 02 47", "FA 06 F6 00 50 02 48", "FA 07 32 33"), REPLIES_OF_THREE[2:], 1.5, False),
    ],
    ids=["rows", "waits", "one drive", "two of three drives", "answered", "silent by setting"],
)
def test_only_the_last_of_requests_that_follow_each_other_at_once_is_answered(requests, replies, gap_ms, too_fast):
    causes = [each.suspicion.cause for each in diagnosed(rows_of_requests(requests, replies, gap_ms)).causes]
    assert ("too_fast" in causes) is too_fast
    # Whom the host has not let answer is not looked for.
    assert not ("wrong_address" in causes and too_fast)


def test_some_of_requests_that_follow_each_other_at_once_are_answered():
    sent = (SPEEDS_OF_THREE[0], "FA 05 31 30", "FA 05 3A 39", "FA 05 F1 F0")
    came = (REPLIES_OF_THREE[:1], (REPLIES_OF_THREE[0], "FB 05 F1 01 F2")) * 2
    rows = [rows_of_requests(sent, replies, 1.8, rounds=1) for replies in came]
    items = [replace(item, t_ns=item.t_ns + 500 * MS * n) for n, row in enumerate(rows) for item in row]
    assert [each.suspicion.cause for each in diagnosed(items).causes] == ["too_fast"]


def test_requests_of_which_none_is_answered_are_not_compared_with_what_did_not_come(monkeypatch):
    asked, awaited = 0, haste.awaited

    def counting(message):
        nonlocal asked
        asked += 1
        return awaited(message)

    monkeypatch.setattr(haste, "awaited", counting)
    frames = [bytes((0xFA, address, code)) for address, code in product(range(1, 101), (0x31, 0x32))]
    diagnosed(rows_of_requests([(f + bytes([sum(f) & 0xFF])).hex() for f in frames], REPLIES_OF_THREE[2:], 10, rounds=1))
    assert len(frames) <= asked <= 3 * len(frames)
