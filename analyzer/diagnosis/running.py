"""Diagnosis while traffic comes: asked again and again, in a thread of its own, less often the longer it takes."""

from __future__ import annotations

import threading
from collections.abc import Sequence

from analyzer.catalogue import Dialect
from analyzer.diagnosis.diagnose import Diagnosis, cause_lines, weighed
from analyzer.diagnosis.scene import Confidence, Scene
from analyzer.diagnosis.watch import Watch

#: Between two looks at least, and how many times longer than the last one took.
_PERIOD_NS = 1_000_000_000
_REST = 20
#: How long the end waits for the last look.
_PATIENCE_S = 5.0


class Running(Watch):
    """A watch whose causes are told as they become likely. `causes`: the lines of each that was, by its id."""

    def __init__(self) -> None:
        super().__init__()
        self.causes: dict[str, list[str]] = {}
        self._thread: threading.Thread | None = None
        self._begun_ns = self._due_ns = 0
        self._looked = 0
        self._result: Diagnosis | None = None
        self._forgotten = self._ending = False
        self._fault = ""
        self._told_fault = False

    def look(self, now_ns: int, dialects: Sequence[Dialect]) -> list[str]:
        """Take what the look before found, and begin the next one where it is due; return the lines of new causes."""
        if self._thread is not None:
            if self._thread.is_alive():
                return []
            self._due_ns = now_ns + max(_PERIOD_NS, _REST * (now_ns - self._begun_ns))
            self._thread = None
        new = self._take_result()
        if self.found and not self._due_ns:
            # One finding alone tells little; more come soon.
            self._due_ns = now_ns + _PERIOD_NS
        if self.found != self._looked and now_ns >= self._due_ns:
            self._begin(now_ns, dialects)
        return new

    def end(self, now_ns: int, dialects: Sequence[Dialect]) -> list[str]:
        """Look once more at what no look has seen, and wait for it; return the lines of new causes."""
        if self._thread is not None:
            self._thread.join(_PATIENCE_S)
        new = self._take_result()
        self._ending = True
        if self.found and (self._thread is None or not self._thread.is_alive()):
            self._begin(now_ns, dialects)
            assert self._thread is not None  # just begun
            self._thread.join(_PATIENCE_S)
        return new + self._take_result()

    def _begin(self, now_ns: int, dialects: Sequence[Dialect]) -> None:
        self._looked, self._begun_ns = self.found, now_ns
        scenes = self.scenes(dialects)
        if self.full:
            self.forget()
            self._forgotten = True
        self._thread = threading.Thread(target=self._weigh, args=(scenes,), name="servotap-diagnosis", daemon=True)
        self._thread.start()

    def _weigh(self, scenes: Sequence[Scene]) -> None:
        try:
            self._result = weighed(scenes)
        # The recording goes on; that its diagnosis failed is told.
        except Exception as error:
            self._fault = f"{type(error).__name__}: {error}"

    def _take_result(self) -> list[str]:
        found, self._result = self._result, None
        if self._fault and not self._told_fault:
            self._told_fault = True
            return [f"a fault of servotap in the diagnosis: {self._fault}; the recording goes on, please report it"]
        if found is None:
            return []
        now = {
            each.suspicion.cause: cause_lines(number, each)
            for number, each in enumerate(found.causes, 1)
            if self._ending or each.suspicion.confidence is not Confidence.POSSIBLE
        }
        new = [line for cause, lines in now.items() if cause not in self.causes for line in lines]
        # What was forgotten counts on; else the last look knows most.
        self.causes = {**self.causes, **now} if self._forgotten else now
        return new
