"""The viewer's page for a browser, as one that asks this machine alone.

As the viewer serves it, the page reports its use, asks for new versions, and takes its fonts from another server. A header that
browsers obey forbids all of that; the viewer cannot send it, so that its page goes through a server that adds it.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from http.client import HTTPConnection
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread

HEADER = "Content-Security-Policy"
POLICY = "default-src 'self' http://127.0.0.1:{data} 'unsafe-inline' 'unsafe-eval' data: blob:"
KEPT = ("Content-Type", "rerun-final-length")
ANSWER_SECONDS = 60.0


@contextmanager
def local_page(web: int, data: int) -> Iterator[int]:
    """The port at which the page of the viewer at port ``web`` is served, as a context; the page may ask it and port ``data``,
    where the viewer has its recording."""

    class Page(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            viewer = HTTPConnection("127.0.0.1", web, timeout=ANSWER_SECONDS)
            try:
                viewer.request("GET", self.path)
                answer = viewer.getresponse()
                content = answer.read()
            except OSError:
                self.send_error(502)
                return
            finally:
                viewer.close()
            self.send_response(answer.status)
            for name in KEPT:
                if answer.getheader(name):
                    self.send_header(name, answer.getheader(name))
            self.send_header("Content-Length", str(len(content)))
            self.send_header(HEADER, POLICY.format(data=data))
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, *parts) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Page)
    thread = Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield server.server_address[1]
    finally:
        server.shutdown()
        server.server_close()
