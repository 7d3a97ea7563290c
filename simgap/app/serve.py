"""Serve the app on the loopback interface until it is interrupted."""

from __future__ import annotations

import contextlib
import secrets
import signal
import socket
import webbrowser
from collections.abc import Callable
from pathlib import Path

import uvicorn

from mjsim.errors import InputError
from simgap.app.server import make_app

__all__ = ["serve"]

_HOST = "127.0.0.1"


def serve(folder: Path, port: int, browser: bool, tell: Callable[[str], None]) -> None:
    """Serve the runs in a folder; ``port`` 0: a free one; ``tell``: called with the address, which holds a new token.

    Raises InputError for a port that cannot be had and for a folder that cannot be written.
    """
    with socket.socket() as listening:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind((_HOST, port))
        except OSError as error:
            raise InputError(
                "--port", f"{port} cannot be had ({error.strerror})", "a free port", "choose another, or 0"
            ) from None
        listening.listen()  # a browser that comes before the server waits
        bound = listening.getsockname()[1]
        token = secrets.token_urlsafe(32)
        app = make_app(folder, token, bound, ending=lambda: server.should_exit)
        address = f"http://{_HOST}:{bound}/?token={token}"
        # no access log: it would hold the token
        config = uvicorn.Config(app, log_level="warning", access_log=False, server_header=False, timeout_graceful_shutdown=1,
                                ws="none", proxy_headers=False)  # fmt: skip
        server = uvicorn.Server(config)
        heard = signal.signal(signal.SIGINT, server.handle_exit)  # the server ends by it also before it has started
        try:
            tell(address)
            if browser:
                webbrowser.open(address)
            with contextlib.suppress(KeyboardInterrupt):  # a termination, which the command line raises
                server.run(sockets=[listening])
        finally:
            signal.signal(signal.SIGINT, heard)
