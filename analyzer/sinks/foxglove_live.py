"""The log, live: all messages of a log file also go out over Foxglove's WebSocket, with the same topics, schemas and JSON.

    McapLog -> FoxgloveFile -> McapFile          always first and complete, despite the network
                            -> FoxgloveServer -> clients that have subscribed

A message is passed on only while a client subscribes to its topic. The SDK sends from its own threads and
keeps at most `BACKLOG` messages for a slow client; then the oldest are dropped. So a client can lose messages but never slow
the recording. The server offers no capability for sending, so it takes nothing from clients.

Needs the package foxglove-sdk (the extra `foxglove`). A server is started in the process that uses it, never before a fork.
"""

from __future__ import annotations

import contextlib
import importlib.util
from collections.abc import Mapping
from typing import Any, NamedTuple

from analyzer.errors import UsageError
from analyzer.sinks.mcap_file import LogFile, McapFile
from analyzer.values import is_host, quote

HOST = "127.0.0.1"
PORT = 8765
#: Messages that wait for one client.
BACKLOG = 4096
_LOOPBACK = frozenset(("127.0.0.1", "localhost", "::1"))


class Place(NamedTuple):
    """Where a server listens."""

    host: str
    port: int

    def __str__(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"

    @property
    def loopback(self) -> bool:
        """Whether only this machine can reach it."""
        return self.host in _LOOPBACK or self.host.startswith("127.")


def read_place(text: str) -> Place:
    """Return the place that `HOST:PORT`, `HOST`, `:PORT` or a port alone means; empty: loopback, port 8765.

    Raises UsageError for anything else.
    """
    host, colon, port = text.strip().rpartition(":")
    if not colon:
        host, port = ("", port) if port.isdigit() else (port, "")
    elif text.strip().endswith("]"):
        host, port = text.strip(), ""
    host = host.strip("[]")
    if port and not (port.isascii() and port.isdigit() and int(port) <= 65535):
        raise UsageError(f"foxglove: expected HOST:PORT with a port of 0..65535, got {quote(text)}")
    if any(c.isspace() or c in "/?#@" for c in host) or not is_host(host):
        raise UsageError(f"foxglove: expected HOST:PORT such as 127.0.0.1:8765, got {quote(text)}")
    return Place(host or HOST, int(port) if port else PORT)


def require_foxglove() -> None:
    """Raise UsageError where the SDK is not installed."""
    if importlib.util.find_spec("foxglove") is None:
        raise UsageError("--foxglove needs the package foxglove-sdk: pip install 'servotap[foxglove]'")


class FoxgloveServer:
    """Offers topics to clients. One serves all parts of a recording. Raises UsageError where it cannot listen."""

    def __init__(self, place: Place) -> None:
        require_foxglove()
        import foxglove

        self._context = foxglove.Context()
        # Without this the SDK would say on standard error what it does, in the middle of a terminal view.
        foxglove.set_log_level("CRITICAL")
        try:
            self._server = foxglove.start_server(
                name="servotap", host=place.host, port=place.port, context=self._context, message_backlog_size=BACKLOG
            )
        except RuntimeError as error:
            reason = str(error).removeprefix("FoxgloveError: ")
            raise UsageError(f"foxglove: cannot listen on {place}: {reason}") from None
        self.place = Place(place.host, self._server.port)
        self._topics: dict[str, Any] = {}

    @property
    def address(self) -> str:
        """The address that Foxglove is told to open."""
        return f"ws://{self.place}"

    def topic(self, topic: str, schema_name: str, schema: bytes, metadata: Mapping[str, str]) -> Any:
        """Return what a topic's messages are passed to; one topic is offered once."""
        known = self._topics.get(topic)
        if known is None:
            import foxglove

            known = self._topics[topic] = foxglove.Channel(
                topic,
                schema=foxglove.Schema(name=schema_name, encoding="jsonschema", data=schema),
                message_encoding="json",
                metadata=dict(metadata),
                context=self._context,
            ).base
        return known

    def beside(self, file: LogFile) -> FoxgloveFile:
        """Return a file that passes on what is written to another."""
        return FoxgloveFile(file, self)

    def close(self) -> None:
        # A server that has lost its socket cannot be stopped again; there is nothing left to do then.
        with contextlib.suppress(RuntimeError):
            self._server.stop()


class FoxgloveFile:
    """A log file that others can watch while it is written; see `McapFile` for what its methods do.

    The server outlives it. Attributes that only the file itself has are the file's.
    """

    def __init__(self, file: LogFile, server: FoxgloveServer) -> None:
        self._file = file
        self._server = server
        self._schemas: dict[int, tuple[str, bytes]] = {}
        self._topics: dict[int, Any] = {}
        # A file that another process left has its channels already.
        if isinstance(file, McapFile):
            self._schemas = {schema.id: (schema.name, schema.data) for schema in file.schemas()}
            for channel in file.channels():
                schema_name, data = self._schemas[channel.schema_id]
                self._topics[channel.id] = server.topic(channel.topic, schema_name, data, channel.metadata)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)

    @property
    def messages(self) -> int:
        return self._file.messages

    def add_schema(self, name: str, data: bytes) -> int:
        """Register a JSON Schema and return its id."""
        schema_id = self._file.add_schema(name, data)
        self._schemas[schema_id] = (name, data)
        return schema_id

    def add_channel(self, topic: str, schema_id: int, metadata: Mapping[str, str]) -> int:
        """Register a channel of JSON messages and return its id."""
        channel_id = self._file.add_channel(topic, schema_id, metadata)
        self._topics[channel_id] = self._server.topic(topic, *self._schemas[schema_id], metadata)
        return channel_id

    def add_message(self, channel_id: int, sequence: int, log_ns: int, publish_ns: int, data: bytes) -> None:
        """Add a message, and pass it on to those who have subscribed to it."""
        self._file.add_message(channel_id, sequence, log_ns, publish_ns, data)
        topic = self._topics.get(channel_id)
        if topic is not None and topic.has_sinks():
            topic.log(data, log_ns)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        self._file.add_metadata(name, values)

    def flush(self) -> None:
        self._file.flush()

    def finish(self) -> None:
        """Write what is left, the summary and the footer."""
        self._file.finish()

    def abandon(self) -> None:
        self._file.abandon()
