"""The outer boundary: what a fault becomes, and that nothing printed steers a terminal."""

from __future__ import annotations

import errno
import io
import os
import re
import signal
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import pytest
from rich.progress import Progress

from analyzer import cli
from analyzer.cli import COMMANDS, boundary, main
from analyzer.cli import show as show_module
from analyzer.cli.boundary import FOLDER, READER_GONE, _clean_streams, bounded
from analyzer.cli.console import Console
from analyzer.system import own_process
from tests import CAPTURES, ROOT

HOSTILE = "\x1b[2J\x9b31m\x7f\x00\r\b\u202etxt\udcff\u2066é"
SHOWN = r"\x1b[2J\u009b31m\u007f\x00\r\x08\u202etxt\udcff\u2066é"


@pytest.fixture
def faults(tmp_path, monkeypatch):
    """The files about faults, in a folder that is not looked at after the test."""
    folder = tmp_path / "faults of this test"
    folder.mkdir()
    monkeypatch.setenv(FOLDER, str(folder))
    return lambda: [path.read_text() for path in folder.iterdir()]


class Terminal(io.StringIO):
    def isatty(self):
        return True


def fails(error):
    def command(words):
        raise error

    return command


def test_a_fault_is_one_line_and_a_file(faults, capsys):
    assert bounded(fails(KeyError(HOSTILE)), ["show", "a b"]) == 70
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert "Traceback" not in err
    line = r"servotap: a fault of servotap: KeyError: .*; please report it with the file written to (.*\.txt)\n"
    named = re.fullmatch(line, err)[1]
    (told,) = faults()
    assert Path(named).read_text() == told
    assert "command line: ['servotap', 'show', 'a b']" in told
    assert "Traceback (most recent call last)" in told
    for word in ("python: ", "packages: ", "mcap "):
        assert word in told


@pytest.mark.parametrize("asked", ["option", "variable"])
def test_the_traceback_is_shown_where_it_is_asked_for(asked, faults, capsys, monkeypatch):
    if asked == "variable":
        monkeypatch.setenv("SERVOTAP_TRACEBACK", "1")
    assert bounded(fails(RuntimeError(HOSTILE)), ["--traceback"] * (asked == "option")) == 70
    err = capsys.readouterr().err
    assert "Traceback (most recent call last)" in err
    assert "\x1b" not in err
    assert len(faults()) == 1


@pytest.mark.parametrize("words", [["--traceback", "show", "x"], ["show", "--traceback", "x"]])
def test_the_option_stands_before_or_behind_the_command(words, faults, capsys, monkeypatch):
    monkeypatch.setattr(show_module, "run", fails(ZeroDivisionError()))
    assert main(words) == 70
    assert "ZeroDivisionError" in capsys.readouterr().err.splitlines()[-1]


def test_a_current_folder_that_was_removed_is_told(faults, capsys, tmp_path, monkeypatch):
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    assert main(["record", "left=tcp:127.0.0.1:1", "-o", "left.mcap"]) == 2
    assert capsys.readouterr().err == "servotap: the current folder has been removed: change into one that exists\n"
    assert faults() == []


def test_a_module_that_is_no_command_is_left_out(capsys, monkeypatch):
    monkeypatch.setattr(cli, "_added", lambda: {"foo": ("errno", "")})
    assert main(["foo"]) == 2
    assert "the command foo (errno) failed and is left out: AttributeError" in capsys.readouterr().err


def prints(status):
    def command(words):
        print("x", end="")
        return status

    return command


@pytest.mark.parametrize(
    ("error", "command", "status"),
    [
        (BrokenPipeError(), fails(BrokenPipeError()), READER_GONE),
        (BrokenPipeError(), prints(0), READER_GONE),
        (BrokenPipeError(), prints(1), 1),
        (BrokenPipeError(), prints(20), 20),
        (OSError(errno.ENOSPC, "full"), prints(0), 2),
        (OSError(errno.ENOSPC, "full"), prints(1), 2),
        (OSError(errno.ENOSPC, "full"), prints(20), 20),
    ],
)
def test_output_that_is_not_taken_makes_no_run_green(error, command, status, capfd, monkeypatch):
    class Unread(io.StringIO):
        def flush(self):
            raise error

    monkeypatch.setattr(sys, "stdout", Unread())
    monkeypatch.setattr(boundary, "_drop_output", lambda: None)
    assert bounded(command, ["test"]) == status


def test_where_no_file_can_be_written_the_traceback_is_shown(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv(FOLDER, str(tmp_path / "gone"))
    assert bounded(fails(ValueError("x")), []) == 70
    err = capsys.readouterr().err
    assert "its file cannot be written (No such file or directory)" in err
    assert "Traceback" in err


def test_a_fault_in_another_thread_ends_in_70_too(faults, capsys):
    def command(words):
        thread = threading.Thread(target=fails(RuntimeError("there")), args=(words,))
        thread.start()
        thread.join()
        return 0

    assert bounded(command, []) == 70
    assert len(faults()) == 1
    assert capsys.readouterr().err.startswith("servotap: a fault of servotap: RuntimeError: there; ")


def test_a_fault_where_python_ignores_it_ends_in_70_too(faults, capsys):
    class Odd:
        def __del__(self):
            raise RuntimeError("there")

    def command(words):
        Odd()
        return 0

    assert bounded(command, []) == 70
    assert len(faults()) == 1


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), "cannot write the output: No space left on device"),
        (OSError(errno.EMFILE, "Too many open files"), "the system has no more for this process: Too many open files"),
        (MemoryError(), "the system has no more for this process: memory"),
        (RuntimeError("can't start new thread"), "the system has no more for this process: can't start new thread"),
        (ImportError("x.so: failed to map segment"), "the system has no more for this process: x.so: failed to map segment"),
        (FileNotFoundError(2, "No such file or directory", "gone\x1b"), "gone\\x1b: No such file or directory"),
        (FileNotFoundError(2, "No such file or directory", b"gone\xff"), "gone\\udcff: No such file or directory"),
        (OverflowError("timestamp too large to convert to C _PyTime_t"), "this computer's clock is behind 2262: set it"),
        (
            FileNotFoundError(errno.ENOENT, "No usable temporary directory found in ['/tmp']"),
            "no folder takes temporary files; TMPDIR names one",
        ),
    ],
)
def test_what_the_system_refuses_is_no_fault(error, said, faults, capsys):
    assert bounded(fails(error), []) == 2
    assert capsys.readouterr().err == f"servotap: {said}\n"
    assert faults() == []


def test_a_number_that_is_too_long_to_read_is_no_fault(capsys):
    assert bounded(lambda words: int(words[0]), ["9" * 5000]) == 2
    assert capsys.readouterr().err == "servotap: a number has more than 4300 digits\n"
    assert main(["scan", "tcp:127.0.0.1:1", "--rates", "9" * 5000]) == 2


class PanicException(BaseException):
    """As the libraries in Rust raise it."""


def test_a_panic_of_a_library_is_a_fault_or_what_the_system_refuses(faults, capsys):
    told = 'failed to create UnixStream: Os { code: 24, kind: Uncategorized, message: "Too many open files" }'
    assert bounded(fails(PanicException(told)), []) == 2
    assert "the system has no more for this process: Too many open files" in capsys.readouterr().err
    assert bounded(fails(PanicException("index out of bounds")), []) == 70
    assert "a fault of servotap: PanicException: index out of bounds" in capsys.readouterr().err
    assert bounded(fails(GeneratorExit("x")), []) == 70
    assert len(faults()) == 2


def test_an_error_of_the_system_without_a_place_is_a_fault(faults):
    assert bounded(fails(OSError(errno.EBADF, "Bad file descriptor")), []) == 70
    assert len(faults()) == 1


def test_what_is_printed_cannot_steer_a_terminal(capsys):
    def command(words):
        print(HOSTILE)
        print(HOSTILE, file=sys.stderr)
        print("a\tb\nc", "\x1b[31mred\x1b[0m")
        return 0

    assert bounded(command, []) == 0
    out, err = capsys.readouterr()
    assert out == f"{SHOWN}\na\tb\nc \\x1b[31mred\\x1b[0m\n"
    assert err == SHOWN + "\n"


def test_only_our_colours_get_to_a_terminal(monkeypatch):
    terminal = Terminal()
    monkeypatch.setattr(sys, "stdout", terminal)
    bounded(lambda words: print("\x1b[31mred\x1b[0m", "\x1b[8mhidden\x1b[2J", HOSTILE) or 0, [])
    assert terminal.getvalue() == f"\x1b[31mred\x1b[0m \\x1b[8mhidden\\x1b[2J {SHOWN}\n"


def test_what_rich_draws_is_clean_but_for_its_own_escapes():
    file = io.StringIO()
    console = Console(file=file, force_terminal=True, color_system="standard", width=200)
    console.print(HOSTILE, style="red", markup=False, highlight=False)
    # rich itself leaves out the bell, the backspace and their like.
    assert re.fullmatch(r"\x1b\[31m\\x1b\[2J.*txt\\udcff\\u2066é\x1b\[0m\n", file.getvalue())


def test_what_an_encoding_lacks_is_written_as_an_escape(monkeypatch):
    raw = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(raw, "ascii"))
    assert bounded(lambda words: print("90° …\udcff") or 0, []) == 0
    assert raw.getvalue() == b"90\\u00b0 \\u2026\\udcff\n"


def test_a_nul_in_a_word_is_refused(capsys):
    assert main(["show", "a\0b"]) == 2
    assert "NUL" in capsys.readouterr().err


SHELL = [sys.executable, "-m", "analyzer"]


@pytest.mark.parametrize(
    ("closed", "status"),
    [("<&-", 0), ("2>&-", 0), (">/dev/null <&- 2>&-", 0), (">&-", 2), (">&- 2>&-", 2), ("<&- >&- 2>&-", 2)],
)
def test_closed_streams_harm_nothing_and_an_output_that_is_closed_is_told(closed, status, tmp_path):
    capture = tmp_path / "a.log"
    capture.write_text("> FA 01 32 2D\n< FB 01 32 00 64 92\n")
    log = tmp_path / "a.mcap"
    line = f'"$0" -m analyzer decode "$1" -o "$2" {closed}'
    done = subprocess.run(["sh", "-c", line, sys.executable, capture, log], capture_output=True, text=True)
    said = "servotap: cannot write the output: it is closed\n" if closed == ">&-" else ""
    assert (done.returncode, done.stderr) == (status, said)
    assert log.stat().st_size > 500


@pytest.mark.parametrize("words", [["--help"], ["show", "--help"], ["--version"], ["explain", "FA 01 32 2D"], ["catalogue"]])
def test_each_way_to_print_tells_that_the_output_is_closed(words):
    done = subprocess.run(["sh", "-c", '"$@" >&-', "sh", *SHELL, *words], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (2, "servotap: cannot write the output: it is closed\n")


def test_a_reader_that_leaves_is_no_fault(tmp_path):
    read, write = os.pipe()
    os.close(read)
    with open(write, "w") as out:
        done = subprocess.run([*SHELL, "catalogue", "--dialect", "mks-can"], stdout=out, stderr=subprocess.PIPE, text=True)
    assert (done.returncode, done.stderr) == (READER_GONE, "")


def test_standard_error_that_cannot_be_written_changes_nothing():
    if not os.path.exists("/dev/full"):
        pytest.skip("no /dev/full on this machine")
    with open("/dev/full", "w") as full:
        assert subprocess.run([*SHELL, "show", "gone"], stderr=full, stdout=subprocess.PIPE).returncode == 2


def test_the_streams_are_left_as_they_were():
    before = sys.stdout, sys.stderr, threading.excepthook, sys.unraisablehook
    assert main(["--version"]) == 0
    assert (sys.stdout, sys.stderr, threading.excepthook, sys.unraisablehook) == before


def test_a_package_that_ends_the_process_is_a_fault(monkeypatch, faults, capsys):
    import analyzer.cli as cli

    monkeypatch.setattr(os, "_exit", own_process.raising())
    broken = SimpleNamespace(__doc__="", add_arguments=lambda parser: None, run=lambda arguments: os._exit(0))
    monkeypatch.setattr(cli, "import_module", lambda name: broken)
    assert main(["show"]) == 70
    assert len(faults()) == 1
    assert "os._exit(0) was called" in capsys.readouterr().err


def test_every_command_stands_in_the_boundary(monkeypatch, faults, capsys):
    """A failing command is a fault, in this package and in others."""
    from importlib.metadata import entry_points

    import analyzer.cli as cli

    broken = SimpleNamespace(__doc__="", add_arguments=lambda parser: None, run=fails(RuntimeError("x")))
    monkeypatch.setattr(cli, "import_module", lambda name: broken)
    names = [*COMMANDS, *(point.name for point in entry_points(group=cli.GROUP))]
    assert {name: main([name]) for name in names} == dict.fromkeys(names, 70)
    assert len(faults()) == len(names)


@pytest.mark.parametrize("word", ["--filter=--", "--dialect=--"])
def test_the_mark_of_the_end_of_options_is_no_value(word, capsys):
    with pytest.raises(SystemExit) as ended:
        main(["show", "x", word])
    assert ended.value.code == 2
    assert capsys.readouterr().err.startswith(f"servotap show: argument {word[:-3]}: expected a value, got --")


@pytest.mark.parametrize("name", ["-a.log", "--json", "--"])
def test_behind_the_mark_of_the_end_of_options_a_name_may_begin_with_a_dash(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path(name).write_text("> FA 01 32 2D\n")
    assert main(["show", "--limit", "1", "--", name]) == 0
    assert "read_speed" in capsys.readouterr().out


def test_a_time_zone_a_day_off_is_told_and_no_fault():
    words = [sys.executable, "-m", "analyzer", "show", "captures/mks_can.asc", "--limit", "1"]
    ended = subprocess.run(words, cwd=ROOT, env={**os.environ, "TZ": "XXX-24"}, capture_output=True, text=True)
    assert (ended.returncode, ended.stderr) == (
        0,
        "servotap: TZ=XXX-24: expected less than 24 hours from UTC; times are shown in UTC\n",
    )
    assert "09:00:00.000000" in ended.stdout


def test_ctrl_c_while_the_command_line_is_imported_shows_no_traceback(tmp_path):
    """The import of the command line waits to be interrupted; before ours, Python's own beginning is beyond reach."""
    (tmp_path / "analyzer" / "system").mkdir(parents=True)
    for name in ("__init__.py", "__main__.py", "system/__init__.py", "system/own_process.py"):
        (tmp_path / "analyzer" / name).write_text((ROOT / "analyzer" / name).read_text())
    (tmp_path / "analyzer" / "cli.py").write_text("import time\nprint('here', flush=True)\ntime.sleep(20)\n")
    words = [sys.executable, "-S", "-m", "analyzer"]
    with subprocess.Popen(words, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"here\n"
        process.send_signal(signal.SIGINT)
        assert process.stderr.read() == b""
        assert process.wait(10) == -signal.SIGINT


def test_ctrl_c_in_a_destructor_ends_the_command_without_a_word_of_python(capfd):
    class Dying:
        def __del__(self):
            raise KeyboardInterrupt

    def command(words):
        dying = Dying()
        del dying
        threading.Event().wait(20)
        return 0

    assert bounded(command, []) == 130
    assert capfd.readouterr() == ("", "servotap: interrupted; nothing more was written\n")


@pytest.mark.parametrize("kind", ["hex", "csv"])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_an_export_of_a_pipe_that_says_nothing(kind, number, tmp_path, monkeypatch, capsys):
    silent, end = os.pipe()
    monkeypatch.setattr(sys, "stdin", os.fdopen(silent))
    timer = threading.Timer(0.2, lambda: signal.pthread_kill(threading.main_thread().ident, number))
    # Without the signal the pipe ends, so that the test does.
    late = threading.Timer(5.0, lambda: os.close(end))
    timer.start()
    late.start()
    assert main(["export", "-", "--to", kind, "-o", str(tmp_path / "out")]) == 128 + number
    late.cancel()
    assert "nothing more was written" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_progress_draws_on_the_terminal_and_texts_stay_clean(monkeypatch):
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    with _clean_streams(), Progress(console=Console(stderr=True), transient=True) as bar:
        bar.add_task("decoding", total=10)
        print("a note with \x1b[2J in it", file=sys.stderr)
        bar.refresh()
    assert "\r\x1b[2K" in terminal.getvalue()
    assert "\\x1b" not in terminal.getvalue()
    # rich takes the escapes of what others print above its display.
    assert "a note with" in terminal.getvalue()
    assert "\x1b[2J" not in terminal.getvalue()


BROKEN = "a\nservotap: all well"


@pytest.mark.parametrize(
    "words",
    [
        ["show", BROKEN],
        ["show", f"{BROKEN}/x"],
        ["show", "--limit", BROKEN, "x"],
        ["show", f"--{BROKEN}"],
        ["show", "there", "--dbc", BROKEN],
        ["show", BROKEN * 20],
        ["cut", BROKEN, "-o", "x.mcap"],
        ["restore", BROKEN],
        ["recover", BROKEN],
        ["send", BROKEN, "read_speed"],
        ["send", "mks-rs485@1", "read_speed", "--on", f"serial:{BROKEN}"],
        ["scan", f"serial:{BROKEN}"],
        ["record", f"serial:{BROKEN}"],
        [BROKEN],
    ],
    ids=lambda words: " ".join(words)[:30],
)
def test_the_end_of_a_line_in_a_name_breaks_no_message_in_two(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("there").write_text("> FA 01 32 2D\n")
    try:
        status = main(words)
    except SystemExit as left:
        status = left.code
    assert status == 2
    said = capsys.readouterr().err
    assert "a\\nservotap: all well" in said
    assert "\nservotap: all well" not in said


def test_the_end_of_a_line_in_a_name_breaks_no_output_in_two(tmp_path, capsys):
    log = str(CAPTURES / "mks_rs485.mcap")
    assert main(["cut", log, "--since", "1s", "-o", str(tmp_path / BROKEN)]) == 0
    assert "\nservotap: all well" not in "".join(capsys.readouterr())
