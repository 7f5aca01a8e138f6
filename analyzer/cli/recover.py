"""Repair the log of an interrupted recording: add the bytes left in its spools, and finish it.

Without -o the log is repaired in place. With the recording's folder FILE.spool not even the last second is lost. Without it
all readable parts of the log are copied, also those behind damaged places, and the copy replaces the log. If the log cannot
be continued, a second one (FILE-spools.mcap) gets all that the folder holds, unless that is everything. The folder is removed
when the log was read back to its end. Works on logs of other programs, too.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import shutil
import stat
import sys
import tempfile
from pathlib import Path

import msgspec

from analyzer.cli.output import Output, kept
from analyzer.cli.reading import showing_progress
from analyzer.cli.signals import Interrupt
from analyzer.errors import UnreadableError, UsageError
from analyzer.live import checkpoint, config
from analyzer.live.config import RecordingConfig
from analyzer.live.lock import RUNNING, Lock
from analyzer.live.log_parts import LogParts, log_of
from analyzer.live.recorder import Recorder
from analyzer.live.recording import Recording
from analyzer.live.spool import SpoolReader, segments, spool_folder, stems
from analyzer.sinks.mcap_repair import RepairResult, repair
from analyzer.sinks.mcap_sound import broken_before, unreadable
from analyzer.sources.recording_parts import base_of, look, parts_named
from analyzer.sources.times import iso
from analyzer.values import counted, printable

EXAMPLES = """\
examples:
  servotap recover week.mcap                    repairs week.mcap
  servotap recover week.mcap -o whole.mcap      leaves week.mcap unchanged
  servotap recover week-0007.mcap               the last part of a recording in parts
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("file", metavar="FILE", help="the log, or its folder of spools")
    parser.add_argument("-o", "--output", metavar="WHOLE", help="write the repaired log here and leave FILE unchanged")
    parser.add_argument("--force", action="store_true", help="replace WHOLE if it exists")


def run(arguments: argparse.Namespace) -> int:
    """Make the log whole; return 0."""
    # `.` and the like have a name only once they are resolved.
    path = Path(arguments.file) if Path(arguments.file).name else Path(arguments.file).resolve()
    if not path.name:
        raise UsageError(f"{path} is a folder, expected a log, or a folder of spools (*.spool)")
    target = _target(arguments)
    folder = path if path.is_dir() and path.name.endswith(".spool") else spool_folder(base_of(path))
    if folder.is_dir():
        if target is None:
            _finish(folder)
        else:
            _finish_copy(folder, target, arguments.force)
        return 0
    if not path.exists() and parts_named(path):
        path = parts_named(path)[-1]
    if path.is_dir():
        raise UsageError(f"{path} is a folder, expected a log, or a folder of spools (*.spool) with its {config.NAME}")
    if not path.exists():
        raise UnreadableError(f"{path} does not exist, and neither does {folder}")
    if not path.is_file():
        # A pipe would be waited for.
        raise UsageError(f"{path} is not a regular file, expected a log")
    _repair(path, target, arguments.force)
    return 0


def _target(arguments: argparse.Namespace) -> Path | None:
    if arguments.output is None:
        return None
    target = Path(arguments.output)
    if target.is_dir():
        target = target / Path(arguments.file).name
    if target.exists() and target.resolve() == Path(arguments.file).resolve():
        return None
    if target.exists() and not arguments.force:
        raise UsageError(f"{target} exists; --force replaces it")
    return target


# --- with the spools ------------------------------------------------------------------------------------------------


def _finish(folder: Path) -> list[Path]:
    """Go on with a recording to the end of its spools; return its logs."""
    strange = next((each for each in sorted(folder.iterdir()) if not stat.S_ISREG(each.lstat().st_mode)), None)
    if strange is not None:
        raise UnreadableError(f"{strange} is not a regular file, which alone a recording makes: remove it, or move it away")
    try:
        told = config.load(folder)
    except UnreadableError as error:
        raise UnreadableError(
            f"{error}. Without it the spools cannot be read. Move {folder} away, and servotap recover repairs the log alone"
        ) from None
    log = log_of(folder, told)
    taken = f"{log} is being recorded; stop the recording first"
    with Lock(folder, RUNNING, taken=taken), Interrupt() as interrupt:
        trouble = _trouble(folder, log, interrupt)
        if not trouble:
            paths = _go_on(folder, log, interrupt)
            what = "went on where the recording had stopped"
            print(f"{printable(paths[-1].name)}: whole; {what}")
            return paths
        print(f"the log cannot be gone on with: {printable(trouble)}")
        return _from_spools(folder, told, log, interrupt)


def _trouble(folder: Path, log: Path, interrupt: Interrupt) -> str:
    """Read back what the recording had written; return why it cannot be gone on with, or nothing."""
    try:
        start = checkpoint.load(folder)
        told = config.load(folder)
        parts = LogParts(folder, told)
        if start is None:
            begun = bool(parts_named(log)) if parts.rotating else log.exists()
            return f"there is no checkpoint in {folder}" if begun else ""
        if not start.position:
            return ""
        path = parts.path_of(start)
        Recording(folder, told, parts).abandon()
        parts.close()
    except UnreadableError as error:
        return str(error)
    with showing_progress(f"reading {path.name}", start.position, lambda: interrupt.place):
        broken = broken_before(path, start.position, interrupt.reached)
    return f"{path} is damaged: {broken}" if broken else ""


def _go_on(folder: Path, log: Path, interrupt: Interrupt) -> list[Path]:
    """Take all that the spools hold into the log; return its parts. Then the spools are gone."""
    before = _spooled(folder)
    recorder = Recorder(folder, final=True, asked=lambda: interrupt.asked, say=_say)
    try:
        with showing_progress(f"recovering {log.name}", before, lambda: before - _spooled(folder)):
            finished = recorder.run(until=lambda: bool(interrupt.asked))
    finally:
        recorder.close()
    if not finished:
        raise KeyboardInterrupt
    print(f"took {counted(before, 'byte')} from the spools")
    if recorder.damaged:
        print(f"passed {counted(recorder.damaged, 'byte')} of them that {'is' if recorder.damaged == 1 else 'are'} damaged")
    return parts_named(log) if recorder.parts.rotating else [recorder.parts.path]


def _from_spools(folder: Path, told: RecordingConfig, log: Path, interrupt: Interrupt) -> list[Path]:
    """Make a log of the spools alone. It replaces the old one where they hold all of the recording; else that is repaired."""
    parts = LogParts(folder, told)
    mine = not log.exists() or look(log).recording == parts.recording
    whole = (
        mine and not parts.rotating and all(_unbroken(folder, stem) for stem in (config.CONTROL, *(p.stem for p in told.ports)))
    )
    second = _free(log.with_name(f"{log.stem}-spools.mcap"))
    new = folder.rename(spool_folder(second))
    for pattern in ("checkpoint.*", "index.*"):
        for path in new.glob(pattern):
            path.unlink()
    mode = stat.S_IMODE(log.stat().st_mode) if log.exists() else told.mode
    alone = msgspec.structs.replace(
        told, log=str(second.absolute()), mode=mode, rotate_bytes=0, rotate_ns=0, keep=0, max_total=0
    )
    alone.save(new)
    paths = _go_on(new, second, interrupt)
    logs = [log, *parts_named(log)]
    old = [path for path in logs if path.exists()]
    if whole or not old:
        second.replace(log)
        what = "which held all of the recording" if whole else "as far as they had it"
        print(f"{printable(log.name)}: whole; written anew from its spools, {what}")
        return [log]
    for path in old[-1:]:
        _repair(path, None, replace=True)
    print(f"{printable(second.name)}: whole; all that the spools held, some of which {printable(log.name)} may have, too")
    return [*old, *paths]


def _unbroken(folder: Path, stem: str) -> bool:
    """Say whether a spool holds all that its readers stored since the beginning."""
    reader = SpoolReader(folder, stem)
    expected = 0
    found = True
    while found:
        found = False
        for record in reader.read(final=True):
            # What its reader could not store, it has told.
            if record.before != expected and not record.data.startswith(b'{"event":"dropped"'):
                return False
            found, expected = True, record.before + record.units
    # The first reader begins with 0; a spool that was deleted whole says nothing of what it held.
    return any(number == 0 for number, _ in segments(folder, stem))


def _free(path: Path) -> Path:
    """Return a name like this one, of no log and no folder of spools."""
    free, number = path, 1
    while os.path.lexists(free) or os.path.lexists(spool_folder(free)):
        number += 1
        free = path.with_name(f"{path.stem}-{number}{path.suffix}")
    return free


def _finish_copy(folder: Path, target: Path, replace: bool) -> None:
    """Make a whole log of a recording and leave all of it as it is: on copies."""
    told = config.load(folder)
    if told.rotate_bytes or told.rotate_ns or told.max_total:
        raise UsageError(
            f"the recording is in parts, and only the last needs repair: omit -o, or copy "
            f"{folder} and the parts and recover the copy"
        )
    log = log_of(folder, told)
    taken = f"{log} is being recorded; stop the recording first"
    with Lock(folder, RUNNING, taken=taken):
        work = Path(tempfile.mkdtemp(prefix=f".{target.name}.", suffix=".recover", dir=target.parent))
        try:
            copied = work / log.name
            spools = spool_folder(copied)
            spools.mkdir()
            for source in folder.iterdir():
                if source.is_file():
                    shutil.copyfile(source, spools / source.name)
            if log.exists():
                shutil.copyfile(log, copied)
            first, *others = _finish(spools)
            if target.exists() and not replace:
                raise UsageError(f"{target} was created by another program meanwhile; --force replaces it")
            first.replace(target)
            made = [target]
            for other in others:
                made.append(_free(target.with_name(f"{target.stem}-spools.mcap")))
                other.replace(made[-1])
        finally:
            shutil.rmtree(work, ignore_errors=True)
    print(f"wrote {printable(', '.join(map(str, made)))}; {log} and {folder} are as they were")


def _spooled(folder: Path) -> int:
    """Return how many bytes the spools hold that are not in the log yet."""
    size = 0
    with contextlib.suppress(OSError, UnreadableError):
        start = checkpoint.load(folder)
        done = {stem: (s.segment, s.place) for stem, s in start.spools.items()} if start is not None else {}
        for stem in stems(folder):
            at, place = done.get(stem, (-1, 0))
            for number, path in segments(folder, stem):
                if number >= at:
                    size += path.stat().st_size - (place if number == at else 0)
    return size


def _say(text: str) -> None:
    print(f"servotap recover: {printable(text)}", file=sys.stderr)


# --- without them ---------------------------------------------------------------------------------------------------


def _repair(path: Path, target: Path | None, replace: bool) -> None:
    """Copy what can be read of a log into a whole one."""
    into = target or path
    with Interrupt() as interrupt:
        size = path.stat().st_size
        if target is None:
            with showing_progress(f"reading {path.name}", size, lambda: interrupt.place):
                whole = not broken_before(path, None, interrupt.reached) and not unreadable(path, interrupt.reached)
            if whole:
                print(f"{printable(path.name)} is whole: nothing was changed")
                return
        output = Output(into, replace or target is None)
        with kept(output, f"{path.name} is as it was"):
            with showing_progress(f"recovering {path.name}", size, lambda: interrupt.place):
                outcome = repair(path, output.stream, interrupt.reached)
                output.stream.flush()
                trouble = unreadable(output.part, interrupt.reached)
            if trouble:
                raise UnreadableError(f"{path} was repaired, but the result cannot be read back: {trouble}; it is as it was")
    _report(path, into, outcome)


def _report(path: Path, into: Path, outcome: RepairResult) -> None:
    span = f", from {iso(outcome.first_ns)} to {iso(outcome.last_ns)}" if outcome.messages else ""
    print(f"{printable(into.name)}: whole; {counted(outcome.messages, 'message')} in {counted(outcome.chunks, 'chunk')}{span}")
    lost = 0
    for fault in outcome.faults:
        lost += fault.size
        print(f"  {printable(str(fault))}")
    if lost:
        print(f"  {counted(lost, 'byte')} of {printable(path.name)} in total are in incomplete records")
