"""The outer boundary of every command: what leaves on its two streams, and what an error becomes that nothing foresaw.

- **Streams.** What is printed comes from captures, file names and plugins. A control character in it becomes visible
  (`\\x1b`), and so does what the terminal's encoding lacks. Only colours of our own pass, and only to a terminal. Bytes of an
  export (`stdout.buffer`) and what rich draws do not pass here: `console.Console` cleans the texts that rich draws.
- **Faults.** An unforeseen error is a fault of servotap, or of a package that adds to it: it becomes one line and exit status
  70, and all about it stands in a file. An error in another thread is one too. What the system refuses (a full disk, a missing
  folder) is no fault.

In a process of our own both hold to its end, also for what packages do as Python exits.
"""

from __future__ import annotations

import _thread
import codecs
import contextlib
import errno
import os
import re
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from types import CodeType, FrameType
from typing import Any, TextIO, cast

from analyzer.cli.signals import begin, ended_status
from analyzer.system import own_process
from analyzer.values import escaped, printable

#: Exit status of a fault of servotap, as `EX_SOFTWARE` of sysexits.h.
FAULT = 70
#: Exit status of a command whose reader has gone, as a shell tells SIGPIPE: what it would have judged is not known.
READER_GONE = 141
#: Environment variables: shows the traceback of a fault; the folder for the files about faults, else that of temporary files.
TRACEBACK, FOLDER = "SERVOTAP_TRACEBACK", "SERVOTAP_FAULTS"
_COLOUR = re.compile(r"(\x1b\[(?:[0-2]|3[1-6])m)")
_LONGEST = 300
#: The system has no more descriptors, processes or memory.
_SHORT = {errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.EAGAIN}
_UNWRITTEN = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS}

_ERRORS = "servotap-escape"


def _escape(error: UnicodeError) -> tuple[str, int]:
    assert isinstance(error, UnicodeEncodeError)
    return escaped(error.object[error.start : error.end]), error.end


codecs.register_error(_ERRORS, _escape)


class Forgiving:
    """A text stream to which writing never fails; all else is as with the stream itself."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        with contextlib.suppress(OSError):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with contextlib.suppress(OSError):
            self._stream.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


class _Clean:
    """A text stream to which nothing gets that steers a terminal; all else is as with the stream itself."""

    def __init__(self, stream: TextIO | Forgiving) -> None:
        #: Where rich writes: its own escapes are wanted.
        self.rich_proxied_file = stream
        self._colours = stream.isatty()
        with contextlib.suppress(AttributeError):
            cast(Any, stream).reconfigure(errors=_ERRORS)

    def write(self, text: str) -> int:
        if not text.isprintable() and text != "\n":
            parts = _COLOUR.split(text) if self._colours else [text]
            text = "".join(part if n % 2 else printable(part, "\n\t") for n, part in enumerate(parts))
        self.rich_proxied_file.write(text)
        return len(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.rich_proxied_file, name)


@contextlib.contextmanager
def _clean_streams() -> Iterator[None]:
    before = sys.stdout, sys.stderr
    if None in (sys.stdin, *before):
        _reserve_descriptors()
    for number, name, stream in ((1, "stdout", sys.stdout), (2, "stderr", sys.stderr)):
        if not isinstance(stream, _Clean):
            usable = stream or open(number, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
            # Errors that cannot be told go nowhere; an output that cannot be written is one.
            setattr(sys, name, _Clean(Forgiving(usable) if name == "stderr" else usable))
    try:
        yield
    finally:
        if not own_process.is_own:
            sys.stdout, sys.stderr = before


def _reserve_descriptors() -> None:
    """Open what was closed of the descriptors 0, 1 and 2, so that no file gets them and then what others print.

    The output is only opened for reading: what is printed has to fail.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDONLY if number == 1 else os.O_RDWR)


class _Faults:
    """While this is entered, faults of all threads are reported; `any`: there was one."""

    def __init__(self, words: Sequence[str]) -> None:
        self.any = False
        self._words = words
        self._shown = "--traceback" in words or bool(os.environ.get(TRACEBACK))

    def __enter__(self) -> _Faults:
        self._before = threading.excepthook, sys.unraisablehook
        threading.excepthook, sys.unraisablehook = self._in_thread, self._unraisable
        _entered.append(self)
        return self

    def __exit__(self, *exception: object) -> None:
        _entered.remove(self)
        if not own_process.is_own:
            threading.excepthook, sys.unraisablehook = self._before

    def _in_thread(self, arguments: threading.ExceptHookArgs) -> None:
        if arguments.exc_value is not None and _is_fault(arguments.exc_value):
            self.add(arguments.exc_value)

    def _unraisable(self, unraisable: Any) -> None:
        if isinstance(unraisable.exc_value, KeyboardInterrupt):
            # Ctrl-C fell into a place where Python drops it: it is given once more, and not here, which is such a place.
            threading.Thread(target=_interrupt_outside, args=(self._unraisable.__code__,), daemon=True).start()
        elif unraisable.exc_value is not None:
            self.add(unraisable.exc_value)

    def add(self, error: BaseException) -> None:
        """Report a fault: one line, and a file with all about it."""
        import traceback

        from analyzer.plugins import reason, whose

        self.any = True
        trace = "".join(traceback.format_exception(error))
        shown = self._shown
        try:
            where = f"the file written to {_write_report(self._words, trace)}"
        except OSError as unwritten:
            where, shown = f"this traceback, for its file cannot be written ({unwritten.strerror})", True
        what = reason(error)[:_LONGEST].rstrip(": ")
        package = printable(whose(error))
        whom = f"the package {package}" if package else "servotap"
        lines = f"servotap: a fault of {whom}: {what}; please report it{' to its makers' * bool(package)} with {where}\n"
        sys.stderr.write(lines + trace if shown else lines)


def _is_fault(error: BaseException) -> bool:
    """Say whether an error is more than the wish of the program to end."""
    return not isinstance(error, SystemExit) or isinstance(error, own_process.Ended)


def _interrupt_outside(hook: CodeType) -> None:
    """Interrupt the main thread as soon as it has left a hook."""
    main = threading.main_thread().ident
    frame: FrameType | None = sys._current_frames()[main or 0]
    while frame is not None:
        inside = frame.f_code is hook
        frame = frame.f_back
        if inside:
            time.sleep(0.001)
            frame = sys._current_frames().get(main or 0)
    if hasattr(signal, "pthread_kill") and main is not None:
        # As the terminal does: it ends a wait, too.
        signal.pthread_kill(main, signal.SIGINT)
    else:
        _thread.interrupt_main()


#: The boundaries that are entered, the innermost last.
_entered: list[_Faults] = []


def report(error: Exception) -> None:
    """Report an error as a fault and go on: what it broke is not what the command is for."""
    _entered[-1].add(error)


def _write_report(words: Sequence[str], trace: str) -> str:
    """Write what a report needs into a file, and return its name."""
    import platform
    from datetime import UTC, datetime
    from importlib.metadata import distributions

    packages = set()
    for each in distributions():
        # A package whose own words cannot be read may be what is at fault.
        with contextlib.suppress(Exception):
            packages.add(f"{each.name} {each.version}")
    about = {
        "command line": ["servotap", *words],
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
        "python": f"{sys.version} on {platform.platform()}",
        "encodings": f"{sys.getfilesystemencoding()}, {sys.stdout.encoding}, {sys.stderr.encoding}",
        "packages": ", ".join(sorted(packages)),
    }
    handle, name = tempfile.mkstemp(prefix="servotap-fault-", suffix=".txt", dir=os.environ.get(FOLDER) or None)
    with open(handle, "w", encoding="utf-8", errors="backslashreplace") as file:
        file.writelines(f"{key}: {value}\n" for key, value in about.items())
        file.write(f"\n{trace}")
    return name


def bounded(command: Callable[[list[str]], int], words: list[str]) -> int:
    """Run a command within the boundary and return its exit status."""
    begin()
    with _clean_streams(), _Faults(words) as faults:
        status = _status(command, words, faults)
        return FAULT if faults.any else status


def _status(command: Callable[[list[str]], int], words: list[str], faults: _Faults) -> int:
    status = 0
    try:
        try:
            status = command(words)
        except SystemExit:
            # argparse leaves so after the help, which may be what cannot be written.
            sys.stdout.flush()
            raise
        sys.stdout.flush()
        return status
    except BrokenPipeError:
        # The reader of our output has gone (`| head`): leave without a word.
        _drop_output()
        return status or READER_GONE
    except KeyboardInterrupt:
        print("servotap: interrupted; nothing more was written", file=sys.stderr)
        return ended_status()
    except SystemExit as error:
        if not _is_fault(error):
            raise
        faults.add(error)
        return FAULT
    # Other packages raise what derives from BaseException alone.
    except BaseException as error:
        why = refused(error)
        if why:
            try:
                sys.stdout.flush()
            except OSError:
                _drop_output()
            print(f"servotap: {why}", file=sys.stderr)
            return max(status, 2)
        faults.add(error)
        return FAULT


#: What a library in Rust raises for a fault of its own. It derives from BaseException and cannot be imported by name.
PANIC = "PanicException"
#: How Python tells that the system gives no more threads, and that a number is too long to be read: its cost grows with the
#: square of its digits. How the loader of libraries tells that there is no memory for one.
_NO_THREAD, _TOO_MANY_DIGITS, _NO_ROOM = "can't start new thread", "Exceeds the limit (", "failed to map segment"
#: How Python tells of a clock that it cannot read, and that no folder takes a temporary file.
_NO_TIME, _NO_SCRATCH = "timestamp too large to convert to C _PyTime_t", "No usable temporary directory found"


def refused(error: BaseException) -> str:
    """Return what the system or Python refused; nothing where the error is none of theirs."""
    if type(error).__name__ == PANIC:
        code = re.search(r"Os \{ code: (\d+),", str(error))
        return refused(OSError(int(code[1]), os.strerror(int(code[1])))) if code is not None else ""
    if isinstance(error, MemoryError) or (isinstance(error, RuntimeError) and str(error) == _NO_THREAD):
        return f"the system has no more for this process: {str(error) or 'memory'}"
    if isinstance(error, ImportError) and _NO_ROOM in str(error):
        return f"the system has no more for this process: {error}"
    if isinstance(error, ValueError) and str(error).startswith(_TOO_MANY_DIGITS):
        return f"a number has more than {sys.get_int_max_str_digits()} digits"
    if isinstance(error, OverflowError) and str(error) == _NO_TIME:
        return "this computer's clock is behind 2262: set it"
    if not isinstance(error, OSError):
        # pathlib tells a loop of links so, before Python 3.13.
        return str(error) if isinstance(error, RuntimeError) and str(error).startswith("Symlink loop") else ""
    if error.errno in _SHORT:
        return f"the system has no more for this process: {error.strerror}"
    if error.errno == errno.ENOENT and error.filename is None:
        if str(error.strerror).startswith(_NO_SCRATCH):
            return "no folder takes temporary files; TMPDIR names one"
        return "the current folder has been removed: change into one that exists"
    if error.filename is not None:
        name = os.fsdecode(error.filename) if isinstance(error.filename, (bytes, str, os.PathLike)) else str(error.filename)
        return f"{printable(name)}: {error.strerror}"
    if error.errno == errno.EBADF and _output_is_closed():
        return "cannot write the output: it is closed"
    return f"cannot write the output: {error.strerror}" if error.errno in _UNWRITTEN else ""


def _output_is_closed() -> bool:
    """Say whether the output was closed from the start: then it is open for reading alone."""
    try:
        with open(sys.stdout.fileno(), "wb", buffering=0, closefd=False) as output:
            output.write(b"")
    except OSError as error:
        return error.errno == errno.EBADF
    return False


def _drop_output() -> None:
    """Send what is still buffered nowhere, so that there is no second error at exit."""
    with contextlib.suppress(OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
