"""A bench for the LK drive: one drive, one virtual clock, requests by name, and everything the drive sent."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from analyzer.catalogue import Role
from analyzer.decoder import Decoder
from analyzer.encoder import build
from analyzer.protocols.lk_rs485 import DIALECT
from analyzer.records import Chunk, Frame
from conformance.drives.drive import Outgoing
from conformance.drives.lk.drive import LkDrive

SECOND = 1_000_000_000
STEP_NS = 1_000_000


class Bench:
    """A drive on a clock. `trace`: what it answered to each request, as (ns after the request, hex)."""

    def __init__(self, address: int = 1, **options: Any) -> None:
        self.drive = LkDrive(DIALECT, address, **options)
        self.t_ns = 0
        self.trace: list[list[tuple[int, str]]] = []
        self.chunks: list[Chunk] = []

    @property
    def seconds(self) -> float:
        return self.t_ns / SECOND

    def wait(self, seconds: float) -> None:
        self.t_ns += round(seconds * SECOND)
        assert self.drive.advance(self.t_ns) == []

    def request(self, command: str, /, address: int | None = None, **values: int) -> bytes:
        return build(DIALECT, command, self.drive.address if address is None else address, values)

    def send(self, data: bytes) -> list[Outgoing]:
        """Give the drive a frame now, with its checks as they are; the clock goes on by a millisecond."""
        good = all(check.ok for check in DIALECT.link.checks(data))
        frame = Frame("bench", self.t_ns, self.t_ns, 0, data, DIALECT, Role.UNKNOWN, good)
        sent = self.drive.receive(frame, self.t_ns)
        self.trace.append([(each.at_ns - self.t_ns, each.data.hex(" ").upper()) for each in sent])
        self.chunks.append(Chunk(self.t_ns, "bench", data))
        self.chunks += [Chunk(each.at_ns, "bench", each.data) for each in sent]
        self.t_ns += STEP_NS
        return sent

    def ask(self, command: str, /, **values: int) -> list[Outgoing]:
        return self.send(self.request(command, **values))

    def read(self, command: str, /, **values: int) -> dict[str, Any]:
        """Return the values of the one reply, as sent."""
        (reply,) = self.ask(command, **values)
        frame = Frame("bench", 0, 0, 0, reply.data, self.drive.dialect, Role.REPLY, True)
        message, _ = Decoder(self.drive.dialect).decode(frame)
        assert message.command is not None
        assert message.command.name == command
        return message.values

    def position(self) -> int:
        position: int = self.read("read_position")["position"]
        return position

    def speed(self) -> int:
        speed: int = self.read("read_state_2")["speed"]
        return speed


#: Exchanges with a drive on its bench.
Script = Callable[[Bench], None]


def look(bench: Bench) -> None:
    """Read what changes with motion."""
    bench.ask("read_state_2")
    bench.ask("read_position")
    bench.ask("read_single_turn")
