"""An SFTP server on the loopback that serves one folder, to read from, and cuts off every seventh read."""

from __future__ import annotations

import contextlib
import os
import socket
import threading
from itertools import count
from pathlib import Path

import paramiko

PASSWORD = "of the plant"


class _Door(paramiko.ServerInterface):
    def check_auth_password(self, username, password):
        return paramiko.AUTH_SUCCESSFUL if password == PASSWORD else paramiko.AUTH_FAILED

    def check_channel_request(self, kind, chanid):
        return paramiko.OPEN_SUCCEEDED if kind == "session" else paramiko.OPEN_FAILED_ADMINISTRATIVELY_PROHIBITED


class _Handle(paramiko.SFTPHandle):
    asked = count(1)

    def read(self, offset, length):
        # A read that gives nothing is the end of the file for its client.
        return b"" if next(self.asked) % 7 == 0 else super().read(offset, length)

    def stat(self):
        return paramiko.SFTPAttributes.from_stat(os.fstat(self.readfile.fileno()))


class _Folder(paramiko.SFTPServerInterface):
    def __init__(self, server, folder):
        self._folder = folder

    def _local(self, path):
        return self._folder / path.lstrip("/")

    def list_folder(self, path):
        return [paramiko.SFTPAttributes.from_stat(each.stat(), each.name) for each in self._local(path).iterdir()]

    def stat(self, path):
        if not self._local(path).exists():
            return paramiko.SFTP_NO_SUCH_FILE
        return paramiko.SFTPAttributes.from_stat(self._local(path).stat())

    lstat = stat

    def open(self, path, flags, attr):
        if flags & (os.O_WRONLY | os.O_RDWR):
            return paramiko.SFTP_PERMISSION_DENIED
        handle = _Handle(flags)
        handle.readfile = self._local(path).open("rb")
        return handle


@contextlib.contextmanager
def serving(folder: Path):
    """Serve a folder; yield the port."""
    key = paramiko.ECDSAKey.generate()

    def serve():
        while True:
            try:
                connection, _ = listening.accept()
            except OSError:
                return
            transport = paramiko.Transport(connection)
            opened.append(transport)
            transport.add_server_key(key)
            transport.set_subsystem_handler("sftp", paramiko.SFTPServer, _Folder, folder)
            transport.start_server(server=_Door())

    opened: list[paramiko.Transport] = []
    with socket.create_server(("127.0.0.1", 0)) as listening:
        thread = threading.Thread(target=serve)
        thread.start()
        yield listening.getsockname()[1]
        listening.shutdown(socket.SHUT_RDWR)
        thread.join()
    for transport in opened:
        transport.close()
