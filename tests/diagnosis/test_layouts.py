"""Causes in the layouts of logs: what a drive and a host do wrong is named the same however it is written down."""

from __future__ import annotations

import pytest

from analyzer import dialects as registry
from analyzer.catalogue import Role
from analyzer.diagnosis.diagnose import of_traffic
from analyzer.link import modbus_crc
from analyzer.records import Chunk
from tests.diagnosis.test_diagnosis import diagnosed as untimed
from tests.diagnosis.test_healthy import verdict
from tests.diagnosis.test_log_forms import log, pairs, shows
from tests.diagnosis.test_pastes import diagnosed

SERIAL = [dialect for dialect in registry.every() if dialect.bus == "serial"]


def native(*body, head=0xFA):
    return bytes((head, *body, (head + sum(body)) & 0xFF))


def reply(*body):
    return native(*body, head=0xFB)


def lk(code, address, *data):
    head = bytes((0x3E, code, address, len(data)))
    return head + bytes((sum(head) & 0xFF,)) + bytes((*data, sum(data) & 0xFF)[: len(data) + bool(data)])


def unit(*body):
    return bytes(body) + modbus_crc(bytes(body)).to_bytes(2, "little")


def exchanges(*rows):
    return [row for sent, came in rows for row in ((">", sent), *(("<", each) for each in came))]


def marked(data):
    """Return bytes as an encoding of text leaves them that has none from 80 on."""
    return data.translate(bytes((*range(128), *b"?" * 128)))


POSITION, SPEED, STATUS = native(4, 0x31), native(4, 0x32), native(4, 0xF1)
POSITIONS = [reply(4, 0x31, 0, 0, 0, 0, n, 7 * n) for n in range(1, 9)]
OTHERS = [reply(4, 0x31, 0, 0, 0, 9, n, 5) for n in range(1, 9)]
STATES = [lk(0x92, 6, n, 3, 0, 0, 0, 0, 0, 0) for n in range(1, 9)]
READ = unit(7, 4, 0, 0x31, 0, 3)
VALUES = [unit(7, 4, 6, 0, 0, 0, 0, n, 9) for n in range(1, 9)]
#: Rows of a log, and what is wrong.
STORIES = {
    "clean": (exchanges(*((POSITION, [came]) for came in POSITIONS), (STATUS, [reply(4, 0xF1, 1)])), None),
    "clean lk": (exchanges(*((lk(0x92, 6), [came]) for came in STATES)), None),
    "two whole replies": (
        exchanges(
            *((POSITION, pair) for pair in zip(POSITIONS[:4], OTHERS[:4], strict=True)),
            (native(5, 0x31), [reply(5, 0x31, *[0] * 5, 9)]),
        ),
        "duplicate_address",
    ),
    "two whole replies of a unit": (
        exchanges(*((READ, pair) for pair in zip(VALUES[:3], VALUES[5:], strict=True))),
        "duplicate_address",
    ),
    "two whole replies lk": (
        exchanges(*((lk(0x92, 6), pair) for pair in zip(STATES[:3], STATES[5:], strict=True))),
        "duplicate_address",
    ),
    "one of three": (
        exchanges(
            *(row for came in POSITIONS[:3] for row in ((POSITION, []), (SPEED, []), (STATUS, [came]))),
            (SPEED, [reply(4, 0x32, 0, 9)]),
        ),
        "too_fast",
    ),
    "a second host": (
        exchanges(*((lk(0x92, 6), [came, lk(0x9A, 2), lk(0x9A, 2, 30, 0xC4, 9, 0, 0, 0, 0)]) for came in STATES[:3])),
        "two_masters",
    ),
    "an echo without its start": (exchanges(*((POSITION, [POSITION[1:] + came]) for came in POSITIONS[:3])), "echo"),
    "a write of several that comes back": (
        exchanges(*((write, [write]) for write in (unit(7, 0x10, 0, 0xF6, 0, 2, 4, 0, 9, 1, 44), unit(7, 6, 0, 0xF3, 0, 1)))),
        "echo",
    ),
    "a byte of the fields is missing": (
        exchanges(*((native(4, 0xFD, 0, speed, 0, 0, 0x19, speed), []) for speed in (70, 120, 200))),
        "wrong_length",
    ),
    "question marks": (exchanges(*((marked(f), []) for f in (POSITION, STATUS, native(4, 0xF3, 1)))), "text_mode"),
    "frames of can": (
        exchanges(*((bytes((4, *body, (4 + sum(body)) & 0xFF)), []) for body in ((0x31,), (0xF3, 1), (0xF6, 1, 44, 5)))),
        "wrong_dialect",
    ),
}
STORIES |= {
    "fragments of a unit": (exchanges(*((f, [f[:3]]) for f in (READ, unit(7, 4, 0, 0xF1, 0, 1)))), "wrong_dialect"),
    "question marks in replies": (exchanges(*((READ, [marked(came)]) for came in VALUES)), "text_mode"),
    "question marks in replies lk": (
        exchanges(*((lk(0x9C, 6), [marked(lk(0x9C, 6, 30, n, 2, 0, 3, 0x90, 1))]) for n in (1, 2, 3, 4))),
        "text_mode",
    ),
    "another dialect, once": (exchanges((READ, []), (native(7, 0x31), [reply(7, 0x31, 0, 0, 0, 0, 0, 9)])), "wrong_dialect"),
    "another address, once": (exchanges((native(9, 0x31), []), (POSITION, POSITIONS[:1])), "wrong_address"),
    "a code that is not listed": (
        exchanges((lk(0x71, 6), []), (lk(0x92, 6), STATES[:1]), (lk(0x71, 6), [])),
        "unknown_command",
    ),
}
#: Layouts that show who sent; of the others, which show it too, the forms of a library stand in for its kin.
CHOSEN = (
    "docklight", "modbus-poll", "csv", "json", "python", "lists", "arduino", "strace", "digits", "sentences", "table", "braces",
    "blocks", "socat", "buffers",
)  # fmt: skip


@pytest.mark.parametrize("story", STORIES)
@pytest.mark.parametrize("form", CHOSEN)
def test_a_cause_in_a_layout(form, story):
    rows, cause = STORIES[story]
    shows(log(form, rows, at_once=8), cause)


def causes(text):
    return [each.suspicion.cause for each in diagnosed(text).causes]


# --- layouts that tell less ----------------------------------------------------------------------------------------------


def test_a_console_prints_below_a_call_what_it_returns():
    move = native(4, 0xFD, 1, 44, 5, 0, 0, 25, 0)
    sent = exchanges(*((POSITION, [POSITION + came]) for came in POSITIONS[:2]), (move, [move + reply(4, 0xFD, 1)]))
    text = "".join(f">>> port.write({d!r})\n{len(d)}\n" if mark == ">" else f">>> port.read(64)\n{d!r}\n" for mark, d in sent)
    assert causes(text) == ["echo"]
    assert diagnosed(text.replace(repr(move), "X").replace("X + ", "")).verdict == "trouble"


@pytest.mark.parametrize("label", ["Serial2.write: {}", "port.write = {}", "to the motor: {}", "drv> cmd: {}"])
def test_bytes_without_their_zeros_behind_any_word(label):
    frames = (native(4, 0x31), native(4, 0xF3, 1), native(4, 0xF6, 1, 44, 5))
    text = "".join(
        f"10:00:0{n}.000 -> {label.format(' '.join(f'{b:X}' for b in f[1:-1] and (*f[:-1], sum(f[1:-1]) & 0xFF)))}\n"
        for n, f in enumerate(frames)
    )
    assert causes(text) == ["wrong_checksum_rule"]


def test_numbers_behind_a_word_are_no_bytes():
    assert diagnosed("count: 1 2 3 4\nsizes = [0x10, 0x20]\nsteps: 5 6 7 8\n").verdict == "unknown"


@pytest.mark.parametrize("bus", ["bus: {}", "sniff: [{}]", "wire {{{}}}"])
def test_what_is_short_behind_a_word_that_stood_before_frames(bus):
    rows = [(">", READ)] + [row for came in VALUES[:4] for row in (("<", came[:4]), (">", READ))]
    shape = (lambda d: pairs(d)) if "[" not in bus and "{{" not in bus else lambda d: ", ".join(f"0x{b:02x}" for b in d)
    text = "".join(f"10:00:0{n}.100 {bus.format(shape(data))}\n" for n, (_, data) in enumerate(rows))
    assert causes(text)[:1] == ["reply_cut"]


def test_a_dump_below_its_mark():
    rows = exchanges(*((SPEED, [SPEED + reply(4, 0x32, 0, n)]) for n in (60, 61)))
    text = "".join(f"{'Sent' if mark == '>' else 'Received'}\n  0000  {pairs(data)}\n" for mark, data in rows)
    assert causes(text) == ["echo"]


@pytest.mark.parametrize(
    ("frames", "cause"),
    [
        ([unit(4, 4, 0, n, 0, 1)[:-2] for n in (0x32, 0x3A, 0xF1)], "missing_checksum"),
        (
            [f[:-2] + f[:-3:-1] for f in (unit(4, 4, 0, 0x32, 0, 1), unit(4, 6, 0, 0xF3, 0, 1), unit(4, 4, 0, 0xF1, 0, 1))],
            "crc_swapped",
        ),
        (
            [f[:-1] + bytes(((f[-1] - 0xFA) & 0xFF,)) for f in (POSITION, SPEED, native(4, 0xF6, 1, 44, 5))],
            "wrong_checksum_rule",
        ),
        ([lk(0xA2, 6, n, 3, 1, 0)[:-1] for n in (7, 70, 99)], "missing_checksum"),
        # Two may be alike by chance. Only frames of a catalogue tell where to cut.
        ([b"\x55\x21\x07\x60\x13", b"\x55\x21\x08\x61\x14", b"\x55\x21\x09\x62\x15"], None),
    ],
)
def test_frames_in_a_recording_that_knows_no_pause(frames, cause):
    found = of_traffic([Chunk(None, "bus", b"".join(frames), Role.UNKNOWN, False)], SERIAL).causes
    assert [each.suspicion.cause for each in found] == ([cause] if cause else [])


WRONG = [bytes((*frame[:-1], -sum(frame[:-1]) & 0xFF)) for frame in (POSITION, native(4, 0xF3, 1))]


@pytest.mark.parametrize(
    ("frames", "cause"),
    [
        (WRONG, "wrong_checksum_rule"),
        ([native(4, 0xF6, 1, 44, 5)[:-1] + b"\x21"], "wrong_checksum"),
        # The program puts the check in its place, or behind the bytes.
        ([native(4, 0xF6, 1, 44, 5)[:-1] + b"\0", POSITION[:-1]], None),
        ([POSITION, native(4, 0xF3, 1)], None),
    ],
)
def test_the_checks_of_arrays_of_a_program(frames, cause, causes_of):
    text = "".join(f"uint8_t step{n}[] = {{{', '.join(f'0x{b:02X}' for b in f)}}};\n" for n, f in enumerate(frames))
    assert causes_of(text) == ([cause] if cause else [])


def test_a_second_reply_to_a_setting_on_can():
    assert causes(can(*["003#820489", "003#820186", "003#820186"] * 3, step_ns=1_000_000))[:1] == ["firmware_quirk"]


def test_one_request_of_modbus_tcp_without_a_letter():
    assert causes("00 07 00 00 00 06 01 04 00 33 00 02\n") == ["tcp_framing"]


@pytest.mark.parametrize(
    ("frames", "cause"),
    [
        ([POSITION, POSITION, POSITIONS[0], SPEED, SPEED, reply(4, 0x32, 0, 9), STATUS, STATUS, reply(4, 0xF1, 1)], "echo"),
        # One request again and again may be a repetition each time.
        ([frame for came in POSITIONS[:3] for frame in (POSITION, POSITION, came)], "no_reply"),
        # One that is answered at once was not sent twice.
        ([POSITION, POSITION, POSITIONS[0], SPEED, reply(4, 0x32, 0, 9), STATUS, STATUS, reply(4, 0xF1, 1)], "no_reply"),
    ],
)
def test_requests_that_all_stand_twice_before_their_replies(frames, cause):
    found = untimed([Chunk(None, "bus", frame, Role.UNKNOWN, True) for frame in frames]).causes
    assert [each.suspicion.cause for each in found] == [cause]


# --- what is not accused -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "rows",
    [
        # One drive says the same twice; a late reply comes beside that of the request that was sent again.
        exchanges(*((POSITION, [came, came]) for came in POSITIONS[:3])),
        exchanges((POSITION, []), (POSITION, POSITIONS[:2])),
        # A drive that reports by itself.
        exchanges((POSITION, POSITIONS[:5])),
    ],
)
def test_a_second_reply_alone_is_no_second_drive(rows):
    text = "".join(f"10:00:0{n}.000 {mark} {pairs(data)}\n" for n, (mark, data) in enumerate(rows))
    assert "duplicate_address" not in causes(text)


def test_a_document_shows_a_frame_of_each_dialect(tmp_path, capsys):
    text = (
        f"To read the position send `{pairs(POSITION)}`; the drive answers `{pairs(POSITIONS[0])}`.\n"
        f"To read its speed, `{pairs(SPEED)}`, which gives `{pairs(reply(4, 0x32, 0, 60))}`.\n"
        f"In Modbus: `{pairs(unit(4, 4, 0, 0x31, 0, 3))}`."
    )
    assert verdict(text, tmp_path, capsys)[1] == []


def test_a_device_that_answers_frames_with_the_sum_of_can_is_another_one():
    asked = [bytes((4, *body, (4 + sum(body)) & 0xFF)) for body in ((0x31,), (0x32,), (0xF1,))]
    rows = exchanges(*((sent, [bytes((0x84, sent[1], 1, 9, sent[1] ^ 9))]) for sent in asked))
    assert "wrong_dialect" not in causes("".join(f"{mark} {pairs(data)}\n" for mark, data in rows))


def test_several_requests_whose_replies_all_come_later_are_not_certainly_late():
    came = (POSITIONS[0], reply(4, 0x32, 0, 60), reply(4, 0xF1, 1))
    rows = exchanges(*(row for _ in range(4) for row in ((POSITION, []), (SPEED, []), (STATUS, came))))
    found = diagnosed("".join(f"{mark} {pairs(data)}\n" for mark, data in rows))
    assert {each.suspicion.confidence for each in found.causes} <= {"possible"}


# --- can -----------------------------------------------------------------------------------------------------------------


def can(*rows, step_ns=100_000_000):
    return "".join(f"({1_700_000_000 + n * step_ns / 1e9:.6f}) can0 {row}\n" for n, row in enumerate(rows))


ASKED = ["005#3136", "005#3237", "005#F1F6"]
OTHER_DRIVE = ["006#3137", "006#3100000000000138"]
CAME = ["005#3100000000020038", "005#32004077", "005#F101F7"]


@pytest.mark.parametrize(
    ("text", "found"),
    [
        (can(*[row for n in range(4) for row in (ASKED[n % 3], *([CAME[(n - 1) % 3]] if n else []))]), "late_reply"),
        (can(*[*ASKED, CAME[0], ASKED[1], CAME[1]] * 3, step_ns=1_000_000), "too_fast"),
        # Several at once are answered all.
        (can(*[*ASKED, *CAME] * 3, step_ns=1_000_000), None),
        (can(*[ASKED[0], CAME[0], "005#3100000000040A44", *OTHER_DRIVE] * 3, step_ns=1_000_000), "duplicate_address"),
        (can("005#05F301F9", "005#05F6012C052D"), "wrong_length"),
    ],
)  # fmt: skip
def test_causes_on_can(text, found):
    assert causes(text)[:1] == ([found] if found else [])
