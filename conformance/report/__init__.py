"""Reports of a run: on the terminal, as a page, as logs. All are made from records of verdicts; no rig is needed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from analyzer.errors import UsageError

if TYPE_CHECKING:
    from conformance.suite.record import RunRecord, VerdictRecord

#: Each report by its option: the module and the function that write it.
WRITERS = {
    "report": ("html", "write_html"),
    "junitxml": ("junit", "write_junit"),
    "log": ("log", "write_log"),
    "failures": ("log", "write_failures"),
    "write_baseline": ("baseline", "save"),
}


#: What a file begins with that a later report replaces, by its option: an earlier one. No other file is replaced.
_BEGINNINGS = {"report": b"<", "junitxml": b"<", "write_baseline": b"[", "log": b"\x89"}


def check_places(places: Mapping[str, Any], *, force: bool | None) -> None:
    """Raise UsageError where a report would replace a file of another kind, or a log.

    `force`: whether it may nevertheless; None where no option says so: then an earlier log is replaced as other reports are.
    """
    for option, beginning in _BEGINNINGS.items():
        place = places.get(option)
        if not place or not (path := Path(place)).exists():
            continue
        if not path.is_file():
            raise UsageError(f"{path} is not a regular file: name a file")
        if force:
            continue
        advice = "name another file" if force is None else "--force replaces it"
        if option == "log" and force is False:
            raise UsageError(f"{path} exists; {advice}")
        try:
            with path.open("rb") as stream:
                begins = stream.read(1)
        except OSError as error:
            raise UsageError(f"{path} exists and cannot be read: {error.strerror}; {advice}") from None
        if begins not in (b"", beginning):
            raise UsageError(f"{path} exists and is not what --{option.replace('_', '-')} writes; {advice}")


def write_reports(
    records: Sequence[VerdictRecord], run: RunRecord, places: Mapping[str, Any], *, force: bool | None
) -> dict[str, str]:
    """Write each report that has a place, by its option; return why some could not be written. One costs no other.

    `force`: as `check_places` takes it. It is looked once more: a run takes hours, and other programs write, too.
    """
    refused = {}
    for option, (module, name) in WRITERS.items():
        place = places.get(option)
        if place:
            more = {"replace": force is not False} if option == "log" else {}
            try:
                check_places({option: place}, force=force)
                getattr(import_module(f"conformance.report.{module}"), name)(Path(place), records, run, **more)
            except UsageError as error:
                refused[option] = str(error)
    return refused
