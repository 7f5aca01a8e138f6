"""Make what the documents show: outputs in README.md and first-hour.md from real runs, a picture, the tables.

`make_view.py` beside it makes the pictures that need a browser or the view.

python docs/make.py                rewrite README.md and what is made in docs in place
python docs/make.py statements.md  rewrite this one alone
python docs/make.py --check        say what is out of date, exit 1 if anything is
"""

from __future__ import annotations

import argparse
import contextlib
import fcntl
import os
import pty
import re
import select
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import termios
import time
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))


#: A drive, and what is typed while it is there, up to the end of the section.
_SESSION = re.compile(r"<!-- drive: (.*?) -->\n(.*?)(?=\n## |\Z)", re.DOTALL)


def commands(text: str) -> list[tuple[str, str]]:
    """Return (command, output) of each console block that stands alone, outside of sessions."""
    result = []
    for block in re.finditer(r"```console\n(.*?)```", _SESSION.sub("", text), re.DOTALL):
        command, _, output = block.group(1).partition("\n")
        result.append((command.removeprefix("$ "), output))
    return result


def live(text: str) -> list[tuple[str, str]]:
    """Return (command, output) of each block whose numbers differ from run to run (`console live`)."""
    return commands(text.replace("```console\n", "```other\n").replace("```console live\n", "```console\n"))


#: Lines of progress come as often as the machine is quick.
PROGRESS = re.compile(r"^\d+ s  .*\n", re.MULTILINE)


def masked(output: str) -> str:
    """Return output without progress, its numbers and blanks made alike."""
    return re.sub(r"[ \t]+", " ", re.sub(r"\d+(?:[.:]\d+)*", "0", PROGRESS.sub("", output)))


def alike(output: str, old: str) -> bool:
    """Say whether outputs of a drive that moves are alike: but for numbers, their signs, and bytes."""
    one, other = (
        masked(re.sub(r"\b[0-9A-F]{2}( [0-9A-F]{2})+\b", "0", re.sub(r"-(?=\d)", "", tidy(t)))) for t in (output, old)
    )
    return one == other


def run(command: str, folder: Path) -> str:
    """Run a command of the README in a folder that has the captures, and return what it prints."""
    if not (folder / "captures").exists():
        shutil.copytree(ROOT / "captures", folder / "captures", ignore=shutil.ignore_patterns("__pycache__"))
    search = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        command, shell=True, cwd=folder, capture_output=True, text=True, env={**os.environ, "PATH": search}, timeout=60
    )
    return (done.stdout + done.stderr).replace(f"{folder}/", "")


def tidy(output: str) -> str:
    """Return output without blanks at line ends and with what differs from run to run named."""
    lines = [line.rstrip() for line in output.splitlines()]
    return "\n".join(lines).strip("\n") + "\n"


def filled(text: str, folder: Path) -> str:
    """Return the README with the outputs of real runs, but for its sessions."""
    sessions = [session.span() for session in _SESSION.finditer(text)]

    def replace(block: re.Match[str]) -> str:
        if any(start < block.start() < end for start, end in sessions):
            return block[0]
        fence, (command, _, old) = block.group(1), block.group(2).partition("\n")
        new = tidy(run(command.removeprefix("$ "), folder))
        if "live" in fence and masked(new) == masked(old):
            new = old
        return f"{fence}{command}\n{new}```"

    return re.sub(r"(```console(?: live)?\n)(.*?)```", replace, text, flags=re.DOTALL)


#: What the sessions of the first hour name, and what stands for it here: there is no adapter.
_STAND_INS = {
    "/dev/ttyUSB0": "{}/ttyUSB0",
    "/tmp/servo": "{}/servo",
    "can:socketcan:can0": "can:udp_multicast:239.74.163.21,port={}",
    "can:udp_multicast:239.74.163.5": "can:udp_multicast:239.74.163.5,port={}",
}
_BLOCK = re.compile(r"```console( terminal| view)?\n(.*?)```", re.DOTALL)


def sessions(text: str) -> list[tuple[str, list[tuple[str, str, str]]]]:
    """Return the sessions of a page: the command that stands for the drive, and (kind, command, output) of each block."""
    return [
        (drive, [(kind.strip(), *body.partition("\n")[::2]) for kind, body in _BLOCK.findall(part)])
        for drive, part in _SESSION.findall(text)
    ]


def play(drive: str, blocks: list[tuple[str, str, str]], folder: Path) -> Iterator[tuple[str, str, int]]:
    """Run a session's commands in their order, on an emulated drive; yield each with what it printed and its exit status.

    A command of the second terminal prints until it is ready, and the rest at its Ctrl-C.
    """
    # A port of its own: a multicast group alone does not keep buses of one machine apart.
    stands = {
        name: there.format(20_000 + os.getpid() % 20_000 if "port=" in there else folder) for name, there in _STAND_INS.items()
    }

    search = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"

    def started(command: str) -> subprocess.Popen[bytes]:
        for name, there in stands.items():
            command = command.replace(f"--can {name}", f"--can {there[4:]}").replace(name, there)
        return subprocess.Popen(
            command, shell=True, cwd=folder, stdout=said, stderr=said, stdin=subprocess.DEVNULL, start_new_session=True,
            env={**os.environ, "PATH": search, "COLUMNS": "200", "LINES": "50"},
        )  # fmt: skip

    def ready(words: str, process: subprocess.Popen[bytes]) -> str:
        late = time.monotonic() + 30
        while words not in (text := path.read_text()):
            assert time.monotonic() < late, f"{words!r} did not come: {text}"
            assert process.poll() is None, text
            time.sleep(0.05)
        return text

    def ended(process: subprocess.Popen[bytes]) -> None:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGINT)
        process.wait(30)

    def told(output: str) -> str:
        for name, there in stands.items():
            output = output.replace(there, name)
        return PROGRESS.sub("", output.replace(f"{folder}/", ""))

    path = folder / "drive.txt"
    with path.open("wb") as said:
        emulated = started(f"exec servotap {drive}")
    second: subprocess.Popen[bytes] | None = None
    before = ""
    try:
        ready("listening on", emulated)
        for number, (kind, command, _) in enumerate(blocks):
            if command == "^C":
                assert second is not None
                ended(second)
                path = folder / "terminal.txt"
                yield command, told(path.read_text()[len(before) :]), second.returncode
                continue
            path = folder / ("terminal.txt" if kind == "terminal" else f"{number}.txt")
            words = command.removeprefix("$ ")
            if kind == "view":
                yield command, *_viewed(words, folder, search)
                continue
            with path.open("wb") as said:
                process = started(f"exec {words}" if kind == "terminal" else words)
            if kind == "terminal":
                second, before = process, ready("Ctrl-C ends it", process)
                yield command, told(before), 0
            else:
                status = process.wait(60)
                yield command, told(path.read_text(errors="replace")), status
    finally:
        for each in (second, emulated):
            if each is not None:
                ended(each)


def _viewed(words: str, folder: Path, search: str) -> tuple[str, int]:
    """Run the view in a terminal, look at the plot, and leave; return what was drawn and the exit status."""
    ours, its = pty.openpty()
    fcntl.ioctl(its, termios.TIOCSWINSZ, struct.pack("HHHH", 40, 160, 0, 0))
    process = subprocess.Popen(
        words, shell=True, cwd=folder, stdin=its, stdout=its, stderr=its, start_new_session=True,
        env={**os.environ, "PATH": search, "TERM": "xterm-256color", "COLUMNS": "160", "LINES": "40"},
    )  # fmt: skip
    os.close(its)
    drawn, keys, late = "", [("  FILE  ", b"4"), ("[1] ", b"q")], time.monotonic() + 60
    with contextlib.suppress(OSError):  # the end of a terminal
        while time.monotonic() < late:
            if select.select([ours], [], [], 0.5)[0]:
                drawn += os.read(ours, 65536).decode(errors="replace")
            if keys and keys[0][0] in drawn:
                os.write(ours, keys.pop(0)[1])
    os.close(ours)
    return drawn, process.wait(10)


def played(text: str) -> str:
    """Return a page with the outputs of real runs of its sessions; what differs by its numbers alone stays."""
    for drive, blocks in sessions(text):
        with tempfile.TemporaryDirectory() as folder:
            for (kind, command, old), (_, output, _) in zip(blocks, play(drive, blocks, Path(folder)), strict=True):
                new = old if kind == "view" or "ports" in command or alike(output, old) else tidy(output)
                fence = f"```console{f' {kind}' if kind else ''}\n{command}\n"
                # The same command can stand in several sessions: this one is the first whose output is the old one.
                text = text.replace(f"{fence}{old}```", f"{fence}{new}```", 1)
    return text


def picture() -> str:
    """Return a terminal with the frames of a capture as an SVG."""
    from rich.console import Console
    from rich.text import Text

    command = f"{sys.executable} -m analyzer show captures/mks_rs485.log --limit 34"
    output = subprocess.run(command, shell=True, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    rows = [line[:118] for line in output.splitlines() if "read_" not in line or "speed" in line]
    console = Console(record=True, width=118, file=open(os.devnull, "w"))  # noqa: SIM115 (rich keeps it)
    for line in rows[:1] + rows[4:]:
        style = "bold" if "command  " in line else "red" if "! error" in line else "cyan" if " request " in line else "green"
        console.print(Text(line, style=style), soft_wrap=True)
    return console.export_svg(title="servotap show captures/mks_rs485.log", unique_id="servotap")


def findings() -> str:
    """Return the page of rules."""
    from analyzer.findings import RULES

    rows = [f"| `{r.id}` | {r.severity} | {r.meaning} |" for r in RULES.values()]
    return "\n".join(
        [
            "# Findings",
            "",
            "Each finding stands in the log on `/findings` (schema `foxglove.Log`): `name` is the rule, `file` and `line`",
            "the topic and sequence of the message it is about, `offset` the place of its bytes. `--strict` exits 1 on those",
            "of severity error.",
            "",
            "| rule | severity | what it means |",
            "| --- | --- | --- |",
            *rows,
            "",
        ]
    )


def troubles() -> str:
    """Return the page of causes."""
    from analyzer.diagnosis.causes import CAUSES

    lines = [
        "# Troubles and their causes",
        "",
        "`servotap diagnose FILE` names these, with the evidence in the capture and the next step. It asks only where",
        "something is wrong, and names no cause where the bytes show none.",
    ]
    for cause in CAUSES.values():
        lines += ["", f"## {cause.id}", "", cause.wrong, "", f"- What it looks like: {cause.looks}", f"- Why: {cause.why}"]
        lines += [f"- What to do: {cause.todo}", f"- Example: `{cause.example}`"]
    return "\n".join([*lines, ""])


def statements() -> str:
    """Return the page of what the manuals say, and the share of it that has claims."""
    from analyzer import dialects

    every = [d for d in dialects.every() if d.statements]
    lines = [
        "# Statements of the manuals",
        "",
        "Each thing that a manual says a drive does is a statement with an id and its section. It names the claims that would",
        "refute its opposite, or the reason why none can. `servotap catalogue --statements [--dialect D] [--json]` lists all.",
        "A test holds that each claim that is named exists.",
        "",
        "| dialect | manual | statements | with claims | share |",
        "| --- | --- | ---: | ---: | ---: |",
    ]
    for dialect in every:
        total, claimed = len(dialect.statements), sum(bool(s.claims) for s in dialect.statements)
        lines.append(f"| `{dialect.name}` | {dialect.manual} | {total} | {claimed} | {100 * claimed / total:.1f} % |")
    counts = [(len(d.statements), sum(bool(s.claims) for s in d.statements)) for d in every]
    total, claimed = (sum(n) for n in zip(*counts, strict=True))
    lines += [f"| all | | {total} | {claimed} | {100 * claimed / total:.1f} % |", "", "## Without a claim, and why"]
    for dialect in every:
        lines += ["", f"### {dialect.name}", "", "| statement | what is said | why no claim judges it |", "| --- | --- | --- |"]
        lines += [f"| `{s.id}` | {s.says} | {s.unclaimed} |" for s in dialect.statements if s.unclaimed]
    return "\n".join([*lines, ""])


def main() -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pages", nargs="*", metavar="PAGE", help="only these, by file name")
    parser.add_argument("--check", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        makers = {
            ROOT / "README.md": lambda: played(filled((ROOT / "README.md").read_text(), Path(folder))),
            ROOT / "docs" / "devices.md": lambda: filled((ROOT / "docs" / "devices.md").read_text(), Path(folder)),
            ROOT / "docs" / "logic.md": lambda: filled((ROOT / "docs" / "logic.md").read_text(), Path(folder)),
            ROOT / "docs" / "first-hour.md": lambda: played((ROOT / "docs" / "first-hour.md").read_text()),
            ROOT / "docs" / "show.svg": picture,
            ROOT / "docs" / "findings.md": findings,
            ROOT / "docs" / "statements.md": statements,
            ROOT / "docs" / "troubles.md": troubles,
        }
        made = {path: make() for path, make in makers.items() if not arguments.pages or path.name in arguments.pages}
    old = [path for path, text in made.items() if not path.exists() or path.read_text() != text]
    for path in old:
        print(f"{path.relative_to(ROOT)} {'is out of date' if arguments.check else 'written'}")
        if not arguments.check:
            path.write_text(made[path])
    return 1 if arguments.check and old else 0


if __name__ == "__main__":
    sys.exit(main())
