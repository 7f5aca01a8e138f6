"""The command line. Commands are a table; a command's module is imported only when it runs.

A module of a command has `add_arguments(parser)` and `run(arguments) -> int`. Other packages (and `conformance`) add
commands by entry points of the group `servotap.commands` that name such a module.
"""

from __future__ import annotations

import argparse
import gc
import os
import re
import signal
import sys
import time
from collections.abc import Sequence
from functools import partial
from importlib import import_module
from types import ModuleType
from typing import Any, NoReturn

from analyzer.cli.boundary import bounded
from analyzer.system import own_process

COMMANDS: dict[str, tuple[str, str]] = {
    "record": ("analyzer.cli.record", "record serial ports and CAN buses into one crash-safe, decoded MCAP log"),
    "decode": ("analyzer.cli.decode", "decode a capture into an annotated MCAP log, with a summary"),
    "diagnose": ("analyzer.cli.diagnose", "say what is wrong on a bus: the cause, the evidence, the next step"),
    "show": ("analyzer.cli.show", "show the decoded frames of a capture or a log as a table"),
    "view": ("analyzer.cli.view", "view a capture or a log in the terminal: frames, counts, findings, a plot"),
    "report": ("analyzer.cli.report", "write captures and logs as one page: diagnosis, plots, latencies, findings"),
    "plot": ("analyzer.cli.plot", "plot fields over time, as a picture or in the terminal"),
    "recover": ("analyzer.cli.recover", "repair the log of an interrupted recording"),
    "cut": ("analyzer.cli.cut", "copy a time range or some buses into a smaller log"),
    "merge": ("analyzer.cli.merge", "merge several logs into one"),
    "explain": ("analyzer.cli.explain", "explain a frame byte by byte"),
    "frame": ("analyzer.cli.frame", "print the bytes of a frame"),
    "ports": ("analyzer.cli.ports", "list serial ports and CAN interfaces, with the endpoints to record them"),
    "export": (
        "analyzer.cli.export",
        "export a capture or log as a table (CSV, Parquet, Excel), or its raw bytes (candump, pcapng, hex)",
    ),
    "catalogue": ("analyzer.cli.catalogue", "show reference pages of the dialects and errata of their manuals"),
    "dbc": ("analyzer.cli.dbc", "print the commands of a CAN dialect as a DBC file for other tools"),
    "wireshark": ("analyzer.cli.wireshark", "print a dissector for Wireshark, made from the manuals"),
    "ingest": ("analyzer.fleet.cli.ingest", "take the captures of a fleet into one lake of tables"),
    "ask": ("analyzer.fleet.cli.ask", "ask a lake in SQL"),
    "fleet": ("analyzer.fleet.cli.fleet", "write a page about a lake: drives by health, and what got worse"),
    "compact": ("analyzer.fleet.cli.compact", "join the small files of a lake, and remove what no table needs"),
    "completion": ("analyzer.cli.completion", "print what makes your shell complete these commands"),
}
GROUP = "servotap.commands"
#: Packages of this project: what fails in them is a fault of servotap.
_OWN = ("analyzer.", "conformance.")
_NO_VALUE = re.compile(r"(--[\w-]+=|-\w=?)--")
#: The end of a line in a word, with what stands around it: a message may hold a part of the word.
_LINE_END = re.compile(r"[^\n]?\n+[^\n]?")
_DAY_S = 86_400
#: Other names of commands.
_ALIASES = {"catalog": "catalogue"}
#: What one wants to do -> the commands for it, in the order of the help. Commands that stand nowhere come last.
_PURPOSES: dict[str, tuple[str, ...]] = {
    "look": ("decode", "diagnose", "show", "view", "report", "plot", "explain", "catalogue", "dbc", "wireshark"),
    "record": ("record", "tap", "ports", "recover", "cut", "merge", "export"),
    "drive": ("scan", "init", "send", "stop", "frame", "replay", "emulate"),
    "test": ("test", "check", "rerun", "restore"),
    "fleet": ("ingest", "ask", "fleet", "compact"),
}

_EPILOG = """\
examples:
  servotap decode capture.log                    write capture.log.mcap and print a summary
  servotap show capture.log --filter 'address == 1'
  servotap explain "FA 01 F6 01 40 02 34"
  servotap frame mks-rs485@1 run_speed direction=cw speed=320 acceleration=2
  servotap catalogue --dialect mks-can run_speed

'servotap COMMAND --help' describes a command.
A fault of servotap itself ends with status 70; --traceback, or SERVOTAP_TRACEBACK=1, shows where it was.
"""


def _added() -> dict[str, tuple[str, str]]:
    """Return the commands of other packages: name -> (module, help)."""
    from analyzer.plugins import points

    # The text after the blank in an entry point's name would not be valid, so the help comes from the module itself.
    return {point.name: (point.value.split(":")[0], "") for point in points(GROUP)}


def _every_command() -> dict[str, tuple[str, str]]:
    return COMMANDS | {n: (m, _help_of(n)) for n, (m, _) in _added().items()}


def _overview(commands: dict[str, tuple[str, str]]) -> str:
    width = max(len(name) for name in commands)
    listed = {name for names in _PURPOSES.values() for name in names}
    groups = {**_PURPOSES, "more": tuple(name for name in commands if name not in listed)}
    rows = "\n".join(
        "\n".join([f"{purpose}:", *(f"  {name:<{width}}  {commands[name][1]}" for name in names if name in commands)])
        for purpose, names in groups.items()
        if any(name in commands for name in names)
    )
    return (
        "usage: servotap COMMAND ...\n\n"
        "Analyze servo-drive buses (RS485, CAN), log them, and test drives against their manuals.\n\n"
        f"{rows}\n\n{_EPILOG}"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit status.

    0: well; 1: findings; 2: wrong use or an unreadable input; 70: a fault of servotap; 130: Ctrl-C,
    143: SIGTERM. Some commands have more.
    """
    return bounded(_main, list(sys.argv[1:] if arguments is None else arguments))


def _keep_zone() -> None:
    """Go on in UTC where the time zone is a day or more off: `datetime` has none such, and python-can is not imported in it."""
    if "TZ" in os.environ and abs(time.localtime().tm_gmtoff) >= _DAY_S:
        zone, os.environ["TZ"] = os.environ["TZ"], "UTC"
        time.tzset()
        print(f"servotap: TZ={zone}: expected less than 24 hours from UTC; times are shown in UTC", file=sys.stderr)


def _main(words: list[str]) -> int:
    _keep_zone()
    if "_ARGCOMPLETE" in os.environ:
        from analyzer.cli.completion import complete

        complete(_every_command())
    if any("\0" in word for word in words):
        print("servotap: a word of the command line holds a NUL character", file=sys.stderr)
        return 2
    if words[:1] == ["--traceback"]:
        words = words[1:]
    if not words or words[0] in ("-h", "--help", "help"):
        print(_overview(_every_command()))
        return 0 if words else 2
    if words[0] in ("-V", "--version"):
        from analyzer import __version__

        print(f"servotap {__version__}")
        return 0
    name, rest = _ALIASES.get(words[0], words[0]), words[1:]
    from analyzer.plugins import attempt

    entry = COMMANDS.get(name) or _added().get(name)
    if entry is None:
        from analyzer.values import near

        print(f"servotap: no command {name!r}{near(name, [*COMMANDS, *_added()], 1)} (see servotap --help)", file=sys.stderr)
        return 2
    load = partial(_loaded, entry[0])
    module = load() if entry[0].startswith(_OWN) else attempt(f"the command {name} ({entry[0]})", load)
    # Its start had it off. The first search would go through all that was loaded, which stays.
    if own_process.is_own:
        gc.freeze()
    gc.enable()
    return 2 if module is None else _run(name, module, rest)


def _loaded(name: str) -> ModuleType:
    """Return the module of a command. Raises AttributeError for one that is none."""
    module = import_module(name)
    for part in ("add_arguments", "run"):
        getattr(module, part)
    return module


def _joined(words: Sequence[str]) -> list[str]:
    """Return the words with a moment before the end (`--since -5min`) joined to its option: alone it looks like one."""
    joined: list[str] = []
    for word in words:
        if joined and joined[-1] in ("--since", "--until") and word[:1] == "-" and word[1:2].isdigit():
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return joined


def _help_of(name: str) -> str:
    """Return the help line of an added command, which stands in a table beside its module to keep the start quick."""
    try:
        from conformance.cli import HELP
    except ImportError:
        return ""
    return HELP.get(name, "")


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are one line: the usage stands in the help."""

    def error(self, message: str) -> NoReturn:
        from analyzer.values import near, printable

        wrong = next((word for word in message.split() if word.startswith("--")), "")
        hint = near(wrong.partition("=")[0], self._option_string_actions, 1) if wrong else ""
        # argparse may have named the option itself.
        hint = "" if hint[len("; did you mean ") : -1] in message else hint
        self.exit(2, f"{self.prog}: {printable(message)}{hint} (see {self.prog} --help)\n")

    def _print_message(self, message: str, file: Any = None) -> None:
        """Print the help, or an error; argparse's own says nothing where that cannot be written."""
        (file or sys.stderr).write(message)


def _run(name: str, module: ModuleType, words: Sequence[str]) -> int:
    from analyzer.cli.signals import handled
    from analyzer.errors import ServotapError

    parser = _Parser(
        prog=f"servotap {name}",
        description=(module.__doc__ or "").split("\n\n")[0],
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog=getattr(module, "EXAMPLES", None),
    )
    parser.add_argument("--traceback", action="store_true", help=argparse.SUPPRESS)
    module.add_arguments(parser)
    # argparse takes a value `--` for the mark of the end of options, and gives an empty list instead.
    wrong = next((word for word in words if _NO_VALUE.fullmatch(word)), None)
    if wrong is not None:
        parser.error(f"argument {wrong[:-2].rstrip('=')}: expected a value, got --")
    # Options may stand among the positional arguments: `frame D@1 run_speed --reply status=1`.
    words = _joined(words)
    # That way of parsing loses what stands behind `--` and begins with a dash, before Python 3.13.
    parsed = parser.parse_args(words) if "--" in words else parser.parse_intermixed_args(words)
    try:
        # Any of these signals ends a command as Ctrl-C does, so that no unfinished file stays behind.
        with handled(signal.default_int_handler):
            # A command of another package may return nothing.
            return int(module.run(parsed) or 0)
    except ServotapError as error:
        print(f"servotap {name}: {_with_names_shown(str(error), words)}", file=sys.stderr)
        return error.exit_status


def _with_names_shown(text: str, words: Sequence[str]) -> str:
    """Return a text with the ends of lines in names that were given as `\\n`: a name is not to break a message in two."""
    from analyzer.values import printable

    for broken in {end[0] for word in words for end in _LINE_END.finditer(word)}:
        text = text.replace(broken, printable(broken))
    return text
