"""A small object store that takes and deletes as S3 does, and can be told to hang, as `tests.service.s3` cannot."""

from __future__ import annotations

import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import urlsplit

BUCKET = "faces"


@dataclass
class ObjectStore:
    """What it holds, by key, whether it answers to PUT and DELETE, and how many PUTs have begun."""

    url: str = ""
    blobs: dict[str, bytes] = field(default_factory=dict)
    puts: threading.Event = field(default_factory=threading.Event)
    deletes: threading.Event = field(default_factory=threading.Event)
    begun: int = 0

    def environment(self) -> dict[str, str]:
        """The credentials and the address, as `AWS_*` variables."""
        keys = {"AWS_ACCESS_KEY_ID": "key", "AWS_SECRET_ACCESS_KEY": "secret", "AWS_REGION": "local"}
        return keys | {"AWS_ENDPOINT": self.url, "AWS_ALLOW_HTTP": "true"}


@contextmanager
def object_store() -> Iterator[ObjectStore]:
    """One of our own at a free port."""
    store = ObjectStore()
    store.puts.set()
    store.deletes.set()

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def log_message(self, *_: object) -> None:
            pass

        @property
        def key(self) -> str:
            return urlsplit(self.path).path.removeprefix(f"/{BUCKET}").lstrip("/")

        def answer(self, status: int, body: bytes = b"", **headers: str) -> None:
            self.send_response(status)
            for name, value in {"Content-Length": str(len(body)), **headers}.items():
                self.send_header(name.replace("_", "-"), value)
            self.end_headers()
            self.wfile.write(body)

        def do_PUT(self) -> None:
            content = self.rfile.read(int(self.headers["Content-Length"]))
            store.begun += 1
            if not store.puts.wait(30):
                return
            store.blobs[self.key] = content
            self.answer(200, ETag='"1"')

        def do_POST(self) -> None:
            wanted = self.rfile.read(int(self.headers["Content-Length"])).decode()
            if not store.deletes.wait(30):
                return
            keys = re.findall("<Key>(.*?)</Key>", wanted)
            for key in keys:
                store.blobs.pop(key, None)
            gone = "".join(f"<Deleted><Key>{key}</Key></Deleted>" for key in keys)
            self.answer(200, f"<DeleteResult>{gone}</DeleteResult>".encode(), Content_Type="application/xml")

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    store.url = f"http://127.0.0.1:{server.server_address[1]}"
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield store
    finally:
        store.puts.set()
        store.deletes.set()
        server.shutdown()
        server.server_close()
