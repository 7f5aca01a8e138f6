"""A link of another package that fails: its dialect is left out and named once, and all other bytes are decoded."""

from __future__ import annotations

import copy
from dataclasses import replace

import pytest

from analyzer import dialects
from analyzer.catalogue import Role
from analyzer.diagnosis.diagnose import of_traffic
from analyzer.encoder import build
from analyzer.errors import PluginError
from analyzer.link import MORE, TIE, CanLink, HeadLink, guarded
from analyzer.pipeline import Pipeline
from analyzer.port import Options
from analyzer.records import CanFrame, Chunk, JunkReason
from analyzer.sinks.summary import Summary
from tests.collect import MS, Collect, sum8

HEADS = {0xAA: Role.REQUEST, 0x55: Role.REPLY}
#: Exchanges in the other dialect, then in ours; an unknown code and a reply that nothing asked for.
OTHER = [sum8(text) for text in ("AA 01 32", "55 01 32 00 64", "AA 01 0F", "55 01 F6 01", "AA 01 32", "55 01 32 00 64")]
OURS = [dialects.get("mks-rs485")]
OWN = [sum8(text) for text in ("FA 01 32", "FB 01 32 00 64", "FA 01 0F", "FB 01 F6 01")]


def fails(*asked, **named):
    raise ValueError("no\x1b")


def other(link, bus="serial"):
    """Return a dialect of another package."""
    own = dialects.get("mks-rs485" if bus == "serial" else "mks-can")
    return replace(own, name="other", link=guarded("other of servotap.dialects", link))


def of_heads(**methods):
    return other(type("Wrong", (HeadLink,), methods)(heads=HEADS))


def of_slicer(name, answer):
    def slicer(self, commands, expects):
        found = copy.copy(HeadLink.slicer(self, commands, expects))
        setattr(found, name, answer)
        return found

    return of_heads(slicer=slicer)


def items(*texts):
    return [Chunk(n * MS, "bus", bytes.fromhex(text), burst=True) for n, text in enumerate(texts)]


def read(chosen, chunks):
    sink, summary = Collect(), Summary()
    Pipeline(chosen, (sink, summary), Options()).run(chunks)
    frames = sum(len(e.message.frame.data) for e in sink.entries)
    assert frames + sum(len(j.data) for j in sink.pieces) == sum(len(c.data) for c in chunks)
    return sink


def test_a_link_that_serves_is_read_as_before(capsys):
    plain = replace(dialects.get("mks-rs485"), name="other", link=HeadLink(heads=HEADS))
    found = of_heads()
    assert isinstance(found.link, HeadLink)
    both = [read([each, *OURS], items(*OTHER, *OWN, "12 34", *OTHER)) for each in (plain, found)]
    assert both[0].shown == both[1].shown
    assert both[0].rules == both[1].rules
    assert len(both[1].entries) == 16
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("glued", [False, True])
@pytest.mark.parametrize(
    "found",
    [
        pytest.param(lambda: of_heads(slicer=fails), id="slicer"),
        pytest.param(lambda: of_heads(slicer=lambda *asked: None), id="no slicer"),
        pytest.param(lambda: of_heads(parse=fails), id="parse"),
        pytest.param(lambda: of_heads(parse=lambda *asked: ("address",)), id="no head"),
        pytest.param(lambda: of_heads(checks=fails), id="checks"),
        pytest.param(lambda: of_slicer("look", fails), id="look"),
        pytest.param(lambda: of_slicer("look", lambda *asked: None), id="no length"),
        pytest.param(lambda: of_slicer("look", lambda *asked: 5000), id="more than there is"),
        pytest.param(lambda: of_slicer("look", lambda *asked: MORE), id="more at the end"),
        pytest.param(lambda: of_slicer("look", lambda *asked: TIE), id="a tie of nothing"),
        pytest.param(lambda: of_slicer("lengths", fails), id="lengths"),
        pytest.param(lambda: of_slicer("damaged", fails), id="damaged"),
        pytest.param(lambda: of_slicer("starts", b"["), id="no pattern"),
        pytest.param(lambda: other(HeadLink(HEADS, check=lambda data: 1 // (len(data) - 5))), id="later"),
        pytest.param(lambda: other(HeadLink(HEADS, check=lambda data: exit(3))), id="exit"),
    ],
)
def test_a_link_that_fails_harms_its_own_bytes_alone(found, glued, capsys):
    dialect = found()
    texts = [*OTHER[:2], "AA 01 32 00", "AA 01", *OWN, *OTHER, *OWN]
    chunks = items(*(["".join(texts)] if glued else texts))
    sink, alone = read([dialect, *OURS], chunks), read(OURS, chunks)
    told = capsys.readouterr().err
    assert told.count("\n") <= 1
    own = [e.message.frame.data for e in sink.entries if e.message.frame.dialect is not dialect]
    assert own == [e.message.frame.data for e in alone.entries]
    assert bool(told) == bool(dialect.link.left_out)
    if told:
        assert told.startswith("servotap: other of servotap.dialects failed and is left out: ")
        assert "\x1b" not in told
        assert sink.pieces[-1].reason is JunkReason.LEFT_OUT
        assert "decoder_fault" in sink.rules


@pytest.mark.parametrize("method", ["parse", "checks", "fits"])
def test_frames_of_can_stay_frames_and_say_why_they_are_not_read(method, capsys):
    dialect = other(type("Wrong", (CanLink,), {method: fails})(), "can")
    frames = [CanFrame(n * MS, "can0", 1, bytes.fromhex("32 33" if n % 2 else "30 00")) for n in range(4)]
    sink = Collect()
    Pipeline([dialect], (sink,), Options()).run(frames)
    assert len(sink.entries) == 4
    assert capsys.readouterr().err.count("\n") == 1
    assert {e.topic for e in sink.entries if e.findings} == {"/can0/unknown"}
    assert sink.rules.count("decoder_fault") >= 3
    assert not sink.pieces
    both = Collect()
    Pipeline([dialect, dialects.get("mks-can")], (both,), Options()).run(frames)
    assert [e.message.frame.dialect.name for e in both.entries] == ["mks-can"] * 4


def test_what_is_sent_is_refused(capsys):
    dialect = of_heads(parse=fails, build=fails)
    command = dialect.by_name["read_speed"]
    for _ in range(2):
        with pytest.raises(PluginError, match=r"other of servotap.dialects failed: ValueError: no"):
            build(dialect, command, 1)
    with pytest.raises(PluginError):
        dialect.link.finder(dialect.commands)
    assert capsys.readouterr().err.count("\n") == 1


def test_a_finder_that_fails_never_says_that_nothing_is_there():
    class Wrong(HeadLink):
        def finder(self, commands):
            found = super().finder(commands)
            found.at = fails
            return found

    dialect = other(Wrong(HEADS))
    finder = dialect.link.finder(dialect.commands)
    with pytest.raises(PluginError):
        finder.at(b"\xaa\x01\x32\xdd", 0)
    with pytest.raises(PluginError):
        list(finder.checked(b"\xaa\x01\x32\xdd", 0, 4))


def test_a_dialect_that_is_left_out_has_no_troubles(capsys):
    dialect = of_heads(checks=fails, build=fails, completed=fails)
    found = of_traffic(items(*OTHER, "AA 01 32 00", *OWN, "FA 01 32 00"), [dialect, *OURS])
    assert found.troubles
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize("fact", [{"checked": None}, {"first_bytes": b""}, {"shortest": property(fails)}])
def test_what_a_link_is_is_asked_when_it_is_loaded(fact):
    with pytest.raises((TypeError, ValueError)):
        of_heads(**fact)


def test_our_own_links_are_not_guarded():
    for name in dialects._OWN:
        link = dialects.get(name).link
        assert type(link).__module__.startswith("analyzer.link.")
        assert not hasattr(type(link).parse, "__wrapped__")
