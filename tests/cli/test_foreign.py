"""Other nodes on a bus, as the commands show them: identifiers in hexadecimal, who else spoke and how much, --ids."""

from __future__ import annotations

import json

import pytest

from analyzer import dialects
from analyzer.cli import main, option_types
from analyzer.errors import UsageError
from analyzer.pipeline import Pipeline
from analyzer.records import CanFrame
from analyzer.sinks.summary import MOST_OTHERS, Summary

MIXED = """\
(1700000000.000000) can0 012#3244
(1700000000.001000) can0 012#32004084
(1700000000.002000) can0 701#05
(1700000000.003000) can0 701#05
(1700000000.004000) can0 18FEF100#0102030405060708
(1700000000.005000) can0 141#30000000000000000000
(1700000000.006000) can0 012#32004000
"""


@pytest.fixture
def mixed(tmp_path):
    path = tmp_path / "mixed.log"
    path.write_text(MIXED)
    return str(path)


def lines_of(capsys, *words):
    assert main(list(words)) == 0
    return capsys.readouterr().out.splitlines()


def test_show_has_identifiers_in_hexadecimal(mixed, capsys):
    rows = [line.split() for line in lines_of(capsys, "show", mixed, "--utc") if line.startswith("22:")]
    assert [row[2] for row in rows] == ["0x012", "0x012", "0x701", "0x701", "0x18FEF100", "0x141", "0x012"]
    assert rows[4][3:] == ["foreign", "[18FEF100", "01", "02", "03", "04", "05", "06", "07", "08]"]


def test_foreign_frames_can_be_left_out(mixed, capsys):
    shown = lines_of(capsys, "show", mixed, "--filter", 'role != "foreign"')
    assert sum("0x012" in line and "read_speed" in line for line in shown) == 3
    assert any("bad_checksum" in line for line in shown)
    assert not any("0x701" in line for line in shown)
    assert sum("0x18FEF100" in line for line in lines_of(capsys, "show", mixed, "--filter", "address == 0x18FEF100")) == 1


def test_the_summary_says_who_else_spoke_and_how_much(mixed, tmp_path, capsys):
    out = lines_of(capsys, "decode", mixed, "-o", str(tmp_path / "a.mcap"))
    table = out.index(next(line for line in out if "not of this dialect" in line))
    assert out[table + 1].split() == ["can0", "0x701", "2", "28.6", "%", "333.3", "2"]
    assert {line.split()[1] for line in out[table + 2 : table + 4]} == {"0x141", "0x18FEF100"}
    assert any("/can0/18/read_speed/reply #7" in line and ", 0x012: checksum" in line for line in out)
    summary = json.loads(lines_of(capsys, "decode", mixed, "-o", str(tmp_path / "b.mcap"), "--json")[0])
    assert summary["others"][0] == {"bus": "can0", "who": "0x701", "frames": 2, "bytes": 2}
    assert {row["address"] for row in summary["commands"]} == {"18"}
    assert summary["bytes"]["total"] == 2 + 4 + 2 + 8 + 10 + 4


def test_nothing_is_lost_in_the_log(mixed, tmp_path, capsys):
    log = str(tmp_path / "a.mcap")
    main(["decode", mixed, "-o", log])
    capsys.readouterr()
    assert lines_of(capsys, "show", log, "--utc") == lines_of(capsys, "show", mixed, "--utc")


def test_the_user_says_who_is_a_drive(mixed, capsys):
    shown = lines_of(capsys, "show", mixed, "--ids", "0x100-0x14F")
    assert sum("foreign" in line for line in shown) == 6
    assert any("0x141" in line and "read_encoder" in line for line in shown)
    assert lines_of(capsys, "show", mixed, "--ids", "can0=0x141") == lines_of(capsys, "show", mixed, "--ids", "0x141")
    assert sum("foreign" in line for line in lines_of(capsys, "show", mixed, "--ids", "can9=0x141")) == 4


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1,x", "--ids: got 'x', expected addresses from 0 to 2047"),
        ("0x18FEF100", "an identifier of 29 bits: drives have 11, 0x7FF at most"),
        ("9-1", "got '9-1'"),
        ("", "got ''"),
    ],
)
def test_ids_that_are_none(text, said):
    with pytest.raises(UsageError, match=said):
        option_types.ids_of([text])


def test_ids_by_bus_and_for_all_others():
    ids = option_types.ids_of(["1,0x10-0x12", "arm=7", "arm=8"])
    assert ids.of("left") == {1, 0x10, 0x11, 0x12}
    assert ids.of("arm") == {7, 8}
    assert option_types.ids_of([]).of("arm") is None


def test_as_many_identifiers_as_one_likes_take_no_more_memory():
    sink = Summary()
    frames = [CanFrame(n, "can0", n, b"\1", extended=True) for n in range(MOST_OTHERS + 50)]
    Pipeline([dialects.get("mks-can")], (sink,)).run(frames)
    assert len(sink.others) == MOST_OTHERS + 1
    assert sink.others["can0", "further"] == [50, 50]


def test_a_node_that_no_checksum_speaks_for_is_named(mixed, tmp_path, capsys):
    wrong = "".join(f"(1700000001.00{n}000) can0 2{n // 4}0#300000000000000{n}\n" for n in range(1, 6))
    (tmp_path / "more.log").write_text(MIXED + wrong)
    out = lines_of(capsys, "decode", str(tmp_path / "more.log"))
    said = [line for line in out if "--ids says who is a drive" in line]
    assert said == ["can0 0x200: none of 3 frames has a fitting checksum: another node? --ids says who is a drive"]


def test_check_judges_drives_alone(mixed, cli):
    out = cli("check", mixed, status=1).out
    assert "3 frames, 1 request, 3 CAN frames, 2 replies, 4 not of this dialect" in out
    assert "address 0x012, checksum: expected 84, got 00" in out
