"""Seeds: the inputs that mutations of each target begin with, and how a mutation changes one.

A seed is what the libraries and this program write, or what showed a fault once (`corpus`). A change takes a source of chance,
an input and all seeds, and returns another input. `mutators` knows how bytes of each format change.
"""

from __future__ import annotations

import json
import random
import re
import shlex
import tempfile
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

from analyzer import dialects
from analyzer.catalogue import Role
from analyzer.reference.dbc import dbc
from analyzer.sources import FORMATS
from tests import CAPTURES
from tests.bytestreams import vectors
from tests.collect import sum8
from tests.fuzz.corpus import INPUT, Input, captures, quick
from tests.fuzz.mutators import SIZE_LIMIT, TOKENS, VALUES, bytes_changed, kind_of, mutated, text_changed
from tests.live.spooled import START, Spools, port
from tests.sources.builders import SAMPLES

# --- recordings -------------------------------------------------------------------------------------------------------

LOG = "out.mcap"


@cache
def recordings() -> list[Input]:
    """Return recordings that were killed: their logs and spools, some with nothing flushed yet, and a log alone."""
    found = []
    for seed, flushed in ((1, 0), (2, 20), (3, 45)):
        with tempfile.TemporaryDirectory() as folder:
            spools = Spools(
                folder, port("1-left", "left", byte_ns=260_416), port("2-arm", "arm", "can", ("mks-can",)), segment_size=900
            )
            for n in range(12 + seed):
                spools.data("1-left", 20 * n, sum8(f"FA {n + 1:02X} 32"))
                spools.data("1-left", 20 * n + 4, sum8(f"FB {n + 1:02X} 32 FE D4"))
                spools.can("2-arm", 20 * n + 2, "001#3031")
            spools.event("1-left", 400, "note", text="seen")
            if seed == 3:
                spools.end(500)
            spools.close()
            recording = spools.begin()
            for number, each in enumerate(recording.merger.take(START + 10**12)):
                if number == flushed:
                    break
                recording.take([each])
                if number % 10 == 9:
                    recording.flush()
            recording.abandon()
            files = {str(p.relative_to(folder)): p.read_bytes() for p in sorted(Path(folder).rglob("*")) if p.is_file()}
            found.append(files)
    return [*found, {LOG: found[2][LOG]}, {LOG: samples()["mcap"]}]


def recording_seeds() -> list[Input]:
    return [*recordings(), *quick("recover")]


#: Files that have no place in a folder of spools.
_STRAYS = (
    "notes.raw",
    "x.000000.raw",
    "1-left.000009.raw",
    "9-x.000001.raw",
    "-1-x.0.raw",
    "1-left.1e9.raw",
    "checkpoint.part",
)


def recording_changed(chance: random.Random, given: Input, others: Sequence[Input]) -> Input:
    """Damage some files of a recording, or drop, double or swap them."""
    files = dict(given)
    for _ in range(chance.choice((1, 1, 1, 2, 3))):
        name = chance.choice(sorted(files))
        act = chance.random()
        if act < 0.05 and len(files) > 1:
            del files[name]
        elif act < 0.09:
            other = chance.choice(sorted(files))
            files[name], files[other] = files[other], files[name]
        elif act < 0.13:
            stray = chance.choice(_STRAYS)
            files[f"{LOG}.spool/{stray}"] = files[name]
        elif act < 0.25:
            files[name] = files[name][: chance.randint(0, len(files[name]))]
        elif act < 0.3:
            start = chance.randint(0, len(files[name]))
            files[name] = files[name][:start] + bytes(len(files[name]) - start)
        else:
            files[name] = mutated(chance, files[name], kind=_kind(name, files[name]))
    return files


def bytes_of_recording_changed(chance: random.Random, given: Input, others: Sequence[Input]) -> Input:
    """Damage a file as a medium does: bits, zeros over a range, an end that is missing. No byte moves."""
    name = chance.choice(sorted(given))
    data = bytearray(given[name])
    at, count = chance.randrange(len(data)), chance.choice((1, 8, 100))
    act = chance.random()
    if act < 0.6:
        data[at] ^= 1 << chance.randrange(8)
    elif act < 0.8:
        data[at : at + count] = bytes(len(data[at : at + count]))
    else:
        del data[at:]
    return {**given, name: bytes(data)}


def _kind(name: str, data: bytes) -> str:
    return next((kind for part, kind in _KINDS.items() if part in name), None) or kind_of(data)


_KINDS = {"/checkpoint": "checkpoint", ".json": "json", ".raw": "spool"}


# --- captures ---------------------------------------------------------------------------------------------------------


@cache
def samples() -> dict[str, bytes]:
    """Return a small capture of each format, as the libraries write them."""
    with tempfile.TemporaryDirectory() as folder:
        return {name: sample.make(Path(folder)).read_bytes() for name, sample in SAMPLES.items()}


def file_seeds(*targets: str, kinds: Sequence[str] = ()) -> Callable[[], list[Input]]:
    """Return what gives the captures of some formats (of all), and what targets found before."""

    def seeds() -> list[Input]:
        made = [*captures(), *samples().values()]
        found = [given for target in targets for given in quick(target) if list(given) == [INPUT]]
        return [*({INPUT: data} for data in made if not kinds or kind_of(data) in kinds), *found]

    return seeds


def file_changed(chance: random.Random, given: Input, others: Sequence[Input]) -> Input:
    other = chance.choice(others)
    return {name: mutated(chance, data, other=other.get(INPUT, b"")) for name, data in given.items()}


def mf4_seeds() -> list[Input]:
    return [{INPUT: (CAPTURES / "mks_can.mf4").read_bytes()}, *quick("mf4")]


def bytes_seeds() -> list[Input]:
    frames = b"".join(frame for _, _, frame in vectors())
    return [{INPUT: frames[at : at + 150]} for at in range(0, len(frames), 100)] + quick("framer")


def frames_changed(chance: random.Random, given: Input, others: Sequence[Input]) -> Input:
    """Damage some frames in a row; most often few, as what is short is quick."""
    data = given[INPUT] + chance.choice(others)[INPUT]
    at, size = chance.randrange(len(data)), chance.choice((12, 25, 40, 60, 300))
    return {INPUT: bytes_changed(chance, data[at : at + size], 1 + size // 12)[:1000]}


_SENDERS = ("", "> ", "< ", "TX: ", "RX: ", "send ", "recv ")


def pastes() -> list[Input]:
    return [{INPUT: b"> FA 01 31 2C\n"}, *quick("troubles")]


def troubled(chance: random.Random, given: Input, others: Sequence[Input]) -> Input:
    """Write frames of the manuals and of any Modbus unit as lines of a paste, some of them as a bad line leaves them."""
    frames = [frame for _, _, frame in vectors()]
    marked, timed = chance.random() < 0.7, chance.random() < 0.5
    rows, t_ms = [], 0
    for _ in range(chance.choice((1, 2, 3, 6, 20))):
        unit, function = chance.choice((0, 1, 1, 2, 17, 247, 255)), chance.choice((1, 2, 3, 3, 4, 5, 6, 15, 16, 0x83, 0x90, 43))
        body = bytes((unit, function)) + chance.randbytes(chance.choice((1, 3, 4, 4, 5, 9, 13)))
        frame = chance.choice(frames) if chance.random() < 0.5 else dialects.get("mks-modbus").link.completed(body)
        for _ in range(chance.choice((1, 1, 2))):
            if chance.random() < 0.4:
                frame = chance.choice(_HURTS)(chance, frame)
            t_ms += chance.choice((0, 1, 5, 1000))
            rows.append(f"{t_ms / 1000:.3f} " * timed + chance.choice(_SENDERS) * marked + frame.hex(" "))
    return {INPUT: "\n".join(rows).encode() + b"\n"}


_HURTS: tuple[Callable[[random.Random, bytes], bytes], ...] = (
    lambda chance, frame: bytes(byte ^ 0xFF for byte in frame),
    lambda chance, frame: bytes(byte & 0x7F for byte in frame),
    lambda chance, frame: chance.choice((b"\0", b"\xff", b"\0\0", b"\xfe\xff")) + frame,
    lambda chance, frame: frame + chance.choice((b"\0", b"\xff", bytes(8), frame)),
    lambda chance, frame: frame[: chance.randrange(1, len(frame) + 1)],
    lambda chance, frame: frame[chance.randrange(len(frame)) :],
    lambda chance, frame: frame[:-1] + bytes((chance.randrange(256),)),
    lambda chance, frame: frame[:-2] + frame[:-3:-1],
    lambda chance, frame: frame.hex().encode(),
    lambda chance, frame: bytes_changed(chance, frame, 3) or b"\0",
)


def two_logs() -> list[Input]:
    logs = [samples()["mcap"], *(each[LOG] for each in recordings() if LOG in each)]
    return [{INPUT: a, "other": b} for a in logs for b in logs]


# --- command lines ----------------------------------------------------------------------------------------------------

#: Files that command lines can name.
FILES = {"c.log": "mks_rs485.log", "c.asc": "mks_can.asc", "c.blf": "mks_can.blf", "c.bin": "mks_modbus.bin", "c.mcap": ""}


LINES = Path(__file__).with_name("lines.txt")


_MOMENTS = ("5s", "+1:30", "-5min", "09:00:05", "2026-11-21T16:22:11Z", "0", "-0s", "1e9s", "+99999999h")


_WORDS = (
    *FILES, *_MOMENTS, "-", "--", "-o", "-h", "--json", "--force", "--limit", "--format", "--dialect", "--baud", "--filter",
    "--since", "--until", "--bus", "--ids", "--group", "--late", "--to", "--rate", "--fields", "--topics", "out", ".", "..",
    "none.log", "mks-can", "mks-rs485,mks-can", "hex", "all", "/dev/null", "/dev/full", "\udcff", "\udc80.log", "a" * 300,
    "x" * 5000, "((((((", "~" * 330, "not " * 300, "a.b" + ".c" * 450, "f(" * 200, "1" + "+1" * 600,
)  # fmt: skip


#: Commands that wait for a bus, a port or a person.
_WAITING = ("record", "tap", "emulate", "scan", "init", "stop", "test", "send", "replay", "restore", "rerun", "view")


def lines() -> dict[str, list[Input]]:
    """Return the command lines that mutations begin with, by target."""
    found: dict[str, list[Input]] = {"explain": [], "filter": [], "frame": [], "catalogue": [], "words": []}
    for line in LINES.read_text().splitlines():
        if not line.startswith("#"):
            words = shlex.split(line)
            name = "filter" if "--filter" in words else words[0] if words[0] in found else "words"
            found[name].append(_line(words))
    return found


def line_seeds(name: str) -> list[Input]:
    return [*lines()[name], *quick(name)]


def _line(words: Sequence[str]) -> Input:
    return {INPUT: json.dumps(list(words)).encode()}


def line_changed(chance: random.Random, given: Input, others: Sequence[Input]) -> Input:
    words = list(json.loads(given[INPUT]))
    for _ in range(chance.choice((1, 1, 2, 3))):
        at = chance.randint(1, len(words)) if len(words) > 1 else len(words)
        act = chance.random()
        if act < 0.2:
            words.insert(at, chance.choice((*_WORDS, *TOKENS)))
        elif act < 0.3 and at < len(words):
            del words[at]
        elif act < 0.4 and at < len(words):
            words[at] = chance.choice((*_WORDS, *TOKENS, *map(str, VALUES)))
        elif act < 0.5:
            words[at:at] = json.loads(chance.choice(others)[INPUT])[1:][: chance.randint(1, 3)]
        elif at < len(words):
            changed = text_changed(chance, words[at].encode("utf-8", "surrogateescape"))
            words[at] = changed.decode("utf-8", "surrogateescape")
    return _line(words) if _harmless(words) else given


def _harmless(words: Sequence[str]) -> bool:
    """Say whether a command line can run here: it names no file elsewhere, and waits for nothing."""
    named = [
        word
        for word in words
        if "/" in word and word not in ("/dev/null", "/dev/full") and not re.fullmatch(r"[^/.~]* / [^/.~]*", word)
    ]
    waits = bool(words) and words[0] in _WAITING and not {"--dry-run", "--help", "-h", "--list"} & set(words)
    return not named and not waits and words[:1] != ["_ARGCOMPLETE"]


@cache
def capture_of(name: str) -> bytes:
    return (CAPTURES / name).read_bytes() if name else samples()["mcap"]


# --- logic analyzers, devices, captures with a further file -----------------------------------------------------------


def levels_seeds() -> list[Input]:
    """Return captures of a logic analyzer in each format, made and real, and what was found before."""
    with tempfile.TemporaryDirectory() as folder:
        made = [sample.make(Path(folder)).read_bytes() for sample in SAMPLES.values() if FORMATS[sample.format].levels]
    real = [path.read_bytes() for path in sorted((CAPTURES / "logic").glob("*.sr")) if path.stat().st_size < 4096]
    return [*({INPUT: data} for data in (*made, *real)), *quick("levels")]


#: Files of devices, and captures of such devices.
DEVICES = CAPTURES / "devices"


def device_seeds() -> list[Input]:
    from cantools.database import load_file

    own = [(DEVICES / name).read_bytes() for name in ("battery.dbc", "meter.csv")]
    kcd = load_file(DEVICES / "battery.dbc").as_kcd_string().encode()
    return [
        *({INPUT: data} for data in (*own, kcd, dbc(dialects.get("mks-can"), [1], Role.REPLY).encode())),
        *quick("device-files"),
    ]


def rows_changed(chance: random.Random, given: Input, others: Sequence[Input]) -> Input:
    lines = given[INPUT].split(b"\n")
    for _ in range(chance.choice((1, 1, 2, 5))):
        at, act = chance.randrange(len(lines)), chance.random()
        if act < 0.6:
            lines[at] = text_changed(chance, lines[at])
        elif act < 0.8:
            lines.insert(at, chance.choice(chance.choice(others)[INPUT].split(b"\n")))
        elif len(lines) > 1:
            del lines[at]
    return {INPUT: b"\n".join(lines)[:SIZE_LIMIT]}


def captures_with(name: str, *targets: str) -> Callable[[], list[Input]]:
    """Return seeds that are captures with a further file, of bytes, and what targets found before."""

    def seeds() -> list[Input]:
        found = [given for target in targets for given in quick(target)]
        return [
            *({**given, name: bytes(range(at % 200, at % 200 + 40))} for at, given in enumerate(file_seeds("decode")())),
            *found,
        ]

    return seeds
