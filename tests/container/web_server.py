"""A real web server for tests: nginx on the loopback, which serves a folder and counts requests in its log."""

from __future__ import annotations

import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import urlopen

NGINX = shutil.which("nginx") or shutil.which("nginx", path="/usr/sbin:/usr/local/sbin")
SETTINGS = """
daemon off;
master_process off;
pid {prefix}/nginx.pid;
error_log {prefix}/error.log;
events {{}}
http {{
  log_format asked '$request_uri|$http_range|$status|$body_bytes_sent';
  access_log {prefix}/access.log asked;
  client_body_temp_path {prefix}/body;
  proxy_temp_path {prefix}/proxy;
  fastcgi_temp_path {prefix}/fastcgi;
  uwsgi_temp_path {prefix}/uwsgi;
  scgi_temp_path {prefix}/scgi;
  server {{ listen 127.0.0.1:{port}; root {root}; {more} }}
}}
"""


class WebServer:
    """url: of the folder that is served."""

    def __init__(self, prefix: Path, port: int) -> None:
        self.url = f"http://127.0.0.1:{port}"
        self.log = prefix / "access.log"
        self.seen = 0

    def requests(self) -> list[tuple[str, int, int]]:
        """Range, status and bytes of each request since the last call."""
        mark = f"/end-of-{self.seen}"  # a request of our own: nginx writes its log after the answers, in their order
        with suppress(HTTPError):
            urlopen(f"{self.url}{mark}", timeout=30).close()
        lines: list[str] = []
        for _ in range(600):
            lines = self.log.read_text().splitlines()
            if any(line.startswith(f"{mark}|") for line in lines):
                break
            time.sleep(0.05)
        new, self.seen = lines[self.seen :], len(lines)
        fields = [line.split("|") for line in new]
        return [(asked, int(status), int(sent)) for path, asked, status, sent in fields if path != mark]


@contextmanager
def serving(root: Path, prefix: Path, more: str = "") -> Iterator[WebServer]:
    """nginx with the folder `root`. prefix: an empty folder for what it writes. more: directives for the server."""
    assert NGINX is not None
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    settings = prefix / "nginx.conf"
    settings.write_text(SETTINGS.format(prefix=prefix, port=port, root=root, more=more))
    command = [NGINX, "-p", str(prefix), "-e", str(prefix / "error.log"), "-c", str(settings)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        for _ in range(300):
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", port)) == 0:
                    break
            assert process.poll() is None, (prefix / "error.log").read_text()
            time.sleep(0.05)
        yield WebServer(prefix, port)
    finally:
        process.terminate()
        process.wait(30)
