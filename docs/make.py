"""Make what the documents show: the outputs in README.md from real runs, the picture, the tables of rules and statements.

python docs/make.py                rewrite README.md, docs/show.svg, docs/findings.md and docs/statements.md in place
python docs/make.py statements.md  rewrite this one alone
python docs/make.py --check        say what is out of date, exit 1 if anything is
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))


def commands(text: str) -> list[tuple[str, str]]:
    """Return (command, output) of each console block."""
    result = []
    for block in re.finditer(r"```console\n(.*?)```", text, re.DOTALL):
        command, _, output = block.group(1).partition("\n")
        result.append((command.removeprefix("$ "), output))
    return result


def live(text: str) -> list[tuple[str, str]]:
    """Return (command, output) of each block whose numbers differ from run to run (`console live`)."""
    return commands(text.replace("```console\n", "```other\n").replace("```console live\n", "```console\n"))


def masked(output: str) -> str:
    """Return output with its numbers and blanks made alike."""
    return re.sub(r"[ \t]+", " ", re.sub(r"\d+(?:[.:]\d+)*", "0", output))


def run(command: str, folder: Path) -> str:
    """Run a command of the README in a folder that has the captures, and return what it prints."""
    if not (folder / "captures").exists():
        (folder / "captures").mkdir()
        for path in (ROOT / "captures").iterdir():
            if path.is_file():
                (folder / "captures" / path.name).write_bytes(path.read_bytes())
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
    """Return the README with the outputs of real runs."""

    def replace(block: re.Match[str]) -> str:
        fence, (command, _, old) = block.group(1), block.group(2).partition("\n")
        new = tidy(run(command.removeprefix("$ "), folder))
        if "live" in fence and masked(new) == masked(old):
            new = old
        return f"{fence}{command}\n{new}```"

    return re.sub(r"(```console(?: live)?\n)(.*?)```", replace, text, flags=re.DOTALL)


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
            ROOT / "README.md": lambda: filled((ROOT / "README.md").read_text(), Path(folder)),
            ROOT / "docs" / "show.svg": picture,
            ROOT / "docs" / "findings.md": findings,
            ROOT / "docs" / "statements.md": statements,
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
