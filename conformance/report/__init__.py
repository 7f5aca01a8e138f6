"""Reports of a run: on the terminal, as a page, as logs. All are made from records of verdicts; no rig is needed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

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


def write_reports(
    records: Sequence[VerdictRecord], run: RunRecord, places: Mapping[str, str | None], *, replace_log: bool = True
) -> dict[str, str]:
    """Write each report that has a place, by its option; return why some could not be written. One costs no other.

    `replace_log`: whether a log may be replaced that another program has written since the run began.
    """
    refused = {}
    for option, (module, name) in WRITERS.items():
        place = places.get(option)
        if place:
            more = {"replace": replace_log} if option == "log" else {}
            try:
                getattr(import_module(f"conformance.report.{module}"), name)(Path(place), records, run, **more)
            except UsageError as error:
                refused[option] = str(error)
    return refused
