"""Stop drives: those that are named, or all that answer on a bus. Each is stopped by a ramp that keeps the torque, where it
has one; where that does not work, at once. Reads prove that the shaft stands. No motor is disabled.

Where none is named, all are told to stop before any is looked for: by the address that every drive obeys, or by each address
where there is none. Drives that are found are told once more, and the proofs come last. Where none is found, others may drown
what is sent and what is answered: then every address gets every stop, again and again, and drives are looked for in between.

A port that goes meanwhile is opened anew, and all begins once more, for some seconds from the first time that it went. A driver
that hangs ends the command, for nothing can be sent through it.

Exit status: 0 all stand, 2 wrong use, 20 a drive is not seen standing, none answers, or the port cannot be opened.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

from analyzer.catalogue import Dialect
from analyzer.cli.boundary import report
from analyzer.cli.frame import parse_target
from analyzer.dialects import drive_name
from analyzer.errors import ServotapError, UsageError
from analyzer.live import endpoint as endpoints
from analyzer.live import profile
from analyzer.live.endpoint import Endpoint
from analyzer.system import own_process
from analyzer.values import addresses as addresses_of
from analyzer.values import printable
from conformance.bus.lasting import BACK_SECONDS, LastingLine
from conformance.bus.line import Line, LineLost
from conformance.claim import Inconclusive, NotStopped
from conformance.cli.endpoint import at_own_rate, gate_to
from conformance.cli.scan import DEFAULT_ADDRESSES, dialects_on, rates_of, showing_progress
from conformance.gate.gate import Gate, Refused
from conformance.gate.permissions import Allowance
from conformance.motion import motion
from conformance.safety import stopping
from conformance.safety.signals import as_interrupt, undisturbed
from conformance.talk.probe import plain_probe
from conformance.talk.scan import Found, scan

#: How often all are told to stop, and looked for, where none is found.
_ROUNDS = 2
#: How long a port that goes is tried anew, from the first time on, and the pause between two tries.
_LOST_NS, _AGAIN_SECONDS = int(BACK_SECONDS * 1e9), 0.2
#: After so many looks at the same call of a driver it hangs. They are counted, for this process may be suspended meanwhile.
_LOOKS, _LOOK_SECONDS = 30, 1.0
#: So many bytes a frame of another sender on CAN is taken to have.
_CAN_BYTES = 8
EXAMPLES = """\
examples:
  servotap stop serial:/dev/ttyUSB0,baud=38400                     all that answer at addresses 1 to 32
  servotap stop serial:/dev/ttyUSB0                                the same at every rate: up to a minute or two
  servotap stop serial:/dev/ttyUSB0,baud=38400 mks-rs485@1 lk-rs485@3
  servotap stop can:socketcan:can0 mks-can@1 --cut-power 'usbrelay OFF_1=1'
  servotap stop arm                                                a drive or a bus of a profile, servotap.toml
"""


class _WatchedLine(LastingLine):
    """A line of which a thread watches each call into the driver; `hangs` is called where one does not return."""

    def __init__(self, endpoint: Endpoint, hangs: Callable[[], None]) -> None:
        self._hangs = hangs
        #: What is new for each call, None between two.
        self._call: object = None
        self._is_open = True
        # Where the system gives no more threads, it is stopped all the same.
        with contextlib.suppress(RuntimeError):
            threading.Thread(target=self._look, daemon=True).start()
        with self._called():
            super().__init__(endpoint, lambda: False)

    @contextlib.contextmanager
    def _called(self) -> Iterator[None]:
        self._call = object()
        try:
            yield
        finally:
            self._call = None

    @contextlib.contextmanager
    def _there(self) -> Iterator[Line]:
        with self._called(), super()._there() as line:
            yield line

    def _look(self) -> None:
        seen, looks = self._call, 0
        while self._is_open and looks < _LOOKS:
            time.sleep(_LOOK_SECONDS)
            looks = looks + 1 if seen is not None and self._call is seen else 0
            seen = self._call
        if self._is_open:
            self._hangs()

    def close(self) -> None:
        self._is_open = False
        super().close()


def _end_hung(endpoint: str, cut_power: str) -> None:
    """Cut the power and end this process: its main thread is in a driver that hangs."""
    power = stopping.cut_power(cut_power)
    print(f"servotap stop: NOT STOPPED: {printable(endpoint)}: its driver hangs; {power}", file=sys.stderr, flush=True)
    own_process.end(NotStopped.exit_status)


class _Drive(NamedTuple):
    """A drive that is to be stopped, and the rate at which it answers."""

    dialect: Dialect
    address: int
    rate: int

    @property
    def name(self) -> str:
        return drive_name(self.dialect, self.address)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument(
        "endpoint", metavar="ENDPOINT", help="serial:PORT[,baud=N], tcp:HOST:PORT, can:INTERFACE:CHANNEL or a name"
    )
    parser.add_argument("drives", nargs="*", metavar="DIALECT@ADDRESS", help="the drives; without any, those that answer")
    parser.add_argument("--addresses", default=DEFAULT_ADDRESSES, metavar="LIST", help="where to look, as 1-32 (default)")
    parser.add_argument("--cut-power", default="", metavar="COMMAND", help="runs when a drive is not seen standing")


def run(arguments: argparse.Namespace) -> int:
    """Stop; return 0 if all stand. Raises NotStopped."""
    place = profile.look_up(arguments.endpoint)
    endpoint = endpoints.parse(arguments.endpoint) if place is None else place.endpoint
    dialects = dialects_on(endpoint)
    rates = rates_of(None, endpoint, dialects)
    named = [parse_target(text, None) for text in arguments.drives]
    # A drive of a profile is stopped alone. On a bus of a profile its drives are stopped, and all others that answer.
    alone = bool(named) or (place is not None and place.is_drive)
    if place is not None and not named:
        named = [(each.dialect, each.entry.address) for each in place.drives]
    for dialect, _ in named:
        endpoint.check_dialect(dialect)
    endpoint = at_own_rate(endpoint, named[0][0]) if named else endpoint.at(rates[0]) if len(rates) > 1 else endpoint
    addresses = addresses_of(arguments.addresses, "--addresses", min(d.addresses[0] for d in dialects))
    stand: list[str] = []
    failures: list[str] = []
    # Each try waits for the port by itself, for all of them have one deadline.
    try:
        hangs = partial(_end_hung, arguments.endpoint, arguments.cut_power)
        with as_interrupt(), gate_to(endpoint, Allowance(), opened=lambda at: _WatchedLine(at, hangs)) as gate:
            drives = [_Drive(*each, gate.line.endpoint.bits_per_second) for each in named]
            # On a full bus, frames of others must not make replies late. Orders to all are read: they may move what is stopped.
            everyone = [dialect.broadcast for dialect in dialects if dialect.broadcast is not None]
            if gate.line.acceptance is not None:
                gate.line.acceptance.only([*everyone, *(each.address for each in drives), *([] if alone else addresses)])
            everywhere = _Everywhere(gate, dialects, addresses, rates)
            until_ns: int | None = None
            try:
                while until_ns is None or gate.now_ns() < until_ns:
                    stand, failures = [], []
                    try:
                        for told, stands in _stopped(gate, drives, None if alone else everywhere):
                            (stand if stands else failures).append(told)
                        break
                    except LineLost as error:
                        failures.append(str(error))
                        until_ns = until_ns or gate.now_ns() + _LOST_NS
                        time.sleep(_AGAIN_SECONDS)
                if not drives and not failures:
                    failures.append(f"no drive answered on {arguments.endpoint}: {everywhere.said()}")
            except ServotapError as error:
                failures.append(str(error))
            except Exception as error:
                # No fault of ours may keep the power on.
                report(error)
                failures.append(f"a fault of servotap: {type(error).__name__}")
            except KeyboardInterrupt:
                failures.append(f"{', '.join(drive.name for drive in drives) or arguments.endpoint}: interrupted")
    # The port cannot be opened, so what turns turns on.
    except UsageError as error:
        failures.append(str(error))
    power = ""
    if failures:
        with undisturbed():
            power = stopping.cut_power(arguments.cut_power)
    try:
        # After all drives: one that turns is stopped also where nothing can be printed.
        for told in stand:
            print(told)
    finally:
        if failures:
            raise NotStopped(f"NOT STOPPED: {'; '.join(failures)}; {power}")
    return 0


def _stopped(gate: Gate, drives: list[_Drive], everywhere: _Everywhere | None) -> Iterator[tuple[str, bool]]:
    """Stop these drives, and all `everywhere`, which are added; yield what is found of each, and whether it stands.

    Raises LineLost.
    """
    told_ns, passed = gate.now_ns(), gate.line.passed
    for drive in drives:
        _ask(gate, drive)
    if everywhere is not None:
        everywhere.tell()
        drives += [each for each in everywhere.found() if each not in drives]
        drives += [] if drives else everywhere.insist()
    # A silent one is given up only after long: those that answer are stopped and proved to stand before it.
    for drive in sorted(drives, key=lambda drive: not _answers(gate, drive)) if len(drives) > 1 else drives:
        # Where more comes than any line brings, bytes that fit by chance look like drives: their ramps are waited for at once.
        is_flooded = not gate.line.is_can and gate.line.passed > passed
        yield _prove(gate, drive, told_ns if is_flooded else None)


class _Everywhere:
    """All drives that may be on a bus, at all rates that it may have."""

    def __init__(self, gate: Gate, dialects: list[Dialect], addresses: list[int], rates: list[int]) -> None:
        self._gate = gate
        self._dialects = dialects
        self._addresses = addresses
        self._rates = rates
        self._refused = ""
        self._others_send: list[str] = []
        #: Whether more came than any line brings while drives were looked for.
        self._is_flooded = False

    def tell(self, *, thoroughly: bool = False, at_once: bool = False) -> None:
        """Tell all to stop. `thoroughly`: each address, too, where one reaches all; `at_once`: without a ramp, too."""
        for rate in self._rates:
            if rate != self._gate.line.endpoint.bits_per_second:
                self._gate.set_speed(rate)
            for dialect in self._dialects:
                first, last = dialect.addresses
                own = [address for address in self._addresses if first <= address <= last]
                everyone = [] if dialect.broadcast is None else [dialect.broadcast]
                for address in [*everyone, *own] if thoroughly else everyone or own:
                    self._refused = stopping.tell(self._gate, dialect, address, at_once=at_once) or self._refused

    def found(self) -> list[_Drive]:
        """Look for drives, ask each to stop as it is found, and return them."""
        gate, drives = self._gate, list[_Drive]()

        def take(found: Found) -> bool:
            drive = _Drive(found.dialect, found.address, found.speed)
            # One that seems to answer for every address is asked once: the proof asks again.
            if drive not in drives:
                drives.append(drive)
                _ask(gate, drive)
            return False

        begun_ns, passed = gate.now_ns(), gate.line.passed
        with showing_progress(quiet=False) as progress:
            report = scan(
                gate, self._dialects, addresses=self._addresses, rates=self._rates, busy=True, enough=take, progress=progress
            )  # fmt: skip
        heard = sum(len(stray.data) for stray in report.strays) + _CAN_BYTES * report.others.total()
        heard += gate.line.passed - passed
        self._is_flooded = not gate.line.is_can and gate.line.passed > passed
        self._others_send = stopping.flood(heard, gate.now_ns() - begun_ns, gate.line)
        return list({drive.name: drive for drive in drives}.values())

    def insist(self) -> list[_Drive]:
        """Send all stops to all addresses, again and again, until a drive is found; return those that are."""
        # A silent line of an unknown rate drowns nothing: there the power is not to wait for what was done once.
        rounds = _ROUNDS if self._others_send or len(self._rates) == 1 else 0
        for number, at_once in enumerate((False, True) * rounds, 1):
            self.tell(thoroughly=True, at_once=at_once)
            # In more than any line brings no drive is found, and the power is not to wait for that: one last look is enough.
            if (not self._is_flooded or number == 2 * rounds) and (drives := self.found()):
                return drives
        if not rounds:
            self.tell(thoroughly=True, at_once=True)
        return []

    def said(self) -> str:
        """Return the message for the case that no drive was found."""
        told = "every stop was sent to every address, and whether a shaft stands cannot be read"
        return "; ".join([told, *self._others_send, *filter(None, [self._refused]), "name a drive that does not answer reads"])


def _ask(gate: Gate, drive: _Drive) -> None:
    """Ask a drive to stop by a ramp; whether it does is looked at later, and so is why one could not be sent."""
    probe = plain_probe(drive.dialect, drive.address, gate.under(stopping.stopping(drive.address)))
    for command in stopping.ramped_stops(drive.dialect):
        stopping.ask(probe, command)


def _answers(gate: Gate, drive: _Drive) -> bool:
    if drive.rate != gate.line.endpoint.bits_per_second:
        gate.set_speed(drive.rate)
    try:
        motion.speed(plain_probe(drive.dialect, drive.address, gate))
    except (Inconclusive, Refused):
        return False
    return True


def _prove(gate: Gate, drive: _Drive, told_ns: int | None) -> tuple[str, bool]:
    """Prove that a drive stands, and stop it once more where it does not; return what is found, and whether it stands.

    `told_ns`: as `stopping.stop` takes it.
    """
    if drive.rate != gate.line.endpoint.bits_per_second:
        gate.set_speed(drive.rate)
    passed = gate.line.passed
    way, failure = stopping.stop(gate.under(stopping.stopping(drive.address)), drive.dialect, drive.address, told_ns=told_ns)
    if not failure and not gate.line.is_can and gate.line.passed > passed:
        failure = "what shows it standing came faster than any line brings, and proves nothing"
    if failure:
        return f"{drive.name}: {failure}", False
    try:
        place = motion.position(plain_probe(drive.dialect, drive.address, gate)).value
    except Inconclusive as error:
        # That it stands is proved; on a busy line one more read can fail.
        return f"{drive.name}: stands, after a stop {way}; its place was not read again: {error}", True
    return f"{drive.name}: stands at {place:.2f} deg, after a stop {way}", True
