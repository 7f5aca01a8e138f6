"""The lake: tables of Delta Lake in one place, and how a batch of captures comes into all of them or into none.

    lake/captures               a row for each content: what became of it
    lake/states, findings, ...  a table each, messages/<dialect>/<command>/<role> too
    lake/journal/<batch>.json   a batch that is being committed: the files of all tables
    lake/ranges/<scan>/         parts of huge captures on their way to workers

Delta commits one table at a time. So a batch is committed in this order:

1. Its data files lie in the lake; no table knows of them.
2. The journal names them all.
3. `captures` takes the rows of the batch. From here on the batch counts. This commit succeeds only if no other one came since
   the table was read. The second of two clients reads it again and leaves out what the first has taken: no content comes twice.
4. All other tables take their files; each remembers the batch, so that no file is taken twice. The journal is removed.

If a client dies before 3, its files belong to no table (`compact` removes them). If it dies in 4, the next ingest goes on
by the journal. Questions leave out batches whose journal still stands.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import time
import uuid
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import msgspec

from analyzer.cli.boundary import PANIC
from analyzer.errors import ServotapError, UnreadableError, UsageError
from analyzer.fleet import counts
from analyzer.fleet.files import PARTITIONS, Added, Destination, only
from analyzer.fleet.place import Place
from analyzer.fleet.rows import TAKEN, UNSEEN, Taken, captures_schema
from analyzer.system.decoding import UNDECODABLE
from analyzer.table.extras import needed
from analyzer.values import printable

if TYPE_CHECKING:
    import deltalake
    import pyarrow.dataset

CAPTURES = counts.CAPTURES
JOURNAL = "journal"
#: The folder in each table that says which files it has.
LOG = "_delta_log"
#: The folder of ranges of huge captures that wait for a worker.
RANGES = "ranges"
#: A later version of a table, of which a column has another meaning.
_VERSION = "@"
#: Protocols of stores that Delta Lake can commit to, by their names for it.
_STORES = {
    "file": "",
    "local": "",
    "s3": "s3",
    "s3a": "s3",
    "gs": "gs",
    "gcs": "gs",
    "abfs": "abfss",
    "abfss": "abfss",
    "az": "az",
}
#: Delta Lake would read %41 as A, so its log and our files would be in two places; the others it cannot write to.
_MISREAD = frozenset("%[]|\\^")
#: fsspec's options for a store -> those of Delta Lake.
_OPTIONS = {"key": "aws_access_key_id", "secret": "aws_secret_access_key", "token": "aws_session_token"}
_OPTIONS |= {"endpoint_url": "aws_endpoint_url", "region_name": "aws_region"}
#: A row of `captures` that another one replaces: of the same content, or of a place that could not be read.
_SAME = f"old.capture = new.capture or (old.capture like '{UNSEEN}%' and old.source = new.source and old.name = new.name)"
#: Least and greatest values stand in the Parquet files. A log that had those of some columns would make readers lose rows.
_SETTINGS: dict[str, str | None] = {"delta.dataSkippingNumIndexedCols": "0"}
#: The setting of `captures` that says what all other tables are partitioned by.
_PARTITIONS = "servotap.partitions"
#: Colours in texts of Delta Lake, and the stack that RUST_BACKTRACE asks for.
_COLOURS, _STACK = re.compile(r"\x1b\[[0-9;]*m"), re.compile(r"\n\s*0: .*", re.DOTALL)
#: Losses of a race for one commit, one after the other, after which something else must be wrong.
_RACES = 1000


def store_of(url: str) -> str:
    """Return the protocol of a lake's store. Raises UsageError for one to which Delta Lake cannot commit."""
    protocol = url.partition("://")[0] if "://" in url else "file"
    if protocol not in _STORES:
        stores = ", ".join(sorted({f"{name}://" for name in _STORES if name not in ("file", "local")}))
        raise UsageError(f"{url}: a lake can be in a folder or at {stores}; {protocol}:// cannot commit")
    return protocol


class Journal(msgspec.Struct):
    """A batch that is being committed. `seen`: the version of `captures` before; `files`: of all other tables."""

    seen: int
    files: dict[str, list[dict[str, Any]]]


class Lake:
    """A lake in a place. `make`: make it if it is not there, with tables that are partitioned by some of PARTITIONS.

    Raises UnreadableError for a place without a lake otherwise.
    """

    def __init__(self, place: Place, *, make: bool = False, partitions: Sequence[str] = PARTITIONS) -> None:
        self.place = place
        self._delta = needed("deltalake")
        # What its libraries raise. Damaged text of a data file is a ValueError of Python's, a number of a log an OverflowError.
        delta = self._delta.exceptions.DeltaError
        self._errors = (OSError, ValueError, OverflowError, needed("pyarrow").ArrowException, delta)
        protocol = store_of(place.url)
        if not place.root.isprintable() or _MISREAD & set(place.root):
            raise UsageError(f"{place.url}: a lake needs a path of printable text without {' '.join(sorted(_MISREAD))}")
        scheme = _STORES[protocol]
        self._base = f"{scheme}://{place.root}" if scheme else place.root
        self._options = _store_options(place.options) if scheme else None
        #: Versions of tables that came up because a column changed its meaning, in words.
        self.notes: list[str] = []
        self._known: dict[str, str] = {}
        #: Tables whose logs were found to be whole.
        self.checked: set[str] = {CAPTURES}
        self._seen = -1
        self._open: dict[str, deltalake.DeltaTable] = {}
        if make:
            with self._writing():
                self._create(CAPTURES, captures_schema(), (), _SETTINGS | {_PARTITIONS: ",".join(partitions)})
        elif not self.exists(CAPTURES):
            raise UnreadableError(f"{place.url} is no lake: make one with servotap ingest CAPTURES --to {place.url}")
        captures = self.open(CAPTURES)
        with self.reading(CAPTURES):
            said = captures.metadata().configuration.get(_PARTITIONS, ",".join(PARTITIONS))
            partitions = said.split(",")
            if not set(partitions) <= set(PARTITIONS):
                raise ValueError(f"expected partitions by {' or '.join(PARTITIONS)}, got {said}")
        self.destination = Destination(place, tuple(partitions))

    @contextlib.contextmanager
    def _told(self, kind: type[ServotapError], what: str, advice: str = "") -> Iterator[None]:
        """Raise an error of ours in place of one of the lake's libraries, or of the system."""
        try:
            yield
        # A panic of Rust derives from BaseException alone: a log that Delta Lake has not expected is enough.
        except BaseException as error:
            if not isinstance(error, self._errors) and type(error).__name__ != PANIC:
                raise
            raise kind(f"{what}: {_said(error)}{advice}") from None

    def _writing(self) -> contextlib.AbstractContextManager[None]:
        """Raise UsageError where the lake cannot be written: its disk is full, its store refuses."""
        return self._told(UsageError, f"{self.place.url} cannot be written")

    def reading(self, table: str) -> contextlib.AbstractContextManager[None]:
        """Raise UnreadableError where a table cannot be read: it is damaged, its store refuses."""
        advice = "; if its files are damaged, restore them, or ingest into a new lake"
        return self._told(UnreadableError, f"{self.uri(table)} cannot be read", advice)

    # --- tables ---------------------------------------------------------------------------------------------------

    def uri(self, table: str) -> str:
        """Return where a table is, as Delta Lake names it."""
        return f"{self._base}/{table}"

    def _check_files(self, folder: str) -> None:
        """Raise ValueError where something in a folder of the lake cannot be read to an end."""
        if self.place.local and os.path.isdir(path := self.place.path(folder)):
            self.place.check_files(f"{folder}/{name}" for name in os.listdir(path))

    def exists(self, table: str) -> bool:
        with self.reading(table):
            return bool(self._delta.DeltaTable.is_deltatable(self.uri(table), storage_options=self._options))

    def open(self, table: str) -> deltalake.DeltaTable:
        """Return a table as it is now."""
        opened = self._open.get(table)
        with self.reading(table):
            self._check_files(f"{table}/{LOG}")
            if opened is None:
                opened = self._open[table] = self._delta.DeltaTable(self.uri(table), storage_options=self._options)
            else:
                opened.update_incremental()
        return opened

    def seen(self, table: str, transaction: str) -> int | None:
        """Return the version of a transaction in a table as it was last opened; None where it has none."""
        with self.reading(table):
            return self._open[table].transaction_version(transaction)

    def dataset(self, table: str) -> pyarrow.dataset.Dataset:
        """Return a table as it is now, as a dataset of Arrow. Raises UnreadableError for one whose files are not below it."""
        opened, files = self.open(table), None
        if self.place.local:
            # The store of Delta Lake is one of Python. Arrow waits for ever where one of its threads meets an error of Python
            # while another begins to read.
            arrow = needed("pyarrow.fs")
            files = arrow.SubTreeFileSystem(self.uri(table), arrow.LocalFileSystem())
        with self.reading(table):
            found: pyarrow.dataset.Dataset = opened.to_pyarrow_dataset(filesystem=files)
            self.place.check_files(f"{table}/{path}" for path in getattr(found, "files", ()))
            for path in getattr(found, "files", ()):
                if ".." in path.split("/") or path.startswith("/"):
                    raise ValueError(f"its log names a file that is not below it: {path}")
        return found

    def table(self, name: str, schema: pyarrow.Schema) -> deltalake.DeltaTable:
        """Return a table, made if it is not there. `schema`: without the partitions."""
        self._create(name, schema, self.destination.partitions, _SETTINGS)
        return self.open(name)

    def _create(self, name: str, schema: pyarrow.Schema, partitions: Sequence[str], settings: dict[str, str | None]) -> None:
        pa = needed("pyarrow")
        if name not in self._open and not self.exists(name):
            kinds = {"date": pa.date32(), "machine": pa.string()}
            whole = pa.schema([*schema, *(pa.field(each, kinds[each]) for each in partitions)])
            try:
                self._delta.DeltaTable.create(
                    self.uri(name),
                    schema=self._delta.Schema.from_arrow(whole),
                    partition_by=list(partitions) or None,
                    mode="ignore",
                    configuration=settings,
                    storage_options=self._options,
                    # Its own settings are kept, too.
                    raise_if_key_not_exists=False,
                )
            except self._delta.exceptions.CommitFailedError:
                # Another client made it at the same time.
                if not self.exists(name):
                    raise

    def tables(self) -> list[str]:
        """Return the names of all tables, `captures` first."""
        found = []
        for depth in ("*", "*/*/*/*"):
            with self.reading("*"):
                paths = self.place.glob(f"{depth}/{LOG}")
            for path in paths:
                found.append(path[len(self.place.root) :].strip("/").removesuffix(f"/{LOG}"))
        # A client that died while it made a table, or found no room for it, leaves a log without a commit.
        found = [name for name in found if name in self._open or self.exists(name)]
        return sorted(found, key=lambda name: (name != CAPTURES, name.startswith("messages/"), name))

    def fitting(self, name: str, schema: pyarrow.Schema) -> str:
        """Return the version of a table that a schema fits, with columns added that are new.

        A column of the same name and another unit or type is of another version: `states`, `states@2`, ...
        """
        for _ in range(_RACES):
            # Another client that adds columns at the same time may have come first.
            with contextlib.suppress(self._delta.exceptions.CommitFailedError):
                return self._fitting(name, schema)
        raise _lost(self.uri(name))

    def _fitting(self, name: str, schema: pyarrow.Schema) -> str:
        for number in range(1, 1000):
            table = name if number == 1 else f"{name}{_VERSION}{number}"
            is_new = table not in self._open and not self.exists(table)
            opened = self.table(table, schema)
            if is_new and number > 1:
                self.notes.append(f"{name}: a column has another unit or type than before; its rows go to {table}")
            there = {each.name: each for each in opened.schema().fields}
            wanted = list(self._delta.Schema.from_arrow(schema).fields)
            if all(_alike(there[each.name], each) for each in wanted if each.name in there):
                new = [each for each in wanted if each.name not in there]
                if new:
                    opened.alter.add_columns(new)
                return table
        raise UsageError(f"{name} has too many versions")

    # --- commits --------------------------------------------------------------------------------------------------

    def rows(self, *columns: str) -> list[dict[str, Any]]:
        """Return some columns of all captures."""
        dataset = self.dataset(CAPTURES)
        with self.reading(CAPTURES):
            found: list[dict[str, Any]] = dataset.to_table(columns=list(columns)).to_pylist()
            return found

    def known(self) -> Mapping[str, str]:
        """Return SHA-256 -> status of all captures."""
        opened = self.open(CAPTURES)
        if opened.version() != self._seen:
            self._known = {row["capture"]: row["status"] for row in self.rows("capture", "status")}
            self._seen = opened.version()
        return self._known

    def commit(self, tasks: Sequence[Taken]) -> int:
        """Commit what some tasks took as one batch: all of it or nothing. Return how many captures it brought.

        Content that others have committed since, or that comes twice, is left out. Raises UsageError where nothing can be
        written.
        """
        counts.check(self, {each.table for task in tasks for each in task.added})
        with self._writing():
            for _ in range(_RACES):
                known, batch = self.known(), uuid.uuid4().hex
                fresh: dict[str, dict[str, Any]] = {}
                files: list[Added] = []
                for task in tasks:
                    rows = {row["capture"]: row for row in task.captures if _is_new(row, known) and row["capture"] not in fresh}
                    fresh |= rows
                    files += only(self.place, task.added, rows.keys())
                if not fresh:
                    return 0
                entries = self._entries(files)
                self.place.write(f"{JOURNAL}/{batch}.json", msgspec.json.encode(Journal(self._seen, entries)))
                if self._commit_captures(batch, list(fresh.values()), known, entries):
                    self._settle(batch, entries)
                    return sum(row["status"] in TAKEN for row in fresh.values())
                self.place.remove(f"{JOURNAL}/{batch}.json")
            raise _lost(self.place.url)

    def _entries(self, files: Sequence[Added]) -> dict[str, list[dict[str, Any]]]:
        """Return what the journal says of files, by table; those of another version are brought to its folder."""
        versions: dict[tuple[str, bytes], str] = {}
        entries: dict[str, list[dict[str, Any]]] = {}
        for each in files:
            key = (each.table, each.schema.serialize().to_pybytes())
            table = versions.get(key) or versions.setdefault(key, self.fitting(each.table, each.schema))
            if table != each.table:
                self.place.move(f"{each.table}/{each.path}", f"{table}/{each.path}")
                each.table = table
            told = {"path": each.path, "size": each.size, "values": each.values, "count": each.count}
            entries.setdefault(table, []).append(told)
        return entries

    def _commit_captures(self, batch: str, rows: list[dict[str, Any]], known: Mapping[str, str], tables: Iterable[str]) -> bool:
        pa, delta = needed("pyarrow"), self._delta
        table = pa.Table.from_pylist([row | {"batch": batch} for row in rows], schema=captures_schema())
        opened = self._open[CAPTURES]
        properties = self._once(batch, CAPTURES, map(counts.of_table, tables))
        try:
            if any(status not in TAKEN for status in known.values()):
                merge = opened.merge(table, _SAME, source_alias="new", target_alias="old", commit_properties=properties)
                merge.when_matched_update_all().when_not_matched_insert_all().execute()
            else:
                delta.write_deltalake(opened, table, mode="append", commit_properties=properties)
        except delta.exceptions.CommitFailedError:
            return False
        return True

    def _once(self, batch: str, table: str, counters: Iterable[str]) -> Any:
        """Return the properties of a commit that succeeds only if none came between, names its batch, and counts it."""
        delta = self._delta
        further = [delta.Transaction(each, counts.count(self, table, each) + 1) for each in counters]
        return delta.CommitProperties(max_commit_retries=0, app_transactions=[delta.Transaction(batch, 1), *further])

    def _settle(self, batch: str, entries: Mapping[str, list[dict[str, Any]]]) -> None:
        """Commit the files of a batch to all tables that do not have them, and remove its journal."""
        for table, files in entries.items():
            self._commit_files(batch, table, files)
        self.place.remove(f"{JOURNAL}/{batch}.json")

    def _commit_files(self, batch: str, table: str, files: list[dict[str, Any]]) -> None:
        actions = [
            needed("deltalake.transaction").AddAction(
                each["path"], each["size"], each["values"], 0, True, json.dumps({"numRecords": each["count"]})
            )
            for each in files
        ]
        for _ in range(_RACES):
            opened = self.open(table)
            if self.seen(table, batch) is not None:
                return
            with contextlib.suppress(self._delta.exceptions.CommitFailedError):
                opened.create_write_transaction(
                    actions,
                    "append",
                    opened.schema(),
                    list(self.destination.partitions),
                    commit_properties=self._once(batch, table, [counts.BATCHES]),
                )
                return
        raise _lost(self.uri(table))

    # --- batches that are under way ---------------------------------------------------------------------------------

    def pending(self) -> Iterator[tuple[str, Journal]]:
        """Yield the batches that have a journal."""
        with self.reading(JOURNAL):
            self._check_files(JOURNAL)
            paths = self.place.glob(f"{JOURNAL}/*.json")
        for path in paths:
            name = path.rpartition("/")[2]
            # Its client may have removed it meanwhile.
            try:
                journal = msgspec.json.decode(self.place.read(f"{JOURNAL}/{name}"), type=Journal)
            except FileNotFoundError:
                continue
            except UNDECODABLE as error:
                raise UnreadableError(
                    f"{path} is damaged, so its batch cannot be finished: {error}; restore it, or ingest into a new lake"
                ) from None
            yield name.removesuffix(".json"), journal

    def compact(self, days: float) -> tuple[int, int]:
        """Join small files, and remove those that no table has needed for some days; return how many of both."""
        with self._writing():
            joined = removed = 0
            tables = self.tables()
            if link := self.place.link_in(tables):
                raise UsageError(
                    f"{link} is a link to a folder, whose files would be removed: put what it leads to in its place"
                )
            for name in tables:
                opened = self.open(name)
                joined += opened.optimize.compact()["numFilesRemoved"]
                removed += len(opened.vacuum(int(days * 24), dry_run=False, enforce_retention_duration=False, full=True))
                opened.create_checkpoint()
                opened.cleanup_metadata()
            before = time.time() - days * 86_400
            # A client that died has left them.
            there = self.place.files(RANGES) if self.place.glob(f"{RANGES}/*") else []
            left = [each for each in there if each.modified < before]
            for each in left:
                self.place.remove(f"{RANGES}/{each.name}")
            return joined, removed + len(left)

    def recover(self) -> int:
        """Finish batches whose client died in the middle; return how many."""
        with self._writing():
            finished = 0
            for batch, journal in list(self.pending()):
                captures = self.open(CAPTURES)
                if self.seen(CAPTURES, batch) is not None:
                    self._settle(batch, journal.files)
                    finished += 1
                elif captures.version() > journal.seen:
                    # Another commit came first, so this one can never succeed.
                    self.place.remove(f"{JOURNAL}/{batch}.json")
            return finished


def _lost(where: str) -> UsageError:
    return UsageError(f"{where}: no commit succeeded in {_RACES} attempts: is its store in order?")


def _said(error: BaseException) -> str:
    return printable(" ".join(_STACK.sub("", _COLOURS.sub("", str(error))).split()))


def _is_new(row: Mapping[str, Any], known: Mapping[str, str]) -> bool:
    """Say whether a row of `captures` brings something: content that is not there, or could not be taken before."""
    before = known.get(row["capture"], "")
    return row["status"] != "known" and before not in TAKEN and (row["status"] in TAKEN or before != row["status"])


def _alike(there: Any, wanted: Any) -> bool:
    """Say whether two fields of one name mean the same."""
    return there.type == wanted.type and (there.metadata or {}).get("unit") == (wanted.metadata or {}).get("unit")


def _store_options(options: Mapping[str, Any]) -> dict[str, str]:
    """Return fsspec's options for a store as Delta Lake has them."""
    found = {}
    for name, value in {**options, **options.get("client_kwargs", {})}.items():
        if name in _OPTIONS:
            found[_OPTIONS[name]] = str(value)
    if found.get("aws_endpoint_url", "").startswith("http://"):
        found["aws_allow_http"] = "true"
    return found
