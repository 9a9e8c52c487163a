"""An FTP server of one folder, for tests of file systems that are not the local one; nobody is asked who he is."""

from __future__ import annotations

import os
import socket
import socketserver
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


class _Conversation(socketserver.StreamRequestHandler):
    """What a client asks for, a line each (RFC 959; MLSD and SIZE of RFC 3659)."""

    def handle(self) -> None:
        self.root: Path = self.server.root  # type: ignore[attr-defined]
        self.listener: socket.socket | None = None
        self.offset, self.renamed = 0, Path()
        self.say("220 ready")
        for line in self.rfile:
            command, _, argument = line.decode().strip().partition(" ")
            try:
                if command.upper() == "QUIT":
                    break
                getattr(self, f"do_{command.lower()}", self.unknown)(argument)
            except OSError:
                self.say("550 no")
        self.close_listener()

    def close_listener(self) -> None:
        if self.listener is not None:
            self.listener.close()

    def say(self, text: str) -> None:
        self.wfile.write(f"{text}\r\n".encode())

    def unknown(self, _argument: str) -> None:
        self.say("502 not known")

    def path(self, argument: str) -> Path:
        return self.root / argument.strip("/")

    def do_user(self, _argument: str) -> None:
        self.say("230 welcome")

    def do_type(self, _argument: str) -> None:
        self.say("200 as you like")

    do_acct = do_cwd = do_type

    def do_pasv(self, _argument: str) -> None:
        self.close_listener()
        self.listener = socket.create_server(("127.0.0.1", 0))
        port = self.listener.getsockname()[1]
        self.say(f"227 (127,0,0,1,{port // 256},{port % 256})")

    def do_rest(self, argument: str) -> None:
        self.offset = int(argument)
        self.say("350 from there")

    @contextmanager
    def data(self) -> Iterator[socket.socket]:
        assert self.listener is not None
        self.say("150 here it comes")
        with self.listener, self.listener.accept()[0] as connection:
            yield connection
        self.say("226 done")

    def do_mlsd(self, argument: str) -> None:
        entries = sorted(os.scandir(self.path(argument)), key=lambda entry: entry.name)
        lines = []
        for entry in entries:
            kind, about = "dir" if entry.is_dir() else "file", entry.stat()
            lines.append(f"type={kind};size={about.st_size};modify={about.st_mtime_ns}; {entry.name}\r\n")
        with self.data() as connection:
            connection.sendall("".join(lines).encode())

    def do_size(self, argument: str) -> None:
        self.say(f"213 {self.path(argument).stat().st_size}")

    def do_retr(self, argument: str) -> None:
        content = self.path(argument).read_bytes()[self.offset :]
        self.offset = 0
        with self.data() as connection:
            connection.sendall(content)

    def do_stor(self, argument: str) -> None:
        with self.path(argument).open("r+b" if self.offset else "wb") as file, self.data() as connection:
            file.seek(self.offset)
            self.offset = 0
            while piece := connection.recv(1 << 16):
                file.write(piece)

    def do_dele(self, argument: str) -> None:
        self.path(argument).unlink()
        self.say("250 gone")

    def do_mkd(self, argument: str) -> None:
        self.path(argument).mkdir(exist_ok=True)
        self.say(f'257 "{argument}"')

    def do_rnfr(self, argument: str) -> None:
        self.renamed = self.path(argument)
        self.say("350 to what?")

    def do_rnto(self, argument: str) -> None:
        self.renamed.replace(self.path(argument))
        self.say("250 renamed")


@contextmanager
def ftp_server(root: Path) -> Iterator[str]:
    """Serve a folder; yield its URL."""

    class Server(socketserver.ThreadingTCPServer):
        daemon_threads, block_on_close = True, False

        def handle_error(self, request: Any, client_address: Any) -> None:
            """Say nothing of a client that hangs up."""

    with Server(("127.0.0.1", 0), _Conversation) as server:
        server.root = root  # type: ignore[attr-defined]
        serving = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
        serving.start()
        try:
            yield f"ftp://127.0.0.1:{server.server_address[1]}"
        finally:
            server.shutdown()
            serving.join()
