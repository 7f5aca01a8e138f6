"""What the line does to bytes: traffic of our drives and of any other device, through a line that spoils it."""

import json
import random

import pytest

from analyzer.catalogue import Role
from analyzer.cli import main
from analyzer.diagnosis.bits import Line, Rows, levels, read, unread
from analyzer.diagnosis.reader import Reader
from analyzer.records import Chunk
from benchmarks import troubles
from tests.diagnosis.spoiled_line import STEPS, Format, both, received
from tests.diagnosis.spoiled_line import levels as on_the_line
from tests.diagnosis.test_diagnosis import (
    LK_READS,
    MODBUS,
    NATIVE,
    READS,
    build,
    captures,
    changed,
    diagnosed,
    exchanged,
    first,
    told,
)

SERIAL = Reader.of_bus("serial")


def modbus(text):
    body = bytes.fromhex(text)
    return body + captures.crc16(body)


#: A device that is not in the catalogue: a meter at address 17.
METER = [
    (">", modbus("11 03 01 31 00 02")),
    ("<", modbus("11 03 04 12 34 00 56")),
    (">", modbus("11 04 02 00 00 01")),
    ("<", modbus("11 04 02 0B C1")),
    (">", modbus("11 03 01 35 00 03")),
    ("<", modbus("11 03 06 00 01 FF FE 41 20")),
]
NATIVES = exchanged("mks-rs485@1", *READS)
SPEEDS = exchanged("mks-rs485@2", *(build(NATIVE, name, 2) for name in ("read_speed", "read_pulses", "read_protection")))


def spoiled(rows, mark="<", **how):
    return changed(rows, mark, lambda data: received(on_the_line(data), **how))


# --- the way back from bytes ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("line", [Line(inverted=True), Line(missed=1), Line(parity=1), Line(0.5)], ids=str)
@pytest.mark.parametrize("data", [bytes.fromhex("FA 01 30 2B"), READS[1], modbus("01 04 00 30 00 03")], ids=bytes.hex)
def test_bytes_are_led_back_to_their_frame(line, data):
    heard = read(levels(data, line), line)
    found = unread(heard, line, lambda begun: SERIAL.begins(begun, 12), lambda sent: SERIAL.best(sent) is not None)
    assert heard == data or found == (data, len(heard))


@pytest.mark.parametrize("how", [{"inverted": True}, {"missed": 1}, {"ratio": 0.5}], ids=str)
def test_both_receivers_read_the_same(how):
    line = Line(**how)
    for data in READS + LK_READS:
        assert read(levels(data, line), line) == received(on_the_line(data), **how)


@pytest.mark.parametrize("ratio", [0.167, 0.5, 0.868, 1.302, 2.0, 3.333, 6.667])
def test_a_search_looks_at_every_frame_that_may_begin_so(ratio):
    chance, line = random.Random(ratio), Line(ratio)
    seen = [levels(chance.randbytes(size)) for size in (1, 3, 5, 8) * 30]
    for late in ((-0.05, -0.05), (0.05, 0.05), (-0.05, 0.05)):
        whole = [read(each, line, late) for each in seen]
        heads = bytes({came[0] for came in whole[::40] if came})
        chosen = set(Rows(seen).beginning(line, late, heads))
        assert {row for row, came in enumerate(whole) if came and came[0] in heads} <= chosen
        assert ratio < 0.5 or len(chosen) < len(seen)
        for came, each in zip(whole, seen, strict=True):
            assert read(each, line, late, {came[:size] for size in (1, 2, 3)}) == came
            assert len(came) < 2 or read(each, line, late, {came[:1]}) == b""


# --- set up wrongly ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("how", "cause"), [({"inverted": True}, "inverted_lines"), ({"missed": 1}, "lost_start"), ({"ratio": 0.5}, "wrong_baud")]
)
@pytest.mark.parametrize("rows", [METER, NATIVES], ids=["meter", "native"])
def test_replies_of_any_device(rows, how, cause):
    assert first(*spoiled(rows, **how)) == cause


def test_request_and_reply_in_one_stretch():
    rows = [received(on_the_line(sent), inverted=True) + received(on_the_line(came), inverted=True) for sent, came in
            zip([d for m, d in NATIVES if m == ">"], [d for m, d in NATIVES if m == "<"], strict=True)]  # fmt: skip
    assert first(*rows) == "inverted_lines"


def test_what_is_sent_explains_what_is_read():
    sent = bytes.fromhex("01 23 45 67 07 04 08")
    line = Line(inverted=True)
    came = read(levels(sent, line), line)
    assert first((">", sent), ("<", came)) == "inverted_lines"
    assert first((">", sent), ("<", came[:3] + b"\xff" + came[3:])) == "inverted_lines"


def test_seven_bits_in_one_stream():
    stream = b"".join(data for _, data in NATIVES)
    assert first(bytes(byte & 0x7F for byte in stream)) == "wrong_parity"


def test_other_bytes_are_no_frame_on_a_wrong_line():
    chance = random.Random(3)
    assert told(*(chance.randbytes(chance.randrange(5, 14)) for _ in range(6))) == []


@pytest.mark.parametrize("edge", [b"", b"\0"], ids=["plain", "edge"])
def test_one_reply_on_swapped_wires(edge):
    rows = [METER[0], ("<", edge + received(on_the_line(METER[1][1]), inverted=True))]
    assert first(*rows) == "inverted_lines"


def test_one_reply_of_which_no_byte_is_there():
    found = told(METER[0], ("<", bytes.fromhex("FB F8 7F 00")))
    assert [(each.cause, each.confidence) for each in found] == [("wrong_baud", "possible")]


@pytest.mark.parametrize("reply", ["11 03 7F 00", "4F 4B 0D 0A", "FF FF FF FF"], ids=["head", "text", "idle"])
def test_one_reply_that_is_no_matter_of_the_line(reply):
    assert "wrong_baud" not in [each.cause for each in told(METER[0], ("<", bytes.fromhex(reply)))]


def test_replies_that_repeat_and_are_no_frames():
    asked = [build(MODBUS, "read_speed", 1), build(MODBUS, "read_pulses", 1)] * 3
    rows = [row for frame in asked for row in ((">", frame), ("<", received(on_the_line(frame), 3.3)))]
    found = told(*rows)
    assert [each.cause for each in found] == ["wrong_baud"]
    # A protocol that is not known sends frames that begin alike and do not repeat, or repeat with a field that counts.
    heads = [bytes((0x9C, 0x11, n, 0x07, 0x02, 0xE1, 0x40, n * 37 & 0xFF)) for n in range(6)]
    assert told(*heads) == []
    assert told(*heads * 2) == []
    assert told(b"".join(bytes((0xFC, 0x0B, n, 2, 2, 0, 0, 0, 0, 0, n * 91 & 0xFF, n * 53 & 0xFF)) for n in range(20))) == []
    # Or has checks of its own.
    bodies = (b"\x9c\x01\x20\x85", b"\x9c\x02\x33\x99", b"\x9c\x05\x41\xc4")
    assert told(*(body + captures.sum8(body) for body in bodies)) == []


# --- edges ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        (lambda data: b"\x00" + data, "leading_glitch"),
        (lambda data: b"\xf8\x14\x00" + data, "leading_glitch"),
        (lambda data: b"\x00" * 8 + data, "leading_glitch"),
        (lambda data: b"\x00" + data[:-1], "leading_glitch"),
        (lambda data: data + b"\xff\x00", "trailing_glitch"),
        (lambda data: data[1:], "lost_start"),
    ],
)
def test_edges_of_any_device(change, cause):
    assert first(*changed(METER, "<", change)) == cause


def test_a_glitch_between_request_and_reply_of_a_stream():
    stream = b"".join(b"\x00" + data if mark == "<" else data for mark, data in METER)
    assert first(stream) == "leading_glitch"


def test_a_glitch_before_a_reply_that_lacks_as_much_at_its_end():
    found = told(*changed(METER, "<", lambda data: b"\x00" + data[:-1]))
    assert found[0].cause == "leading_glitch"
    assert "lacks 1 byte" in found[0].evidence
    assert "whole" not in found[0].evidence + found[0].next


def test_both_edges_are_told_and_the_glitch_alone_is_named():
    found = told(*changed(METER, "<", lambda data: b"\x00" + data + b"\xff"))
    assert [each.cause for each in found] == ["leading_glitch", "trailing_glitch"]
    assert found[0].evidence.startswith("00 stands before the whole frame 11 03 04")


# --- echo ----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [1, 2, 4])
def test_an_echo_that_ends_in_the_read_behind_it(size):
    lk = [
        ("3E 9C 01 00 DB", "3E 9C 01 07 E2 1E 05 00 68 01 E8 03 77"),
        ("3E 9C 01 00 DB", "3E 9C 01 07 E2 1E 07 00 68 01 38 04 CA"),
    ]
    rows = []
    for asked, answer in [tuple(map(bytes.fromhex, row)) for row in lk]:
        rows += [(">", asked), ("<", asked[:size]), ("<", asked[size:] + answer)]
    found = told(*rows)
    assert [each.cause for each in found] == ["echo"]
    assert found[0].evidence.endswith("; 2 times")


@pytest.mark.parametrize("size", [5, 7])
def test_an_echo_that_the_host_cuts(size):
    rows = [(mark, sent) for _, sent in METER[::2] for mark, sent in ((">", sent), ("<", sent[:size]))]
    assert first(*rows) == "echo"


def test_a_write_that_comes_back_is_its_reply():
    write = modbus("11 06 01 31 00 02")
    assert "echo" not in [each.cause for each in told((">", write), ("<", write), (">", write), ("<", write))]


# --- several senders -----------------------------------------------------------------------------------------------------


def test_a_second_host_with_sound_frames():
    others = [("<", build(NATIVE, "read_speed", 3)), ("<", bytes.fromhex("FB 03 32 00 64 94"))]
    assert first(*NATIVES, *others, *NATIVES, *others) == "two_masters"
    # A listener that is no host receives all requests.
    assert told(*(("<", data) for _, data in [*NATIVES, *others])) == []


def test_a_second_host_over_replies():
    rows = []
    for number, (sent, came) in enumerate(zip(NATIVES[::2], NATIVES[1::2], strict=True)):
        other = build(NATIVE, "read_speed", 3)
        line = both(on_the_line(came[1]), [1] * 14 * STEPS + on_the_line(other))
        rows += [sent, ("<", received(line))] if number % 2 else [sent, came, ("<", other)]
    assert first(*rows, *rows) == "two_masters"


@pytest.mark.parametrize("skew", [6, 14, 181])
def test_two_drives_of_one_address(skew):
    rows = []
    for speed in (100, -200, 301, -4, 77):
        one, other = (bytes.fromhex("FB 01 32") + value.to_bytes(2, "big", signed=True) for value in (speed, 0))
        line = both(on_the_line(one + captures.sum8(one)), [1] * skew + on_the_line(other + captures.sum8(other)))
        rows += [(">", build(NATIVE, "read_speed", 1)), ("<", received(line)), *SPEEDS]
    found = told(*rows)
    assert [each.cause for each in found] == ["duplicate_address"]
    assert "address 1" in found[0].say


def test_the_host_does_not_wait():
    rows = []
    for number, (sent, came) in enumerate(zip(NATIVES[::2], NATIVES[1::2], strict=True)):
        early = NATIVES[(2 * number + 2) % len(NATIVES)]
        line = both(on_the_line(came[1]), [1] * 6 * STEPS + on_the_line(early[1]))
        rows += [sent, early, ("<", received(line)), early, NATIVES[(2 * number + 3) % len(NATIVES)]]
    assert first(*rows) == "collision"


def test_the_driver_stays_on():
    spoiled_start = b"\xc5\x30" + METER[1][1][3:]
    assert first(METER[0], ("<", spoiled_start), *METER[:4], METER[0], ("<", spoiled_start)) == "collision"


@pytest.mark.parametrize("rows", [NATIVES * 6, METER * 6], ids=["native", "meter"])
@pytest.mark.parametrize("marked", [True, False])
def test_spikes_here_and_there(rows, marked):
    chance = random.Random(7)
    found = []
    for mark, data in rows:
        line = on_the_line(data)
        if chance.random() < 0.3:
            at = chance.randrange(len(line) - STEPS)
            line[at : at + STEPS] = [0] * STEPS
        found.append((mark if marked else "", received(line)))
    assert first(*found) == "noise"


@pytest.mark.parametrize("rows", [METER, NATIVES, [*NATIVES, *SPEEDS]])
def test_sound_frames_of_any_device_have_no_cause(rows):
    assert told(*rows, *rows) == []
    assert told(b"".join(data for _, data in rows)) == []


# --- polls whose values change, of each dialect ---------------------------------------------------------------------------


def swept(case, name, seed):
    """Return the first cause of a case of the sweep."""
    spoil = next(spoil for each, _, spoil in troubles.CASES if each == case)
    chance = random.Random(seed)
    causes = troubles.diagnosed(spoil(troubles.traffic(name, chance), chance)).causes
    return causes[0].suspicion.cause if causes else ""


@pytest.mark.parametrize("name", ["mks-rs485", "mks-modbus", "lk-rs485"])
@pytest.mark.parametrize(
    ("case", "cause"),
    [
        ("noise 0.2 host", "noise"),
        ("7E1 reads 8N1 host", "wrong_parity"),
        ("8N1 reads 7E1 host", "wrong_parity"),
        ("8N1 reads 7E1 listener", "wrong_parity"),
        ("3 lost at the start", "lost_start"),
        ("1 read of each reply", "reply_cut"),
        ("two drives at each address", "duplicate_address"),
        ("sound host", ""),
        ("sound listener", ""),
    ],
)
def test_polls_whose_values_change(case, cause, name):
    assert swept(case, name, f"{case} {name}") == cause


@pytest.mark.parametrize(
    ("case", "name", "cause"),
    [
        ("inverted listener", "mks-modbus", "inverted_lines"),
        ("read at 4 of the speed host", "lk-rs485", "wrong_baud"),
        ("read at 1/4 of the speed host", "lk-rs485", "wrong_baud"),
        ("read at 1/2 of the speed listener", "mks-rs485", "wrong_baud"),
    ],
)
def test_a_wrong_line_is_not_taken_for_another(case, name, cause):
    assert swept(case, name, f"{case} {name} 1") == cause


@pytest.mark.parametrize(
    ("marks", "rows", "cause"),
    [
        # A listener at 9600 on a bus of 38400, and a host that reads so: of no frame more than three bytes come.
        ("  ", "E0|00 00 FF|E4|04 D4|E0|00 FF|E4|B4 F5|E4|04 C0|E0|00 90 FF", "wrong_baud"),
        ("><", "FA 07 3A 3B|42|FA 07 33 34|00 C6|FA 07 31 32|00 04|FA 07 33 34|00 F6|FA 07 31 32|00 A4", "wrong_baud"),
        # Devices of other protocols that answer in few bytes.
        ("  ", "E0|00 00 FF|E4|04 D4|E0|31 32|E4|33 34 35|E4|07|E0|55", None),
        ("><", "FA 07 3A 3B|06|FA 07 33 34|15 01|FA 07 31 32|06 80|FA 07 33 34|15 02|FA 07 31 32|06 81", None),
    ],
)
def test_short_reads_at_a_wrong_speed_fit_their_requests_each_time(marks, rows, cause):
    assert first(*(f"{marks[n % 2]} {row}" for n, row in enumerate(rows.split("|")))) == cause


@pytest.mark.parametrize(("own", "cause"), [(117_100_000, "two_masters"), (100_000_000, None)])
def test_two_clocks_whose_requests_meet_are_two_hosts(own, cause):
    """A loop of one host has one clock, however often a drive is silent."""
    status, reply = build(NATIVE, "read_status", 1), bytes.fromhex("FB 01 F1 04 F1")
    asked = [
        (100_000_000 * n, build(NATIVE, "read_position", 1), bytes.fromhex("FB 01 31 00 00 00 00 40 00 6D")) for n in range(30)
    ]
    other = [(33_000_000 + own * n, status, reply) for n in range(25)]
    silent = {at for at, _, _ in asked for near, _, _ in other if abs(at - near) < 8_000_000} or {asked[9][0], asked[20][0]}
    silent |= {near for near, _, _ in other if min(abs(at - near) for at in silent) < 8_000_000}
    items = []
    for at, request, answer in sorted((*asked, *other)):
        items.append(Chunk(at, "serial", request))
        items += [] if at in silent else [Chunk(at + 4_000_000, "serial", answer)]
    causes = [each.suspicion.cause for each in diagnosed(items).causes]
    assert causes[:1] == [cause] if cause else "two_masters" not in causes


@pytest.mark.parametrize("parity", [0, 1])
def test_bytes_that_are_misframed_by_a_parity_are_read_as_zeros(parity):
    sent = [modbus(f"01 04 00 {register}") for register in ("31 00 03", "F1 00 01", "32 00 01")]
    rows = [bytes(byte if byte.bit_count() & 1 == parity else 0 for byte in frame) for frame in sent]
    found = told(*(("<", row) for row in rows * 2))
    assert [(each.cause, each.confidence.value) for each in found] == [("wrong_parity", "certain")]
    assert "wrong_parity" not in [each.cause for each in told(*(("<", row) for row in rows[:1] * 6))]


def test_bytes_of_one_parity_by_chance_are_no_format():
    # A few bytes of one parity, as small numbers have.
    assert "wrong_parity" not in [each.cause for each in told("< FB 01 30 03 05", "< FB 01 30 06 05")]


def test_a_part_of_a_frame_is_no_noise():
    frame = METER[5][1]
    assert "noise" not in [each.cause for each in told(*METER, ("<", frame[: len(frame) - 3]))]


def test_a_reply_that_begins_as_its_request_does_on_an_inverted_line():
    """The request itself has a byte too many. The end of the long reply is lost."""
    came = received(on_the_line(modbus("04 03 20 " + "01 F4 00 07 " * 8)), inverted=True)
    assert told((">", modbus("04 03 00 10 00 10") + b"\0"), ("<", came[:20]))[0].cause == "inverted_lines"
    assert "inverted_lines" not in [each.cause for each in told((">", modbus("04 03 00 10 00 10")), ("<", came[5:20]))]


# --- a recording that knows no pause: all that came is one stretch -----------------------------------------------------


def unbroken(rows, **how):
    """Return what is suspected of a recording without times, directions and pauses: all that came over a line."""
    came = b"".join(received(on_the_line(data), **how) for _, data in rows)
    chunk = Chunk(None, "bus", came, Role.UNKNOWN, False)
    return [each.suspicion.cause for each in diagnosed([chunk]).causes]


LONG = {
    "native": NATIVES * 4,
    "lk": exchanged("lk-rs485@1,baud=38400", *LK_READS) * 8,
    "modbus": exchanged("mks-modbus@4", *(build(MODBUS, name, 4) for name in ("read_speed", "read_pulses"))) * 16,
}


@pytest.mark.parametrize("rows", LONG.values(), ids=LONG.keys())
@pytest.mark.parametrize(
    ("how", "cause"), [({"inverted": True}, "inverted_lines"), ({"ratio": 0.5}, "wrong_baud"), ({"ratio": 1.5}, "wrong_baud")]
)
def test_an_unbroken_recording_of_a_wrong_line(rows, how, cause):
    assert unbroken(rows, **how)[:1] == [cause]


def polled(name):
    """Return one request, asked again and again, with replies whose value changes."""
    request = {"native": build(NATIVE, "read_pulses", 1), "modbus": build(MODBUS, "read_pulses", 1), "lk": LK_READS[0]}[name]
    (reply,) = (data for mark, data in exchanged({"native": "mks-rs485@1", "modbus": "mks-modbus@1", "lk": "lk-rs485@1"}[name],
                request) if mark == "<")  # fmt: skip
    link = SERIAL.best(reply).dialect.link
    bare = reply[: -len(link.checks(reply)[-1].expected)]
    replies = [link.completed(bare[:-2] + bytes((number, 0x20 + 7 * number))) for number in range(10)]
    return [row for each in replies for row in ((">", request), ("<", each))]


@pytest.mark.parametrize("name", ["native", "modbus", "lk"])
@pytest.mark.parametrize(
    ("how", "cause"), [({"inverted": True}, "inverted_lines"), ({"ratio": 0.5}, "wrong_baud"), ({"ratio": 0.768}, "wrong_baud")]
)
def test_one_request_again_and_again(name, how, cause):
    rows = polled(name)
    assert unbroken(rows, **how) == [cause]
    # A burst a line: each of the same bytes counts, and a sum that fits all the same is no frame.
    found = told(*(received(on_the_line(data), **how) for _, data in rows))[0]
    assert found.cause == cause
    assert len(found.troubles) >= len(rows) // 2


@pytest.mark.parametrize("ratio", [1.992, 2.0, 2.008])
def test_an_exchange_of_which_a_slow_receiver_skips_bits(ratio):
    assert unbroken(polled("native"), ratio=ratio) == ["wrong_baud"]


def test_a_receiver_that_samples_on_the_edges_reads_either_bit():
    rows = exchanged("mks-rs485@1", *[build(NATIVE, "read_position", 1), build(NATIVE, "read_speed", 1)] * 12)
    assert unbroken(rows, ratio=2 / 3, shaky=random.Random(21)) == ["wrong_baud"]


@pytest.mark.parametrize("name", LONG)
def test_an_unbroken_recording_of_a_right_line(name):
    assert unbroken(LONG[name]) == unbroken(polled(name)) == []


@pytest.mark.parametrize("sent", [NATIVES[::2], [(">", modbus(f"02 04 00 {n} 00 01")) for n in (30, 32, 0x3A)]])
def test_an_edge_before_each_burst_on_swapped_wires(sent):
    assert first(*(b"\0" + received(on_the_line(data), inverted=True) for _, data in sent * 2)) == "inverted_lines"


def alike(seed):
    """Return bytes whose beginning repeats, as that of frames of another device."""
    chance = random.Random(seed)
    head = chance.randbytes(4)
    return b"".join(head + bytes((number, chance.randrange(4))) + chance.randbytes(3) for number in range(70))


REPEATED = b"\x0f\x40\x03\x1f\xf8\xc0\x07\x3e\x00" * 40
OTHERS = [*(random.Random(seed).randbytes(600) for seed in range(4)), *map(alike, range(4)), REPEATED, bytes(400)]


@pytest.mark.parametrize("data", OTHERS, ids=range(len(OTHERS)))
def test_an_unbroken_recording_of_other_bytes(data):
    found = diagnosed([Chunk(None, "bus", data, Role.UNKNOWN, False)]).causes
    assert not {"wrong_baud", "inverted_lines", "wrong_parity"} & {each.suspicion.cause for each in found}


def test_bytes_before_each_frame_of_an_unbroken_recording():
    assert [each.suspicion.cause for each in diagnosed([joined(NATIVES, b"\0", b"")]).causes] == ["leading_glitch"]
    replies = [(mark, data + b"\0" * (mark == "<")) for mark, data in NATIVES]
    assert [each.suspicion.cause for each in diagnosed([joined(replies, b"", b"")]).causes] == ["trailing_glitch"]


def joined(rows, before, behind):
    return Chunk(None, "bus", b"".join(before + data + behind for _, data in rows), Role.UNKNOWN, False)


def test_short_frames_that_a_receiver_with_a_parity_reads():
    replies = [NATIVE.link.completed(bytes((0xFB, 1, 0x31, 0, 0, 0, 0, 0, n))) for n in (0x3E, 0x12, 0x30, 0x16)]
    request = build(NATIVE, "read_position", 1)
    rows = [received(on_the_line(data), form=Format(8, even=True)) for reply in replies for data in (request, reply)]
    assert len(rows[0]) < len(request)
    assert first(*rows) == "wrong_parity"


def test_an_inverted_reply_behind_an_edge():
    sent, reply = modbus("03 10 00 51 00 01 02 00 09"), modbus("03 10 00 51 00 01")
    came = received(on_the_line(reply), inverted=True)
    assert first((">", sent), ("<", b"\0\xec" + came[1:] + b"\0")) == "inverted_lines"


@pytest.mark.parametrize(("even", "cause"), [(True, "wrong_parity"), (False, "no_reply")])
def test_levels_with_a_parity_that_no_drive_answers(even, cause, tmp_path, capsys):
    bit_s, sent = 1 / 38400 / STEPS, [build(MODBUS, name, 1) for name in ("read_speed", "read_pulses", "read_status")] * 3
    rows, last = ["Time [s],Channel 0", "0.000000000,1"], 1
    for number, data in enumerate(sent):
        for at, level in enumerate([*on_the_line(data, Format(even=even)), 1]):
            rows += [f"{0.05 + 0.5 * number + at * bit_s:.9f},{level}"] if level != last else []
            last = level
    path = tmp_path / "levels.csv"
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    main(["diagnose", "--json", str(path)])
    assert [each["cause"] for each in json.loads(capsys.readouterr().out)["causes"]] == [cause]


@pytest.mark.parametrize("marked", [True, False])
def test_an_analyzer_with_a_parity_on_a_line_without(marked, tmp_path, capsys):
    sent = bytes.fromhex("01 04 00 31 00 03 E1 C4 01 04 06 00 00 00 00 00 00 60 93")
    rows = [f"{0.1 + n / 800 + n // 8 / 50:.6f},0x{b:02X},{'Error' if marked and not b.bit_count() & 1 else ''},\n"
            for n, b in enumerate(sent)]  # fmt: skip
    path = tmp_path / "export.csv"
    path.write_text("Time [s],Value,Parity Error,Framing Error\n" + "".join(rows))
    assert main(["diagnose", str(path), "--json"]) == marked
    found = json.loads(capsys.readouterr().out)
    assert [each["cause"] for each in found["causes"]] == ["wrong_parity"] * marked
