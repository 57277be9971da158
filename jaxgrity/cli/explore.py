"""Open a page with sliders for the robot, its gait and its ground, and watch how the motion changes."""

import contextlib
import socket
import time
import webbrowser
from collections.abc import Iterator

from jaxgrity.cli.settings import ExploreSettings
from jaxgrity.core.arguments import check_number
from jaxgrity.core.errors import InputError
from jaxgrity.explorer.page import Page
from jaxgrity.explorer.server import LOOPBACK, guarded_server, silent
from jaxgrity.io.scene_files import load_scene, scene_names
from jaxgrity.report import view


def main(settings: ExploreSettings) -> None:
    """Serve the page until Ctrl-C."""
    if not view.available():
        raise InputError("the explorer needs viser, which is not installed; expected: pip install 'jaxgrity[view]'")
    check_number("duration", settings.duration, above=0.0, unit="s")
    check_address(settings.host, settings.port)
    load_scene(settings.scene)
    if settings.host not in LOOPBACK:
        print(f"warning: others on the network can reach the page at {settings.host}")
    names = [settings.scene, *(name for name in scene_names() if name != settings.scene)]
    with served(tuple(names), settings.duration, settings.host, settings.port) as (_, address):
        print(f"open {address} in a browser; press Ctrl-C to stop", flush=True)
        if settings.browser:
            webbrowser.open(address)
        while True:
            time.sleep(3600)


def check_address(host: str, port: int) -> None:
    """Raises `InputError` for an unusable address: the server itself would wait for ever."""
    if not 0 <= port < 2**16:
        raise InputError(f"port = {port}: expected a number from 0 to {2**16 - 1}")
    try:
        socket.create_server((host, 0), family=socket.AF_INET6 if ":" in host else socket.AF_INET).close()
    except OSError as error:
        raise InputError(f"host = {host!r}: expected an address of this machine ({error})") from error


@contextlib.contextmanager
def served(
    scenes: tuple[str, ...], duration: float, host: str = LOOPBACK[0], port: int = 0
) -> Iterator[tuple[Page, str]]:
    """The page and its address, as a context; port 0: any free one."""
    server = guarded_server(host, port)
    page = Page(server, scenes, duration)
    try:
        page.start()
        yield page, f"http://{host}:{server.get_port()}"
    finally:
        page.stop()
        with silent():
            server.stop()
