"""One waveform in every format of logic analyzers, and what is broken in such files."""

from __future__ import annotations

import random
import struct
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from analyzer.cli import main
from analyzer.errors import UnreadableError
from analyzer.records import Chunk
from analyzer.sources import open_source
from tests.contracts.source_contract import read_all
from tests.logic import waves
from tests.logic.waves import Wave, uart

RATE = 4_000_000
ROWS = [(1e6 + n * 4e6, bytes.fromhex("FA 01 30 2B") + bytes((n,))) for n in range(6)]
LINE, SENT = uart(ROWS, 115200, name="RX")
WAVES = [LINE, Wave("idle", 0)]

NINE = [Wave(f"D{n}") for n in range(9)]

Write = Callable[[Path, Sequence[Wave], int], Path]
WRITERS: dict[str, tuple[str, Write]] = {
    "sr": ("sigrok-session", waves.write_sr),
    "sr-pieces": ("sigrok-session", lambda path, lines, rate: waves.write_sr(path, lines, rate, piece=1001)),
    "sr-16-channels": ("sigrok-session", lambda path, lines, rate: waves.write_sr(path, [*NINE, *lines], rate)),
    "vcd": ("vcd", waves.write_vcd),
    "vcd-ps": ("vcd", lambda path, lines, rate: waves.write_vcd(path, lines, rate, "10 ps")),
    "csv": ("saleae-levels", waves.write_saleae_csv),
    "logic1-csv": ("saleae-levels", waves.write_logic1_csv),
    "binary-0": ("saleae-binary", lambda path, lines, rate: waves.write_saleae_binary(path, lines[0], rate)),
    "binary-1": ("saleae-binary", lambda path, lines, rate: waves.write_saleae_binary(path, lines[0], rate, 1)),
}  # fmt: skip


@pytest.mark.parametrize("name", WRITERS)
def test_every_format_gives_the_same(name: str, tmp_path: Path) -> None:
    format, write = WRITERS[name]
    source, records = read_all(write(tmp_path / "capture", WAVES, RATE))
    assert source.format == format
    found = [(record.t_ns or 0, record.data[0]) for record in records if isinstance(record, Chunk)]
    assert [value for _, value in found] == [value for _, value in SENT]
    assert all(abs(a - b) <= 250 for (a, _), (b, _) in zip(found, SENT, strict=True))
    assert source.problems == []


def test_the_channels_of_a_saleae_export_are_one_capture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "export"
    folder.mkdir()
    asked = [(1e6 + n * 6e6, bytes.fromhex("FA 01 30 2B")) for n in range(8)]
    came = [(3e6 + n * 6e6, bytes.fromhex("FB 01 30 00 00 00 01 20 00 4D")) for n in range(8)]
    for number, rows in ((0, asked), (10, came)):
        waves.write_saleae_binary(folder / f"digital_{number}.bin", uart(rows, 115200)[0], RATE, 1)
    source, records = read_all(folder)
    whole = b"".join(data for _, data in sorted(asked + came))
    assert b"".join(record.data for record in records if isinstance(record, Chunk)) == whole
    assert any(note.startswith("10: UART 115200 baud") for note in source.notes)
    assert main(["decode", str(folder), "-o", str(tmp_path / "x.mcap")]) == 0
    (folder / "digital_10.bin").write_bytes((folder / "digital_10.bin").read_bytes()[:-3])
    with pytest.raises(UnreadableError, match=r"digital_10.bin: the Saleae export breaks off at byte \d+"):
        read_all(folder)


@pytest.mark.parametrize("width", [1, 2, 8])
def test_sample_numbers_become_times_by_the_line_speed(width: int, tmp_path: Path) -> None:
    path = waves.write_logic1_binary(tmp_path / "x.bin", WAVES, RATE, width)
    source, records = read_all(path, baud=115200)
    found = [(record.t_ns or 0, record.data[0]) for record in records if isinstance(record, Chunk)]
    assert [value for _, value in found] == [value for _, value in SENT]
    # 34.72 samples a bit, measured to a hundredth or so.
    assert all(abs(a - b) <= 0.002 * b for (a, _), (b, _) in zip(found, SENT, strict=True))
    source, records = read_all(path)
    assert {record.t_ns for record in records} == {None}
    assert any("give --baud" in note for note in source.notes)


def test_times_before_the_trigger(tmp_path: Path) -> None:
    source, records = read_all(waves.write_saleae_csv(tmp_path / "x.csv", WAVES, RATE, trigger=1000))
    assert abs((records[0].t_ns or 0) - SENT[0][0]) <= 250
    assert "times before the trigger: all are moved by 0.00025 s" in source.notes


def test_vectors_and_comments_of_a_dump(tmp_path: Path) -> None:
    path = waves.write_vcd(tmp_path / "x.vcd", [LINE], RATE)
    text = path.read_text().replace("$var wire 1 ! RX $end", "$var wire 4 ! bus [3:0] $end\n$var real 64 r volt $end")
    head, _, body = text.partition("$enddefinitions $end\n")
    body = "$comment #9 ?? $end\n$dumpvars bx1 ! r0.5 r $end\n" + body.replace("1!", "bx1 !").replace("0!", "bx0 !")
    path.write_text(f"{head}$enddefinitions $end\n{body}")
    source, records = read_all(path)
    assert [record.data[0] for record in records if isinstance(record, Chunk)] == [value for _, value in SENT]
    assert "x and z leave a channel as it was" in source.notes
    assert any(note.startswith("bus[0]: UART 115200") for note in source.notes)


@pytest.mark.parametrize(
    ("declared", "bit", "name"),
    [("8 ! bus [7:0]", "b100 !", "bus[2]"), ("8 ! bus [15:8]", "b100 !", "bus[10]"), ("8 ! bus [0:7]", "b100 !", "bus[5]"),
     ("1 ! \\a[3]+/b", "1!", "\\a[3]+/b"), ("4 ! \\a/b [3:0]", "bU10W !", "\\a/b[2]"), ("1 ! rx", "h!", "rx")],
)  # fmt: skip
def test_styles_of_simulators(declared: str, bit: str, name: str, tmp_path: Path) -> None:
    path = waves.write_vcd(tmp_path / "x.vcd", [LINE], RATE, "10 ps")
    low = bit.replace("1", "0") if "1" in bit else "l!"
    head, _, body = path.read_text().replace("1 ! RX", declared).partition("$enddefinitions $end\n")
    head = head.replace("$scope", "$scope module top $end\n$scope", 1).replace("$upscope $end", "$upscope $end $upscope $end")
    rows = body.replace("1!", bit).replace("0!", low).splitlines()
    # A level within one step of time, and a pause of the dump.
    rows[3] += f" {bit} {low} {bit} {low} {rows[3].split(' ', 1)[1]}"
    path.write_text(f"{head}$enddefinitions $end\n#0 $dumpvars x! $end\n" + "\n".join(rows) + "\n$dumpoff x! $end\n")
    source, records = read_all(path)
    assert [record.data[0] for record in records if isinstance(record, Chunk)] == [value for _, value in SENT]
    assert any(note.startswith(f"{name}: UART 115200") for note in source.notes)


def test_gaps_between_chunks(tmp_path: Path) -> None:
    data = waves.write_saleae_binary(tmp_path / "x.bin", LINE, RATE, 1).read_bytes()
    chunk, end = data[24:], struct.unpack_from("<d", data, 44)[0]
    later = struct.pack("<IdddQ", 0, float(RATE), end + 1, end + 2, 1) + struct.pack("<d", end + 1.5)
    (tmp_path / "x.bin").write_bytes(data[:16] + struct.pack("<Q", 2) + chunk + later)
    source, records = read_all(tmp_path / "x.bin")
    assert [record.data[0] for record in records if isinstance(record, Chunk)][: len(SENT)] == [value for _, value in SENT]
    assert any("1 gap" in note for note in source.notes)


def test_a_long_capture_is_read_stretch_by_stretch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = waves.write_sr(tmp_path / "x.sr", WAVES, RATE, piece=10_000)
    whole = read_all(path)[1]
    monkeypatch.setattr("analyzer.sources.logic.sigrok_session._PIECE", 700)
    monkeypatch.setattr("analyzer.sources.logic.traffic._MOST_EDGES", 80)
    monkeypatch.setattr("analyzer.sources.logic.traffic._TOGETHER", 7)
    assert read_all(path)[1] == whole


# --- what is broken -----------------------------------------------------------------------------------------------------


def repacked(path: Path, change: Callable[[str, bytes], bytes | None], compression: int = zipfile.ZIP_DEFLATED) -> None:
    with zipfile.ZipFile(path) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w", compression) as archive:
        for name, data in files.items():
            if (changed := change(name, data)) is not None:
                archive.writestr(name, changed)


def bomb(path: Path) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("metadata", "[device 1]\ncapturefile=logic-1\nsamplerate=1 MHz\ntotal probes=8\nunitsize=1\n")
        archive.writestr("logic-1-1", bytes(1 << 20))
    # The size that the directory claims is what would be unpacked.
    data = path.read_bytes()
    at = data.rindex(b"PK\x01\x02")
    path.write_bytes(data[: at + 24] + struct.pack("<I", 3 << 30) + data[at + 28 :])


def damaged(path: Path) -> None:
    repacked(path, lambda name, data: data, zipfile.ZIP_STORED)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)


def edited(old: str, new: str) -> Callable[[Path], None]:
    return lambda path: path.write_bytes(path.read_bytes().replace(old.encode(), new.encode(), 1))


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-100])


def in_metadata(old: bytes, new: bytes) -> Callable[[Path], None]:
    return lambda path: repacked(path, lambda name, data: data.replace(old, new) if name == "metadata" else data)


BROKEN: dict[str, tuple[str, Callable[[Path], None], str]] = {
    "cut archive": ("sr", cut, "is a zip archive that is broken, at its directory"),
    "damaged samples": ("sr", damaged, "the zip archive is broken in its file logic-1-1, behind byte .*CRC"),
    "bomb": ("sr", bomb, "claim to hold 3221225472 bytes of samples.*decompression bomb"),
    "no unitsize": ("sr", in_metadata(b"unitsize=1", b"unitsize=x"), "expected unitsize from 1 to 64 in 'metadata', got x"),
    "no ini": ("sr", in_metadata(b"[device 1]", b"device"), "broken in its file 'metadata'|no logic channels"),
    "piece missing": ("sr-pieces", lambda p: repacked(p, lambda n, d: None if n == "logic-1-3" else d), "its file logic-1-3 is missing"),
    "saleae capture": ("sr", lambda p: repacked(p, lambda n, d: d) or in_zip(p, "meta.json"), "File > Export Data"),
    "other archive": ("sr", lambda p: in_zip(p, "photo.jpg"), "is a zip archive and no session of sigrok.*photo.jpg"),
    "no end of header": ("vcd", edited("$enddefinitions", "$foo"), "has no end: expected \\$enddefinitions"),
    "timescale": ("vcd", edited("1 ns", "1 parsec"), "line 6: expected a timescale as in 1 ns, got 1 parsec"),
    "unknown code": ("vcd", edited("1!", "1?"), "line 1[0-9]: expected a time as #123 .* got '1\\?'"),
    "time backwards": ("vcd", edited("\n#1", "\n#999999999999\n#1"), "line 1[0-9]: expected a time .* not before the last"),
    "garbage": ("vcd", edited("0!", "0! ~~~"), "got '~~~'"),
    "cut row": ("csv", edited(",0\n", ",0,1\n"), "line 2: 3 levels, expected 2"),
    "level": ("csv", edited(",1,", ",7,"), "line 2: a level that is not 0, 1 or X: 7"),
    "binary cut": ("binary-0", cut, "the Saleae export breaks off at byte .*: expected .* bytes of its .* transitions"),
    "binary version": ("binary-0", lambda p: p.write_bytes(b"<SALEAE>\x09" + p.read_bytes()[9:]), "byte 8: expected version 0 or 1"),
    "binary state": ("binary-0", lambda p: p.write_bytes(p.read_bytes()[:16] + b"\x07" + p.read_bytes()[17:]), "byte 16: expected a state"),
    "analog": ("binary-0", lambda p: p.write_bytes(p.read_bytes()[:12] + b"\x01" + p.read_bytes()[13:]), "is an analog export"),
    "binary times": ("binary-1", lambda p: p.write_bytes(p.read_bytes()[:68] + b"\xff" * 8 + p.read_bytes()[76:]), "byte 68: expected a time"),
}  # fmt: skip
# ruff: noqa: E501


def in_zip(path: Path, name: str) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(name, b"{}")


@pytest.mark.parametrize("name", BROKEN)
def test_what_is_broken_is_one_line_and_writes_nothing(name: str, tmp_path: Path, cli) -> None:
    form, spoil, error = BROKEN[name]
    path = WRITERS[form][1](tmp_path / "capture", WAVES, RATE)
    spoil(path)
    with pytest.raises(UnreadableError, match=error):
        read_all(path)
    said = cli("decode", path, "-o", tmp_path / "out.mcap", status=2).err
    assert said.startswith("servotap decode: capture")
    assert said.count("\n") == 1
    assert sorted(p.name for p in tmp_path.iterdir()) == ["capture"]


@pytest.mark.parametrize("form", ["sr", "vcd", "csv", "binary-0", "binary-1"])
def test_damage_anywhere_raises_nothing_unforeseen(form: str, tmp_path: Path) -> None:
    path = WRITERS[form][1](tmp_path / "capture", WAVES, RATE)
    whole, chance = path.read_bytes(), random.Random(7)
    for _ in range(16):
        data = bytearray(whole)
        for _ in range(chance.choice((1, 3, 20))):
            data[chance.randrange(len(data))] = chance.choice((0, 255, chance.randrange(256)))
        path.write_bytes(data)
        error = ""
        try:
            with open_source(path, format=WRITERS[form][0]) as source:
                list(source)
        except UnreadableError as raised:
            error = str(raised)
        # What was not foreseen is told so.
        assert "cannot be read as" not in error


def test_a_header_of_many_sections_is_read_once(tmp_path: Path) -> None:
    """To count the lines before each section anew would take minutes."""
    path = tmp_path / "a.vcd"
    waves.write_vcd(path, [uart([(1e6, b"\xfa\x01\x30\x2b")], 38400)[0]], 1_000_000)
    _, alone = read_all(path)
    section = "$comment x $end\n"
    path.write_text(section * ((4 << 20) // len(section) - 100) + path.read_text())
    assert read_all(path)[1] == alone


def test_a_header_whose_last_section_has_no_end_is_not_kept(tmp_path: Path) -> None:
    path = tmp_path / "a.vcd"
    path.write_text("$timescale 1us $end\n$enddefinitions\n" + "#1 1!\n" * (1 << 20))
    with pytest.raises(UnreadableError, match="breaks off in \\$enddefinitions"):
        read_all(path)
