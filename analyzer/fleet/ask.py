"""Questions to a lake: SQL by DuckDB over its tables, of which only the columns and files that matter are read.

A table of messages is `"mks-can".read_speed_reply`, or mks_can.read_speed_reply; all others have their own names.

A question may come from anywhere, a page or a chat. So it reads only the lake: no other file, no URL, no extension and no
Python variable. It writes nothing. Its memory and its time are bounded: DuckDB ends it between two steps of its work.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import threading
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

from analyzer.errors import UnreadableError, UsageError
from analyzer.fleet import counts
from analyzer.fleet.lake import CAPTURES, LOG, Lake
from analyzer.fleet.place import again
from analyzer.table.extras import needed
from analyzer.values import near, printable

try:
    import resource
except ImportError:  # a system without it
    resource = None  # type: ignore[assignment]

if TYPE_CHECKING:
    import duckdb
    import pyarrow.dataset


#: What a question may do, in this order: the last one keeps it from changing them.
_BOUNDS = ("python_enable_replacements = false", "enable_external_access = false", "lock_configuration = true")


_ALL_NS = "coalesce(time_ns, epoch_us(time) * 1000) as time_ns"

#: A question of one word, which is meant for a table.
_NAME = re.compile(r"[\w-]+(\.[\w-]+)?")


def _memory() -> int:
    """Return how many bytes a question may take: half of the machine's memory."""
    if not hasattr(os, "sysconf"):
        return 4 << 30
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 2


@contextlib.contextmanager
def _bounded_memory() -> Iterator[None]:
    """Bound the memory of this process, where the system can: DuckDB does not count the values that a question makes."""
    if resource is None:
        yield
        return
    before, most = resource.getrlimit(resource.RLIMIT_DATA)
    bound = min([_memory(), *(limit for limit in (before, most) if limit != resource.RLIM_INFINITY)])
    resource.setrlimit(resource.RLIMIT_DATA, (bound, most))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, (before, most))


def has_times(schema: pyarrow.Schema) -> bool:
    """Say whether a table has times, which are in `time_ns` only where `time` does not tell them."""
    types = needed("pyarrow").types
    kinds = {each.name: each.type for each in schema}
    return "time" in kinds and types.is_timestamp(kinds["time"]) and kinds.get("time_ns") == "int64"


def sql_name(table: str) -> str:
    """Return the name of a table in SQL: messages/mks-can/read_speed/reply is mks_can.read_speed_reply."""
    parts = table.replace("@", "_v").split("/")
    return table.replace("@", "_v") if len(parts) == 1 else f"{parts[1].replace('-', '_')}.{'_'.join(parts[2:])}"


@contextlib.contextmanager
def answering() -> Iterator[None]:
    """Raise UsageError where a question cannot be answered; much of that shows only as its rows are fetched."""
    try:
        yield
    # Python's dates end with the year 9999, those of SQL do not. A value that Python cannot have is a ValueError of it.
    except (needed("duckdb").Error, needed("pyarrow").ArrowException, OverflowError, ValueError) as error:
        raise UsageError(f"the question cannot be answered: {printable(str(error))}") from None
    except RecursionError:
        raise UsageError("the question is nested too deeply: expected fewer brackets and subqueries in each other") from None
    except MemoryError:
        raise UsageError(f"the answer needs more than {_memory() >> 20} MiB of memory: ask for less of it") from None


class Column(NamedTuple):
    """A column of a table for people."""

    name: str
    kind: str
    unit: str
    note: str


class Question:
    """A lake that is asked. Batches that are not in all tables yet are left out."""

    def __init__(self, lake: Lake) -> None:
        self.lake = lake
        self.tables = {sql_name(table): table for table in lake.tables()}
        self._pending = [batch for batch, _ in lake.pending()]
        self._asked: list[duckdb.DuckDBPyConnection] = []

    @contextlib.contextmanager
    def bounded(self, seconds: float) -> Iterator[None]:
        """Bound the time and memory of questions asked within, and end them. Raises UsageError where one takes more."""
        late = threading.Event()

        def end() -> None:
            late.set()
            for connection in self._asked:
                connection.interrupt()

        timer = threading.Timer(seconds, end)
        timer.daemon = True
        timer.start()
        try:
            with _bounded_memory(), answering():
                yield
        except UsageError:
            if late.is_set():
                raise UsageError(f"the answer takes more than {seconds:g} s: ask for less, or give it --seconds") from None
            raise
        finally:
            timer.cancel()
            # A query that still runs would outlive this program and crash it.
            while self._asked:
                self._asked.pop().close()

    def dataset(self, table: str) -> pyarrow.dataset.Dataset:
        """Return a table as a dataset of Arrow, with what is in all tables alone. Raises UsageError for no table."""
        name = self.tables.get(table, table)
        if name not in self.tables.values():
            raise self._no_table(table)
        self._check_log(name)
        # That `captures` has lost rows is told by what others count: few tables, into which most batches come.
        counts.check(self.lake, [name] if name != CAPTURES else [each for each in self.tables.values() if "/" not in each])
        found = self.lake.dataset(name)
        if self._pending:
            compute = needed("pyarrow.compute")
            if name == CAPTURES:
                return found.filter(~compute.field("batch").isin(self._pending))
            rows = self.lake.rows("capture", "batch")
            hidden = needed("pyarrow").array([row["capture"] for row in rows if row["batch"] in self._pending], "string")
            return found.filter(~compute.field("capture").isin(hidden))
        return found

    def _no_table(self, name: str) -> UsageError:
        return UsageError(
            f"no table {printable(name)}{near(name, self.tables)} (servotap ask {self.lake.place.url} lists them)"
        )

    def _check_log(self, table: str) -> None:
        """Raise UnreadableError where a commit of a table was emptied: readers pass over it, and its rows are gone."""
        place = self.lake.place
        place.fs.invalidate_cache()
        with self.lake.reading(table):
            log = again(lambda: place.fs.ls(place.path(f"{table}/{LOG}"), detail=True))
        for each in log:
            if each["name"].endswith(".json") and not each["size"]:
                raise UnreadableError(
                    f"{each['name']} is empty, so what it committed is not known: restore it, or ingest into a new lake"
                )

    def sql(self, query: str) -> duckdb.DuckDBPyRelation:
        """Return the answer to a query. Raises UsageError for what is none, or names no table."""
        connection = needed("duckdb").connect(config={"memory_limit": f"{_memory() >> 20}MiB"})
        self._asked.append(connection)
        with answering():
            parsed = json.loads(connection.execute("select json_serialize_sql(?)", [query]).fetchall()[0][0])
            if parsed["error"]:
                if _NAME.fullmatch(query.strip()):
                    raise self._no_table(query.strip())
                raise UsageError(
                    f"the question cannot be read: {printable(parsed['error_message'])}; "
                    "expected SQL, as in: select count(*) from captures"
                )
            named = set(_named(parsed, "schema_name", "table_name"))
            own = {name for _, name in _named(parsed, "", "key")}
            for schema, name in sorted(named):
                if schema or name not in own:
                    self._offer(connection, schema, name)
            for bound in _BOUNDS:
                connection.execute(f"set {bound}")
            answer: duckdb.DuckDBPyRelation | None = connection.sql(query)
        if answer is None:
            raise UsageError("the question is empty: expected a select")
        return answer

    def _offer(self, connection: Any, schema: str, name: str) -> None:
        """Make a table of the lake one of a connection. Raises UsageError where the lake has none of that name."""
        full = f"{schema.replace('-', '_')}.{name}" if schema else name
        if full not in self.tables:
            raise self._no_table(full)
        source, found = f"lake {full}", self.dataset(full)
        connection.register(source, found)
        place = f'"{schema}".' if schema else ""
        if schema:
            connection.execute(f'create schema if not exists "{schema}"')
        # What `time` tells, `time_ns` does not have in the files.
        told = f" replace ({_ALL_NS})" if has_times(found.schema) else ""
        connection.execute(f'create view {place}"{name}" as select *{told} from "{source}"')

    def columns(self, table: str) -> Iterator[Column]:
        """Yield the columns of a table."""
        self._check_log(self.tables[table])
        opened = self.lake.open(self.tables[table])
        with self.lake.reading(self.tables[table]):
            fields = opened.schema().fields
        for each in fields:
            about = each.metadata or {}
            kind = str(getattr(each.type, "type", each.type))
            yield Column(each.name, kind, str(about.get("unit", "")), str(about.get("note", "")))


def _named(tree: Any, schema: str, name: str) -> Iterator[tuple[str, str]]:
    """Yield the tables that a parsed query names: those of the lake, or with no schema those that it makes itself (`with`)."""
    if isinstance(tree, dict):
        if name in tree and (tree.get("type") == "BASE_TABLE" or not schema):
            yield tree.get(schema, ""), tree[name]
        for each in tree.values():
            yield from _named(each, schema, name)
    elif isinstance(tree, list):
        for each in tree:
            yield from _named(each, schema, name)
