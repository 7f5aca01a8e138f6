"""Files that commands write: complete under their names, or absent.

Under construction they are `.NAME.xxxxxxxx.part`. One that a killed process left goes when the same file is written again.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import os
import re
import shutil
import stat
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Set
from pathlib import Path
from typing import IO

from analyzer.errors import UsageError
from analyzer.live.lock import recorded
from analyzer.sources.recording_parts import logs_in
from analyzer.system.scratch import held, let_go, remove_left


def target_of(path: Path) -> Path:
    """Return the file that is to be written, behind symbolic links. Raises UsageError for links that lead to themselves."""
    if not path.is_symlink():
        return path
    try:
        return path.resolve()
    except (RuntimeError, OSError):
        raise UsageError(f"{path} is a symbolic link that leads back to itself: remove it, or name another file") from None


#: What tells a file from all others, whatever its names.
Identity = tuple[int, int]


def identity(path: Path) -> Identity:
    """Return what tells a file or a folder from all others, behind links of any kind. Raises OSError."""
    about = path.stat()
    return about.st_dev, about.st_ino


def inputs(words: Iterable[str]) -> frozenset[Identity]:
    """Return which files are read: captures, device files, and of a folder the logs in it. `-` is standard input."""
    found = set()
    for path in (Path(word) for word in words if word != "-"):
        # What cannot be looked at is told when it is read.
        with contextlib.suppress(OSError, ValueError):
            found |= {identity(each) for each in (path, *(logs_in(path) if path.is_dir() else ()))}
    return frozenset(found)


def free_target(path: Path, replace: bool, read: Set[Identity] = frozenset()) -> Path:
    """Return the file that is to be written, behind symbolic links, before any work is done for it.

    `read`: the files that are read (see `inputs`). Raises UsageError for a folder, a device, a pipe, and one of
    these files. A file that exists is refused, too, unless `replace` is set.
    """
    target = target_of(path)
    if target.exists():
        if not target.is_file():
            raise UsageError(f"{target} is {'a folder' if target.is_dir() else 'not a regular file'}: name a file")
        if identity(target) in read:
            raise UsageError(f"{target} is one of the files that are read; choose another name with -o")
        if not replace:
            raise UsageError(f"{target} exists; --force replaces it")
    return target


def add_text_output(parser: argparse.ArgumentParser) -> None:
    """Add the options of a command that prints one file: -o and --force."""
    parser.add_argument("-o", "--output", metavar="OUT", help="the file; standard output by default")
    parser.add_argument("--force", action="store_true", help="replace a file that exists")


def deliver(text: str, arguments: argparse.Namespace) -> None:
    """Print a text as UTF-8, or write it to the file of -o. Raises UsageError where that cannot be."""
    if arguments.output in (None, "-"):
        sys.stdout.buffer.write(text.encode())
        sys.stdout.buffer.flush()
    else:
        write_whole(free_target(Path(arguments.output), arguments.force), text.encode(), replace=arguments.force)


def write_whole(path: Path, data: bytes, *, replace: bool = True) -> None:
    """Write a file under its name only when it is whole. Raises UsageError where that cannot be."""
    with whole(path, replace=replace) as stream:
        stream.write(data)


@contextlib.contextmanager
def whole(path: Path, *, replace: bool = True) -> Iterator[IO[bytes]]:
    """Yield a file to write. It gets its name when this ends, and leaves no file where something is raised.

    Raises UsageError where it cannot be written.
    """
    output = Output(path, replace)
    with kept(output, "the incomplete file was removed"):
        yield output.stream


def apart(arguments: argparse.Namespace, *options: str) -> None:
    """Raise UsageError where two options name one file: what is read or written last would replace the other."""
    named: dict[object, str] = {}
    for option in options:
        if not (place := getattr(arguments, option)):
            continue
        path = Path(place)
        other = named.setdefault(identity(path) if path.exists() else path.resolve(), option)
        if other != option:
            one, two = (f"--{each.replace('_', '-')}" for each in (other, option))
            raise UsageError(f"{one} and {two} name the same file, {path}: choose another name for one of them")


class Output:
    """A file under construction in the target's folder. It takes the target's name only when it is whole.

    `target`: the name it is to have; `replace`: whether a file of that name may be replaced. Raises UsageError where no
    file can be made.
    """

    def __init__(self, target: Path, replace: bool) -> None:
        self.target = target = target_of(target)
        self._replace = replace
        if target.exists() and not target.is_file():
            raise UsageError(f"{target} is not a regular file: name a file")
        if recorded(target):
            raise UsageError(f"{target} is being recorded; stop the recording first, or name another file")
        try:
            self.part, self._lock = _held_part(target, _new_file)
            self.stream: IO[bytes] = open(self.part, "wb", buffering=1 << 20)  # noqa: SIM115
        except OSError as error:
            raise UsageError(f"cannot write {target}: {error.strerror}") from None

    def keep(self) -> None:
        """Give the file its name. Raises UsageError if another program created that file meanwhile."""
        self.stream.close()
        self._name_it()
        self._lock = let_go(self._lock)

    def _name_it(self) -> None:
        umask = os.umask(0)
        os.umask(umask)
        mode = 0o666 & ~umask
        if self._replace:
            # What was private stays so.
            with contextlib.suppress(FileNotFoundError):
                mode = stat.S_IMODE(self.target.stat().st_mode)
        _permit(self.part, mode)
        if self._replace:
            self.part.replace(self.target)
            return
        try:
            # A link, unlike a rename, fails if the file was created meanwhile.
            os.link(self.part, self.target)
        except FileExistsError:
            raise UsageError(f"{self.target} was created by another program meanwhile; --force replaces it") from None
        except OSError:
            self.part.replace(self.target)  # a file system without links
            return
        # It is whole under its name: a second one that stays does no harm.
        with contextlib.suppress(OSError):
            self.part.unlink()

    def drop(self) -> None:
        # On a full disk closing fails too; the file is removed all the same.
        with contextlib.suppress(OSError):
            self.stream.close()
        with contextlib.suppress(OSError):
            self.part.unlink()
        self._lock = let_go(self._lock)


@contextlib.contextmanager
def kept(output: Output, otherwise: str) -> Iterator[None]:
    """Give a file its name when this ends; leave none where something is raised. `otherwise`: what is then, in words.

    Raises UsageError where it cannot be written.
    """
    try:
        yield
        output.keep()
    except OSError as error:
        output.drop()
        raise UsageError(f"cannot write {output.target}: {error.strerror or error}; {otherwise}") from None
    except BaseException:
        output.drop()
        raise


class OutputFolder:
    """A folder of tables while they are written. It stands next to the target, and takes the target's name when it is whole.

    `target`: the name it is to have; `replace`: whether a folder of that name that holds nothing but tables may be replaced.
    Raises UsageError where no folder can be made.
    """

    def __init__(self, target: Path, replace: bool) -> None:
        self.target, self._replace = target, replace
        if target.exists():
            if not replace:
                raise UsageError(f"{target} exists; --force replaces it")
            if target.is_symlink():
                raise UsageError(f"{target} is a symbolic link: name the folder itself")
            if not target.is_dir() or any(each.suffix != ".parquet" or not each.is_file() for each in target.iterdir()):
                raise UsageError(f"{target} is no folder of Parquet files alone: name another one")
        try:
            self.part, self._lock = _held_part(target, tempfile.mkdtemp)
        except OSError as error:
            raise UsageError(f"cannot write {target}: {error.strerror}") from None

    def keep(self) -> None:
        """Give the folder its name. Raises UsageError if another program created that folder meanwhile."""
        self._name_it()
        self._lock = let_go(self._lock)

    def _name_it(self) -> None:
        umask = os.umask(0)
        os.umask(umask)
        _permit(self.part, 0o777 & ~umask)
        # A folder takes the place of no folder that holds anything.
        if not self._replace or not self.target.exists():
            try:
                self.part.replace(self.target)
            except OSError:
                if self.target.exists():
                    raise UsageError(f"{self.target} was created by another program meanwhile; --force replaces it") from None
                raise
            return
        # At a kill in between the old one is still there, under the other name.
        old = self.part.with_suffix(".old")
        self.target.replace(old)
        self.part.replace(self.target)
        shutil.rmtree(old)

    def drop(self) -> None:
        shutil.rmtree(self.part, ignore_errors=True)
        self._lock = let_go(self._lock)


def _permit(path: Path, mode: int) -> None:
    """Give a file or folder its permissions; many a stick or share has none of its own, and refuses."""
    with contextlib.suppress(OSError):
        path.chmod(mode)


def _new_file(*, prefix: str, suffix: str, dir: Path) -> str:
    """Make a file as `tempfile.mkdtemp` makes a folder; return its name."""
    handle, name = tempfile.mkstemp(suffix, prefix, dir)
    os.close(handle)
    return name


def _held_part(target: Path, make: Callable[..., str]) -> tuple[Path, int]:
    """Make the part that will become the target; return it and its lock. Parts that a killed process left are removed."""
    name = re.compile(rf"\.{re.escape(target.name)}\.[a-z0-9_]{{8}}\.part")
    remove_left(path for path in _parts_in(target.parent) if name.fullmatch(path.name))
    return held(lambda: Path(make(prefix=f".{target.name}.", suffix=".part", dir=target.parent)))


@functools.cache
def _parts_in(folder: Path) -> tuple[Path, ...]:
    """Return what is under construction in a folder at first sight: many captures of one folder read it once."""
    try:
        return tuple(folder.glob(".*.part"))
    except OSError:
        return ()
