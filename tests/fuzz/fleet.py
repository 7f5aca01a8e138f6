"""Lakes under attack: hostile captures that are taken into one, questions in any SQL, and lakes with damaged files.

`corpus/lake/whole` is a lake of one small capture.
"""

from __future__ import annotations

import contextlib
import json
import random
import re
import zlib
from collections.abc import Sequence
from functools import cache

from analyzer.errors import ServotapError
from analyzer.fleet.ask import Question
from analyzer.fleet.lake import Lake
from analyzer.fleet.place import Place as LakePlace
from tests.fleet.lakes import candump, ingest
from tests.fuzz.corpus import FOLDER, INPUT, Input, lay_out, load, quick
from tests.fuzz.mutators import BREAKS, TOKENS, bytes_changed, json_changed, mutated, text_changed
from tests.fuzz.running import Fault, Place, fed, heard_words, run_words

LAKE = "lake"

# --- captures into a lake -------------------------------------------------------------------------------------------------


def taken(given: Input, place: Place) -> None:
    """Take captures into a lake; no byte may be lost on the way into its tables."""
    lay_out(given, place.folder / "in")
    size = fed(place.folder / "in" / INPUT)
    lake = Lake(LakePlace(LAKE), make=True)
    _ingested(lake)
    question = Question(lake)
    (row,) = question.dataset("captures").to_table().to_pylist() or [None]
    if row is None:
        # A capture that decode would have made, or a profile.
        return
    whole = 0
    for table in question.tables.values():
        found = question.dataset(table).to_table()
        if table.startswith(("messages/", "unknown", "foreign", "junk")) and "_raw" in found.column_names:
            whole += sum(len(each or b"") for each in found["_raw"].to_pylist())
    if row["status"] == "decoded" and not whole == row["frame_bytes"] + row["junk_bytes"] == size:
        raise Fault(f"{size} bytes came in, {row['frame_bytes']} + {row['junk_bytes']} were counted, {whole} stand in tables")


def _ingested(lake: Lake) -> None:
    """Take what is in `in`. The cluster of the command takes seconds to start: here the same runs without one."""
    for name, reason in ingest(lake, LakePlace("in"), pattern=None).unread:
        if "a fault of servotap" in reason or "worker died" in reason:
            raise Fault(f"{name}: {reason}")


# --- questions ------------------------------------------------------------------------------------------------------------

#: A file next to the lake, which no question may read.
_SECRET = b"name,value\nnobody,is-to-read-this\n"
_QUESTIONS = (
    "from captures", "select * from findings where date > '2026-01-01' order by time desc limit 3", "captures",
    "mks_can.read_speed_reply", 'select avg(speed) from "mks-can".read_speed_reply group by address having count(*) > 1',
    "select machine, count(*) over (partition by date), row_number() over () from captures",
    "with a as (select * from states), b as (select speed from a) select * from b join a using (speed)",
    "select * from captures c left join findings f on c.capture = f.capture where c.dialects[1] like 'mks%'",
    "with recursive t(n) as (select 1 union all select n + 1 from t where n < 9) select sum(n), list(n) from t",
    "select time_bucket(interval '1 second', time), quantile_cont(latency, 0.9) from transactions group by all",
    "pivot findings on rule using count(*) group by machine", "summarize states", "describe transactions",
    "select {'a': speed, 'b': [1, null]}, map {1: 'x'}, 1::hugeint, 'x'::blob, uuid(), time '10:00' from states",
    "select unnest(generate_series(1, 20)), repeat('x', 300), 'infinity'::timestamp, 0.0 / 0.0, interval 3 month",
    "select columns('s.*') exclude (speed) replace (1 as sequence) from states qualify row_number() over () < 3",
    "select * from read_csv('secret.csv')", "from 'secret.csv'", "select * from glob('*')",
    "select content from read_text('*')", "copy captures to 'x.csv'", "attach 'x.db'", "install httpfs; load httpfs",
    "set enable_external_access = true", "select * from duckdb_settings()", "from pragma_version()",
    "call pragma_table_info('captures')", "select current_setting('x')", "from query('select 1')",
    "from query_table('captures')", "select * from sniff_csv('secret.csv')", "select getvariable('x')",
    "select list_transform([1, 2], x -> x + 1), [x * 2 for x in [1, 2] if x > 1]", "values (1, 'a'), (2, null)",
    "select regexp_extract_all(text, '(a+)+'), strftime(time, '%c'), format('{}', 1), printf('%d', 1) from findings",
)  # fmt: skip
_WORDS = (
    "select", "from", "where", "group by", "order by", "limit", "offset", "union all", "except", "join", "natural join",
    "lateral", "asof join", "positional join", "cross join", "using", "on", "as", "with", "recursive", "distinct", "all",
    "not", "null", "in", "exists", "case when", "then", "else", "end", "between", "like", "similar to", "cast", "::varchar",
    "::int", "::json", "::date", "over ()", "filter (where true)", "tablesample 10%", "pivot", "unpivot", "qualify", "unnest",
    "range(5)", "generate_series", "captures", "states", "findings", "transactions", "mks_can.read_speed_reply",
    '"mks-can".read_speed_reply', "no_such", "main.", "read_parquet('lake/**')", "parquet_scan", "read_json('*')",
    "read_blob('*')", "'secret.csv'", "delta_scan('lake/captures')", "*", "count(*)", "(", ")", "[", "]", "{", "}", ",", ";",
    "'", '"', "$$", "--", "/*", "?", "$1", "1", "-1", "1e400", "0x1", "interval '1' year", "date '12000-01-01'",
    "timestamp '290000-01-01'", "'\\x1b[31m'", "chr(27)", "repeat('x', 9)", "random()",
)  # fmt: skip
_TOKEN = re.compile(rb"'[^']*'|\w+|\s+|.", re.DOTALL)


def questions() -> list[Input]:
    """Return questions to begin with, and what was found before."""
    return [*({INPUT: each.encode()} for each in _QUESTIONS), *quick("ask")]


def question_changed(chance: random.Random, given: Input, others: Sequence[Input]) -> Input:
    """Change some words of a question; put it into another one, or deep into itself."""
    tokens = _TOKEN.findall(given[INPUT]) or [b""]
    for _ in range(chance.choice((1, 1, 2, 4))):
        at, act = chance.randrange(len(tokens)), chance.random()
        if act < 0.45:
            word = f" {chance.choice(_WORDS)} ".encode()
            tokens[at : at + chance.randrange(2)] = [word]
        elif act < 0.55:
            to = chance.randrange(len(tokens))
            tokens[at], tokens[to] = tokens[to], tokens[at]
        elif act < 0.65:
            tokens[at] = b""
        elif act < 0.72:
            tokens[at] = b"(" + chance.choice(others)[INPUT] + b")"
        elif act < 0.77:
            tokens[at] *= chance.choice((2, 30, 1000))
        elif act < 0.8:
            deep = chance.choice((3, 40, 600))
            before, after = chance.choice(((b"(", b")"), (b"[", b"]"), (b"not ", b""), (b"-", b""), (b"(select ", b")")))
            tokens[at] = before * deep + tokens[at] + after * deep
        elif act < 0.9:
            tokens[at] = chance.choice((*(each.encode("utf-8", "surrogatepass") for each in TOKENS), *BREAKS))
        else:
            tokens[at] = text_changed(chance, tokens[at])
    return {INPUT: b"".join(tokens)[:16_384]}


def asked(given: Input, place: Place) -> None:
    """Ask a lake; the answer is of the lake alone, and nothing is written beside it."""
    lay_out({f"{LAKE}/{name}": data for name, data in whole_lake().items()}, place.folder)
    (place.folder / "secret.csv").write_bytes(_SECRET)
    before = _names(place)
    query = given[INPUT].replace(b"\0", b"").decode("utf-8", "surrogateescape")
    ending = ("", "csv", "parquet")[zlib.crc32(given[INPUT]) % 3]
    _, said = heard_words(("ask", LAKE, *(["-o", f"out.{ending}"] if ending else []), "--seconds", "2", "--", query), place)
    out = place.folder / f"out.{ending}"
    if b"is-to-read-this" in said or (out.exists() and b"is-to-read-this" in out.read_bytes()):
        raise Fault("a question read a file next to the lake")
    if more := _names(place) - before - {out.name}:
        raise Fault(f"a question wrote {sorted(more)}")


def _names(place: Place) -> set[str]:
    return {str(path.relative_to(place.folder)) for path in place.folder.rglob("*")}


# --- lakes with damaged files ---------------------------------------------------------------------------------------------

_COMMANDS = (
    ("ask", LAKE), ("ask", LAKE, "from captures"), ("ask", LAKE, "select count(*), max(speed) from mks_can.read_speed_reply"),
    ("ask", LAKE, "mks_can.read_speed_reply"), ("fleet", LAKE, "-o", "out.html"), ("compact", LAKE, "--keep", "0"), ("ingest",),
)  # fmt: skip


@cache
def whole_lake() -> Input:
    """Return the files of a small lake."""
    return {name: data for name, data in load(FOLDER / "lake" / "whole").items() if name != INPUT}


def lakes() -> list[Input]:
    """Return a lake with each command that is run on it, and what was found before."""
    return [*({INPUT: json.dumps(words).encode(), **whole_lake()} for words in _COMMANDS), *quick("lake")]


def lake_changed(chance: random.Random, given: Input, others: Sequence[Input]) -> Input:
    """Damage some files of a lake: the logs of its tables line by line, its data as bytes; drop, double or swap them."""
    files = dict(given)
    for _ in range(chance.choice((1, 1, 1, 2, 3))):
        name = chance.choice(sorted(set(files) - {INPUT}) or [INPUT])
        act = chance.random()
        if name == INPUT:
            break
        if act < 0.06:
            del files[name]
        elif act < 0.12:
            other = chance.choice(sorted(set(files) - {INPUT}))
            files[name], files[other] = files[other], files[name]
        elif act < 0.16:
            number = chance.choice((1, 2, 3, 9, 10**19))
            files[re.sub(r"\d{20}\.json", f"{number:020}.json", name) + "x" * (".json" not in name)] = files[name]
        elif act < 0.2:
            files[f"journal/{chance.getrandbits(128):032x}.json"] = chance.choice(
                (b"", b"{}", b'{"seen": 0, "files": {}}', b'{"seen": -1, "files": {"states": [{"path": "../x"}]}}', files[name])
            )
        elif act < 0.26:
            files[name] = files[name][: chance.randint(0, len(files[name]))]
        elif name.endswith(".json") and act < 0.9:
            lines = files[name].split(b"\n")
            at = chance.randrange(len(lines))
            lines[at] = json_changed(chance, lines[at])
            files[name] = b"\n".join(lines)
        else:
            files[name] = bytes_changed(chance, files[name])
    return files


def lake_of(given: Input, place: Place) -> None:
    """Run a command on a lake that is damaged."""
    lay_out({f"{LAKE}/{name}": data for name, data in given.items() if name != INPUT}, place.folder)
    words = json.loads(given[INPUT])
    if words[:1] != ["ingest"]:
        run_words(words, place)
        return
    lay_out({"in/a.log": candump(7, 9).encode(), "in/b.log": mutated(random.Random(3), candump(8, 9).encode())}, place.folder)
    # A lake that is damaged is told.
    with contextlib.suppress(ServotapError):
        _ingested(Lake(LakePlace(LAKE), make=True))
