"""`servotap export`: what is written reads back as the same bytes, times, roles and frames."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time

import msgspec
import pytest
from mcap.reader import make_reader

from analyzer.catalogue import Role
from analyzer.cli import main
from analyzer.export import Choices, Export, writer
from analyzer.records import CanFrame, Chunk, Comment
from tests import CAPTURES, ROOT
from tests.contracts.source_contract import read_all
from tests.sources import builders

T = 1_772_442_000_123_456_789

SERIAL = [
    Comment(T, "left", "begin"),
    Chunk(T, "left", bytes.fromhex("FA01F601400234"), Role.REQUEST, True),
    Chunk(T + 3_125_001, "left", bytes.fromhex("FB01F601F3"), Role.REPLY, True),
    Chunk(T + 5_000_000, "arm-2.x", b"\x00\xff", Role.UNKNOWN, True),
    Chunk(T + 2_000_000_000, "left", bytes.fromhex("3E"), Role.REPLY, True),
]
CAN = [
    CanFrame(T, "can0", 0x001, bytes.fromhex("F60140023A"), Role.REQUEST),
    CanFrame(T + 1, "can0", 0x001, bytes.fromhex("F601F8")),
    CanFrame(T + 2_000, "vcan1", 0x1ABCDE, b"\x01\x02", extended=True),
    CanFrame(T + 3_000, "can0", 0x123, b"", remote=True),
    CanFrame(T + 4_000, "can0", 0x7FF, bytes(range(12)), fd=True),
    CanFrame(T + 5_000, "can0", 0x004, bytes(8), error=True),
]


def exported(path, items, to, **choices):
    with path.open("wb") as stream:
        export = Export(writer(to, stream, Choices(**choices)), ("can", "serial"), 38400)
        export.run(items)
        outcome = export.finish()
    return outcome


def traffic(records):
    return [r for r in records if not isinstance(r, Comment)]


@pytest.mark.parametrize("serial_as", ["user", "rtac"])
def test_pcapng_holds_both_kinds_as_they_are(serial_as, tmp_path):
    path = tmp_path / "a.pcapng"
    exported(path, SERIAL + CAN, "pcapng", serial_as=serial_as)
    source, records = read_all(path)
    assert traffic(records) == traffic(SERIAL + CAN)
    assert source.problem_count == 0
    assert [r.text for r in records if isinstance(r, Comment)] == ["begin"]


def test_a_reply_in_pcapng_is_one_although_no_request_came_before(tmp_path):
    path = tmp_path / "a.pcapng"
    only = [Chunk(T, "left", b"\x3e", Role.REPLY, True), Chunk(T + 1, "left", b"\x3e", Role.UNKNOWN, True)]
    for serial_as in ("user", "rtac"):
        exported(path, only, "pcapng", serial_as=serial_as)
        assert read_all(path)[1] == only


def test_comments_stand_at_packets_and_none_is_lost(tmp_path):
    path = tmp_path / "a.pcapng"
    given = [Comment(T, "left", "one"), Comment(T, "left", "two"), SERIAL[1], Comment(T + 9, "left", "behind all")]
    outcome = exported(path, given, "pcapng")
    assert (outcome.comments, outcome.lost_comments) == (3, 0)
    assert [r.text for r in read_all(path)[1] if isinstance(r, Comment)] == ["one\ntwo\nbehind all"]
    outcome = exported(path, [Comment(T, "left", "alone")], "pcapng")
    assert (outcome.comments, outcome.lost_comments) == (0, 1)


@pytest.mark.parametrize("digits", [6, 9])
def test_candump(digits, tmp_path):
    path = tmp_path / "a.log"
    exported(path, CAN, "candump", digits=digits)
    cut = 10 ** (9 - digits)
    assert read_all(path)[1] == [msgspec.structs.replace(f, t_ns=f.t_ns // cut * cut) for f in CAN]
    first = path.read_text().splitlines()[0]
    assert first == f"({T // 10**9}.{T % 10**9:09d}"[: 12 + digits] + ") can0 001#F60140023A T"


def test_candump_is_read_by_python_can(tmp_path):
    import can

    path = tmp_path / "a.log"
    given = [f for f in CAN if not f.error]
    exported(path, given, "candump")
    with can.LogReader(path) as reader:
        got = [(m.channel, m.arbitration_id, bytes(m.data), m.is_extended_id, m.is_rx) for m in reader]
    assert got == [(f.port, f.id, f.data, f.extended, f.direction is not Role.REQUEST) for f in given]


def test_hex_text(tmp_path):
    path = tmp_path / "a.txt"
    exported(path, SERIAL, "hex")
    source, records = read_all(path)
    assert traffic(records) == traffic(SERIAL)
    assert source.problem_count == 0
    assert path.read_text().splitlines()[:2] == ["// begin", "2026-03-02 09:00:00.123456789 > [bus:left] FA 01 F6 01 40 02 34"]


HOSTILE = ("FA 01 02 03", "SEND HEX>", "# SEND HEX>", "Tx: FA 01", "> 01 02", "a\nFB 01 02", "\x1b[2J 00 11")


@pytest.mark.parametrize("text", HOSTILE)
def test_nothing_in_a_comment_becomes_traffic(text, tmp_path):
    for to in ("hex", "pcapng"):
        path = tmp_path / f"a.{to}"
        exported(path, [SERIAL[1], Comment(T, "left", text), SERIAL[2]], to)
        assert traffic(read_all(path)[1]) == [SERIAL[1], SERIAL[2]], to


def test_without_times_hex_has_none_and_pcapng_made_up_ones(tmp_path):
    given = [Chunk(None, "serial", bytes(4)), Chunk(None, "serial", b"\xfa\x01")]
    exported(tmp_path / "a.txt", given, "hex")
    assert (tmp_path / "a.txt").read_text() == "00 00 00 00\nFA 01\n"
    outcome = exported(tmp_path / "a.pcapng", given, "pcapng")
    assert outcome.made_up == 2
    byte_ns = 10 * (10**9 // 38400)
    assert [c.t_ns for c in read_all(tmp_path / "a.pcapng")[1]] == [4 * byte_ns, 6 * byte_ns]


def test_times_from_the_start_of_a_capture_are_seconds(tmp_path):
    path = tmp_path / "a.txt"
    given = [
        Chunk(1_500_000_001, "serial", b"\xfa", Role.REQUEST, True),
        Chunk(90_000 * 10**9, "serial", b"\xfb", Role.REPLY, True),
    ]
    exported(path, given, "hex")
    assert path.read_text() == "1.500000001 > FA\n90000.000000000 < FB\n"
    assert read_all(path)[1] == given
    assert exported(path, [Chunk(-5, "serial", b"\x01")], "hex").negative == 1


# --- the command ----------------------------------------------------------------------------------------------------


def frames(log):
    """Topic, bytes, time and findings of every frame of a log."""
    with log.open("rb") as stream:
        found = []
        for _, channel, message in make_reader(stream).iter_messages():
            value = json.loads(message.data)
            if "_raw" in value:
                found.append((channel.topic, value["_raw"], message.log_time, value.get("_findings")))
    return found


@pytest.mark.parametrize(
    ("capture", "to", "options"),
    [
        ("mks_rs485.log", "hex", []),
        ("mks_rs485.log", "pcapng", []),
        ("mks_rs485.log", "pcapng", ["--serial-as", "rtac"]),
        ("mks_modbus.log", "pcapng", []),
        ("lk_rs485.log", "hex", []),
        ("lk_rs485.log", "pcapng", []),
        ("mks_can.asc", "candump", ["--nanoseconds"]),
        ("mks_can.asc", "pcapng", []),
    ],
)
def test_a_log_exported_and_decoded_again_holds_the_same_frames(capture, to, options, tmp_path):
    log, out, again = tmp_path / "a.mcap", tmp_path / "out", tmp_path / "b.mcap"
    assert main(["decode", str(CAPTURES / capture), "-o", str(log)]) == 0
    assert main(["export", str(log), "--to", to, "-o", str(out), *options]) == 0
    assert main(["decode", str(out), "-o", str(again)]) == 0
    assert frames(again) == frames(log)
    assert len(frames(log)) > 10


def test_the_default_name_and_what_is_said(tmp_path, capsys, cli):
    log = tmp_path / "week.mcap"
    main(["decode", str(CAPTURES / "mks_can.asc"), "-o", str(log)])
    capsys.readouterr()
    assert "25 frames of can1 (CAN, 89 bytes)" in cli("export", log, "--to", "candump").out
    assert (tmp_path / "week.candump.log").stat().st_mode & 0o777 == 0o666 & ~_umask()
    assert "exists; --force replaces it" in cli("export", log, "--to", "candump", status=2).err
    assert main(["export", str(log), "--to", "candump", "--force"]) == 0


def _umask():
    mask = os.umask(0)
    os.umask(mask)
    return mask


def both(path):
    exported(path, SERIAL + CAN, "pcapng")
    return path


def test_candump_leaves_serial_buses_out_and_says_so(tmp_path, cli):
    capture = both(tmp_path / "both.pcapng")
    out = cli("export", capture, "--to", "candump", "-o", tmp_path / "a.log").out
    assert "left out: 3 pieces of left (serial, 13 bytes), 1 piece of arm-2.x (serial, 2 bytes): candump holds CAN alone" in out
    assert "left out: 1 comment:" in out
    assert len((tmp_path / "a.log").read_text().splitlines()) == len(CAN)


def test_nothing_that_fits_is_an_error_and_leaves_no_file(tmp_path, capsys):
    out = tmp_path / "a.log"
    assert main(["export", str(CAPTURES / "mks_rs485.log"), "--to", "candump", "-o", str(out)]) == 2
    assert "has no CAN bus, and candump holds nothing else (it has 39 pieces of serial" in capsys.readouterr().err
    assert os.listdir(tmp_path) == []


def test_raw_bytes_of_a_live_log_stand_back_for_its_frames(tmp_path):
    raw = {"_direction": "unknown"}
    given = [
        ("/left/raw", T, {"_raw": "FA 01 F6 01", "_offset": 0, **raw}),
        ("/left/raw", T + 5, {"_raw": "40 02 34 FB 01", "_offset": 4, **raw}),
        ("/left/1/run_speed/request", T + 6, {"_raw": "FA 01 F6 01 40 02 34", "_offset": 0}),
        ("/left/raw", T + 9, {"_raw": "F6 01 F3 99 98", "_offset": 9, **raw}),
        ("/left/1/run_speed/reply", T + 9, {"_raw": "FB 01 F6 01 F3", "_offset": 7}),
    ]
    log = builders.mcap_log(tmp_path / "live.mcap", given)
    assert main(["export", str(log), "--to", "hex", "-o", str(tmp_path / "frames.txt")]) == 0
    assert main(["export", str(log), "--to", "hex", "-o", str(tmp_path / "chunks.txt"), "--chunks"]) == 0
    stamp = "2026-03-02 09:00:00.1234567"
    assert (tmp_path / "frames.txt").read_text() == (
        f"{stamp}95 > [bus:left] FA 01 F6 01 40 02 34\n{stamp}98 < [bus:left] FB 01 F6 01 F3\n{stamp}98 [bus:left] 99 98\n"
    )
    assert (tmp_path / "chunks.txt").read_text() == (
        f"{stamp}89 [bus:left] FA 01 F6 01\n{stamp}94 [bus:left] 40 02 34 FB 01\n{stamp}98 [bus:left] F6 01 F3 99 98\n"
    )


def test_raw_bytes_that_were_never_decoded_come_in_order(tmp_path):
    given, offset = [], 0
    for n in range(20):
        given.append((f"/{'ab'[n % 2]}/raw", T + n * 10**9, {"_raw": f"{n:02X}", "_offset": offset}))
        offset += n % 2
    log = builders.mcap_log(tmp_path / "live.mcap", given)
    out = tmp_path / "a.txt"
    assert main(["export", str(log), "--to", "hex", "-o", str(out)]) == 0
    assert [line[-2:] for line in out.read_text().splitlines()] == [f"{n:02X}" for n in range(20)]


def test_a_stretch_alone(tmp_path):
    log, out = tmp_path / "a.mcap", tmp_path / "a.log"
    main(["decode", str(CAPTURES / "mks_can.asc"), "-o", str(log)])
    assert main(["export", str(log), "--to", "candump", "-o", str(out), "--since", "+10ms", "--until", "+20.5ms"]) == 0
    assert [line[:21] for line in out.read_text().splitlines()] == [
        "(1772442000.010000) c", "(1772442000.010400) c", "(1772442000.020000) c",
    ]  # fmt: skip


def test_a_folder_of_parts(tmp_path):
    folder = tmp_path / "logs"
    folder.mkdir()
    main(["decode", str(CAPTURES / "mks_can.asc"), "-o", str(folder / "a.mcap")])
    assert main(["export", f"{folder}/", "--to", "candump"]) == 0
    assert len((tmp_path / "logs.candump.log").read_text().splitlines()) == 25


def test_standard_output_is_the_file_alone(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "analyzer", "export", str(CAPTURES / "mks_can.asc"), "--to", "candump", "-o", "-"],
        cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert len(done.stdout.splitlines()) == 25
    assert done.stdout.startswith("(1772442000.000000) can1 001#3031")
    assert "25 frames of can1" in done.stderr


def test_ctrl_c_leaves_no_file(tmp_path):
    read, write = os.pipe()
    out = tmp_path / "a.log"
    process = subprocess.Popen(
        [sys.executable, "-m", "analyzer", "export", "-", "--to", "candump", "-o", str(out)],
        cwd=ROOT, stdin=read, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    os.close(read)
    os.write(write, b"(1772442000.000000) can1 001#3031\n" * 3)
    deadline = time.monotonic() + 20
    while not any(name.endswith(".part") for name in os.listdir(tmp_path)) and time.monotonic() < deadline:
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=20)
    os.close(write)
    assert process.returncode == 130
    assert "nothing more was written" in err
    assert os.listdir(tmp_path) == []


def test_a_full_disk_leaves_no_file(tmp_path):
    rows = tmp_path / "long.log"
    rows.write_text("(1772442000.000000) can1 001#3031\n" * 200_000)
    code = (
        "import resource, signal, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 20, 1 << 20));"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN); from analyzer.cli import main; sys.exit(main(sys.argv[1:]))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, "export", str(rows), "--to", "pcapng", "-o", str(tmp_path / "a.pcapng")],
        cwd=ROOT, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 2
    assert "the incomplete file was removed" in done.stderr
    assert os.listdir(tmp_path) == ["long.log"]


# --- other programs -------------------------------------------------------------------------------------------------

needs_tshark = pytest.mark.skipif(shutil.which("tshark") is None, reason="tshark is not installed")


def tshark(*words):
    done = subprocess.run(["tshark", *words], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@needs_tshark
def test_wireshark_reads_can_serial_and_comments(tmp_path):
    path = both(tmp_path / "both.pcapng")
    rows = tshark(
        "-r", str(path), "-T", "fields", "-e", "frame.time_epoch", "-e", "frame.interface_name", "-e", "can.id",
        "-e", "frame.packet_flags_direction", "-e", "frame.comment", "-e", "data.data",
    )  # fmt: skip
    cells = [row.split("\t") for row in rows]
    assert len(cells) == len(traffic(SERIAL + CAN))
    assert cells[0][:2] == [f"{T // 10**9}.{T % 10**9:09d}", "left"]
    assert cells[0][3:] == ["0x00000002", "begin", "fa01f601400234"]
    assert [c[1] for c in cells] == [r.port for r in traffic(SERIAL + CAN)]
    assert [int(c[2], 0) for c in cells[4:7]] == [1, 1, 0x1ABCDE]


@needs_tshark
@pytest.mark.parametrize(
    ("serial_as", "choice"),
    [("user", ["-o", 'uat:user_dlts:"User 0 (DLT=147)","mbrtu","0","","0",""']), ("rtac", ["-d", "rtacser.data,mbrtu"])],
)
def test_wireshark_tells_modbus_queries_from_responses(serial_as, choice, tmp_path):
    log, out = tmp_path / "a.mcap", tmp_path / "a.pcapng"
    main(["decode", str(CAPTURES / "mks_modbus.log"), "-o", str(log)])
    main(["export", str(log), "--to", "pcapng", "--serial-as", serial_as])
    rows = tshark("-r", str(out), *choice)
    assert "Query: Unit:   1, Func:   4" in rows[0]
    assert "Response: Unit:   1, Func:   4" in rows[1]
