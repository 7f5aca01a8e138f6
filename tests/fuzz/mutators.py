"""Mutators: a valid capture becomes a damaged one whose damage lies inside its containers.

A format is a head and pieces (lines, blocks, records, objects). Pieces are dropped, doubled, swapped and changed; then lengths
and checksums are made to fit again, but now and then. What is inside a piece is changed by its own format: the records of
an MCAP chunk, the objects of a BLF container, what a gzip layer holds. Random bytes alone hardly get past the first check.
"""

from __future__ import annotations

import dataclasses
import gzip
import io
import json
import random
import re
import struct
import warnings
import zipfile
import zlib
from collections.abc import Callable
from typing import Any, NamedTuple

import lz4.frame
import mcap.records
import msgspec
import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.writer import CompressionType, Writer

from analyzer.live import spool

Chance = random.Random
#: Whole inputs stay below this.
SIZE_LIMIT = 64 << 10

NUMBERS = (
    0, 1, 2, 5, 7, 8, 9, 64, 127, 128, 255, 256, 4095, 32767, 65535, 65536, (1 << 29) - 1, 1 << 29, (1 << 31) - 1, 1 << 31,
    (1 << 32) - 1, 1 << 32, (1 << 53) + 1, (1 << 63) - 1, 1 << 63, (1 << 64) - 1, 10**30, -1, -2, -128, -(1 << 63),
)  # fmt: skip
#: In text: numbers that are none, too great, or written in another way.
TOKENS = (
    "", "0", "-1", "1e308", "1e999", "-1e308", "nan", "inf", "0x", "0xFF", "99999999999999999999", "1" * 5000, "1_000", "٣",
    "½", "1.", ".5", "1,5", "00000000000", "-0", "+1", "24:60:61", "2023-02-30", "9999-12-31T23:59:59", "0001-01-01T00:00:00",
    "[", "]", "{", "}", "(", ")", "<", ">", "#", "##", "\"", "'", "\\", "|", ",", ";", ":", "=", "%", "%s", "{}", "~",
    "FA 01 32 2D", "3E 9A 01 01 DA", "can0", "Rx", "Tx", "DLC", "[bold]", "[/]", "<b>", "\x1b[31m", "\x1b]0;x\x07", "\x9b31m",
    "\ufeff", "\u202e", "\u2028", "\U0001f600", "e\u0301" * 9, "../..", "/", "None",
)  # fmt: skip
#: What ends a line for some and for others does not, and bytes that are no UTF-8.
BREAKS = (
    b"\x1e", b"\x1c", b"\x0b", b"\x0c", b"\x85", b"\xc2\x85", b"\xe2\x80\xa8", b"\r", b"\r\n", b"\n", b"\n\n", b"\0", b"\x1a",
    b"\x1b[2J", b"\x9b", b"\xff", b"\xfe\xff", b"\xc3", b"\xed\xa0\x80", b"\xf4\x90\x80\x80", b"\t", b" " * 300,
)  # fmt: skip


class Container(NamedTuple):
    """A format of pieces. `join` takes what `split` gave; `change` makes a piece another one of the same kind."""

    split: Callable[[bytes], tuple[bytes, list[bytes]]]
    join: Callable[[Chance, bytes, list[bytes]], bytes]
    change: Callable[[Chance, bytes], bytes]


def mutated(chance: Chance, data: bytes, *, kind: str | None = None, other: bytes = b"") -> bytes:
    """Return another capture. `kind`: its format, found from its bytes if None. `other`: where foreign pieces come from."""
    kind = kind or kind_of(data)
    container = CONTAINERS.get(kind)
    dice = chance.random()
    if container is None or dice < 0.06:
        return bytes_changed(chance, data)[:SIZE_LIMIT]
    if dice < 0.08:
        return packed(chance, mutated(chance, data, kind=kind))
    head, pieces = container.split(data)
    if dice < 0.12 and head:
        head = bytes_changed(chance, head, 1)
    foreign = container.split(other)[1] if other and kind_of(other) == kind else []
    pieces = pieces_changed(chance, pieces, container.change, foreign)
    return container.join(chance, head, pieces)[:SIZE_LIMIT]


def kind_of(data: bytes) -> str:
    """Return the format of a capture, as a key of CONTAINERS; empty for bytes without pieces."""
    for magic, kind in _MAGICS:
        if data.startswith(magic):
            return kind
    text = sum(32 <= b < 127 or b in b"\t\r\n" for b in data[:2000])
    return "text" if text > 0.8 * len(data[:2000]) else ""


def pieces_changed(
    chance: Chance, pieces: list[bytes], change: Callable[[Chance, bytes], bytes], foreign: list[bytes]
) -> list[bytes]:
    """Drop, double, move and change some pieces."""
    pieces = list(pieces)
    if len(pieces) > 8 and chance.random() < 0.8:
        # A short input is quick to run, and has a fault as often as a long one.
        first = chance.randrange(3)
        stop = chance.randint(first + 1, min(len(pieces), 16))
        pieces = pieces[:first] + pieces[-(stop - first) :] if chance.random() < 0.2 else pieces[: max(stop, 4)]
    for _ in range(chance.choice((1, 1, 1, 2, 2, 3, 5, 9))):
        if not pieces:
            break
        # Most often a piece of the front, which decides how the others are read.
        at = chance.randrange(len(pieces)) if chance.random() < 0.7 else chance.randrange(min(4, len(pieces)))
        act = chance.random()
        if act < 0.70 or len(pieces) == 1:
            pieces[at] = change(chance, pieces[at])
        elif act < 0.78:
            del pieces[at]
        elif act < 0.86:
            to = chance.randrange(len(pieces))
            pieces[at], pieces[to] = pieces[to], pieces[at]
        elif act < 0.90:
            pieces[at:at] = [pieces[at]] * chance.choice((1, 2, 40))
        elif act < 0.95 and foreign:
            pieces.insert(at, chance.choice(foreign))
        else:
            pieces.insert(at, bytes_changed(chance, pieces[at]))
        pieces = [piece for piece in pieces if piece]
    return pieces


# --- bytes ----------------------------------------------------------------------------------------------------------


def bytes_changed(chance: Chance, data: bytes, most: int = 4) -> bytes:
    """Flip, replace, insert, delete or repeat bytes at some places."""
    changed = bytearray(data)
    for _ in range(chance.randint(1, most)):
        at = chance.randint(0, len(changed))
        act = chance.randrange(8)
        count = chance.choice((1, 1, 2, 4, 8, 30))
        if act <= 1 and at < len(changed):
            changed[at] ^= 1 << chance.randrange(8)
        elif act == 2:
            changed[at : at + 1] = bytes((chance.choice((0, 1, 0x7F, 0x80, 0xFF, chance.randrange(256))),))
        elif act == 3:
            width = chance.choice((2, 4, 8))
            number = chance.choice(NUMBERS) & ((1 << 8 * width) - 1)
            changed[at : at + width] = number.to_bytes(width, chance.choice(("little", "big")))
        elif act == 4:
            changed[at:at] = chance.randbytes(count)
        elif act == 5:
            del changed[at : at + count]
        elif act == 6:
            changed[at:at] = changed[at : at + count] * chance.choice((1, 2, 50))
        elif chance.random() < 0.3:
            del changed[at:]
        else:
            changed[at : at + count] = bytes((chance.choice((0, 0xFF, 0x1B, 0x5A)),)) * count
    return bytes(changed)


def number_changed(chance: Chance, piece: bytes, fields: str, order: str = "<") -> bytes:
    """Change one field of a piece's head. `fields`: letters of `struct`, as `HHLL`."""
    places = [(struct.calcsize(order + fields[:n]), letter) for n, letter in enumerate(fields) if letter not in "xs"]
    at, letter = chance.choice(places)
    size = struct.calcsize(order + letter)
    number = (
        chance.choice(NUMBERS)
        if chance.random() < 0.7
        else int.from_bytes(piece[at : at + size], "little") + chance.choice((-1, 1, 4))
    )
    made = (number & ((1 << 8 * size) - 1)).to_bytes(size, "little" if order == "<" else "big")
    return piece[:at] + made + piece[at + size :] if at + size <= len(piece) else bytes_changed(chance, piece)


# --- text -----------------------------------------------------------------------------------------------------------

_TOKEN = re.compile(rb"[0-9A-Fa-f]+|[A-Za-z_]+|\s+|.", re.DOTALL)


def _lines(data: bytes) -> tuple[bytes, list[bytes]]:
    return b"", data.splitlines(keepends=True)


def text_changed(chance: Chance, text: bytes) -> bytes:
    """Change some tokens of a line."""
    tokens = _TOKEN.findall(text) or [b""]
    for _ in range(chance.choice((1, 1, 2, 4))):
        at = chance.randrange(len(tokens))
        act = chance.random()
        if act < 0.35:
            tokens[at] = chance.choice(TOKENS).encode("utf-8", "surrogatepass")
        elif act < 0.5:
            tokens.insert(at, chance.choice(BREAKS))
        elif act < 0.6:
            to = chance.randrange(len(tokens))
            tokens[at], tokens[to] = tokens[to], tokens[at]
        elif act < 0.7:
            tokens[at] = b""
        elif act < 0.8:
            tokens[at] *= chance.choice((2, 3, 30, 400))
        elif act < 0.9 and tokens[at].isdigit():
            tokens[at] = b"%d" % (int(tokens[at][:400]) + chance.choice((-1, 1, 10, 1000)))
        else:
            tokens[at] = bytes_changed(chance, tokens[at], 1)
    return b"".join(tokens)


def _joined_lines(chance: Chance, head: bytes, lines: list[bytes]) -> bytes:
    whole = head + b"".join(lines)
    dice = chance.random()
    if dice < 0.03:
        return whole.replace(b"\n", chance.choice((b"\r", b"\r\n", b"\x1e", b"\n\n")))
    if dice < 0.05:
        return whole.decode("latin-1").encode(chance.choice(("utf-16", "utf-16-le", "utf-32", "utf-8-sig", "utf-7")))
    return whole


# --- values: JSON, checkpoints --------------------------------------------------------------------------------------------

VALUES: tuple[Any, ...] = (
    None, True, False, 0, 1, -1, 5, 1.5, -1e308, 1e308, (1 << 53) + 1, 1 << 63, -(1 << 63), "", "x", "\x1b[31m", "0",
    "mks-can", "serial", "a" * 3000, "\u2028", "/dev/null", "../x", [], [1], ["x"], {}, {"": 1}, [[[[[]]]]], {"a": {"b": {}}},
)  # fmt: skip


def tree_changed(chance: Chance, tree: Any) -> Any:
    """Return a tree with one node replaced, dropped or renamed."""
    if isinstance(tree, dict) and tree and chance.random() < 0.97:
        key = chance.choice(list(tree))
        act = chance.random()
        if act < 0.06:
            return {k: v for k, v in tree.items() if k != key}
        if act < 0.1:
            return {(chance.choice(TOKENS) if k == key else k): v for k, v in tree.items()}
        return {k: tree_changed(chance, v) if k == key else v for k, v in tree.items()}
    if isinstance(tree, list) and tree and chance.random() < 0.9:
        at = chance.randrange(len(tree))
        act = chance.random()
        if act < 0.2:
            return tree[:at] + tree[at + 1 :]
        if act < 0.3:
            return tree + [tree[at]] * chance.choice((1, 100))
        return [tree_changed(chance, v) if n == at else v for n, v in enumerate(tree)]
    if isinstance(tree, int) and not isinstance(tree, bool) and chance.random() < 0.75:
        return chance.choice((*NUMBERS[:-4], tree + 1, tree - 1, -tree, tree * 1000))
    if isinstance(tree, str) and tree and chance.random() < 0.7:
        return text_changed(chance, tree.encode("utf-8", "replace")).decode("utf-8", "replace")
    if isinstance(tree, bytes) and tree and chance.random() < 0.9:
        return bytes_changed(chance, tree)
    return chance.choice(VALUES)


def json_changed(chance: Chance, data: bytes) -> bytes:
    """Change a value of JSON, or its text."""
    try:
        tree = json.loads(data)
    except (ValueError, RecursionError):
        return text_changed(chance, data)
    dice = chance.random()
    if dice < 0.05:
        return b"[" * 3000 + data
    if dice < 0.12:
        return text_changed(chance, data)
    return json.dumps(tree_changed(chance, tree)).encode()


def checkpoint_changed(chance: Chance, data: bytes) -> bytes:
    """Change a value of a checkpoint (msgpack behind its CRC), or its bytes."""
    dice = chance.random()
    if dice < 0.1:
        return bytes_changed(chance, data)
    try:
        body = msgspec.msgpack.encode(tree_changed(chance, msgspec.msgpack.decode(data[4:])))
    except (msgspec.MsgspecError, OverflowError, TypeError, ValueError):
        body = bytes_changed(chance, data[4:])
    return zlib.crc32(body).to_bytes(4, "little") + body


# --- gzip and zstd layers ---------------------------------------------------------------------------------------------


def _swollen(chance: Chance, data: bytes) -> bytes:
    """Return data that is to be packed; now and then it is a thousand times as long once unpacked."""
    if chance.random() > 0.01:
        return data
    part = chance.choice((b"\0", data[-chance.randint(1, 200) :], data)) or b"\0"
    return data + part * (chance.choice((1 << 19, 1 << 21)) // len(part))


def packed(chance: Chance, data: bytes) -> bytes:
    """Compress, now and then not to the end, twice or with something behind it."""
    data = _swollen(chance, data)
    pack: Callable[[bytes], bytes] = chance.choice(
        (lambda d: gzip.compress(d, 1, mtime=0), zstandard.ZstdCompressor().compress)
    )
    dice = chance.random()
    whole = pack(data)
    if dice < 0.15:
        return whole[: chance.randint(2, len(whole))]
    if dice < 0.3:
        return whole + pack(data[: chance.randint(0, len(data))])
    if dice < 0.4:
        return whole + chance.randbytes(9)
    return bytes_changed(chance, whole, 1) if dice < 0.6 else pack(whole) if dice < 0.65 else whole


def _unpacked(data: bytes) -> tuple[bytes, list[bytes]]:
    try:
        if data.startswith(b"\x1f\x8b"):
            return b"", [zlib.decompressobj(31).decompress(data, 1 << 20)]
        return b"", [zstandard.ZstdDecompressor().decompressobj().decompress(data)[: 1 << 20]]
    except (zlib.error, zstandard.ZstdError):
        return b"", [data]


def _inside(chance: Chance, data: bytes) -> bytes:
    # What could not be unpacked is still packed.
    return bytes_changed(chance, data) if kind_of(data) == "packed" else mutated(chance, data)


def _packed(chance: Chance, head: bytes, pieces: list[bytes]) -> bytes:
    return packed(chance, head + b"".join(pieces))


# --- BLF ------------------------------------------------------------------------------------------------------------

_BLF_CONTAINER = 10
_BLF_HEAD = 16
#: After the signature: header size and version, object size and type; then flags, client, version, time; then the frame.
_BLF_FIELDS = "xxxxHHLLLHHQHBBLQQ"


def _objects(data: bytes) -> list[bytes]:
    return [b"LOBJ" + piece for piece in data.split(b"LOBJ")[1:]]


def _blf_split(data: bytes) -> tuple[bytes, list[bytes]]:
    size = struct.unpack_from("<L", data, 4)[0] if len(data) >= 8 else 0
    return data[:size], _objects(data[size:])


def _blf_join(chance: Chance, head: bytes, pieces: list[bytes]) -> bytes:
    return head + b"".join(pieces)


def _blf_changed(chance: Chance, piece: bytes) -> bytes:
    kind = struct.unpack_from("<L", piece, 12)[0] if len(piece) >= 32 else 0
    if kind == _BLF_CONTAINER and chance.random() < 0.85:
        try:
            inner = zlib.decompress(piece[32:]) if piece[16] == 2 else piece[32:]
        except zlib.error:
            return bytes_changed(chance, piece)
        return blf_container(chance, b"".join(pieces_changed(chance, _objects(inner), _blf_changed, [])))
    if chance.random() < 0.6:
        return number_changed(chance, piece, _BLF_FIELDS)
    tail = bytes_changed(chance, piece[_BLF_HEAD:])
    size = _BLF_HEAD + len(tail) if chance.random() < 0.8 else chance.choice(NUMBERS) & 0xFFFFFFFF
    return piece[:8] + struct.pack("<L", size) + piece[12:16] + tail


def blf_container(chance: Chance, inner: bytes) -> bytes:
    """Return objects in a container; its method and sizes are wrong now and then."""
    method = chance.choice((2, 2, 2, 2, 0))
    inner = _swollen(chance, inner)
    data = zlib.compress(inner, 1) if method == 2 else inner
    if chance.random() < 0.05:
        method = chance.choice((0, 1, 2, 3))
    size = len(inner) if chance.random() < 0.85 else chance.choice(NUMBERS) & 0xFFFFFFFF
    whole = 32 + len(data) if chance.random() < 0.95 else chance.choice(NUMBERS) & 0xFFFFFFFF
    made = struct.pack("<4sHHLLH6xL4x", b"LOBJ", 16, 1, whole, _BLF_CONTAINER, method, size) + data
    return made + bytes(len(data) % 4)


# --- pcap and pcapng ------------------------------------------------------------------------------------------------


def _pcap_split(data: bytes) -> tuple[bytes, list[bytes]]:
    order = "<" if data[:1] in (b"\xd4", b"\x4d") else ">"
    pieces, at = [], 24
    while at + 16 <= len(data):
        stop = at + 16 + struct.unpack_from(order + "L", data, at + 8)[0]
        pieces.append(data[at:stop])
        at = stop
    return data[:24], pieces


def _pcap_changed(chance: Chance, piece: bytes) -> bytes:
    if chance.random() < 0.4:
        return number_changed(chance, piece, "LLLL")
    data = bytes_changed(chance, piece[16:], 2)
    return piece[:8] + struct.pack("<LL", len(data), max(len(data), chance.choice((0, len(data), 1 << 31)))) + data


def _pcapng_split(data: bytes) -> tuple[bytes, list[bytes]]:
    order = "<" if data[8:9] == b"\x4d" else ">"
    pieces, at = [], 0
    while at + 12 <= len(data):
        size = struct.unpack_from(order + "L", data, at + 4)[0]
        if size < 12:
            break
        pieces.append(data[at : at + size])
        at += size
    return b"", pieces


def _pcapng_changed(chance: Chance, piece: bytes) -> bytes:
    kind, body = piece[:4], piece[8:-4]
    dice = chance.random()
    if dice < 0.2:
        return number_changed(chance, piece, "LLLLLLL")
    if dice < 0.3:
        kind = struct.pack("<L", chance.choice((1, 2, 3, 4, 5, 6, 10, 0x0A0D0D0A, 0xBAD)))
    elif dice < 0.55:
        # An option, the last of which may miss its end.
        text = chance.choice(TOKENS).encode("utf-8", "surrogatepass")
        body += struct.pack("<HH", chance.choice((0, 1, 2, 9, 14, 0x8BAD)), len(text)) + text + bytes(-len(text) % 4)
    elif dice < 0.75:
        body = number_changed(chance, body, "LLLLL")
    else:
        body = bytes_changed(chance, body, 2)
    body += bytes(-len(body) % 4)
    size = struct.pack("<L", len(body) + 12 if chance.random() < 0.95 else chance.choice(NUMBERS) & 0xFFFFFFFF)
    return kind + size + body + size


# --- MCAP -----------------------------------------------------------------------------------------------------------

_MCAP_MAGIC = b"\x89MCAP0\r\n"
_MCAP_HEAD = struct.Struct("<BQ")
_CLASSES: dict[int, Any] = {
    Opcode.HEADER: mcap.records.Header, Opcode.SCHEMA: mcap.records.Schema, Opcode.CHANNEL: mcap.records.Channel,
    Opcode.METADATA: mcap.records.Metadata, Opcode.DATA_END: mcap.records.DataEnd, Opcode.FOOTER: mcap.records.Footer,
    Opcode.STATISTICS: mcap.records.Statistics, Opcode.CHUNK_INDEX: mcap.records.ChunkIndex,
    Opcode.SUMMARY_OFFSET: mcap.records.SummaryOffset, Opcode.MESSAGE_INDEX: mcap.records.MessageIndex,
    Opcode.METADATA_INDEX: mcap.records.MetadataIndex,
}  # fmt: skip
_PACKING: dict[str, Callable[[bytes], bytes]] = {
    "zstd": lambda data: zstandard.ZstdCompressor(1).compress(data),
    "lz4": lz4.frame.compress,
    "": bytes,
}
_UNPACKING: dict[str, Callable[[bytes], bytes]] = {
    "zstd": lambda data: zstandard.ZstdDecompressor().decompress(data, 1 << 20),
    "lz4": lz4.frame.decompress,
    "": bytes,
}


def _records(data: bytes) -> list[bytes]:
    pieces, at = [], 0
    while at + 9 <= len(data):
        stop = at + 9 + _MCAP_HEAD.unpack_from(data, at)[1]
        pieces.append(data[at:stop])
        at = stop
    return pieces


def _mcap_split(data: bytes) -> tuple[bytes, list[bytes]]:
    return data[:8], _records(data[8:].removesuffix(_MCAP_MAGIC))


def _mcap_join(chance: Chance, head: bytes, pieces: list[bytes]) -> bytes:
    dice = chance.random()
    if dice < 0.3 and (rebuilt := _rewritten(chance, pieces)):
        return rebuilt
    if dice < 0.5:
        # Not finished: a recording that was killed has no summary.
        ends = [n for n, piece in enumerate(pieces) if piece[0] == Opcode.DATA_END]
        return head + b"".join(pieces[: ends[0]] if ends else pieces)
    return head + b"".join(pieces) + _MCAP_MAGIC


def record(opcode: int, content: bytes) -> bytes:
    """Return an MCAP record."""
    return _MCAP_HEAD.pack(opcode, len(content)) + content


def _mcap_changed(chance: Chance, piece: bytes) -> bytes:
    opcode, content = piece[0], piece[9:]
    dice = chance.random()
    if dice < 0.05:
        return number_changed(chance, piece, "BQ")
    if dice < 0.12:
        return record(opcode, bytes_changed(chance, content, 1))
    if opcode == Opcode.CHUNK:
        return _chunk_changed(chance, piece)
    if opcode == Opcode.MESSAGE:
        if dice < 0.3:
            return record(opcode, number_changed(chance, content, "HLQQ"))
        return record(opcode, content[:22] + json_changed(chance, content[22:]))
    kind = _CLASSES.get(opcode)
    if kind is None:
        return record(opcode, bytes_changed(chance, content, 1))
    try:
        stream = ReadDataStream(io.BytesIO(content))
        read = kind.read(stream)
        field = chance.choice(dataclasses.fields(read)).name
        builder = RecordBuilder()
        dataclasses.replace(read, **{field: _field_changed(chance, getattr(read, field))}).write(builder)
        return builder.end()
    except (McapError, struct.error, UnicodeError, TypeError, ValueError, AttributeError, OverflowError):
        return record(opcode, bytes_changed(chance, content, 1))


def _field_changed(chance: Chance, value: Any) -> Any:
    if isinstance(value, dict) and value:
        key = chance.choice(list(value))
        if isinstance(key, str):
            return {**value, key: chance.choice((*TOKENS, "true", "can", "serial", '["x"]', "{}"))}
        return {**value, key: chance.choice(NUMBERS) & 0xFFFF}
    if isinstance(value, str):
        return chance.choice(
            (
                *TOKENS,
                "",
                value + "/x",
                value.replace("/", ""),
                "/" + value,
                value + "\x1b[31m",
                "/findings",
                "/recording",
                "/left/raw",
            )
        )
    if isinstance(value, bytes):
        return json_changed(chance, value)
    return chance.choice(NUMBERS) & 0xFFFF if isinstance(value, int) else value


def _taken_apart(piece: bytes) -> tuple[str, list[bytes]]:
    """Return the compression of a chunk and the records in it. Raises where it is damaged."""
    chunk = mcap.records.Chunk.read(ReadDataStream(io.BytesIO(piece[9:])))
    return chunk.compression, _records(_UNPACKING[chunk.compression](chunk.data))


_DAMAGED = (
    McapError, struct.error, KeyError, UnicodeError, zstandard.ZstdError, RuntimeError, EOFError, ValueError, MemoryError,
    OverflowError,
)  # fmt: skip


def _chunk_changed(chance: Chance, piece: bytes) -> bytes:
    try:
        compression, inner = _taken_apart(piece)
    except _DAMAGED:
        return bytes_changed(chance, piece)
    return chunk(chance, b"".join(pieces_changed(chance, inner, _mcap_changed, [])), compression)


def chunk(chance: Chance, inner: bytes, compression: str = "zstd") -> bytes:
    """Return records in a chunk; its checksum, sizes and times are wrong now and then."""
    compression = chance.choice((compression,) * 6 + ("", "lz4"))
    inner = _swollen(chance, inner)
    data = _PACKING[compression](inner)
    named = compression if chance.random() < 0.97 else chance.choice(("zstd", "lz4", "", "bz2", "\x1b[31m"))
    crc = chance.choice((0, zlib.crc32(inner), zlib.crc32(inner), zlib.crc32(inner) ^ 1))
    size = len(inner) if chance.random() < 0.93 else chance.choice(NUMBERS) & ((1 << 64) - 1)
    first, last = chance.choice(((0, 0), (1, (1 << 63) - 1), ((1 << 64) - 1, 0), (1_790_000_000 * 10**9,) * 2))
    name = named.encode()
    return record(
        Opcode.CHUNK, struct.pack("<QQQLL", first, last, size, crc, len(name)) + name + struct.pack("<Q", len(data)) + data
    )


def _rewritten(chance: Chance, pieces: list[bytes]) -> bytes:
    """Return the records as the library writes them, with an index that fits; nothing where they cannot be written."""
    out = io.BytesIO()
    kinds = (CompressionType.ZSTD, CompressionType.LZ4, CompressionType.NONE)
    try:
        writer = Writer(out, chunk_size=chance.choice((300, 4000, 1 << 20)), compression=chance.choice(kinds))
        writer.start("servotap", "fuzz")
        schema = writer.register_schema("any", "jsonschema", b'{"type":"object"}')
        channels: dict[int, int] = {}
        inner = (each for piece in pieces for each in (_taken_apart(piece)[1] if piece[0] == Opcode.CHUNK else (piece,)))
        for each in inner:
            stream = ReadDataStream(io.BytesIO(each[9:]))
            if each[0] == Opcode.CHANNEL:
                read = mcap.records.Channel.read(stream)
                channels[read.id] = writer.register_channel(read.topic, read.message_encoding, schema, read.metadata)
            elif each[0] == Opcode.MESSAGE:
                number, sequence, log_time, publish_time = struct.unpack_from("<HLQQ", each, 9)
                if number in channels:
                    writer.add_message(channels[number], log_time, each[31:], publish_time, sequence)
            elif each[0] == Opcode.METADATA:
                about = mcap.records.Metadata.read(stream)
                writer.add_metadata(about.name, about.metadata)
        writer.finish()
    except (*_DAMAGED, IndexError):
        return b""
    return out.getvalue()


# --- spools -----------------------------------------------------------------------------------------------------------


def _spool_split(data: bytes) -> tuple[bytes, list[bytes]]:
    pieces, at = [], 0
    while at + spool.HEAD.size <= len(data):
        stop = at + spool.HEAD.size + struct.unpack_from("<L", data, at + 2)[0]
        pieces.append(data[at:stop])
        at = stop
    return b"", pieces


def _spool_changed(chance: Chance, piece: bytes) -> bytes:
    if chance.random() < 0.2 or len(piece) < spool.HEAD.size:
        return bytes_changed(chance, piece, 1)
    kind, t_ns, before = piece[1], *struct.unpack_from("<QQ", piece, 6)
    data = piece[spool.HEAD.size :]
    dice = chance.random()
    if dice < 0.25:
        kind = chance.randrange(9) if chance.random() < 0.8 else 255
    elif dice < 0.45:
        t_ns = chance.choice((*NUMBERS, t_ns + 10**9, t_ns - 10**9, t_ns + 10**15)) & ((1 << 64) - 1)
    elif dice < 0.65:
        before = chance.choice((*NUMBERS, before + 1, before - 1, before + 10**6)) & ((1 << 64) - 1)
    elif data.startswith(b"{"):
        data = json_changed(chance, data)
    else:
        data = bytes_changed(chance, data, 1)
    return spool.pack(kind, t_ns, before, data)


def _plain(_: Chance, head: bytes, pieces: list[bytes]) -> bytes:
    return head + b"".join(pieces)


def _zip_split(data: bytes) -> tuple[bytes, list[bytes]]:
    """Return the files of an archive, each behind its name."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return b"", [name.encode() + b"\0" + archive.read(name) for name in archive.namelist()]
    except (zipfile.BadZipFile, NotImplementedError, zlib.error, EOFError, RuntimeError, ValueError, OSError):
        return data, []


def _zip_join(chance: Chance, head: bytes, pieces: list[bytes]) -> bytes:
    if not pieces:
        return head
    whole = io.BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(whole, "w", zipfile.ZIP_DEFLATED) as archive:
        # Two files of one name are wanted, too.
        warnings.simplefilter("ignore")
        for piece in pieces:
            name, _, data = piece.partition(b"\0")
            archive.writestr(zipfile.ZipInfo(name.decode("utf-8", "replace") or "x"), data)
    return bytes_changed(chance, whole.getvalue(), 1) if chance.random() < 0.1 else whole.getvalue()


def _zip_changed(chance: Chance, piece: bytes) -> bytes:
    name, zero, data = piece.partition(b"\0")
    changed = mutated(chance, data) if kind_of(data) == "text" else bytes_changed(chance, data)
    return (
        piece if not zero else bytes_changed(chance, name, 1) + zero + data if chance.random() < 0.1 else name + zero + changed
    )


CONTAINERS: dict[str, Container] = {
    "zip": Container(_zip_split, _zip_join, _zip_changed),
    "text": Container(_lines, _joined_lines, text_changed),
    "packed": Container(_unpacked, _packed, _inside),
    "blf": Container(_blf_split, _blf_join, _blf_changed),
    "pcap": Container(_pcap_split, _plain, _pcap_changed),
    "pcapng": Container(_pcapng_split, _plain, _pcapng_changed),
    "mcap": Container(_mcap_split, _mcap_join, _mcap_changed),
    "spool": Container(_spool_split, _plain, _spool_changed),
    "json": Container(lambda data: (b"", [data]), _plain, json_changed),
    "checkpoint": Container(lambda data: (b"", [data]), _plain, checkpoint_changed),
}
_MAGICS = (
    (b"LOGG", "blf"), (_MCAP_MAGIC, "mcap"), (b"\x0a\x0d\x0d\x0a", "pcapng"), (b"\xd4\xc3\xb2\xa1", "pcap"),
    (b"PK\x03\x04", "zip"), (b"\x4d\x3c\xb2\xa1", "pcap"), (b"\x1f\x8b", "packed"), (b"\x28\xb5\x2f\xfd", "packed"),
)  # fmt: skip
