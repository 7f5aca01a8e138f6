"""Places where captures and lakes are: local folders, buckets, servers, archives. fsspec knows them by their URLs.

Rules: a store may refuse or cut off any call; each is tried again, later each time, before its error counts.
"""

from __future__ import annotations

import contextlib
import errno
import os
import posixpath
import stat
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import urlsplit
from urllib.request import getproxies, proxy_bypass

from analyzer.errors import UnreadableError, UsageError
from analyzer.system.scratch import scratch_folder
from analyzer.table.extras import needed
from analyzer.values import printable, quote

T = TypeVar("T")

#: Ports of the endpoints of stores. Seconds in which one has to answer, and how often it is tried.
_PORTS = {"http": 80, "https": 443}
_CONNECT_S, _CONNECTS = 3.0, 3

#: Attempts at one call, and seconds before the second; each further wait is twice as long.
ATTEMPTS, FIRST_WAIT = 6, 0.1
#: What no further attempt changes.
_FINAL = (FileNotFoundError, PermissionError, IsADirectoryError, NotADirectoryError, FileExistsError)
#: Errors of the system that no further attempt changes, and that say nothing of a capture: no room, no quota, too long a file,
#: a read-only place.
_FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS})


def again(call: Callable[[], T], wait: Callable[[float], None] = time.sleep, attempts: int = ATTEMPTS) -> T:
    """Call a store, again and again where it fails, and return the result. Raises its last error, as OSError."""
    for attempt in range(attempts):
        try:
            return call()
        except _FINAL:
            raise
        # Each store has errors of its own, and not all of them are of the system.
        except Exception as error:
            if attempt < attempts - 1 and not no_room(error):
                wait(FIRST_WAIT * 2**attempt)
            elif isinstance(error, OSError):
                raise
            else:
                raise OSError(f"{type(error).__name__}: {error}") from error
    raise AssertionError


def no_room(error: Exception) -> bool:
    """Say whether an error came because nothing can be written, here or at the lake."""
    return isinstance(error, OSError) and error.errno in _FULL


@dataclass(frozen=True)
class Found:
    """A file at a place. `key`: its path for the store; `name`: below the place.

    `mark`: changes with its content; empty where the store tells nothing that does.
    """

    key: str
    name: str
    size: int
    mark: str
    modified: float = 0.0


@dataclass
class Place:
    """A folder or a file, by path or URL. `options`: for the store, as fsspec takes them."""

    url: str
    options: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        fsspec = needed("fsspec")
        _check_endpoint(self.url, self.options)
        try:
            self.fs, self.root = fsspec.url_to_fs(self.url, **self.options)
        except ImportError as error:
            raise UsageError(f"{quote(self.url)}: a package is missing: {error}") from None
        except ValueError as error:
            raise UsageError(f"{quote(self.url)}: expected a folder, or a URL as s3://bucket/folder: {error}") from None
        except Exception as error:
            # A server that refuses us says so in its own way.
            raise UsageError(f"{quote(self.url)} cannot be reached: {printable(str(error))}") from error
        # Names of files need not be text; what is shown and stored of them is.
        self.url = _as_text(self.url)
        #: Folders that could not be listed when `files` last looked, for want of permission.
        self.closed: list[str] = []
        self.local = "file" in ((self.fs.protocol,) if isinstance(self.fs.protocol, str) else self.fs.protocol)

    def path(self, name: str) -> str:
        """Return the store's path of what has a name below this place."""
        return posixpath.join(self.root, name) if name else self.root

    def link_in(self, folders: Iterable[str]) -> str:
        """Return a link to a folder in one of these folders, or nothing. Stores other than a disk have none."""
        # By hand: `os.walk` calls itself for each folder in another, before Python 3.12.
        waiting = [self.path(folder) for folder in folders] if self.local else []
        while waiting:
            # A folder that cannot be listed is passed over: opening what is in it tells why.
            with contextlib.suppress(OSError), os.scandir(waiting.pop()) as there:
                for each in sorted(there, key=lambda entry: entry.name):
                    if each.is_dir() and each.is_symlink():
                        return each.path
                    if each.is_dir():
                        waiting.append(each.path)
        return ""

    def check_files(self, names: Iterable[str]) -> None:
        """Raise ValueError for a pipe, a socket or a device on a disk: reading one may never end."""
        for name in names if self.local else ():
            path = self.path(name)
            if os.path.exists(path) and not os.path.isfile(path) and not os.path.isdir(path):
                raise ValueError(f"{path} is a pipe, a socket or a device: expected a file")

    def files(self, folder: str = "") -> list[Found]:
        """Return all files below this place, or a folder of it, by name. Raises UnreadableError where it is not there."""
        # What a listing held is of before; a store that is asked again has to look again.
        self.fs.invalidate_cache()
        root = self.path(folder)
        self.closed = []
        try:
            # Stores list all at once. fsspec's own walk would pass over a folder that it cannot list.
            at_once = type(self.fs).find is not needed("fsspec").AbstractFileSystem.find
            listed = (
                again(lambda: self.fs.find(root, detail=True)) if at_once else self._walk(again(lambda: self.fs.info(root)))
            )
        except FileNotFoundError:
            raise UnreadableError(f"{self.url} does not exist") from None
        except OSError as error:
            raise UnreadableError(f"{self.url} cannot be listed: {error}") from None
        if at_once and not listed and not again(lambda: self.fs.exists(root)):
            raise UnreadableError(f"{self.url} does not exist")
        found = []
        for key, about in sorted(listed.items()):
            name = posixpath.relpath(key, root) if key != root else posixpath.basename(key)
            if not any(part.startswith(".") for part in name.split("/")):
                found.append(_found(key, name, about))
        return found

    def _walk(self, about: dict[str, Any]) -> dict[str, dict[str, Any]]:
        """Return what stands at a path and below it, without folders. What is removed meanwhile is left out."""
        found: dict[str, dict[str, Any]] = {}
        # By hand, not by recursion: folders may lie in one another deeper than Python calls.
        waiting = [about]
        while waiting:
            each = waiting.pop()
            path = each["name"]
            if each["type"] != "directory":
                found[path] = each
                continue
            try:
                waiting += again(partial(self.fs.ls, path, detail=True))
            except PermissionError:
                self.closed.append(_as_text(path))
            except (FileNotFoundError, NotADirectoryError):
                pass
        return found

    @contextlib.contextmanager
    def as_file(self, found: Found) -> Iterator[Path]:
        """Yield a local file with the content of one; a download is removed afterwards."""
        if self.local:
            path = Path(found.key)
            if not stat.S_ISREG(path.stat().st_mode):
                # A pipe or a device may never end, and links to folders may lead in circles.
                what = "a link to a folder, which is not followed" if path.is_dir() else "a pipe, a socket or a device"
                raise UnreadableError(f"{what}: expected a file")
            yield path
            return
        with scratch_folder() as folder:
            target = folder / posixpath.basename(found.name)

            def fetch() -> None:
                self.fs.get_file(found.key, str(target))
                if target.stat().st_size != found.size:
                    raise OSError(f"{found.name}: expected {found.size} bytes, got {target.stat().st_size}")

            again(fetch)
            yield target

    def write(self, name: str, data: bytes | memoryview) -> None:
        """Write a file, whole or not at all."""
        if not self.local:
            again(lambda: self.fs.pipe_file(self.path(name), bytes(data)))
            return
        target = Path(self.path(name))
        target.parent.mkdir(parents=True, exist_ok=True)
        part = target.with_name(f"{target.name}.part")
        try:
            with part.open("wb") as stream:
                stream.write(data)
            part.replace(target)
        except OSError:
            part.unlink(missing_ok=True)
            raise

    def move(self, name: str, to: str) -> None:
        again(lambda: self.fs.makedirs(posixpath.dirname(self.path(to)), exist_ok=True))
        again(lambda: self.fs.mv(self.path(name), self.path(to)))

    def read(self, name: str) -> bytes:
        """Return a small file."""
        data: bytes = again(lambda: self.fs.cat_file(self.path(name)))
        return data

    def glob(self, pattern: str) -> list[str]:
        self.fs.invalidate_cache()
        return list(again(lambda: self.fs.glob(self.path(pattern))))

    def remove_folder(self, name: str) -> None:
        with contextlib.suppress(FileNotFoundError):
            again(lambda: self.fs.rm(self.path(name), recursive=True))

    def remove(self, name: str) -> None:
        with contextlib.suppress(FileNotFoundError):
            again(lambda: self.fs.rm_file(self.path(name)))


def _check_endpoint(url: str, options: Mapping[str, Any]) -> None:
    """Raise UsageError where no server answers at the endpoint of a store: its own client would try for a minute."""
    named = options.get("endpoint_url") or options.get("client_kwargs", {}).get("endpoint_url")
    if not named and url.startswith(("s3://", "s3a://")):
        named = os.environ.get("AWS_ENDPOINT_URL_S3") or os.environ.get("AWS_ENDPOINT_URL")
    if not named:
        return
    try:
        endpoint = urlsplit(named)
        port = endpoint.port
    except ValueError:
        endpoint, port = urlsplit(""), None
    if endpoint.scheme not in _PORTS or not endpoint.hostname:
        raise UsageError(f"endpoint_url={quote(named)}: expected a URL of a server, as http://minio:9000")
    if endpoint.scheme in getproxies() and not proxy_bypass(endpoint.hostname):
        return
    try:
        again(lambda: _connect(endpoint.scheme, str(endpoint.hostname), port or _PORTS[endpoint.scheme]), attempts=_CONNECTS)
    except OSError as error:
        raise UsageError(
            f"endpoint_url={quote(named)}: no such server answers there ({printable(error.strerror or str(error))}): "
            "check http or https, the host, the port, and that the server runs"
        ) from None


def _connect(scheme: str, host: str, port: int) -> None:
    """Connect to a server. Whether it is the right one, the store's own client looks. Raises OSError."""
    import http.client
    import ssl

    connection = http.client.HTTPConnection(host, port, timeout=_CONNECT_S)
    if scheme == "https":
        context = ssl.create_default_context()
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
        connection = http.client.HTTPSConnection(host, port, timeout=_CONNECT_S, context=context)
    with contextlib.closing(connection):
        connection.connect()


#: What stores call the time of a file, and what changes with its content. A folder's own files have times and numbers.
_MODIFIED = ("mtime", "LastModified", "last_modified", "created")
_TAGS = ("ETag", "etag", "md5Hash", "CRC")


def _as_text(name: str) -> str:
    return name.encode(errors="backslashreplace").decode()


def _found(key: str, name: str, about: Mapping[str, Any]) -> Found:
    modified = next((about[word] for word in _MODIFIED if about.get(word)), 0)
    seconds = modified.timestamp() if hasattr(modified, "timestamp") else float(modified)
    tag = next((about[word] for word in _TAGS if about.get(word)), "")
    mark = str(tag) if tag or not seconds else f"{seconds!r}/{about.get('ino', '')}"
    return Found(key, _as_text(name), int(about.get("size") or 0), mark, seconds)
