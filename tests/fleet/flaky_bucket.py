"""An S3 server that refuses every fifth call: `python -m tests.fleet.flaky_bucket` prints its port.

It is a process of its own, because Delta Lake waits for its store without letting other threads run.
"""

from __future__ import annotations

from itertools import count

from moto.server import DomainDispatcherApplication, create_backend_app
from werkzeug.serving import make_server

_ERROR = b"<Error><Code>SlowDown</Code><Message>Please reduce your request rate.</Message></Error>"


def main():
    app, asked = DomainDispatcherApplication(create_backend_app), count(1)

    def flaky(environ, start):
        if next(asked) % 5:
            return app(environ, start)
        start("503 Slow Down", [("Content-Type", "application/xml")])
        return [_ERROR]

    server = make_server("127.0.0.1", 0, flaky, threaded=True)
    print(server.server_port, flush=True)
    server.serve_forever()


if __name__ == "__main__":
    main()
