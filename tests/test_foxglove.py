"""The log over Foxglove's WebSocket: a real client gets the topics, schemas and JSON of the log, and cannot slow it."""

from __future__ import annotations

import asyncio
import io
import json
import struct
import threading
import time

import pytest
from mcap.reader import make_reader

from analyzer import dialects
from analyzer.errors import UsageError
from analyzer.pipeline import Pipeline
from analyzer.port import Options
from analyzer.records import Chunk
from analyzer.sinks import foxglove_live
from analyzer.sinks.foxglove_live import FoxgloveServer, Place, read_place, require_foxglove
from analyzer.sinks.mcap_file import McapFile
from analyzer.sinks.mcap_log import LIBRARY, PROFILE, McapLog
from tests.collect import sum8

pytest.importorskip("foxglove", reason="foxglove-sdk is not installed (the extra `foxglove`)")
websockets = pytest.importorskip("websockets", reason="the client of these tests is not installed")

MS = 1_000_000
START = 1_700_000_000_000_000_000
#: First byte of a binary message that carries data: subscription u32, log time u64, payload.
DATA = 1


def chunks(count, start=0):
    for n in range(start, start + count):
        t_ns = START + n * 10 * MS
        yield Chunk(t_ns, "left", bytes.fromhex(sum8("FA 01 32")), burst=True)
        yield Chunk(t_ns + 3 * MS, "left", bytes.fromhex(sum8("FB 01 32 01 40")), burst=True)
    yield Chunk(t_ns + 5 * MS, "left", bytes.fromhex("00 55 AA"), burst=True)


@pytest.fixture
def server():
    server = FoxgloveServer(Place("127.0.0.1", 0))
    yield server
    server.close()


def log_beside(server):
    stream = io.BytesIO()
    log = McapLog(server.beside(McapFile(stream, profile=PROFILE, library=LIBRARY)))
    return stream, log, Pipeline([dialects.get("mks-rs485")], (log,), Options())


class Client:
    """Subscribes to everything that is offered. `slow`: takes nothing for a while after that."""

    def __init__(self, address: str, slow: threading.Event | None = None) -> None:
        self.topics: dict[int, dict] = {}
        self.messages: list[tuple[str, int, dict]] = []
        self.info: dict = {}
        self._slow = slow
        self._stop = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._run(address)), daemon=True)
        self._thread.start()

    async def _run(self, address: str) -> None:
        async with websockets.connect(address, subprotocols=["foxglove.sdk.v1"], max_size=None) as socket:
            while not self._stop.is_set():
                try:
                    message = await asyncio.wait_for(socket.recv(), 0.05)
                except TimeoutError:
                    continue
                if isinstance(message, bytes):
                    self._take(message)
                    continue
                said = json.loads(message)
                if said["op"] == "serverInfo":
                    self.info = said
                if said["op"] == "advertise":
                    asked = [{"id": c["id"], "channelId": c["id"]} for c in said["channels"]]
                    await socket.send(json.dumps({"op": "subscribe", "subscriptions": asked}))
                    self.topics |= {c["id"]: c for c in said["channels"]}
                    while self._slow is not None and not self._slow.is_set():
                        # It blocks the loop on purpose: nothing is read from the socket.
                        time.sleep(0.02)

    def _take(self, message: bytes) -> None:
        if message[0] == DATA:
            subscription, log_ns = struct.unpack_from("<IQ", message, 1)
            self.messages.append((self.topics[subscription]["topic"], log_ns, json.loads(message[13:])))

    def until(self, test, what: str) -> None:
        late = time.monotonic() + 10
        while not test():
            assert time.monotonic() < late, what
            time.sleep(0.01)

    def close(self) -> None:
        self._stop.set()
        self._thread.join(5)


def subscribed(server, *topics):
    return all(topic in server._topics and server._topics[topic].has_sinks() for topic in topics)


ALL = ("/left/1/read_speed/request", "/left/1/read_speed/reply", "/left/1/state", "/left/junk", "/findings")


def test_a_client_gets_what_the_log_gets(server):
    stream, log, pipeline = log_beside(server)
    pipeline.run(chunks(1))
    client = Client(server.address)
    client.until(lambda: subscribed(server, *ALL), "subscriptions")
    before = log.messages
    pipeline = Pipeline([dialects.get("mks-rs485")], (log,), Options())
    pipeline.run(chunks(20, start=10))
    client.until(lambda: len(client.messages) >= 20 * 3 + 2, "messages")
    log.finish({})
    assert before == 0
    written = [
        (channel.topic, message.log_time, json.loads(message.data), schema.name, schema.data.decode(), channel.metadata)
        for schema, channel, message in make_reader(io.BytesIO(stream.getvalue())).iter_messages(log_time_order=False)
        if message.log_time >= START + 100 * MS and "stats" not in channel.topic
    ]
    got = [m for m in client.messages if "stats" not in m[0]]
    assert sorted(map(repr, got)) == sorted(repr(row[:3]) for row in written)
    offered = {c["topic"]: c for c in client.topics.values()}
    for topic, _, _, schema_name, schema, metadata in written:
        channel = offered[topic]
        assert (channel["schemaName"], channel["encoding"], channel["schemaEncoding"]) == (schema_name, "json", "jsonschema")
        assert json.loads(channel["schema"]) == json.loads(schema)
        assert channel.get("metadata", metadata) == metadata
    client.close()


def test_nothing_is_taken_from_a_client(server):
    client = Client(server.address)
    client.until(lambda: client.info, "the server's word")
    assert client.info["capabilities"] == []
    client.close()


def test_a_client_that_takes_nothing_slows_nothing_and_the_log_is_whole(server):
    go_on = threading.Event()
    stream, log, pipeline = log_beside(server)
    pipeline.run(chunks(1))
    client = Client(server.address, slow=go_on)
    client.until(lambda: subscribed(server, *ALL), "subscriptions")
    pipeline = Pipeline([dialects.get("mks-rs485")], (log,), Options())
    began = time.thread_time()
    pipeline.run(chunks(5000, start=10))
    spent = time.thread_time() - began
    log.finish({})
    go_on.set()
    client.close()
    assert spent < 10, "a frame takes some microseconds; a client that is waited for would take for ever"
    topics = [c.topic for _, c, _ in make_reader(io.BytesIO(stream.getvalue())).iter_messages()]
    assert topics.count("/left/1/read_speed/reply") == 5001


def test_the_parts_of_a_recording_share_their_topics(server):
    _, first, pipeline = log_beside(server)
    pipeline.run(chunks(1))
    first.finish({})
    client = Client(server.address)
    client.until(lambda: subscribed(server, *ALL), "subscriptions")
    _, second, pipeline = log_beside(server)
    pipeline.run(chunks(1, start=50))
    client.until(lambda: any(m[0].endswith("reply") for m in client.messages), "messages of the second part")
    second.finish({})
    assert len({c["topic"] for c in client.topics.values()}) == len(client.topics)
    client.close()


def test_a_file_that_is_gone_on_with_keeps_its_topics(server, tmp_path):
    path = tmp_path / "log.mcap"
    with open(path, "wb") as stream:
        file = McapFile(stream, profile=PROFILE, library=LIBRARY)
        schema = file.add_schema("servotap.state", b'{"type":"object"}')
        channel = file.add_channel("/left/1/state", schema, {"unit": "deg"})
        tee = server.beside(file)
        client = Client(server.address)
        client.until(lambda: subscribed(server, "/left/1/state"), "subscription")
        tee.add_message(channel, 1, START, START, b'{"position":1.5}')
        client.until(lambda: client.messages, "message")
        assert client.messages == [("/left/1/state", START, {"position": 1.5})]
        client.close()
        tee.finish()


def test_a_port_that_is_taken_is_told(server):
    with pytest.raises(UsageError, match=r"cannot listen on 127\.0\.0\.1:\d+: .*in use"):
        FoxgloveServer(server.place)


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("", Place("127.0.0.1", 8765)), ("9000", Place("127.0.0.1", 9000)), (":9000", Place("127.0.0.1", 9000)),
        ("0.0.0.0:8765", Place("0.0.0.0", 8765)), ("localhost", Place("localhost", 8765)), ("[::1]:80", Place("::1", 80)),
        ("[::1]", Place("::1", 8765)),
    ],
)  # fmt: skip
def test_places(text, place):
    assert read_place(text) == place
    assert read_place(str(place)) == place
    assert place.loopback == (place.host != "0.0.0.0")


@pytest.mark.parametrize("text", ["127.0.0.1:x", "h:70000", "ws://h:1", "a b:1", "h:-1", "a..b:1", "\udcff:1"])
def test_what_is_no_place(text):
    with pytest.raises(UsageError, match="HOST:PORT"):
        read_place(text)


def test_without_the_sdk_it_says_what_to_install(monkeypatch):
    monkeypatch.setattr(foxglove_live.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(UsageError, match="foxglove-sdk"):
        require_foxglove()
    with pytest.raises(UsageError, match="foxglove-sdk"):
        FoxgloveServer(Place("127.0.0.1", 0))
