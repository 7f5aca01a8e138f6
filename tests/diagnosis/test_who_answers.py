"""Who may answer at all: groups, identifiers of 29 bits, numbers that are read wrongly, and two drives at once."""

from __future__ import annotations

import pytest

from tests.diagnosis.test_healthy import verdict
from tests.diagnosis.test_layouts import native as frame
from tests.diagnosis.test_layouts import reply
from tests.diagnosis.test_pastes import checked, diagnosed


def native(text):
    """Return a frame of the native dialect with its sum."""
    data = bytes.fromhex(text)
    return (data + bytes((sum(data) & 0xFF,))).hex(" ").upper()


GROUPED = f"> {native('FA 03 8D 60')}\n< {native('FB 03 8D 01')}\n"
MOTION, READ = native("FA 60 F6 00 50 05"), native("FA 60 31")
ANSWERED = f"> {native('FA 03 F1')}\n< {native('FB 03 F1 01')}\n"


@pytest.mark.parametrize(
    "text",
    [
        GROUPED + f"> {MOTION}\nno answer, retry\n" * 3,
        GROUPED + f"> {MOTION}\ntimeout\n" * 2 + ANSWERED,
        # A read is sent in vain, with words or without.
        GROUPED + f"> {READ}\n" * 3,
        GROUPED + f"> {READ}\n" + ANSWERED,
        # The group was given its address before.
        f"> {MOTION}\ntimed out\n" * 3 + ANSWERED,
        # Each command once, and each time words for nothing.
        GROUPED + "".join(f"tx {native(f'FA 60 F6 00 {n} 05')} rx nothing!\n" for n in (10, 20)) + ANSWERED,
        # So for all.
        ANSWERED + f"> {native('FA 00 F6 00 50 05')}\nno response\n" * 3,
    ],
)
def test_a_host_that_waits_for_a_group(text, causes_of):
    assert causes_of(text) == ["broadcast_no_reply"]


@pytest.mark.parametrize(
    "text",
    [
        # A group is moved again, as it should be.
        GROUPED + f"> {MOTION}\n" * 3,
        GROUPED + f"> {MOTION}\nto the group, no reply expected\n" * 3 + ANSWERED,
        # Each motion is another one, and a text tells of somebody else's timeout.
        GROUPED + f"> {MOTION}\n> {native('FA 60 F6 00 60 05')}\nSerial timeout: 50 ms\n" + ANSWERED,
        "Serial timeout: 50 ms, timeout=0.05\n" + f"> {MOTION}\n" * 3 + ANSWERED,
        # The number of the group is a drive of its own.
        GROUPED + f"> {READ}\n< {native('FB 60 31 00 00 00 00 12 34')}\n" * 2,
    ],
)
def test_a_group_that_is_moved_is_well(text, causes_of):
    assert causes_of(text) == []


STANDARD = "can0  003   [2]  F1 F4\ncan0  003   [3]  F1 01 F5\n"


@pytest.mark.parametrize(
    ("text", "causes"),
    [
        ("can0  00000003   [2]  31 34\ncan0  00000003   [2]  F1 F4\n" + STANDARD, ["can_extended_id"]),
        ("t0032F1F4\nt0033F101F5\nT0000000323134\nT000000032F1F4\n", ["can_extended_id"]),
        # Identifiers of another protocol, sums that do not fit, and one frame by chance.
        ("can0  18FEF103   [2]  31 34\ncan0  18FEF103   [2]  F1 F4\n" + STANDARD, []),
        ("can0  00000003   [2]  31 35\ncan0  00000003   [2]  F1 F5\n" + STANDARD, []),
        ("can0  00000003   [2]  31 34\n" + STANDARD, []),
        ("can0  00000003   [2]  31 34\ncan0  00000003   [2]  F1 F4\ncan0  00000004   [3]  01 02 03\n" + STANDARD, []),
    ],
)
def test_identifiers_of_29_bits_beside_those_of_a_drive(text, causes, causes_of):
    assert causes_of(text) == causes


@pytest.mark.parametrize(("asked", "cause"), [("020", "can_wrong_id"), ("021", "wrong_address")])
def test_digits_that_are_read_as_hexadecimal(asked, cause, causes_of):
    """Drive 20 is 014, and not 020."""
    sums = f"{(int(asked, 16) + 0x31) & 0xFF:02X}"
    rows = [(asked, f"31{sums}")] * 3 + [("014", "F105"), ("014", "F10106")]
    text = "".join(f"({number}.500000) can0 {who}#{data}\n" for number, (who, data) in enumerate(rows))
    assert causes_of(text) == [cause]


def reports(damaged, *, ends=False):
    """Return motions of drive 4 while drive 2 is read: `damaged` replies of each, and the end of the motion or none."""
    text, ms = "", 0
    for _ in range(4):
        rows = [("TX", native("FA 04 FD 00 50 05 00 00 10 00")), ("RX", native("FB 04 FD 01"))]
        for number in range(6):
            came = bytes.fromhex(native(f"FB 02 31 00 00 00 00 {number:02X} 40"))
            if number in damaged:
                came = came[:3] + b"\x10" + came[5:]
            rows += [("TX", native("FA 02 31")), ("RX", came.hex(" ").upper())]
        rows += [("RX", native("FB 04 FD 02"))] if ends else []
        for mark, data in rows:
            ms += 10
            text += f"{ms / 1000:.3f} {mark} {data}\n"
    return text


def test_a_report_that_meets_a_reply(causes_of):
    assert causes_of(reports({3}))[0] == "collision"
    assert "collision" not in causes_of(reports({3}, ends=True))
    assert "collision" not in causes_of(reports({1, 3}))
    assert "collision" not in causes_of(reports(set()))
    # One more is damaged by something else.
    lines = reports({3}).splitlines(keepends=True)
    at = max(n for n, line in enumerate(lines) if "RX FB 02" in line)
    assert causes_of("".join((*lines[:at], lines[at].replace("02 31", "02 11"), *lines[at + 1 :])))[0] == "collision"


@pytest.mark.parametrize(("address", "cause"), [(2, "collision"), (1, "duplicate_address")])
def test_a_request_onto_a_reply_brings_a_reply_that_none_asked_for(address, cause, causes_of):
    log = ""
    for n in range(6):
        spoiled = native(f"FB 01 31 00 00 00 00 10 {n:02X}").replace("FB 01 31", "FA 01 30")
        rows = [native("FA 01 31"), spoiled, native("FA 03 F1"), native("FB 03 F1 01")]
        rows[2:2] = [native("FB 02 31 00 00 00 00 02 00")] if address == 2 else []
        log += "".join(f"{n + at / 100:.3f}  {data}\n" for at, data in enumerate(rows))
    assert causes_of(log)[0] == cause


@pytest.mark.parametrize(("lost", "cause"), [(True, ["collision"]), (False, [])])
def test_a_report_that_meets_the_request(lost, cause, causes_of):
    """The drive ends its motion while it is asked: it hears nothing, and the host reads both at once."""
    log = ""
    for n in range(4):
        rows = [("TX", native(f"FA 07 FD 00 80 02 00 00 50 {n:02X}")), ("RX", native("FB 07 FD 01"))]
        rows += [("TX", native("FA 07 32")), ("RX", f"7B 06 {0x30 + n:02X} 82")] if lost else [("RX", native("FB 07 FD 02"))]
        rows += [("TX", native("FA 07 32")), ("RX", native(f"FB 07 32 00 {n:02X}"))]
        log += "".join(f"{n + at / 10:.2f} {mark} {data}\n" for at, (mark, data) in enumerate(rows))
    assert causes_of(log) == cause


def ends(came, rounds=3, reads=False):
    """Return motions of drives 5 and 8, with what comes at their end, and one round in which both ends come.

    `reads`: the host reads the speed while they run.
    """
    log = ""
    good = [native("FB 05 FE 02"), native("FB 08 FE 02")]
    for n, tail in enumerate([*rounds * [[came]], good]):
        rows = [row for who in ("05", "08") for row in (
            ("TX", native(f"FA {who} FE 00 78 05 00 00 20 {n:02X}")), ("RX", native(f"FB {who} FE 01")))]  # fmt: skip
        rows += [("TX", native("FA 05 32")), ("RX", native(f"FB 05 32 00 {n:02X}"))] if reads else []
        rows += [("RX", frame) for frame in tail]
        log += "".join(f"{3 * n + at / 10:.2f} {mark} {data}\n" for at, (mark, data) in enumerate(rows))
    return log


@pytest.mark.parametrize(
    ("came", "collides"),
    [
        # Each bit is that of FB 05 FE 02 00 and of FB 08 FE 02 03.
        ("FB 00 FE 02 00", True),
        # The second begins while the first is on the line.
        ("FB 05 F2 82 02 03", True),
        # Bits that neither has, and an end of one alone.
        ("FB 00 FE 12 00", False),
        ("FB 05 FE 02 01", False),
    ],
)
def test_two_reports_that_meet(came, collides, causes_of):
    assert ("collision" in causes_of(ends(came))) is collides
    assert ("collision" in causes_of(ends(came, reads=True))) is collides


def test_what_begins_as_one_report_and_ends_as_another_once_is_no_collision(causes_of):
    assert "collision" not in causes_of(ends("FB 05 F2 82 02 03", rounds=1))


def answers(*codes):
    """Return reads of drive 9's encoder by 31, each answered by another read's code, and reads of its speed that are right."""
    log = ""
    for n, code in enumerate(codes):
        rows = [("TX", native("FA 09 31")), ("RX", native(f"FB 09 {code} 00 00 00 00 {n:02X} 40"))]
        rows += [("TX", native("FA 09 32")), ("RX", native(f"FB 09 32 00 {n:02X}"))]
        log += "".join(f"{n + at / 10:.2f} {mark} {data}\n" for at, (mark, data) in enumerate(rows))
    return log


@pytest.mark.parametrize(
    ("codes", "causes"),
    [(("32", "32", "32"), ["firmware_quirk"]), (("3E", "3E"), ["firmware_quirk"]), (("31", "31", "31"), [])],
)
def test_a_drive_that_answers_under_the_code_of_another_command(codes, causes, causes_of):
    assert causes_of(answers(*codes)) == causes


def test_one_reply_under_another_code_is_no_habit(causes_of):
    assert "firmware_quirk" not in causes_of(answers("31", "32", "31", "32"))


def bytewise(frame, ms, answer):
    """Return a log of three requests, of which each byte is written alone."""
    log = ""
    for n in range(3):
        log += "".join(f"{n + at * ms / 1000:.4f} TX {pair}\n" for at, pair in enumerate(frame.split()))
        log += f"{n + 0.6:.4f} {answer}\n"
    return log


@pytest.mark.parametrize("frame", [checked("04 06 00 F3 00 01"), native("FA 03 F3 00"), "3E A1 02 02 E3 64 00 64"])
def test_a_request_that_is_written_byte_by_byte(frame, causes_of):
    assert causes_of(bytewise(frame, 15, "timeout"))[0] == "split_frame"


def test_bytes_that_are_shown_one_by_one_and_answered(causes_of):
    frame, reply = native("FA 03 F3 00"), native("FB 03 F3 01")
    assert causes_of(bytewise(frame, 15, f"RX {reply}")) == []


def test_one_frame_of_another_protocol_that_is_sent_in_vain(causes_of):
    sent = "".join(f"[10:00:0{n}][D][uart_debug:114]: >>> A5:C9:02:00:00:3C:11\n[10:00:0{n}] {{}}\n" for n in range(4))
    assert causes_of(sent.format(*["No Response"] * 4)) == ["no_reply"]
    assert causes_of(sent.format(*["ok"] * 4)) == []


def test_one_frame_too_long_among_those_of_a_document(causes_of):
    document = "".join(
        f"| `{frame}` | an example |\n"
        for frame in (
            native("FA 02 30"),
            native("FB 02 30 00 00 00 01 20 40"),
            native("FA 02 F6 00 50 05"),
            native("FA 02 F3 01"),
        )
    )
    longer, right = native("FA 02 FD 00 50 05 00 00 00 10 00"), native("FA 02 FD 00 50 05 00 00 10 00")
    assert causes_of(f"Frames of the manual.\n{document}| `{longer}` | a move |\n") == ["wrong_length"]
    assert causes_of(f"Frames of the manual.\n{document}| `{right}` | a move |\n") == []


def test_one_wrong_count_among_damaged_replies_is_damage(causes_of):
    """Two units of one address spoil all that they send; one of the replies looks as if it had a count."""
    asked, good = checked("05 04 00 20 00 02"), checked("05 04 04 00 00 10 00")
    doubled = checked("06 04 00 20 00 02")
    rows = "".join(
        f">> {asked}\n<< {good}\n>> {doubled}\n<< {came}\n"
        for came in ("00 00 07 FE", "00 40 FD 11", "06 04 18 89 B1 E4", "00 00 10 05", "00 07 03 FC")
    )
    assert causes_of(rows) == ["duplicate_address"]


def test_a_wrong_sum_in_a_document_is_no_noise(causes_of):
    rows = (
        "TX: FA 01 F3 01 EF\nRX: FB 01 F3 01 F0\nTX: FA 01 F6 00 64 05 5A\nRX: FB 01 F6 01 F9\n"
        "TX: FA 01 30 2B\nRX: FB 01 30 00 00 00 00 20 00 4C\n"
    )
    assert causes_of("## Examples of commands\n" + rows) == []
    assert causes_of("Why does it fail?\n" + rows) == ["noise"]


@pytest.mark.parametrize(("again", "sure"), [(1, "possible"), (0, "certain")])
def test_two_drives_are_not_certain_where_the_same_request_is_answered_well_as_often(again, sure):
    log = "".join(
        f"TX: {native('FA 03 F3 01')}\nRX: {native('FB 03 F3 01')}\n"
        f"TX: {native('FA 04 32')}\nRX: FB 04 22 {n:02X} {0x31 + n:02X}\n"
        + f"TX: {native('FA 04 32')}\nRX: {native(f'FB 04 32 00 {n:02X}')}\n"
        * again
        for n in range(1, 7)
    )
    causes = {each.suspicion.cause: each.suspicion.confidence.value for each in diagnosed(log).causes}
    assert causes["duplicate_address"] == sure


def test_noise_on_requests_that_are_mostly_right(causes_of):
    """The bits that came changed stand in another byte each time; a listener shows who sent."""
    rows = [f"host -> drive: {native('FA 04 32')}\ndrive -> host: {native(f'FB 04 32 00 {n:02X}')}\n" for n in range(12)]
    damaged = ["FA 06 32 30", "DA 04 32 30", "FA 04 72 30", "FA 04 32 B0"]
    log = "".join(row + (f"host -> drive: {damaged[n // 3]}\n" if n % 3 == 1 else "") for n, row in enumerate(rows))
    assert causes_of(log)[0] == "noise"
    stale = "".join(f"host -> drive: FA 04 F6 00 {n:02X} 02 96\n" for n in (0x20, 0x50, 0x80)) + rows[0]
    assert causes_of(stale)[0] == "wrong_checksum"


def test_replies_of_one_command_have_the_sum_without_their_head(causes_of):
    def without(text):
        data = bytes.fromhex(text)
        return (data + bytes((sum(data[1:]) & 0xFF,))).hex(" ").upper()

    log = "".join(
        f"TX: {native('FA 03 32')}\nRX: {native(f'FB 03 32 00 {n:02X}')}\n"
        f"TX: {native('FA 03 33')}\nRX: {without(f'FB 03 33 00 00 0{n} 40')}\n"
        for n in range(4)
    )
    assert causes_of(log) == ["firmware_quirk"]


@pytest.mark.parametrize(
    ("sent", "cause"),
    [
        # 1200, 2400 and 900 mA, of which one is out of range and none is a round number the other way round.
        (("12 00", "24 00", "09 00"), "decimal_as_hex"),
        # 20 and 40 mA may be meant; and what is sent low byte first.
        (("14 00", "28 00"), "wrong_byte_order"),
        (("24 00", "28 00", "30 00"), "decimal_as_hex"),
        (("B0 04", "60 09", "84 03"), "wrong_byte_order"),
    ],
)
def test_decimal_digits_that_are_sent_as_hexadecimal(sent, cause, causes_of):
    log = "".join(f"TX {native(f'FA 02 83 {value}')}\nRX {native('FB 02 83 00')}\n" for value in sent)
    assert causes_of(log) == [cause]


def test_a_device_refuses_values_whose_bytes_are_swapped(causes_of):
    """Its exception says that the value is not allowed; why it is not, the bytes tell."""
    log = "".join(f"TX {checked(f'02 06 00 83 {sent}')}\nRX {checked('02 86 03')}\n" for sent in ("B0 04", "60 09", "84 03"))
    assert causes_of(log)[0] == "wrong_byte_order"


def test_a_group_that_never_confirms(causes_of):
    moved = f"> {MOTION}\n> {native('FA 03 F1')}\n< {native('FB 03 F1 04')}\n" * 2
    assert causes_of(f"The group is set, and the drives never confirm its commands:\n{GROUPED}{moved}") == [
        "broadcast_no_reply"
    ]
    assert causes_of(f"The group is set, and the drives run:\n{GROUPED}{moved}") == []


@pytest.mark.parametrize(
    ("sent", "found"),
    [
        ([MOTION], "ok"),
        ([MOTION, native("FA 60 F6 00 60 05")], "ok"),
        ([MOTION, MOTION], "unknown"),
        ([MOTION, READ], "trouble"),
    ],
)
def test_an_address_that_is_moved_alone_may_be_a_group(sent, found, tmp_path, capsys):
    answered = [(">", native("FA 03 31")), ("<", native("FB 03 31 00 00 00 00 40 00"))] * 3
    rows = [*((">", frame) for frame in sent), *answered]
    text = "".join(f"[10:21:0{n}.000][D][uart_debug:114]: {mark * 3} {frame}\n" for n, (mark, frame) in enumerate(rows))
    assert verdict(text, tmp_path, capsys)[0] == found


@pytest.mark.parametrize("spoiled", ["no value", "a reply that is the same each time"])
def test_two_drives_are_read_as_one_where_they_say_the_same(spoiled, causes_of):
    rows = []
    for n in range(8):
        # The bits that are high in both replies.
        one, other = (reply(2, 0x30, 0, 0, 0, position + n, 2, 0x10) for position in (0x51, 0x33))
        state = reply(2, 0xF1, 1)
        state = state[:-1] + b"\x01" if spoiled.startswith("a reply") and n in (2, 5) else state
        both = bytes(a & b for a, b in zip(one, other, strict=True))
        rows += [(frame(2, 0x30), both), (frame(2, 0xF1), state), (frame(2, 0x32), reply(2, 0x32, 0, 0))]
    log = "".join(f"TX: {sent.hex(' ')}\nRX: {came.hex(' ')}\n" for sent, came in rows)
    assert causes_of(log)[:1] == (["duplicate_address"] if spoiled == "no value" else ["noise"])


def test_noise_does_not_resemble_itself():
    asked, good, bad = "FA 02 30 2C", "FB 02 30 00 00 00 01 20 00 4E", "FB 02 30 00 00 00 01 20 00 0E"
    log = "".join(f"TX: {asked}\nRX: {came}\nTX: FA 02 32 2E\nRX: FB 02 32 00 00 2F\n" for came in (good, bad, good, bad, bad))
    found = diagnosed(log).causes[0].suspicion
    assert found.cause == "noise"
    assert f"{bad} at byte" in found.evidence
    assert f"resembles {bad}" not in found.evidence


def test_requests_of_a_row_whose_first_reply_comes_behind_it(causes_of):
    asked = [frame(2, code) for code in (0x31, 0x32, 0x39, 0xF1)]
    log = "".join(
        "".join(f"[{12000 + 20 * n + at}.000] >> {each.hex(' ')}\n" for at, each in enumerate(asked))
        + f"[{12005 + 20 * n}.200] << {reply(2, 0x31, 0, 0, 0, 0, n, 7).hex(' ')}\n"
        + f"[{12007 + 20 * n}.800] << {reply(2, 0xF1, 4).hex(' ')}\n" * (n % 3 == 1)
        for n in range(6)
    )
    assert causes_of(log) == ["too_fast"]


def test_reads_of_one_size_that_no_reply_has(causes_of):
    code = {0x9A: "3E 9A 01 07 E0 1E 60 09 04 00 00 00 8B", 0x9C: "3E 9C 01 07 E2 1E 00 00 00 00 00 00 1E"}
    asked = {0x9A: "3E 9A 01 00 D9", 0x9C: "3E 9C 01 00 DB"}
    order = [0x9A, 0x9C, 0x9A, 0x9C, 0x9A]
    stream = bytes.fromhex("".join(code[each] for each in order))
    log = "".join(f"tx {asked[each]}\nrx {stream[8 * n : 8 * n + 8].hex(' ')}\n" for n, each in enumerate(order))
    assert causes_of(log)[:2] == ["read_misaligned", "reply_cut"]


@pytest.mark.parametrize(("gap_ms", "cause"), [(24, "too_fast"), (400, "no_reply")])
def test_settings_that_come_while_the_drive_stores_one(gap_ms, cause, causes_of):
    answered = [((0x31,), (0x31, 0, 0, 0, 0, 0, 0)), ((0x82, 5), (0x82, 1))]
    silent = [((code, *value), None) for code, *value in ((0x83, 3, 32), (0x84, 32), (0x88, 1), (0x9B, 4), (0x8F, 1))]
    log, at = "", 0
    for asked, came in (*answered, *silent, answered[0]):
        at += 400 if came is not None and asked[0] == 0x31 else 100 if came is not None else gap_ms
        log += f"10:02:{at // 1000:02}.{at % 1000:03} > {frame(2, *asked).hex(' ')}\n"
        at += 4
        log += f"10:02:{at // 1000:02}.{at % 1000:03} < {reply(2, *came).hex(' ')}\n" if came is not None else ""
    assert causes_of(log)[:1] == [cause]


@pytest.mark.parametrize(("late_ms", "cause"), [(20, "collision"), (4, "duplicate_address")])
def test_a_clock_that_sends_onto_late_replies(late_ms, cause, causes_of):
    log = "time_s,bytes\n"
    for n in range(8):
        spoiled = n % 2
        came = bytes.fromhex(f"FB 01 30 00 00 00 00 14 {n:02X} 66") if spoiled else reply(1, 0x31, 0, 0, 0, 0, 0x14, n)
        rows = [(0, frame(1, 0x31)), (late_ms if spoiled else 4, came)]
        # What meets the reply is not read as a request.
        rows += [] if spoiled else [(20, frame(2, 0x31)), (24, reply(2, 0x31, 0, 0, 0, 1, 0x11, n))]
        log += "".join(f"{n / 10 + at / 1000:.6f},{data.hex(' ')}\n" for at, data in rows)
    assert causes_of(log) == [cause]
