"""A viser server that answers only its own pages."""

import contextlib
import io
from collections.abc import Callable, Iterator
from http import HTTPStatus
from typing import Any
from unittest.mock import patch
from urllib.parse import urlsplit

import lazy_loader

viser = lazy_loader.load("viser")
websockets = lazy_loader.load("websockets")

LOOPBACK = ("127.0.0.1", "localhost", "::1")
"""Names of this machine by which its own browser may ask."""


def guarded_server(host: str, port: int) -> Any:
    """A viser server at `host` (at another port where this one is taken; 0: any) that refuses foreign requests.

    Otherwise a foreign page in the same browser could reach a server on loopback. A request is answered only if its
    Host is the server's own name, and its Origin, which browsers send, is that address.
    """
    make_server, sockets = viser.ViserServer, websockets.asyncio.server
    serve = sockets.serve
    names = (*LOOPBACK, host)

    def guarded(handler: Callable, *where: Any, process_request: Callable, **how: Any) -> Any:
        def answer(connection: Any, request: Any) -> Any:
            if not expected(request.headers.get_all("Host"), request.headers.get_all("Origin"), names):
                return connection.respond(HTTPStatus.FORBIDDEN, "not a page of this server\n")
            return process_request(connection, request)

        return serve(handler, *where, process_request=answer, **how)

    # viser has no way to say which requests it answers, and prints
    with patch.object(sockets, "serve", guarded), silent():
        server = make_server(host=host, port=port, verbose=False)
    # else a button of the page would let the world in, by a relay on the internet
    server.request_share_url = lambda verbose=True: None
    server.gui.configure_theme(show_share_button=False)
    return server


def expected(hosts: list[str], origins: list[str], names: tuple[str, ...]) -> bool:
    """Whether a request has one of the server's names, and comes from its own page or from none."""
    if len(hosts) != 1 or len(origins) > 1:
        return False
    return urlsplit(f"//{hosts[0]}").hostname in names and all(origin == f"http://{hosts[0]}" for origin in origins)


@contextlib.contextmanager
def silent() -> Iterator[None]:
    """Silence for viser's start and end."""
    with contextlib.redirect_stdout(io.StringIO()):
        yield
