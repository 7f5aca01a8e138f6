"""Causes that look alike: which of them is told, and when none is."""

from __future__ import annotations

import pytest

from analyzer import dialects as registry
from analyzer.cli import main
from analyzer.diagnosis.diagnose import diagnosis
from analyzer.diagnosis.watch import Watch
from analyzer.link import modbus_crc
from analyzer.pipeline import Pipeline
from analyzer.sources import open_source
from tests.diagnosis.test_pastes import checked, diagnosed


def of_file(path, bus="serial"):
    dialects = [d for d in registry.every() if d.bus == bus]
    watch = Watch()
    pipeline = Pipeline(dialects, [watch])
    with open_source(str(path)) as source:
        for item in source:
            watch.take(item)
            pipeline.feed(item)
        notes = source.notes
    pipeline.close()
    return diagnosis(watch, dialects), notes


def spy(gap, lost=0):
    rows = (
        (1010, "TX", "FA 01 30 2B"), (1015, "RX", "FB 01 30 00 00 00 02 1A 40 88"), (1515, "TX", "FA 01 31 2C"),
        (1520, "RX", "FB 01 31 00 00 00 00 A2 40 0F"), (2025, "TX", "FA 01 32 2D"), (2030, "RX", "FB 01 32 01 2C 5B"),
    )  # fmt: skip
    text = ""
    for ms, mark, data in rows:
        pairs, size = data.split(), len(data.split())
        pairs = pairs[: size - lost] if size > 8 else pairs
        hexed = " ".join(pairs[:8]) + " " + (gap + " ".join(pairs[8:]) + " " if pairs[8:] else "")
        text += f"{ms / 1000:010.3f} {mark}   0000  {hexed:50}{'.' * size}\n"
    return text


@pytest.mark.parametrize(("gap", "lost", "verdict"), [(" ", 0, "ok"), ("", 0, "ok"), (" ", 2, "unknown"), ("", 1, "unknown")])
def test_what_the_reader_has_lost_is_no_cause(tmp_path, gap, lost, verdict):
    path = tmp_path / "spy.log"
    path.write_text(spy(gap, lost))
    found, notes = of_file(path)
    assert (found.verdict, found.causes) == (verdict, ())
    assert any("as many as the characters show" in note for note in notes) is bool(lost)


def test_a_reply_that_the_host_cuts_is_told_beside_what_the_reader_has_lost(tmp_path):
    cut = "".join(
        f"00000{n}.000 TX   0000  {'FA 01 30 2B ':50}....\n00000{n}.050 RX   0000  {'FB 01 30 00 00 ':50}.....\n"
        for n in range(5, 8)
    )
    path = tmp_path / "spy.log"
    path.write_text(spy(" ", 2) + cut)
    found, _ = of_file(path)
    assert [each.suspicion.cause for each in found.causes] == ["reply_cut"]
    assert len(found.causes[0].suspicion.troubles) == 3


def test_a_row_missing_in_a_dump_is_no_cause(tmp_path):
    data = (bytes.fromhex("FA 01 30 2B FB 01 30 00 00 00 02 1A 40 88")) * 8
    rows = [f"{at:08X}  {data[at : at + 16].hex(' ').upper()}\n" for at in range(0, len(data), 16)]
    path = tmp_path / "dump.txt"
    path.write_text("".join(rows[:3] + rows[4:]))
    found, notes = of_file(path)
    assert (found.verdict, found.causes) == ("unknown", ())
    assert any("missing before offset" in note for note in notes)


TCP_CLIENT = 'client.write(Buffer.from("000100000006030378530002","hex"));\nReceived: {}\n'
TWICE = "> FA 01 {0}\n< FB 01 {1}\n< FB 01 {1}\n"
SETTINGS = (("82 05 82", "82 01 7F"), ("84 10 8F", "84 01 81"), ("86 00 81", "86 01 83"))
READS = (("32 2D", "32 00 00 2E"), ("F1 EC", "F1 01 EE"))
MOVE = "TX: FA 01 F4 03 E8 10 00 00 40 00 2A\nRX: FB 01 F4 01 F1\n"
END = "RX: FB 01 F4 02 F2\n"
STATUS = "TX: FA 01 F1 EC\nRX: FB 01 F1 01 EE\n"
GOOD, BAD = "0A 03 AA E6 00 08 85 58", "0A 03 10 46 67 54 00 43 A0 27 AE 3D CC CC CD 40 00 00 00 66 23"
REQUEST_17 = "01 17 00 00 00 02 00 0A 00 01 02 00 05"


def cut_log(judged):
    reply = bytes.fromhex(checked("0B 03 10 45 CE 0B D7 00 00 00 00 45 CE 6A B8 41 3D C2 8F"))
    rows = ((checked("0B 03 20 06 00 02"), "NO"), (checked("0B 03 04 40 9B F8 A1"), "NO"),
            (checked("0B 03 40 00 00 08"), "NO"), (reply[:12].hex(" "), judged), (reply[12:].hex(" "), judged))  # fmt: skip
    return "".join(
        f"DATE=2022-01-07T20:33:39.{100 + 30 * n};ERR={err};FRAME={d.replace(' ', '-')};SLAVE=11\n"
        for n, (d, err) in enumerate(rows)
    )


@pytest.mark.parametrize(
    ("text", "cause"),
    [
        # A device that sends the header speaks Modbus TCP; a stream may be read in parts.
        (TCP_CLIENT.format("000100000007030304000013\nReceived: 88"), "split_frame"),
        (TCP_CLIENT.format("00010000000703030400001388"), None),
        ("".join(TWICE.format(*each) for each in SETTINGS), "firmware_quirk"),
        ("".join(TWICE.format(*each) for each in READS), None),
        # An exception whose check is not judged says nothing of a register.
        ("[0x01] [0x90] [0x02] [0x00] [0x00]\n", "firmware_quirk"),
        (f"< {checked('01 83 02')}\n", "wrong_register"),
        ("The motor does not send a complete status\n" + MOVE, "firmware_quirk"),
        ("The motor does not turn as far as I want\n" + MOVE, None),
        (MOVE + END + MOVE + STATUS * 2, "firmware_quirk"),
        (MOVE + END + MOVE + END + STATUS * 2, None),
        (MOVE + STATUS * 2, None),
        # A stray byte within a frame and one between frames have one cause.
        (f"SEND: {GOOD}\nRECV: {BAD}\nSEND: {GOOD}\nRECV: FF\nRECV: {BAD[:29]} FF {BAD[30:-3]}\n", "noise"),
        (cut_log("BAD_CRC"), "split_frame"),
        (cut_log("NO"), None),
        (f"> {REQUEST_17} 12 D4\n> {REQUEST_17[:-1]}6 13 94\n", "crc_swapped"),
        (f"> {REQUEST_17}\n> {REQUEST_17[:-1]}6\n", "missing_checksum"),
    ],
)  # fmt: skip
def test_cause(tmp_path, text, cause):
    path = tmp_path / "paste.txt"
    path.write_text(text)
    found, _ = of_file(path)
    assert [each.suspicion.cause for each in found.causes[:1]] == ([cause] if cause else [])


def test_a_right_request_of_function_17_has_no_wrong_check():
    assert modbus_crc(bytes.fromhex(checked(REQUEST_17))) == 0
    assert not diagnosed(f"> {checked(REQUEST_17)}\n").causes


@pytest.mark.parametrize(("step_s", "cause"), [(1, "can_wrong_id"), (0.001, "no_reply")])
def test_a_request_that_comes_again_later_is_not_its_own_reply(tmp_path, step_s, cause):
    frames = ("601#3132", "601#F1F2", "601#F301F5", "601#3233") * 2
    path = tmp_path / "can.log"
    path.write_text("".join(f"({1720000000 + n * step_s:.6f}) can0 {frame}\n" for n, frame in enumerate(frames)))
    found, _ = of_file(path, "can")
    assert [each.suspicion.cause for each in found.causes[:1]] == [cause]


def test_bytes_of_can_without_an_identifier_say_what_is_missing(tmp_path, capsys):
    path = tmp_path / "post.txt"
    path.write_text("The command (0xff, 0xca) is answered (0xff, 0x1); then there is another can message with 0xff, 0x2.\n")
    assert main(["diagnose", str(path)]) == 2
    assert "without an identifier: put that of each frame before it (001#FFCACA)" in capsys.readouterr().err


@pytest.mark.parametrize(("strays", "cause"), [((1, 2, 3, 4, 5), None), ((0, 0, 0, 0, 0), "leading_glitch")])
def test_stray_bytes_that_count_up_are_the_numbers_of_rows(strays, cause):
    frames = [bytes((0xFA, address, 0x3A, 0xFA + address + 0x3A & 0xFF)) for address in range(1, 6)]
    log = "".join(f"> {stray:02X} {frame.hex(' ')}\n" for stray, frame in zip(strays, frames, strict=True))
    assert [each.suspicion.cause for each in diagnosed(log).causes[:1]] == ([cause] if cause else [])
