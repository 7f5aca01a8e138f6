"""What several tests of diagnoses ask."""

from __future__ import annotations

import pytest

from analyzer import dialects as registry
from analyzer.diagnosis.diagnose import diagnosis
from analyzer.diagnosis.watch import Watch
from analyzer.pipeline import Pipeline
from analyzer.records import CanFrame
from analyzer.sources import open_source


@pytest.fixture
def causes_of(tmp_path):
    """Return what is suspected of a text, with its words."""

    def of(text):
        path = tmp_path / "post.txt"
        path.write_text(text + "\n", encoding="utf-8")
        with open_source(path) as source:
            items = list(source)
        kind = "can" if any(isinstance(item, CanFrame) for item in items) else "serial"
        dialects = [d for d in registry.every() if d.bus == kind]
        watch = Watch()
        pipeline = Pipeline(dialects, [watch])
        for item in items:
            watch.take(item)
            pipeline.feed(item)
        pipeline.close()
        return [each.suspicion.cause for each in diagnosis(watch, dialects).causes]

    return of
