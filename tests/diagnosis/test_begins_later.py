"""Trouble that begins in a long capture, and what a row of requests, a register or a report says of it."""

from __future__ import annotations

import pytest

from analyzer import dialects as registry
from analyzer.diagnosis.diagnose import of_traffic
from analyzer.sources import open_source
from tests.diagnosis.spoiled_line import both, levels, received
from tests.diagnosis.test_layouts import CAME, POSITION, SPEED, STATUS, can, causes, exchanges, lk, native, reply, unit
from tests.diagnosis.test_log_forms import pairs

#: Drives of two addresses that answer as they should.
WELL = {
    "native": [
        row
        for n in range(6)
        for row in (
            (native(4, 0x31), reply(4, 0x31, 0, 0, 0, 0, n, 7 * n)),
            (native(9, 0x32), reply(9, 0x32, 0, 40 + n)),
            (native(9, 0xF1), reply(9, 0xF1, 2)),
        )
    ],
    "modbus": [
        row
        for n in range(6)
        for row in (
            (unit(4, 4, 0, 0x31, 0, 3), unit(4, 4, 6, 0, 0, 0, 0, n, 7 * n)),
            (unit(9, 4, 0, 0x32, 0, 1), unit(9, 4, 2, 0, 40 + n)),
            (unit(9, 4, 0, 0xF1, 0, 1), unit(9, 4, 2, 0, 2)),
        )
    ],
    "lk": [
        row
        for n in range(6)
        for row in (
            (lk(0x92, 4), lk(0x92, 4, n, 3, 0, 0, 0, 0, 0, 0)),
            (lk(0x9C, 9), lk(0x9C, 9, 30, n, 2, 0, 3, 0x90, 1)),
            (lk(0x94, 9), lk(0x94, 9, n, 70, 0, 0)),
        )
    ],
}


def log(rows, step=0.05):
    """Return exchanges as lines of a log, with times if there is a step."""
    sent = exchanges(*((asked, came if isinstance(came, list) else [came]) for asked, came in rows))
    lines = [f"{'<-- ' if mark == '<' else '--> '}{pairs(data)}" for mark, data in sent]
    return "".join(f"10:00:{n * step:06.3f} {line}\n" if step else f"{line}\n" for n, line in enumerate(lines))


def inverted(data):
    return received(levels(data), inverted=True)


def of_seven(data):
    return bytes(byte & 0x7F for byte in data)


@pytest.mark.parametrize("dialect", WELL)
@pytest.mark.parametrize(
    ("sent", "came", "cause"),
    [
        (bytes, lambda asked, answer: asked + answer, "echo"),
        (bytes, lambda asked, answer: of_seven(answer), "wrong_parity"),
        (inverted, lambda asked, answer: inverted(answer), "inverted_lines"),
    ],
)
def test_what_is_set_wrongly_in_the_midst_of_a_capture(dialect, sent, came, cause):
    well = WELL[dialect]
    assert causes(log([*well, *((sent(a), [came(a, b)]) for a, b in well[:9])]))[:1] == [cause]
    assert causes(log(well + well)) == []


def test_noise_here_and_there_is_no_setting():
    rows = [(asked, bytes((*answer[:-2], answer[-2] ^ 0x10, answer[-1])) if n in (7, 12, 16) else answer)
            for n, (asked, answer) in enumerate(WELL["native"])]  # fmt: skip
    assert set(causes(log(rows))) <= {"noise"}


@pytest.mark.parametrize("late", [0.0, 3.25, 9.5, 21.75])
def test_two_reports_that_overlap(late):
    moves = [(native(a, 0xFE, 0, 100, 4, 0, 0, 0x80, a), [reply(a, 0xFE, 1)]) for a in (5, 16)]
    seen = received(both(levels(reply(5, 0xFE, 2)), levels(b"")[:1] * int(16 * late) + levels(reply(16, 0xFE, 2))))
    status = (native(9, 0xF1), [reply(9, 0xF1, 1)])
    assert causes(log([*moves, status, (native(9, 0xF1), [reply(9, 0xF1, 1), seen])] * 2))[:1] == ["collision"]


@pytest.mark.parametrize("end", [b"\r\n", b"\n"])
@pytest.mark.parametrize("dialect", WELL)
def test_requests_that_are_written_as_lines(dialect, end):
    assert causes(log([(asked + end, []) for asked, _ in WELL[dialect][:4]])) == ["text_mode"]
    assert causes(log(WELL[dialect] + [(asked + end, []) for asked, _ in WELL[dialect][:4]]))[:1] == ["text_mode"]


@pytest.mark.parametrize("dialect", WELL)
def test_one_wrong_check_in_a_log_of_a_host(dialect):
    frame = {
        "native": native(4, 0xF6, 0, 190, 1),
        "modbus": unit(4, 16, 0, 0xF6, 0, 2, 4, 0, 9, 1, 44),
        "lk": lk(0xA2, 4, 0x70, 0x17, 0, 0),
    }[dialect]
    wrong = (frame[:-1] + bytes((frame[-1] ^ 0x35,)), [])
    assert causes(log([*WELL[dialect][:9], wrong, *WELL[dialect][9:]])) == ["wrong_checksum"]
    # One that others are like was hit by noise.
    asked, _ = WELL[dialect][0]
    hit = (asked[:-1] + bytes((asked[-1] ^ 0x35,)), [])
    assert "wrong_checksum" not in causes(log([*WELL[dialect][:9], hit, *WELL[dialect][9:]]))


def test_a_register_that_the_manual_does_not_list():
    asked = (unit(4, 4, 0, 0xD0, 0, 1), [])
    assert causes(log([asked, WELL["modbus"][0], asked, WELL["modbus"][3]], step=0.4))[:1] == ["unknown_command"]
    # Of a device whose registers are not known nothing is said.
    other = (unit(4, 3, 0x21, 0, 0, 1), unit(4, 3, 2, 0, 9))
    assert "unknown_command" not in causes(log([asked, other, asked, other]))


@pytest.mark.parametrize("dialect", WELL)
def test_reads_of_several_drives_without_a_pause(dialect):
    row = [(WELL[dialect][0][0], []), WELL[dialect][2]]
    assert causes(log(WELL[dialect] + row * 4, step=0))[:1] == ["too_fast"]
    # Without times each may have been waited for, and its drive is dead.
    assert "too_fast" not in causes(log(row * 4, step=0))


def test_motions_that_are_silent_by_a_setting_are_not_too_fast():
    move = native(9, 0xF6, 0, 90, 2)
    rows = [(move, reply(9, 0xF6, 1)), *WELL["native"][:9], *[(move, []), WELL["native"][2]] * 4]
    assert "too_fast" not in causes(log(rows, step=0))


def test_causes_on_can():
    frames = [pairs(each).replace(" ", "") for each in (POSITION, STATUS, SPEED)]
    assert causes(can(*(f"004#{each}" for each in frames))) == ["wrong_dialect"]
    short = ["005#FE003C05195D", "005#FE003D05195E", "005#3136", CAME[0]]
    assert causes(can(*short * 2)) == ["wrong_length"]
    asked = ["005#3136", "005#3237", "005#F1F6"]
    late = [row for n in range(9) for row in (asked[n % 3], *([CAME[(n - 1) % 3]] if n else []))]
    well = [row for n in range(9) for row in (asked[n % 3], CAME[n % 3])]
    assert causes(can(*well, *late)) == ["late_reply"]
    assert causes("".join(f"  can0  {row[:3]}   [{len(row) // 2 - 2}]  {pairs(bytes.fromhex(row[4:]))}\n" for row in late)) == [
        "late_reply"
    ]
    assert causes(can(*well)) == []


@pytest.mark.parametrize("dialect", WELL)
def test_a_recording_may_begin_and_end_within_a_frame(dialect, tmp_path):
    path = tmp_path / "wire.bin"
    whole = b"".join(asked + answer for asked, answer in WELL[dialect])
    said = set()
    for cut in range(1, 40):
        path.write_bytes(whole[cut : -(40 - cut)])
        with open_source(path) as source:
            found = of_traffic(source, [d for d in registry.every() if d.bus == "serial"])
        said.add((found.verdict, *(each.suspicion.cause for each in found.causes)))
    assert said == {("ok",)}


@pytest.mark.parametrize("dialect", ["native", "lk"])
@pytest.mark.parametrize(("all_of_them", "found"), [(True, ["reply_cut", "firmware_quirk"]), (False, ["reply_cut"])])
def test_a_drive_may_send_no_checks(dialect, all_of_them, found):
    rows = [(asked, answer[:-1] if all_of_them or n % 3 else answer) for n, (asked, answer) in enumerate(WELL[dialect])]
    assert causes(log(rows)) == found
