"""Each cause on made traffic, and silence on clean and merely noisy traffic."""

from __future__ import annotations

import importlib.util
import json
import random
from itertools import islice
from pathlib import Path

import pytest

from analyzer import dialects as registry
from analyzer.catalogue import Role
from analyzer.cli import main
from analyzer.detect import choose
from analyzer.diagnosis import diagnose
from analyzer.diagnosis.causes import CAUSES
from analyzer.diagnosis.diagnose import diagnosis
from analyzer.diagnosis.ranking import ranked
from analyzer.diagnosis.scene import Confidence, Suspicion, Trouble
from analyzer.diagnosis.watch import Watch
from analyzer.encoder import assemble, build
from analyzer.pipeline import Pipeline
from analyzer.port import Options
from analyzer.records import CanFrame, Chunk
from conformance.drives.serial_bus import SerialBus
from tests.columns.serial_traffic import POLLS, polls
from tests.conformance.drives.served import drives
from tests.diagnosis.spoiled_line import Format, both, levels, received

ROOT = Path(__file__).parents[2]
_SPEC = importlib.util.spec_from_file_location("make_captures", ROOT / "captures" / "make.py")
captures = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(captures)

NATIVE, MODBUS, CAN, LK = (registry.get(n) for n in ("mks-rs485", "mks-modbus", "mks-can", "lk-rs485"))


def watched(items, spoken):
    watch = Watch()
    pipeline = Pipeline(spoken, [watch], Options(timed=any(item.t_ns is not None for item in items)))
    for item in items:
        watch.take(item)
        pipeline.feed(item)
    pipeline.close()
    return watch


def diagnosed(items):
    chosen = choose(registry.every(), items).dialects
    watch = watched(items, chosen)
    quiet = watch.quiet
    found = diagnosis(watch, chosen)
    assert not (quiet and found.causes)
    assert {each.suspicion.cause for each in found.causes} <= CAUSES.keys()
    return found


def lines(*rows):
    """Return the chunks of rows: `> FA 01` was sent, `< FB 01` received, without a mark either; bytes are taken so."""
    roles = {">": Role.REQUEST, "<": Role.REPLY}
    found = []
    for number, row in enumerate(rows):
        mark, text = ("", row) if isinstance(row, bytes) else row if isinstance(row, tuple) else (row[:1], row.strip("<> "))
        data = text if isinstance(text, bytes) else bytes.fromhex(text)
        found.append(Chunk(number * 10_000_000, "bus", data, roles.get(mark, Role.UNKNOWN), True))
    return found


def told(*rows):
    return [each.suspicion for each in diagnosed(lines(*rows)).causes]


def first(*rows):
    found = told(*rows)
    return found[0].cause if found else None


def exchanged(drive, *requests):
    """Return rows of requests and the replies of an emulated drive."""
    bus = SerialBus(drives(drive))
    rows = []
    for request in requests:
        bus.send(request)
        reply = b""
        while (chunk := bus.receive(50_000_000)) is not None:
            reply += chunk.data
        rows += [(">", request), *([("<", reply)] if reply else [])]
    return rows


def changed(rows, mark, change):
    return [(m, change(data) if m == mark else data) for m, data in rows]


READS = [build(NATIVE, name, 1) for name in ("read_encoder_carry", "read_speed", "read_pulses", "read_protection")]
LK_READS = [build(LK, name, 1) for name in ("read_state_1", "read_state_2", "read_state_3")]


# --- the examples of the issue -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rows", "causes", "right"),
    [
        (["FA 01 F6 00 00 02 F9"], ["wrong_checksum_rule"], "FA 01 F6 00 00 02 F3"),
        (["7F 7E FF FF EB 75 19"], ["inverted_lines"], "01 03 00 00 00 0A C5 CD"),
        (["40 40 40 41 64 F1"], ["lost_start"], "01 01 01 05 91 8B"),
        (["01 03 00 00 00 01 C0 A1"], ["wrong_checksum_rule"], "01 03 00 00 00 01 84 0A"),
        (
            ["> 01 10 00 F5 00 04 08 00 64 00 00 00 00 00 00", "< 01 10 00"],
            ["missing_checksum", "reply_cut"],
            "01 10 00 F5 00 04 08 00 64 00 00 00 00 00 00 DC B1",
        ),
    ],
)
def test_examples(rows, causes, right):
    found = told(*rows)
    assert [each.cause for each in found] == causes
    assert found[0].frames[0].right == right or right in found[0].evidence


def test_the_rule_is_named():
    assert "the sum without the head byte" in told("FA 01 F6 00 00 02 F9")[0].say
    assert "the CRC without the address, high byte first" in told("01 03 00 00 00 01 C0 A1")[0].say


# --- checks --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dialect", [NATIVE, MODBUS, LK], ids=lambda d: d.name)
def test_a_missing_checksum(dialect):
    whole = [build(dialect, name, 1) for name in ("read_encoder_carry", "read_speed") if name in dialect.by_name]
    whole += [build(dialect, c, 1) for c in dialect.commands if c.verb.startswith("read_state")]
    cut = [frame[: -2 if dialect is MODBUS else -1] for frame in whole]
    found = told(*((">", frame) for frame in cut))
    assert found[0].cause == "missing_checksum"
    assert found[0].frames[0].right == whole[0].hex(" ").upper()


@pytest.mark.parametrize(
    ("rule", "cause"),
    [
        (lambda body: bytes((sum(body[1:]) & 0xFF,)), "wrong_checksum_rule"),
        (lambda body: bytes((body[0] ^ body[1] ^ body[2],)), "wrong_checksum_rule"),
        (lambda body: captures.crc16(body), "wrong_checksum_rule"),
        (lambda body: b"\x77", "wrong_checksum"),
    ],
)
def test_native_checks(rule, cause):
    assert first(*((">", frame[:-1] + rule(frame[:-1])) for frame in READS)) == cause


def test_a_swapped_crc():
    asked = [build(MODBUS, name, 1) for name in ("read_encoder_carry", "read_speed")]
    found = told(*((">", frame[:-2] + frame[:-3:-1]) for frame in asked))
    assert (found[0].cause, found[0].confidence) == ("crc_swapped", "certain")


def test_one_sum_for_both_of_lingkong():
    frames = [assemble(LK, "run_speed", 1, {"speed": speed}).frame for speed in (1000, -300)]
    rows = [(">", f[:4] + f[5:-1] + bytes((sum(f[:4] + f[5:-1]) & 0xFF,))) for f in frames]
    found = told(*rows)
    assert found[0].cause == "wrong_checksum_rule"
    assert found[0].frames[0].right == frames[0].hex(" ").upper()


def test_a_can_sum_without_the_identifier():
    sent = [(3, build(CAN, name, 3)) for name in ("read_encoder_carry", "read_speed", "read_pulses")]
    items = [
        CanFrame(n * 5_000_000, "can0", i, data[:-1] + bytes((sum(data[:-1]) & 0xFF,))) for n, (i, data) in enumerate(sent)
    ]
    found = diagnosed(items).causes[0].suspicion
    assert (found.cause, found.frames[0].right) == ("wrong_checksum_rule", f"003 {sent[0][1].hex(' ').upper()}")


# --- edges, and what the host reads --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        (lambda reply: reply[1:], "lost_start"),
        (lambda reply: b"\xff" + reply, "leading_glitch"),
        (lambda reply: b"\x00\x00" + reply, "leading_glitch"),
        (lambda reply: reply + b"\x00", "trailing_glitch"),
        (lambda reply: reply[:3], "reply_cut"),
    ],
)
@pytest.mark.parametrize(("drive", "reads"), [("mks-rs485@1", READS), ("lk-rs485@1,baud=38400", LK_READS)])
def test_spoiled_replies(change, cause, drive, reads):
    assert first(*changed(exchanged(drive, *reads), "<", change)) == cause


def test_an_echo_needs_a_direction_or_times():
    rows = exchanged("mks-rs485@1", *READS)
    echoing = [("<", rows[i - 1][1] + data) if mark == "<" else (mark, data) for i, (mark, data) in enumerate(rows)]
    assert first(*echoing) == "echo"
    untimed = [Chunk(None, "bus", 2 * READS[0], burst=True)]
    assert "echo" not in [c.suspicion.cause for c in diagnosed(untimed).causes]


# --- the line ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("spoil", "cause"),
    [
        (lambda line: received(line, inverted=True), "inverted_lines"),
        (lambda line: received(line, 0.5), "wrong_baud"),
        (lambda line: received(line, 2 / 3), "wrong_baud"),
        (lambda line: received(line, 115200 / 38400), "wrong_baud"),
        (lambda line: received(line, form=Format(7)), "wrong_parity"),
        (lambda line: received(line, form=Format(8, even=True)), "wrong_parity"),
    ],
)
@pytest.mark.parametrize("reads", [READS, LK_READS], ids=["mks", "lk"])
def test_a_line_that_is_set_up_wrongly(spoil, cause, reads):
    found = told(*(spoil(levels(frame)) for frame in reads))
    assert found, [spoil(levels(frame)).hex(" ") for frame in reads]
    assert found[0].cause == cause, found


def test_a_receiver_that_misses_the_first_start_bit():
    asked = [build(MODBUS, name, 1) for name in ("read_encoder_carry", "read_speed")]
    assert first(*(received(levels(frame), missed=1) for frame in asked)) == "lost_start"


# --- silence -------------------------------------------------------------------------------------------------------------


def test_nobody_answers():
    found = told(*((">", frame) for frame in READS))
    assert [each.cause for each in found] == ["no_reply"]
    assert "swapped" in found[0].next


def test_nobody_answers_at_any_of_some_addresses():
    found = told(*((">", build(NATIVE, name, at)) for at in (1, 2, 3) for name in ("read_speed", "read_encoder_carry")))
    assert [(each.cause, len(each.troubles), len(each.frames)) for each in found] == [("no_reply", 6, 6)]
    assert found[0].say.endswith("The same holds for 2, 3.")


def test_a_number_that_is_packed_in_too_few_bytes():
    good = [build(NATIVE, "read_speed", 1), bytes.fromhex("FB 01 32 00 00 2E")]
    rows = [(">", good[0]), ("<", good[1]), (">", bytes.fromhex("FA 01 FD 01 40 02 00 FA 00 35"))] * 2
    found = told(*rows)
    assert [each.cause for each in found] == ["wrong_length"]
    assert found[0].frames[0].right == "FA 01 FD 01 40 02 00 00 FA 00 35"


def test_another_address_answers():
    rows = [*exchanged("mks-rs485@1", *READS), (">", build(NATIVE, "read_speed", 2)), (">", build(NATIVE, "read_pulses", 2))]
    assert first(*rows, *exchanged("mks-rs485@1", *READS)) == "wrong_address"


def test_a_search_for_drives_is_no_wrong_address():
    rows = [(">", build(NATIVE, "read_speed", address)) for address in range(2, 9)]
    assert told(*rows, *exchanged("mks-rs485@1", *READS)) == []


def test_the_drive_speaks_another_dialect():
    speed = build(MODBUS, "read_speed", 1)
    rows = [*exchanged("mks-modbus@1", speed, speed, speed, speed), *((">", frame) for frame in READS)]
    assert first(*rows) == "wrong_dialect"


def test_a_drive_in_the_other_mode_gives_fragments_back():
    rows = [row for frame in READS for row in ((">", frame), ("<", frame[1:3]))]
    assert first(*rows) == "wrong_dialect"


@pytest.mark.parametrize("reply", ["< FB 05 8B 01 8C", "< FB 01 8B 01 88"])
def test_the_old_address_is_asked(reply):
    rows = ["> FA 01 8B 05 8B", reply, "> FA 01 30 2B", "> FA 01 32 2D", "> FA 01 33 2E"]
    assert first(*rows) == "address_changed"
    assert told(*rows[:2]) == []


def test_a_read_of_all_is_not_answered():
    assert first((">", build(NATIVE, "read_speed", 0))) == "broadcast_no_reply"
    # Of a register that the manual does not have, too.
    assert first("> 00 03 00 00 00 0A C4 1C") == "broadcast_no_reply"
    # And a write of one, where nothing else is asked.
    write = MODBUS.link.completed(bytes.fromhex("00 06 70 01 00 05"))
    assert first((">", write)) == "broadcast_no_reply"
    assert told((">", write), *exchanged("mks-modbus@1", build(MODBUS, "read_speed", 1))) == []


def test_motion_is_refused_in_pulse_mode():
    run = [build(NATIVE, "run_speed", 1, {"speed": speed, "acceleration": 2}) for speed in (100, 200, 300)]
    found = told(*exchanged("mks-rs485@1,work_mode=cr_vfoc", READS[1], *run))
    assert found[0].cause == "refused_mode"
    assert build(NATIVE, "set_work_mode", 1, {"work_mode": 5}).hex(" ").upper() in found[0].next


def test_replies_to_motion_are_switched_off():
    run = [build(NATIVE, "run_speed", 1, {"speed": speed, "acceleration": 2}) for speed in (100, 200, 300)]
    rows = exchanged("mks-rs485@1,work_mode=sr_vfoc,respond=0", READS[0], *run, READS[1], *run, READS[2])
    assert first(*rows) == "respond_off"


# --- content, dress, CAN -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("body", "cause", "right"),
    [
        ("01 03 00 32 00 01", "wrong_function", "01 04 00 32 00 01"),
        ("01 04 00 1E 00 03", "decimal_as_hex", "01 04 00 30 00 03"),
        ("01 04 00 35 00 01", "wrong_register", "01 04 00 34 00 01"),
        ("01 04 00 30 00 01", "wrong_length", "01 04 00 30 00 03"),
    ],
)
def test_registers(body, cause, right):
    data = bytes.fromhex(body)
    found = told((">", data + captures.crc16(data)))
    assert found[0].cause == cause
    assert found[0].frames[0].right.startswith(right)


def test_a_code_that_is_not_listed_and_not_answered():
    unknown = captures.sum8(bytes.fromhex("FA 01 2F"))
    asked, answered = bytes.fromhex("FA 01 2F") + unknown, bytes.fromhex("FB 01 2F 01 2C")
    assert first((">", asked), (">", asked)) == "unknown_command"
    assert first((">", asked), ("<", answered), (">", asked), ("<", answered)) != "unknown_command"


@pytest.mark.parametrize(
    ("row", "cause"),
    [
        ("> 46 41 30 31 33 30 32 42", "text_mode"),
        ("< EF BF BD 01 30 00 00 00 01 20 00 4D", "text_mode"),
        ("> C3 BA 01 30 2B", "text_mode"),
        ("> 00 01 00 00 00 06 01 04 00 30 00 03", "tcp_framing"),
    ],
)
def test_dresses(row, cause):
    assert first(row) == cause


def can(*rows):
    """Return CAN frames of rows `001#3031`; eight digits are an identifier of 29 bits, from 20000000 on an error frame."""
    found = []
    for number, row in enumerate(rows):
        name, _, data = row.partition("#")
        value = int(name, 16)
        error = bool(value & 0x20000000)
        extended = len(name) == 8 and not error
        found.append(CanFrame(number * MS, "can0", value & 0x1FFFFFFF, bytes.fromhex(data), extended=extended, error=error))
    return found


MS = 1_000_000
GOOD = ["001#3233", "001#32006497"]


@pytest.mark.parametrize(
    ("rows", "cause"),
    [
        (["20000020#0000000000000000"] * 3, "can_no_ack"),
        (["20000008#0000040000000000", "20000008#0000020000000000"], "can_wrong_bitrate"),
        ([*GOOD, "20000008#0000040000000000", *GOOD, "20000008#0000040000000000", *GOOD], "can_bit_errors"),
        (["20000008#0000040000000000"] + ["20000040#0000000000000000"] * 3, "can_bus_off"),
        (["141#9A00000000000000", "241#9A20000000000000"], "unsupported_dialect"),
        (["00000001#3031", "00000001#3233"], "can_extended_id"),
        (["001#8C008D", "001#8C018E", *GOOD], "wrong_length"),
        (GOOD, None),
    ],
)
def test_can(rows, cause):
    found = diagnosed(can(*rows)).causes
    assert (found[0].suspicion.cause if found else None) == cause


# --- silence of the diagnosis ---------------------------------------------------------------------------------------------


def generated(name, seed, frames):
    found = []
    for number, (address, data) in enumerate(islice(captures.exchanges(name, seed), frames)):
        t_ns = number * 5_000_000
        can = registry.get(name).bus == "can"
        found.append(CanFrame(t_ns, "bus", address, data) if can else Chunk(t_ns, "bus", data))
    return found


@pytest.mark.parametrize("name", registry.names())
def test_clean_traffic_is_not_accused(name):
    for seed in range(10):
        assert diagnosed(generated(name, seed, 60)).verdict == "ok"


@pytest.mark.parametrize("name", sorted(POLLS))
def test_what_is_in_order_has_no_cause(name):
    spoken = [registry.get(name)]
    for seed in range(10):
        rows = polls(name, random.Random(seed), 200)
        watch = watched([Chunk(number * 1_000_000, "bus", row.data) for number, row in enumerate(rows)], spoken)
        assert watch.quiet
        assert not diagnosis(watch, spoken).causes


def test_where_all_is_in_order_nothing_is_loaded_that_explains(tmp_path, capsys, monkeypatch):
    asked = []

    def weighed(scenes):
        asked.append(scenes)
        return weigh(scenes)

    weigh = diagnose.weighed
    monkeypatch.setattr(diagnose, "weighed", weighed)
    path = tmp_path / "polls.log"
    exchanges = "00:00:00.010 > FA 01 32 2D\n00:00:00.020 < FB 01 32 00 00 2E\n" * 100
    for further in ("", "the motor does not turn\n", "00:00:01.010 > FA 01 32 2E\n", "00:00:01.010 > FA 01 32 2D\n"):
        path.write_text(exchanges + further)
        assert main(["decode", "--dialect", "mks-rs485", "--force", str(path)]) == 0
        assert bool(asked) == bool(further)
        asked.clear()
    capsys.readouterr()


@pytest.mark.parametrize("name", ["mks-rs485", "mks-modbus", "lk-rs485"])
def test_noise_is_no_other_cause(name):
    for seed in range(10):
        chance = random.Random(seed)
        items = []
        for item in generated(name, seed, 100):
            data = bytearray(item.data)
            if chance.random() < 0.03:
                data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
            items.append(Chunk(item.t_ns, item.port, bytes(data)))
        assert {each.suspicion.cause for each in diagnosed(items).causes} <= {"noise"}


@pytest.mark.parametrize("path", sorted((ROOT / "captures").glob("*.log")), ids=lambda p: p.name)
def test_the_captures_are_accused_of_their_wrong_value_alone(path, capsys):
    main(["diagnose", "--json", str(path)])
    assert {each["cause"] for each in json.loads(capsys.readouterr().out)["causes"]} <= {"value_out_of_range"}


def test_two_senders_at_once_are_no_fault_of_a_check():
    line = both(levels(READS[0]), levels(READS[1][1:]))
    rows = exchanged("mks-rs485@1", *READS, *READS)
    assert "wrong_checksum" not in [each.cause for each in told(*rows, received(line), *rows)]


# --- the command ---------------------------------------------------------------------------------------------------------


def test_the_command_tells_people_and_programs(tmp_path, capsys):
    path = tmp_path / "a.txt"
    path.write_text("> FA 01 F6 00 00 02 F9\n")
    assert main(["diagnose", str(path)]) == 1
    assert "wrong_checksum_rule" in capsys.readouterr().out
    assert main(["diagnose", "--json", str(path), str(tmp_path / "none")]) == 2
    found, missing = map(json.loads, capsys.readouterr().out.splitlines())
    assert (found["verdict"], found["causes"][0]["cause"], found["causes"][0]["share"]) == ("trouble", "wrong_checksum_rule", 1)
    assert missing["verdict"] == "unreadable"


@pytest.mark.parametrize(
    ("capture", "says"),
    [
        (bytes(range(1, 200, 7)) * 3, "`servotap show FILE` marks each with !"),
        (b"(1.0) can0 701#05\n", "Record while a program talks to the drive"),
    ],
)
def test_without_a_cause_the_next_step_is_told(tmp_path, capsys, capture, says):
    (tmp_path / "x.log").write_bytes(capture)
    assert main(["diagnose", str(tmp_path / "x.log")]) == 0
    assert f"   next: {says}" in capsys.readouterr().out


def test_nothing_wrong_is_one_line(tmp_path, capsys):
    path = tmp_path / "a.txt"
    path.write_text("> FA 01 30 2B\n< FB 01 30 00 00 00 01 20 00 4D\n")
    assert main(["diagnose", str(path)]) == 0
    assert capsys.readouterr().out == "nothing wrong was found\n"


def test_each_cause_of_the_table_is_tested():
    own = "".join(path.read_text() for path in sorted(Path(__file__).parent.glob("test_*.py")))
    assert [cause for cause in CAUSES if f'"{cause}"' not in own] == []


def test_what_explains_nothing_stands_behind_what_explains_all():
    trouble = Trouble("unanswered", 0)
    nothing, silence = (
        Suspicion(cause, confidence, troubles, "", "", "")
        for cause, confidence, troubles in (
            ("two_masters", Confidence.CERTAIN, []),
            ("no_reply", Confidence.POSSIBLE, [trouble]),
        )
    )
    assert ranked([nothing, silence], [trouble])[0].suspicion is silence


@pytest.mark.parametrize(("code", "fields", "changed"), [("A2", 4, 0), ("A1", 2, 0), ("A3", 8, 1)])
def test_the_sum_of_the_fields_alone_is_missing(code, fields, changed):
    """The head counts the fields, and all of them are there; a request without fields has one sum, and is right."""
    head = bytes((0x3E, int(code, 16), 6, fields))
    asked, came = bytes.fromhex("3E 9A 06 00 DE"), bytes.fromhex("3E 9A 06 07 E5 21 68 09 00 00 00 00 92")
    rows = []
    for number in range(1, 5):
        data = bytearray(fields)
        data[changed] = 0x21 * number
        rows += [(">", asked), ("<", came), (">", bytes((*head, sum(head) & 0xFF, *data)))]
    found = told(*rows)
    assert (found[0].cause, found[0].frames[0].right[-2:]) == ("missing_checksum", "21")
