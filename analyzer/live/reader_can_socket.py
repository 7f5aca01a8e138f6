"""Listening to CAN buses that are sockets: the kernel's SocketCAN, and python-can's udp_multicast. Nothing is sent.

    socketcan   a frame of the kernel: struct can_frame (16 bytes) or canfd_frame (72)
    udp_multicast   a datagram of MessagePack, as python-can's interface of that name sends it

python-can's own `recv` takes several times as long for a frame. The kernel stamps each frame on the wall clock. Only the
frame's *age* when it is read is used, so setting the wall clock does no harm. The kernel also counts the frames it had no
room for (SO_RXQ_OVFL), and reports them with the next one.
"""

from __future__ import annotations

import ipaddress
import os
import socket
import struct
import time
from collections.abc import Callable
from pathlib import Path

import msgspec

from analyzer.live.can_listen_only import kernel_notes
from analyzer.live.endpoint import Endpoint
from analyzer.live.reader_can_library import flags_of
from analyzer.live.reader_port import BadCount, Lost, Opened, Stop, Unopened, listen, readable
from analyzer.live.reader_store import Store
from analyzer.live.spool import MOST_BYTES, CanFlag
from analyzer.system.decoding import UNDECODABLE
from analyzer.values import CAN_ID_LIMIT, CAN_ID_MASK, counted

MULTICAST_PORT = 43113
#: Wished size of the kernel's buffer: a tenth of a second of a full bus needs about a megabyte.
BUFFER = 8 << 20
#: An age beyond this is wrong: the system clock was set in between.
OLDEST_NS = 1_000_000_000
_AT_ONCE = 512
_READ_SIZE = 4096
_SO_RCVBUFFORCE = 33
_SO_TIMESTAMPNS = 35
_SO_RXQ_OVFL = 40
_SO_MEMINFO = 55
#: Nine numbers about a socket; the last is how many frames it had no room for.
_MEMINFO = struct.Struct("@9I")
_IP_MULTICAST_ALL = 49
_IPV6_MULTICAST_ALL = 29
_ANCILLARY = socket.CMSG_SPACE(16) + socket.CMSG_SPACE(4) if hasattr(socket, "CMSG_SPACE") else 0
_TIMESPEC = struct.Struct("@qq")
_COUNT = struct.Struct("@I")
_CAN_HEAD = struct.Struct("=IBB2x")
_CLASSIC, _FD = 16, 72
_EFF, _RTR, _ERR = 0x80000000, 0x40000000, 0x20000000
#: Classes of error frames that are worth an event of their own, and what the controller says (data byte 1).
_ERROR_CONTROLLER, _ERROR_BUS_OFF, _ERROR_RESTARTED = 0x004, 0x040, 0x100
_CONTROLLER = ((0x01, "the controller's buffer overflowed: frames were lost"), (0x10, "error passive (receiving)"))
_MSG_DONTROUTE = 4
_CAN_RAW_ERR_FILTER = 2

#: Takes a datagram; returns identifier, flags, payload. Raises one of UNDECODABLE for other bytes.
Dissect = Callable[[bytes], tuple[int, int, bytes]]


class _Multicast(msgspec.Struct):
    """A message as python-can's udp_multicast interface sends it."""

    arbitration_id: int
    data: bytes | None = None
    is_extended_id: bool = True
    is_remote_frame: bool = False
    is_error_frame: bool = False
    is_fd: bool = False


_unpack = msgspec.msgpack.Decoder(_Multicast).decode


def dissect_multicast(datagram: bytes) -> tuple[int, int, bytes]:
    """Return identifier, flags and payload of a datagram of python-can's udp_multicast. Raises one of UNDECODABLE."""
    message = _unpack(datagram)
    if not 0 <= message.arbitration_id < 1 << 32:
        raise ValueError(f"identifier {message.arbitration_id}")
    data = message.data or b""
    if len(data) > MOST_BYTES:
        raise ValueError(counted(len(data), "data byte"))
    return message.arbitration_id, flags_of(message), data


def dissect_kernel(frame: bytes) -> tuple[int, int, bytes]:
    """Return identifier, flags and payload of a frame of the kernel. Raises ValueError."""
    if len(frame) not in (_CLASSIC, _FD):
        raise ValueError(f"not a SocketCAN frame: {counted(len(frame), 'byte')}")
    word, length, _ = _CAN_HEAD.unpack_from(frame)
    flags = 0
    if word & _EFF:
        flags |= CanFlag.EXTENDED
    if word & _RTR:
        flags |= CanFlag.REMOTE
    if word & _ERR:
        flags |= CanFlag.ERROR
    if len(frame) == _FD:
        flags |= CanFlag.FD
    can_id = word & (CAN_ID_MASK if word & (_EFF | _ERR) else CAN_ID_LIMIT)
    # A remote frame says a length and has no data.
    return can_id, flags, b"" if word & _RTR else frame[_CAN_HEAD.size : _CAN_HEAD.size + length]


def trouble(can_id: int, payload: bytes) -> str:
    """Return what an error frame of the kernel says that concerns the whole bus, or nothing."""
    found = []
    if can_id & _ERROR_BUS_OFF:
        found.append("bus off")
    if can_id & _ERROR_RESTARTED:
        found.append("the controller was restarted")
    if can_id & _ERROR_CONTROLLER and len(payload) > 1:
        found += [text for bit, text in _CONTROLLER if payload[1] & bit]
    return ", ".join(found)


class CanSocketPort:
    """A CAN bus behind a socket."""

    unit = "frames"

    def __init__(self, endpoint: Endpoint) -> None:
        self._endpoint = endpoint
        self._interface, self._channel = endpoint.interface
        self._kernel = self._interface == "socketcan"
        self._dissect: Dissect = dissect_kernel if self._kernel else dissect_multicast
        self._socket: socket.socket | None = None
        self._overflows = 0
        self._adopted = False

    def open(self, stop: Stop) -> Opened:
        made: socket.socket | None = None
        try:
            group = int(self._endpoint.options.get("port", MULTICAST_PORT))
            made = self._open_kernel() if self._kernel else open_multicast(self._channel, group)
        except OSError as error:
            raise Unopened(f"cannot open {self._endpoint.place}: {error.strerror or error}") from None
        self._overflows = 0
        self._adopted = False
        return self._set_up(made, kernel_notes(self._channel, self._endpoint.speed) if self._kernel else [])

    def adopt(self, fd: int) -> Opened:
        """Take over the socket of another reader. What the kernel dropped since that one told it is still to be told."""
        made = socket.socket(fileno=fd)
        self._overflows = _overflows(made) or 0
        self._adopted = True
        return self._set_up(made, [])

    def _set_up(self, made: socket.socket, notes: list[str]) -> Opened:
        made.setblocking(False)
        self._socket = made
        stamped = _wish(made, _SO_TIMESTAMPNS, 1)
        if not _wish(made, _SO_RXQ_OVFL, 1):
            notes.append("this kernel does not count the frames that it drops")
        size = with_room(made)
        if size < 1 << 20:
            notes.append(
                f"the kernel buffers {size >> 10} KiB, a full bus of about {size // 15_000} ms; "
                "sysctl net.core.rmem_max=8388608 allows more"
            )
        precision = "stamped by the kernel" if stamped else "stamped as a frame is read"
        return Opened(precision, tuple(notes))

    def _open_kernel(self) -> socket.socket:
        # So that a bus that is down is waited for, instead of being lost again at once.
        flags = Path(f"/sys/class/net/{self._channel}/flags")
        if flags.exists() and not int(flags.read_text(), 16) & 1:
            raise OSError(100, "the interface is down (ip link set ... up)")
        made = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        try:
            # All error frames, and FD frames where there are any.
            made.setsockopt(socket.SOL_CAN_RAW, _CAN_RAW_ERR_FILTER, 0x1FFFFFFF)
            made.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
            made.bind((self._channel,))
        except BaseException:
            made.close()
            raise
        return made

    def descriptor(self) -> int | None:
        return None if self._socket is None else self._socket.fileno()

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    # --- listening ------------------------------------------------------------------------------------------------

    def listen(self, store: Store, stop: Stop) -> None:
        assert self._socket is not None
        bad = BadCount("datagrams that are not frames")
        (self._overflows,) = store.kernel_counts((self._overflows,), adopted=self._adopted)

        def take(ready: bool) -> int:
            taken, wrong = self._take(store)
            bad.count += wrong
            return store.last_ns if taken else 0

        def tick(now_ns: int) -> None:
            self._look_at_overflows(store)
            bad.tell(store, now_ns)

        listen(store, stop, take, wait=readable(self._socket.fileno(), stop), tick=tick)
        self._take(store)
        store.flush()
        self._look_at_overflows(store)

    def _take(self, store: Store) -> tuple[int, int]:
        """Store what is there; return how many frames, and how many datagrams that were none. Raises Lost."""
        assert self._socket is not None
        receive, dissect, can = self._socket.recvmsg, self._dissect, store.can
        monotonic, wall = time.monotonic_ns, time.time_ns
        taken = bad = 0
        for _ in range(_AT_ONCE):
            try:
                data, ancillary, message_flags, _ = receive(_READ_SIZE, _ANCILLARY)
            except BlockingIOError:
                break
            except OSError as error:
                store.flush()
                raise Lost(os.strerror(error.errno) if error.errno else str(error)) from None
            t_ns, now_ns = monotonic(), wall()
            for _, kind, value in ancillary:
                if kind == _SO_TIMESTAMPNS and len(value) == _TIMESPEC.size:
                    seconds, nanoseconds = _TIMESPEC.unpack(value)
                    age_ns = now_ns - seconds * 1_000_000_000 - nanoseconds
                    if 0 < age_ns < OLDEST_NS:
                        t_ns -= age_ns
                elif kind == _SO_RXQ_OVFL:
                    self._tell_overflow(store, _COUNT.unpack(value)[0], t_ns)
            try:
                can_id, flags, payload = dissect(data)
            except UNDECODABLE:
                bad += 1
                continue
            if message_flags & _MSG_DONTROUTE:
                flags |= CanFlag.TX
            can(t_ns, can_id, flags, payload)
            taken += 1
            if self._kernel and flags & CanFlag.ERROR:
                reason = trouble(can_id, payload)
                if reason:
                    store.event("bus_error", t_ns, reason=reason, from_ns=t_ns, count=1)
        return taken, bad

    def _look_at_overflows(self, store: Store) -> None:
        """Tell what the kernel had no room for, also when no frame comes after it that could say so."""
        assert self._socket is not None
        count = _overflows(self._socket)
        if count is not None:
            self._tell_overflow(store, count, time.monotonic_ns())

    def _tell_overflow(self, store: Store, count: int, t_ns: int) -> None:
        lost = (count - self._overflows) & 0xFFFFFFFF
        # A frame that was queued before the last look says less than that look did.
        if 0 < lost < 1 << 31:
            self._overflows = count
            store.event("kernel_dropped", frames=lost, from_ns=store.last_ns, t_ns=t_ns)
            store.told_counts((count,))


def open_multicast(channel: str, port: int) -> socket.socket:
    """Return a socket that hears a multicast group. Raises OSError."""
    try:
        group = ipaddress.ip_address(channel)
    except ValueError:
        raise OSError(22, f"{channel} is not an address, expected one such as 239.74.163.2") from None
    if not group.is_multicast:
        raise OSError(22, f"{channel} is not a multicast address, expected one such as 239.74.163.2")
    family = socket.AF_INET if group.version == 4 else socket.AF_INET6
    made = socket.socket(family, socket.SOCK_DGRAM)
    try:
        for option in ("SO_REUSEADDR", "SO_REUSEPORT"):
            if hasattr(socket, option):
                made.setsockopt(socket.SOL_SOCKET, getattr(socket, option), 1)
        made.bind(("", port))
        # Traffic of groups that other programs on this machine have joined is not ours.
        if group.version == 4:
            _wish(made, _IP_MULTICAST_ALL, 0, socket.IPPROTO_IP)
            request = group.packed + struct.pack("@I", socket.INADDR_ANY)
            made.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, request)
        else:
            _wish(made, _IPV6_MULTICAST_ALL, 0, socket.IPPROTO_IPV6)
            made.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_JOIN_GROUP, group.packed + struct.pack("@I", 0))
    except BaseException:
        made.close()
        raise
    return made


def _overflows(made: socket.socket) -> int | None:
    """Return how many frames a socket had no room for since it was opened; None where the kernel does not say."""
    try:
        return int(_MEMINFO.unpack(made.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMINFO.size))[-1])
    except (OSError, struct.error):
        return None


def with_room(made: socket.socket, size: int = BUFFER) -> int:
    """Let the kernel keep so much for a socket, or what the system allows of it; return how many bytes that is."""
    if not _wish(made, _SO_RCVBUFFORCE, size):
        _wish(made, socket.SO_RCVBUF, size)
    return made.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)


def _wish(made: socket.socket, option: int, value: int, level: int = socket.SOL_SOCKET) -> bool:
    """Set an option that not every system has; say whether it was taken."""
    try:
        made.setsockopt(level, option, value)
    except OSError:
        return False
    return True
