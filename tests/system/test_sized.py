"""Messages behind their sizes: what is put is taken, and what is broken off is an end."""

from __future__ import annotations

import io
import os

from analyzer.system import sized


def test_messages_are_taken_as_they_were_put():
    stream = io.BytesIO()
    for data in (b"a", bytes(70_000), b"end"):
        sized.put(stream, data)
    stream.seek(0)
    assert [bytes(sized.take(stream)) for _ in range(4)] == [b"a", bytes(70_000), b"end", b""]


def test_a_message_that_is_broken_off_or_too_long_is_the_end():
    stream = io.BytesIO()
    sized.put(stream, b"0123456789")
    whole = stream.getvalue()
    for size in range(len(whole)):
        assert sized.take(io.BytesIO(whole[:size])) == b""
    assert sized.take(io.BytesIO(whole), most=9) == b""
    assert sized.take(io.BytesIO(whole), most=10) == b"0123456789"


def test_a_pipe_that_gives_a_part_at_a_time_gives_the_whole():
    class Slow(io.RawIOBase):
        """Takes and gives three bytes at most."""

        def __init__(self) -> None:
            self.data = b""

        def write(self, data) -> int:
            self.data += bytes(data[:3])
            return min(3, len(data))

        def readinto(self, into) -> int:
            part, self.data = self.data[: min(3, len(into))], self.data[min(3, len(into)) :]
            into[: len(part)] = part
            return len(part)

    slow = Slow()
    sized.put(slow, os.urandom(100))
    sent = slow.data[4:]
    assert sized.take(slow) == sent
