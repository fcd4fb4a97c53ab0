"""An HTTP server on loopback that cuts connections, changes its file, or ignores ranges, as a test wants it."""

from __future__ import annotations

import http.server
import threading
from collections.abc import Iterator
from contextlib import contextmanager


class CuttingServer(http.server.ThreadingHTTPServer):
    """Serves ``content``, or the one of ``files`` that a path ends in. ``cuts``: after how many bytes each of the next
    answers breaks off."""

    def __init__(self, content: bytes) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.content = content
        self.files: dict[str, bytes] = {}
        self.etag: str | None = '"one"'
        self.cuts: list[int] = []
        self.ranges_allowed = True
        self.content_type = "application/octet-stream"
        self.status = 0  # another answer than the file
        self.claimed_length: int | None = None
        self.asked: list[str | None] = []  # the Range header of each request

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}/net.pth"


class _Handler(http.server.BaseHTTPRequestHandler):
    server: CuttingServer

    def do_GET(self) -> None:
        server, wanted = self.server, self.headers.get("Range")
        server.asked.append(wanted)
        if server.status:
            self.send_error(server.status)
            return
        start = int(wanted.removeprefix("bytes=").rstrip("-")) if wanted and server.ranges_allowed else 0
        if self.headers.get("If-Range") not in (None, server.etag):
            start = 0
        content = server.files.get(self.path.rpartition("/")[2], server.content)
        total = len(content)
        if start >= total > 0:
            self.send_response(416)
            self.send_header("Content-Range", f"bytes */{total}")
            self.end_headers()
            return
        self.send_response(206 if start else 200)
        if start:
            self.send_header("Content-Range", f"bytes {start}-{total - 1}/{total}")
        if server.etag:
            self.send_header("ETag", server.etag)
        self.send_header("Content-Type", server.content_type)
        self.send_header("Content-Length", str(server.claimed_length or total - start))
        self.end_headers()
        end = start + server.cuts.pop(0) if server.cuts else total
        self.wfile.write(content[start : min(end, start + (server.claimed_length or total))])

    def log_message(self, *_: object) -> None:
        """Nothing on the terminal."""


@contextmanager
def serving(content: bytes) -> Iterator[CuttingServer]:
    """A running server; it is gone after the block."""
    server = CuttingServer(content)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
    thread.start()
    try:
        yield server
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
