"""Who in conformance and servotap can put a byte on a bus, and who may: the gate, emulated drives, a tap for its program."""

from __future__ import annotations

import ast

import pytest

from tests import ROOT

MODULES = sorted(path for package in ("conformance", "servotap") for path in (ROOT / package).rglob("*.py"))

#: What can write to a port, a connection or a bus -> the calls that make it able to.
WRITERS = {
    # The host's end, in the hands of the gate.
    "conformance/bus/serial.py": {"serial.Serial", "os.write"},
    "conformance/bus/tcp.py": {"socket.create_connection"},
    "conformance/bus/can_socket.py": {"socket.socket"},
    # Its socket is a second name of the bus's own, to give that more room.
    "conformance/bus/python_can.py": {"can.Bus", "socket.socket"},
    # The drives' end.
    "conformance/serve/pty.py": {"os.write"},
    "conformance/serve/tcp.py": {"socket.create_server"},
    # The one exception to the gate: bytes that a user's own program wrote to the port that a tap offers it.
    "conformance/tap/adapter.py": {"os.open", "socket.socket"},
    "conformance/tap/passing.py": {"os.write"},
}
_CALLS = {
    "os.write", "os.open", "serial.Serial", "serial.serial_for_url", "can.Bus", "can.ThreadSafeBus", "socket.socket",
    "socket.create_connection", "socket.create_server",
}  # fmt: skip


def name_of(path):
    return str(path.relative_to(ROOT))


def called(path):
    return [ast.unparse(node.func) for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)]


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_what_can_write_stands_in_the_table(path):
    found = set(called(path)) & _CALLS
    # A file that is opened by name for reading, or to be locked, is no port.
    opens_ports = "O_NOCTTY" in path.read_text()
    found -= set() if opens_ports else {"os.open"}
    assert found <= WRITERS.get(name_of(path), set())


def test_the_table_names_nothing_that_is_not_there():
    for name, calls in WRITERS.items():
        assert calls <= set(called(ROOT / name)), name


def test_only_the_gate_writes_to_a_line():
    """A line that is opened anew passes on what the gate gives it, in its own `write` and nowhere else."""

    def writes(tree):
        return [
            ast.unparse(n) for n in ast.walk(tree) if isinstance(n, ast.Call) and ast.unparse(n.func).endswith("line.write")
        ]

    found = {name_of(path): calls for path in MODULES if (calls := writes(ast.parse(path.read_text())))}
    assert found == {"conformance/bus/lasting.py": ["line.write(item)"], "conformance/gate/gate.py": ["self.line.write(item)"]}
    tree = ast.parse((ROOT / "conformance/bus/lasting.py").read_text())
    write = next(node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef) and node.name == "write")
    assert writes(write) == ["line.write(item)"]


def test_a_tap_writes_what_it_read_and_nothing_it_made():
    """Each of its two writes gets the bytes of the one read of the other side, by way of what waits in between."""
    tree = ast.parse((ROOT / "conformance/tap/passing.py").read_text())
    writes = [node for node in ast.walk(tree) if isinstance(node, ast.Call) and ast.unparse(node.func) == "os.write"]
    assert sorted(ast.unparse(node) for node in writes) == ["os.write(fd, data)", "os.write(self._terminal.master, data)"]
    # No literal bytes but the empty ones, with which what waits is tried again.
    texts = {node.value for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, bytes)}
    assert texts <= {b""}
    assert not any(c in ("bytes.fromhex", "build", "struct.pack") for c in called(ROOT / "conformance/tap/passing.py"))
