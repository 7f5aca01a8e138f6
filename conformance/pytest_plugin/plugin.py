"""The pytest plugin: options, fixtures, and data of the suite's reports. It is loaded in every pytest run and idle in most.

    pytest --pyargs conformance --drive mks-rs485@1 --on serial:/dev/ttyUSB0,baud=38400           the suite
    pytest --servo-drive mks-rs485@1 --servo-on serial:/dev/ttyUSB0,baud=38400                    tests with `servo_drive`

In other people's runs each option is `--servo-NAME`, so that it collides with nothing. Where the suite itself is run, `--NAME`
is the same option.

Refuted is failed; confirmed and observed are passed; inconclusive and not run are skipped with their reason. The suite and
Hypothesis are imported only when a test of the suite is collected.

With pytest-xdist, tests on one real port go to one worker, for a port has one owner, and all workers draw from one budget
(`conformance.pytest_plugin.workers`).
If another plugin has an option of the same name, only `--servo-NAME` is there.
"""

from __future__ import annotations

import contextlib
import os
import re
import threading
import time
from typing import Any

import pytest

#: Name behind `--servo-` (and behind `--` for the suite), and what argparse is told. `on` and `drive` may be repeated.
OPTIONS: tuple[tuple[str, dict[str, Any]], ...] = (
    (
        "drive",
        {"action": "append", "default": [], "metavar": "DRIVE", "help": "DIALECT@ADDRESS[,model=M], or a name of a profile"},
    ),
    ("on", {"action": "append", "default": [], "metavar": "ENDPOINT", "help": "serial:, tcp:, can:, or emulated (default)"}),
    ("allow", {"action": "append", "default": [], "metavar": "RISKS", "help": "what may be sent beside reads"}),
    ("alone", {"action": "store_true", "default": False, "help": "no other drive is on the bus"}),
    ("spoken", {"default": None, "metavar": "DIALECTS", "help": "what drives on this bus speak: --alone looks for these"}),
    ("max-speed", {"type": float, "default": None, "metavar": "RPM", "help": "highest speed that may be sent"}),
    ("max-turns", {"type": float, "default": None, "metavar": "N", "help": "longest move that may be sent"}),
    ("max-acceleration", {"type": float, "default": None, "metavar": "N", "help": "highest acceleration that may be sent"}),
    ("max-current", {"type": float, "default": None, "metavar": "MA", "help": "highest current that may be set"}),
    ("subdivision", {"type": int, "default": None, "metavar": "N", "help": "what MKS drives are set to"}),
    ("budget", {"action": "append", "default": [], "metavar": "…", "help": "commands=N,seconds=N,turns=N for the whole run"}),
    ("claim", {"action": "append", "default": [], "metavar": "ID", "help": "only these claims; * and ? are patterns"}),
    ("theme", {"action": "append", "default": [], "metavar": "T", "help": "only this theme"}),
    (
        "short",
        {"action": "store_true", "default": False, "help": "the most telling claims, as many as fit into 90 s of the line"},
    ),
    ("seed", {"type": int, "default": 0, "metavar": "N", "help": "seed of random values"}),
    ("settings", {"default": None, "metavar": "FILE", "help": "JSON: what to put back where the drive cannot be asked"}),
    ("journal", {"default": None, "metavar": "FILE", "help": "where changes are written down before they are made"}),
    ("cut-power", {"default": "", "metavar": "COMMAND", "help": "runs when no stop can be verified"}),
    (
        "accept-quirk",
        {"action": "append", "default": [], "metavar": "NAME", "help": "a known quirk that fails nothing, or all"},
    ),
    ("max-run", {"default": "30", "metavar": "S", "help": "longest run without an end, in seconds"}),
    ("max-inconclusive", {"default": "10%", "metavar": "LIMIT", "help": "inconclusive claims above which the status is 10"}),
    ("report", {"default": None, "metavar": "OUT.html", "help": "one self-contained page"}),
    ("log", {"default": None, "metavar": "OUT.mcap", "help": "all traffic of the run, with a /tests topic"}),
    ("failures", {"default": None, "metavar": "FOLDER", "help": "a small log of each refuted claim"}),
)
#: Options that others have too.
_PREFIXED = frozenset({"seed"})
#: Environment of all workers of one run: the file in which the budget is kept.
BUDGET = "SERVOTAP_BUDGET_FILE"
#: How often a worker looks for its controller, and its exit status where that has gone.
_WATCH_SECONDS = 0.1
_GONE = 3
RUN: pytest.StashKey[Any] = pytest.StashKey()
#: Of a run that ended early: 10 a fault of the rig, 20 a motor that was not stopped. From a worker to its controller by name.
STATUS: pytest.StashKey[int] = pytest.StashKey()
_STATUS = "servotap_status"


def pytest_addoption(parser: pytest.Parser, pluginmanager: pytest.PytestPluginManager) -> None:
    """Add the options."""
    group = parser.getgroup("servotap", "servo drives: their own tests (servotap), and drives for yours (fixture servo_drive)")
    bare = _is_suite(pluginmanager)
    for name, about in OPTIONS:
        destination = f"servotap_{name.replace('-', '_')}"
        prefixed = f"--servo-{name}"
        try:
            group.addoption(prefixed, *[f"--{name}"] * (bare and name not in _PREFIXED), dest=destination, **about)
        except ValueError:
            group.addoption(prefixed, dest=destination, **about)


def _is_suite(pluginmanager: pytest.PytestPluginManager) -> bool:
    """Say whether the suite itself is run: `--pyargs conformance`."""
    words = [str(word) for word in pluginmanager.getplugin("pytestconfig").invocation_params.args]
    return "--pyargs" in words and any(re.split("::|[.]", word)[0] == "conformance" for word in words)


@pytest.hookimpl(tryfirst=True)
def pytest_configure(config: pytest.Config) -> None:
    """Keep the tests of one port together, and give all workers one budget."""
    _names_as_drives(config.option)
    if not config.getoption("servotap_drive"):
        return
    if hasattr(config, "workerinput"):
        threading.Thread(target=_end_with_controller, args=(os.getppid(),), daemon=True).start()
        return
    config.pluginmanager.register(_Controller(config), "servotap-controller")
    real = _any_real(config)
    _check_places(config)
    if real or config.getoption("servotap_budget"):
        from analyzer.system.scratch import scratch_folder

        opened = contextlib.ExitStack()
        config.add_cleanup(opened.close)
        path = opened.enter_context(scratch_folder()) / "budget.json"
        path.touch()
        os.environ[BUDGET] = str(path)


def _any_real(config: pytest.Config) -> bool:
    """Say whether a drive that is named is no emulated one: a name of a profile brings its place."""
    from analyzer.errors import ServotapError
    from conformance.suite.target import any_real

    try:
        return any_real(config.getoption("servotap_drive"), config.getoption("servotap_on"))
    except ServotapError as error:
        raise pytest.UsageError(f"servotap: {error}") from None


def _check_places(config: pytest.Config) -> None:
    """Raise pytest's UsageError where a report would replace a file that is none: before the run, not after it."""
    from analyzer.errors import ServotapError
    from conformance.report import check_places

    try:
        check_places({name: config.getoption(f"servotap_{name}") for name in ("report", "log")}, force=None)
    except ServotapError as error:
        raise pytest.UsageError(f"servotap: {error}") from None


def _names_as_drives(option: Any) -> None:
    """Take words at `--servo-on` that are no endpoints as drives of a profile, which bring their place."""
    places = option.servotap_on
    if not option.servotap_drive and places and all(":" not in place and place != "emulated" for place in places):
        option.servotap_drive, option.servotap_on = places, []


def _end_with_controller(controller: int) -> None:
    """End a worker at once when its controller has gone, as if it had been killed too: the guards then stop the motors.

    By itself a worker goes on for seconds.
    """
    while os.getppid() == controller:
        time.sleep(_WATCH_SECONDS)
    os._exit(_GONE)


class _Controller:
    """What the controller of several workers does: one worker for each port, and none goes on when one has given up."""

    def __init__(self, config: pytest.Config) -> None:
        self._config = config

    @pytest.hookimpl(optionalhook=True)
    def pytest_xdist_make_scheduler(self, config: pytest.Config, log: Any) -> Any:
        """Keep the tests of one real port together; with emulated drives alone tests go anywhere."""
        if not _any_real(config):
            return None
        from conformance.pytest_plugin.workers import ByPort

        return ByPort(config, log)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Stop where a worker gave up: no other one may go on with its port."""
        gave_up = getattr(report, "servotap_gave_up", None)
        session = self._config.pluginmanager.getplugin("dsession")
        if gave_up is not None and session is not None:
            session.shouldstop = gave_up


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Keep the verdict of a test for the reports at the end."""
    verdict = getattr(report, "servotap", None)
    if verdict is not None and report.when == "call":
        _verdicts.append(verdict)


_verdicts: list[str] = []


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Any:
    """Give the report of a claim its verdict, as text that passes from a worker to its controller."""
    outcome = yield
    verdict = getattr(item, "servotap_verdict", None)
    if verdict is not None:
        outcome.get_result().servotap = verdict
    gave_up = getattr(item, "servotap_gave_up", None)
    if gave_up is not None:
        outcome.get_result().servotap_gave_up = gave_up


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    """Show the claims by theme, and write the reports that were asked for."""
    if not _verdicts or hasattr(config, "workerinput"):
        return
    from conformance.pytest_plugin.reports import summarise

    summarise(terminalreporter, config, _verdicts)


def end_with(config: pytest.Config, status: int) -> None:
    """Have the run end with this exit status, or with the worst of several."""
    from conformance.claim import worst

    config.stash[STATUS] = worst(status, config.stash.get(STATUS, 0))
    output = getattr(config, "workeroutput", None)
    if output is not None:
        output[_STATUS] = config.stash[STATUS]


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any, error: object) -> None:
    """Take over what a worker says of its end."""
    status = getattr(node, "workeroutput", {}).get(_STATUS, 0)
    if status:
        end_with(node.config, status)


@pytest.hookimpl(hookwrapper=True, tryfirst=True)
def pytest_sessionfinish(session: pytest.Session) -> Any:
    """Give the run its exit status, after the drives were stopped and put back."""
    yield
    config = session.config
    if _verdicts and not hasattr(config, "workerinput"):
        from conformance.pytest_plugin.reports import judge

        judge(config, _verdicts)
    status = config.stash.get(STATUS, 0)
    if status:
        session.exitstatus = status


def pytest_unconfigure(config: pytest.Config) -> None:
    """Forget the run."""
    _verdicts.clear()


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run a test that takes `servo_drive` with each drive that was named."""
    if "servo_drive" not in metafunc.fixturenames or not metafunc.config.getoption("servotap_drive"):
        return
    from conformance.pytest_plugin.fixtures import drives_of

    metafunc.parametrize("servo_drive", drives_of(metafunc.config), indirect=True)


@pytest.fixture
def servo_drive(request: pytest.FixtureRequest) -> Any:
    """Connect to the drive of `--servo-drive`, emulated or at `--servo-on`: a `servotap.Drive`, stopped after the test."""
    if not hasattr(request, "param"):
        pytest.skip("no drive: give --servo-drive DIALECT@ADDRESS, and --servo-on ENDPOINT for a real one")
    from conformance.pytest_plugin.fixtures import connected

    with connected(request.param, request.config) as drive:
        yield drive


@pytest.fixture
def servo_can_bus() -> Any:
    """Put emulated drives on a CAN bus: `servo_can_bus("mks-can@1")` is a `can.BusABC` of python-can on which they answer."""
    from conformance.pytest_plugin.fixtures import can_buses

    with can_buses() as serve:
        yield serve


@pytest.fixture
def servo_port() -> Any:
    """Serve emulated drives on a pseudo-terminal: `servo_port("mks-rs485@1")` is the path that a program opens."""
    from conformance.pytest_plugin.fixtures import ports

    with ports() as serve:
        yield serve


@pytest.fixture
def servo_line() -> Any:
    """Put emulated drives on a line in virtual time: `servo_line("mks-can@1")` is a `conformance.bus.line.Line`."""
    from conformance.pytest_plugin.fixtures import line_of

    return line_of
