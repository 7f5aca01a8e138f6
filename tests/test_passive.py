"""Nothing in the analyzer can write to a bus. What is proved here, and what rests on convention.

Proved from the source of every module (`ast`, so that comments and texts do not count):

1. No word that sends is used anywhere: not called, not imported, not named in a string for `getattr`.
2. A device is opened in the files of `OPENS` alone, and nothing else there can write: no `open`, no `write`, no `print`.
3. On Linux a serial port is opened with O_RDONLY, by the one `os.open` there is, so the kernel refuses every write; the
   calls that set it up are those of `IOCTLS` and no others.
4. Of what pyserial and python-can open, nothing is used but what `ONLY` lists: it can be read and closed.
5. Sockets are made in the files of `SOCKETS` alone.
6. Of the C library nothing is called but what `NATIVE` lists: it can set memory, and nothing else.

Proved by running it: the kernel holds a recorded port read-only, in every process of a recording; nothing ever arrives at the
other end of a pseudo-terminal, a TCP connection or a CAN bus that is recorded; no command writes its output into a port.

What remains convention: python-can's and pyserial's own code runs in our process and talks to its adapter (slcan is told its
bit rate and to listen only); a port of pyserial (macOS, Windows) could be written to by code that is not there. `Child` hands
a descriptor of a port to the supervisor, which reads nothing and, as the kernel says, cannot write.
"""

from __future__ import annotations

import ast
import os
import socket
import subprocess
import sys
import tty
from pathlib import Path

import pytest

from tests import ROOT
from tests.live.recorded import Recorded, pty_pair

MODULES = sorted((ROOT / "analyzer").rglob("*.py"))

#: What opens a device, and what it may use to do so.
OPENS = {
    "analyzer/live/reader_serial.py": "os.open",
    "analyzer/live/reader_tcp.py": "socket.socket",
    "analyzer/live/reader_can_socket.py": "socket.socket",
    "analyzer/live/reader_can_library.py": "can.Bus",
    "analyzer/live/reader_pyserial.py": "serial.Serial",
}
#: Files that use sockets: those, and those that join the processes of a recording.
SOCKETS = {
    "analyzer/live/reader_tcp.py",
    "analyzer/live/reader_can_socket.py",
    "analyzer/live/reader_port.py",
    "analyzer/live/reader.py",
    "analyzer/live/children.py",
}
#: Words that send bytes, make a bus, or act on the lines of a port.
SENDS = {
    "send", "sendall", "sendto", "sendmsg", "sendfile", "send_periodic", "send_break", "sendmsg_afalg", "splice",
    "tcsendbreak", "tcflow", "serial_for_url", "Notifier", "ThreadSafeBus", "openpty", "forkpty",
    "TIOCMBIS", "TIOCMSET", "TIOCSTI", "TIOCSBRK", "TIOCCBRK", "setDTR", "setRTS", "pwrite", "writev", "pwritev",
}  # fmt: skip
#: The same, where it is not to a bus: (file, word).
NOT_TO_A_BUS = {
    # A reader's descriptor, to its supervisor.
    ("analyzer/live/reader.py", "send_fds")
}
#: Opens files of a recording to lock them.
LOCKS = "analyzer/live/lock.py"
#: Map memory that processes share: a reader and its successor, the processes of a decode.
MEMORY = {"analyzer/live/reader_hand.py", "analyzer/sinks/shared.py"}
#: Expressions by which the C library is called: file -> what is written there.
NATIVE = {"analyzer/columns/memory.py": {"ctypes.CDLL", "ctypes.CDLL(None).mallopt"}}
#: The calls that set a serial port up.
IOCTLS = {"TIOCMBIC", "TCGETS2", "TCSETS2", "TIOCGICOUNT"}
#: What is used of an object that could write: its name in the file -> attributes.
ONLY = {
    "analyzer/live/reader_can_library.py": ("bus", {"recv", "shutdown", "fileno"}),
    "analyzer/live/reader_pyserial.py": (
        "port",
        {"port", "baudrate", "parity", "stopbits", "timeout", "dtr", "rts", "exclusive", "open", "read", "close", "in_waiting"},
    ),
}
#: Words that write to anything; no file that opens a device has them.
WRITES = {"write", "writelines", "write_bytes", "write_text", "print", "fdopen", "FileIO", "BufferedWriter", "dup", "dup2"}


def name_of(path):
    return str(path.relative_to(ROOT))


class Source:
    """A module: its name, and what its code uses."""

    def __init__(self, name, text):
        self.name = name
        self.tree = ast.parse(text)
        nodes = list(ast.walk(self.tree))
        #: Every word that is code: names, attributes, imports, and strings that are one word.
        self.words = {n.id for n in nodes if isinstance(n, ast.Name)} | {n.attr for n in nodes if isinstance(n, ast.Attribute)}
        self.words |= {part for n in nodes if isinstance(n, ast.alias) for part in n.name.split(".")}
        texts = {n.value for n in nodes if isinstance(n, ast.Constant) and isinstance(n.value, str)}
        self.words |= {text for text in texts if text.isidentifier()}
        #: Every call: its dotted name where it has one, and its node.
        self.calls = [(ast.unparse(n.func), n) for n in nodes if isinstance(n, ast.Call)]
        self.imported = {alias.name for n in nodes if isinstance(n, ast.Import) for alias in n.names}
        self.imported |= {
            f"{n.module}.{alias.name}" for n in nodes if isinstance(n, ast.ImportFrom) and n.module for alias in n.names
        }
        self.used = {called.rpartition(".")[2] for called, _ in self.calls} | {i.rpartition(".")[2] for i in self.imported}


def sends(source):
    """Rule 1."""
    found = {word for word in source.words if word in SENDS and (source.name, word) not in NOT_TO_A_BUS}
    # Where nothing is open a word may stand in a table; used it may not be.
    yield from found if source.name.startswith("analyzer/live/") else found & source.used
    # `os.write` passes by every object: no module may have it.
    yield from {"os.write"} & ({called for called, _ in source.calls} | source.imported)


def opens(source):
    """Rules 2 and 5: where devices are opened and sockets made."""
    may = OPENS.get(source.name)
    for module in source.imported:
        first = module.split(".")[0]
        if first == "serial" and not module.startswith("serial.tools.list_ports") and may != "serial.Serial":
            yield module
        if first == "socket" and source.name not in SOCKETS:
            yield module
        if first in ("pty", "tty", "usb") or (first == "mmap" and source.name not in MEMORY):
            yield module
    for called, _ in source.calls:
        # `Bus` alone is also what a recording knows of one.
        bus = called.endswith(".Bus") or (called == "Bus" and any(m.startswith("can") for m in source.imported))
        if (bus or called.endswith("Serial")) and may != called:
            yield called
        if called == "os.open" and source.name.startswith("analyzer/live/") and may != called and source.name != LOCKS:
            yield called
        if called in ("eval", "exec") and source.name != "analyzer/codec.py":
            yield called


def writes(source):
    """Rule 2: a file that opens a device can write nothing."""
    if source.name not in OPENS:
        return
    yield from source.words & WRITES
    for called, node in source.calls:
        if called == "open":
            yield called
        # Constants of modules and flags of a message; never an attribute of something that is open.
        if called == "getattr" and ast.unparse(node.args[0]) not in ("termios", "socket", "message"):
            yield ast.unparse(node)


def sets_up(source):
    """Rule 3: read-only, and no call that acts on the wire."""
    if OPENS.get(source.name) != "os.open":
        return
    opened = [node for called, node in source.calls if called == "os.open"]
    if [ast.unparse(node.args[1]) for node in opened] != ["os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC"]:
        yield "os.open"
    for called, node in source.calls:
        if called.endswith("ioctl") and (
            called != "fcntl.ioctl" or ast.unparse(node.args[1]).removeprefix("termios.") not in IOCTLS
        ):
            yield ast.unparse(node)
        if called.startswith("termios.") and called not in ("termios.tcgetattr", "termios.tcsetattr"):
            yield called


def only(source):
    """Rule 4: what could write is read and closed, and never passed on, returned or kept as a whole."""
    if source.name not in ONLY:
        return
    variable, allowed = ONLY[source.name]
    attributes = [n for n in ast.walk(source.tree) if isinstance(n, ast.Attribute)]
    mine = [n for n in attributes if isinstance(n.value, ast.Name) and n.value.id == variable]
    yield from {n.attr for n in mine} - allowed
    owners = {id(n.value) for n in mine}
    for node in ast.walk(source.tree):
        if isinstance(node, ast.Name) and node.id == variable and isinstance(node.ctx, ast.Load) and id(node) not in owners:
            yield f"{variable} is passed on in line {node.lineno}"
    made = [n for n in ast.walk(source.tree) if isinstance(n, ast.Call) and ast.unparse(n.func) == OPENS[source.name]]
    names = [n for n in ast.walk(source.tree) if isinstance(n, ast.Assign) and n.value in made]
    if len(made) != 1 or [[ast.unparse(target) for target in n.targets] for n in names] != [[variable]]:
        yield f"{OPENS[source.name]} is not kept as {variable}"


def native(source):
    """Rule 6: the C library is called for what is listed, and never kept."""
    nodes = list(ast.walk(source.tree))
    yield from {each for each in source.imported if each.startswith("ctypes.")}
    called = {ast.unparse(n): n for n in nodes if isinstance(n, ast.Attribute) and ast.unparse(n).startswith("ctypes")}
    yield from called.keys() - NATIVE.get(source.name, set())
    names = sum(isinstance(n, ast.Name) and n.id == "ctypes" for n in nodes)
    if names != sum(isinstance(n, ast.Attribute) and ast.unparse(n) == "ctypes.CDLL(None).mallopt" for n in nodes):
        yield "ctypes is kept"


RULES = (sends, opens, writes, sets_up, only, native)


def broken(name, text):
    source = Source(name, text)
    return [f"{rule.__name__}: {what}" for rule in RULES for what in rule(source)]


# --- the source -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_no_module_can_write_to_a_bus(path):
    assert broken(name_of(path), path.read_text()) == []


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("reader_serial", "os.O_RDONLY |", "os.O_RDWR |"),
        ("reader_serial", "termios.TIOCMBIC", "termios.TIOCMBIS"),
        ("reader_serial", "fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)", "termios.tcsendbreak(fd, 0)"),
        ("reader_serial", "fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)", "open(fd, 'wb')"),
        ("reader_serial", "fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)", "getattr(os, 'wr' + 'ite')(fd, b'x')"),
        ("reader_stream", "stamp_ns = time.monotonic_ns()", "os.write(fd, b'x')"),
        ("reader_store", "import time", "import time\nfrom os import write"),
        ("reader_store", "import time", "import time\nimport serial"),
        ("supervisor", "import time", "import time\nimport socket"),
        ("supervisor", "import time", "import time\nimport can\nbus = can.Bus()"),
        ("reader_tcp", "connection.setblocking(False)", "connection.sendall(b'x')"),
        ("reader_tcp", "connection.setblocking(False)", "getattr(connection, 'send')(b'x')"),
        ("reader_tcp", "connection.setblocking(False)", "connection.makefile('wb').write(b'x')"),
        ("reader_can_socket", "made.setblocking(False)", "made.sendmsg([b'x'])"),
        ("reader_can_library", "= bus.recv, bus.shutdown,", "= bus.recv, bus.flush_tx_buffer,"),
        ("reader_can_library", "self._shut, self._number = bus.recv,", "self._shut, self._bus = bus,"),
        ("reader_can_library", "bus = can.Bus(**options)", "bus = self._bus = can.Bus(**options)"),
        ("reader_pyserial", "port.open()", "port.write(b'x')"),
        ("reader_pyserial", "port.dtr = port.rts = False", "port.break_condition = True"),
        ("reader_pyserial", "port = serial.Serial()", "port = other = serial.Serial()"),
    ],
)
def test_a_module_that_could_is_noticed(name, old, new):
    name = f"analyzer/live/{name}.py"
    text = (ROOT / name).read_text()
    assert old in text
    assert broken(name, text.replace(old, new, 1))


@pytest.mark.parametrize("new", ["ctypes.CDLL(None).write", "ctypes.CDLL(None)", "ctypes.CDLL('libusb.so').mallopt"])
def test_another_call_of_the_c_library_is_noticed(new):
    (name,) = NATIVE
    text = (ROOT / name).read_text()
    assert broken(name, text.replace("ctypes.CDLL(None).mallopt", new))
    assert broken("analyzer/other.py", text)


def test_descriptors_are_handed_over_at_one_place():
    users = [name_of(path) for path in MODULES if "send_fds" in Source("", path.read_text()).words]
    assert users == ["analyzer/live/reader.py"]
    # The question whether there is such a call, and the call.
    assert (ROOT / users[0]).read_text().count("send_fds") == 2


def test_the_files_named_here_are_there():
    for name in {*OPENS, *SOCKETS, *ONLY, *NATIVE}:
        assert (ROOT / name).is_file(), name


# --- running it -----------------------------------------------------------------------------------------------------------


def access_modes(pid, device):
    """The access modes (0 read, 1 write, 2 both) in which a process has a device open."""
    number = os.stat(device).st_rdev
    found = []
    for entry in os.scandir(f"/proc/{pid}/fd"):
        try:
            if os.stat(entry.path).st_rdev != number:
                continue
            info = Path(f"/proc/{pid}/fdinfo/{entry.name}").read_text()
        except OSError:
            continue
        flags = next(line.split()[1] for line in info.splitlines() if line.startswith("flags"))
        found.append(int(flags, 8) & os.O_ACCMODE)
    return found


@pytest.mark.skipif(sys.platform != "linux", reason="the kernel's own view of a process")
def test_the_kernel_holds_a_recorded_port_read_only_in_every_process(tmp_path):
    with pty_pair() as (master, path), Recorded(tmp_path, f"serial:{path},baud=115200") as recorded:
        os.write(master, b"\xfa\x01\x31\x2c" * 100)
        assert recorded.wait_bytes(400)
        modes = {pid: access_modes(pid, path) for pid in recorded.pids}
        assert modes[recorded.pid_of("1-")] == [os.O_RDONLY]
        assert all(mode == os.O_RDONLY for found in modes.values() for mode in found), modes


@pytest.mark.skipif(sys.platform != "linux", reason="pseudo-terminals of Linux")
def test_nothing_arrives_at_the_other_end_of_a_serial_line(tmp_path):
    """Also not by the terminal's own echo, which is on when a port is opened."""
    with pty_pair() as (master, path):
        with Recorded(tmp_path, f"serial:{path},baud=115200") as recorded:
            for _ in range(20):
                os.write(master, bytes(range(256)))
            assert recorded.wait_bytes(20 * 256)
            assert recorded.end() == 0
        assert _waiting(master) == b""


def _waiting(fd):
    os.set_blocking(fd, False)
    try:
        return os.read(fd, 1 << 16)
    except BlockingIOError:
        return b""


def test_nothing_arrives_at_a_tcp_server(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        with Recorded(tmp_path, f"tcp:127.0.0.1:{port}") as recorded:
            server.settimeout(10)
            client, _ = server.accept()
            with client:
                client.sendall(b"\xfa\x01\x31\x2c" * 100)
                assert recorded.wait_bytes(400)
                assert recorded.end() == 0
                client.settimeout(10)
                # The end of the connection, and not a byte before it.
                assert client.recv(100) == b""


def test_nothing_arrives_on_a_can_bus(tmp_path):
    can = pytest.importorskip("can")
    pytest.importorskip("msgpack")
    group, port = "239.74.163.77", 43199
    with can.Bus(interface="udp_multicast", channel=group, port=port) as bus:
        with Recorded(tmp_path, f"can:udp_multicast:{group},port={port}") as recorded:
            sent = [can.Message(arbitration_id=1, data=bytes((0x31, n)), is_extended_id=False) for n in range(50)]
            for message in sent:
                bus.send(message)
            assert recorded.wait_records(50)
            assert recorded.end() == 0
        heard = []
        while (message := bus.recv(0.05)) is not None:
            heard.append(bytes(message.data))
        # This interface hands a sender its own frames back: those, and no others.
        assert heard == [bytes(m.data) for m in sent]


@pytest.mark.parametrize(
    "command",
    [
        ["decode", "captures/mks_rs485.log", "--force", "-o"],
        ["record", "tcp:127.0.0.1:1", "--force", "-o"],
        ["export", "captures/mks_rs485.log", "--force", "--to", "hex", "-o"],
    ],
    ids=lambda words: words[0],
)
def test_no_command_writes_its_output_into_a_port(command):
    with pty_pair() as (master, path):
        done = subprocess.run(
            [sys.executable, "-m", "analyzer", *command, path], cwd=ROOT, capture_output=True, text=True, timeout=60
        )
        assert done.returncode == 2, done.stderr
        assert "regular file" in done.stderr
        assert _waiting(master) == b""


def test_a_pty_pair_would_show_a_byte():
    """The proof above proves something: a byte that is written does arrive."""
    with pty_pair() as (master, path):
        fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(fd)
        os.write(fd, b"x")
        os.close(fd)
        assert os.read(master, 10) == b"x"
