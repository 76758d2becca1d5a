"""Server of the page on a port of this machine, in a separate thread."""

import asyncio
import secrets
import threading
from collections.abc import Callable
from typing import Any

from gapsweep.errors import GapsweepError
from gapsweep.model.oscillator import whole


class Explorer:
    """A running page; a notebook displays it.

    The server listens on this machine only, until `stop` or the end of the process.

    Attributes
    ----------
    url : str
        Address for a browser.
    """

    def __init__(self, fill: Callable[[Any], Callable[[], None]], port: int = 0) -> None:
        # Fills the document of a session, and returns a function that ends its work.
        self._fill = fill
        self._ends: list[Callable[[], None]] = []
        whole("port", port, 0, 65535)
        self._is_up = threading.Event()
        self._failure = "cannot be opened"
        self._thread = threading.Thread(target=self._serve, args=(port,), daemon=True)
        self._thread.start()
        self._is_up.wait()
        if self._failure:
            self._thread.join()
            raise GapsweepError(
                f"port {port}: {self._failure}; choose another, or 0 for any that is free"
            )

    def _serve(self, port: int) -> None:
        from bokeh.application import Application
        from bokeh.application.handlers.function import FunctionHandler
        from bokeh.server.server import Server
        from tornado.ioloop import IOLoop
        from tornado.routing import HostMatches, Rule

        asyncio.set_event_loop(asyncio.new_event_loop())
        self._loop = IOLoop.current()
        try:
            # Bound to this machine, under a path that pages of other sites cannot guess: a foreign
            # name that is redirected to this machine (DNS rebinding) would have the right origin.
            path = f"/{secrets.token_urlsafe()}"
            self._server = Server(
                Application(FunctionHandler(self._filled)),
                port=port,
                address="127.0.0.1",
                prefix=path,
                io_loop=self._loop,
            )
            pages = self._server._tornado
            ours = Rule(HostMatches(r"localhost|127\.0\.0\.1"), pages.wildcard_router)
            pages.default_router.rules[:] = [ours]  # even for requests with the right path
            self._server.start()
            self.url, self._failure = f"http://localhost:{self._server.port}{path}/", ""
        except OSError as error:
            self._failure = str(error.strerror)
            return
        finally:
            self._is_up.set()
        self._loop.start()

    def _filled(self, doc: Any) -> None:
        end = self._fill(doc)
        self._ends.append(end)
        doc.on_session_destroyed(lambda _: self._ends.remove(end))

    def wait(self) -> None:
        """Wait until the page is stopped or the process is interrupted."""
        while self._thread.is_alive():
            self._thread.join(0.5)

    def stop(self) -> None:
        """Close the page."""

        def end() -> None:
            self._server.stop()
            self._loop.stop()

        self._loop.add_callback(end)
        self._thread.join()
        for end_of_visit in self._ends:
            end_of_visit()

    def __repr__(self) -> str:
        return f"<gapsweep.explore at {self.url}>"

    def _repr_html_(self) -> str:
        return (
            f'<iframe src="{self.url}" width="100%" height="900" style="border: 0" '
            'title="gapsweep explore"></iframe>'
        )
