"""A network camera: JPEG pictures over HTTP, as multipart/x-mixed-replace (RFC 2046)."""

import threading
import time
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import numpy as np

_BOUNDARY = "picture"


class MjpegServer:
    """Sends pictures to each client until ``close``.

    Args:
        picture: (height, width, 3) blue, green and red of the picture with a number.
        port: port; 0 for any free one.
        rate: pictures per second.
    """

    def __init__(
        self, picture: Callable[[int], np.ndarray], port: int = 0, rate: float = 20.0
    ) -> None:
        import cv2

        self.paused = False
        ended = self._ended = threading.Event()
        server = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                self.send_response(200)
                kind = f"multipart/x-mixed-replace; boundary={_BOUNDARY}"
                self.send_header("Content-Type", kind)
                self.end_headers()
                number = 0
                while not ended.wait(1 / rate):
                    if server.paused:
                        continue
                    jpeg = cv2.imencode(".jpg", picture(number))[1].tobytes()
                    number += 1
                    head = (
                        f"--{_BOUNDARY}\r\nContent-Type: image/jpeg\r\n"
                        f"Content-Length: {len(jpeg)}\r\n\r\n"
                    )
                    try:
                        self.wfile.write(head.encode() + jpeg + b"\r\n")
                    except OSError:
                        return

            def log_message(self, *_: Any) -> None:
                """Stays silent."""

        self._server = ThreadingHTTPServer(("127.0.0.1", port), Handler)
        self._server.daemon_threads = True
        self.port = self._server.server_address[1]
        self.address = f"http://127.0.0.1:{self.port}/video.mjpg"
        threading.Thread(target=self._server.serve_forever, args=(0.05,), daemon=True).start()

    def close(self) -> None:
        """Ends all streams, and frees the port."""
        self._ended.set()
        time.sleep(0.1)  # the streams' last picture
        self._server.shutdown()
        self._server.server_close()
