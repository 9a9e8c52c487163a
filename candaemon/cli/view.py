"""`candaemon view`: a live page in the browser, of buses or of a log."""

from __future__ import annotations

import argparse
import os
import sys
import webbrowser
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Final

from candaemon.binding.bind import bind
from candaemon.binding.bound import Binding
from candaemon.cli import console
from candaemon.cli.arguments import (
    CONFIG,
    LOG_FORMATS,
    add_channel_map,
    input_path,
    logs_name,
    number,
    refused,
    speed,
    whole_number,
)
from candaemon.config.load import load_config
from candaemon.config.shipped import find_config
from candaemon.errors import ConfigError

if TYPE_CHECKING:
    from candaemon.view.page_server import PageAddress
    from candaemon.view.showing import Source

PORT: Final = 8765
LARGEST_PORT: Final = 65_535
"""Largest number of a port."""
LONGEST_VIEW: Final = 86_400.0
"""Longest time that the page is served for where one is given, s."""
_NICENESS: Final = 5
"""The service, and whatever else the machine is there for, goes first."""
SHORTEST_TOKEN: Final = 16
"""Characters of a token, at least."""
LONGEST_TOKEN: Final = 200
"""Characters of a token, at most."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("config", type=input_path, metavar="CONFIG", help=CONFIG)
    parser.add_argument(
        "log",
        type=input_path,
        nargs="*",
        metavar="LOG",
        help=f"{LOG_FORMATS}; several are one drive; or the folder of a recording; default: the live buses",
    )
    parser.add_argument("--speed", type=speed, metavar="X", help="times real time to begin with, of a log; default: 1")
    add_channel_map(parser)
    add_page_arguments(parser)


def add_page_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of where the page is served."""
    parser.add_argument(
        "--port", type=whole_number(0, LARGEST_PORT), default=PORT, help=f"default: {PORT}; 0: any that is free"
    )
    parser.add_argument(
        "--address",
        default="127.0.0.1",
        metavar="ADDRESS",
        help="to serve the page at; default: this machine alone, 127.0.0.1",
    )
    parser.add_argument("--token", type=token, help="that a browser must know; needed with --address")
    parser.add_argument(
        "--duration", type=number(0.001, LONGEST_VIEW, "s"), metavar="S", help="s after which it ends; default: never"
    )
    parser.add_argument("--open", action="store_true", help="open it in the browser")


def token(text: str) -> str:
    """Read a token."""
    plain = text.isascii() and text.replace("-", "").replace("_", "").isalnum()
    if not (plain and SHORTEST_TOKEN <= len(text) <= LONGEST_TOKEN):
        raise refused("…", f"{SHORTEST_TOKEN} to {LONGEST_TOKEN} letters, digits, - and _")
    return text


def execute(arguments: argparse.Namespace) -> None:
    """Show the page until Ctrl-C."""
    require_extra()
    address = page_address(arguments)
    binding = bind(load_config(find_config(arguments.config)))
    console.warn(binding.warnings)
    logs: list[Path] = arguments.log
    if not logs:
        from candaemon.view.live_pictures import LiveListener  # noqa: PLC0415 - the room's libraries are an extra

        if arguments.map or arguments.speed is not None:
            raise ConfigError(f"{'--map' if arguments.map else '--speed'} is for a log; name one, or leave it out")
        listener = LiveListener(binding)
        os.nice(_NICENESS)
        title = ", ".join(f"{bus.settings.channel}" for bus in binding.buses)
        show(binding, listener.pictures, title, address, live=True, opens=arguments.open, duration=arguments.duration)
        return
    from candaemon.view.drive_pictures import pictures_of_log  # noqa: PLC0415 - as above

    channels = dict(arguments.map)
    show(
        binding,
        lambda _: pictures_of_log(binding, logs, channels),
        logs_name(logs),
        address,
        live=False,
        opens=arguments.open,
        speed=arguments.speed or 1.0,
        duration=arguments.duration,
    )


def require_extra() -> None:
    """Say which extra is to be installed, where it is not.

    Raises:
        ConfigError: it is not installed.
    """
    try:
        import aiohttp  # noqa: F401, PLC0415 - only to see whether it is there
    except ImportError as error:
        raise ConfigError("the page needs an extra: pip install 'candaemon[view]'") from error


def page_address(arguments: argparse.Namespace) -> PageAddress:
    """Return where the page is served.

    Raises:
        ConfigError: others can reach it, and there is no token.
    """
    import secrets  # noqa: PLC0415 - for a message alone

    from candaemon.view.page_server import PageAddress  # noqa: PLC0415 - as above

    address = PageAddress(arguments.address, arguments.port, arguments.token or "")
    if not address.is_loopback and not address.token:
        raise ConfigError(
            f"--address {address.host} lets others look; give --token, such as --token {secrets.token_urlsafe(18)}, "
            "or reach 127.0.0.1 through ssh -L"
        )
    return address


def show(
    binding: Binding,
    source: Source,
    title: str,
    address: PageAddress,
    *,
    live: bool,
    opens: bool,
    speed: float = 1.0,
    duration: float | None = None,
) -> None:
    """Show pictures in the browser until Ctrl-C.

    Args:
        binding: the configuration.
        source: of the pictures.
        title: what they are of.
        address: where the page is served.
        live: whether they are of live buses.
        opens: whether the browser is opened.
        speed: multiple of real time to begin with.
        duration: s after which it ends; None: never.
    """
    from candaemon.view.painter import stage_of  # noqa: PLC0415 - as above
    from candaemon.view.showing import ShowRequest, show_pictures  # noqa: PLC0415 - as above

    request = ShowRequest(
        source, stage_of(binding), title, live, address, speed, instance=binding.loaded.path.stem if live else None
    )
    show_pictures(request, _announcer(opens=opens), duration)


def _announcer(*, opens: bool) -> Callable[[str], None]:
    """Return what says where the page is, and opens it if it is to."""

    def announce(url: str) -> None:
        print(url, flush=True)
        console.say("Ctrl-C ends it")
        if opens and not _open(url):
            console.say("no browser of a desktop is here; open the address above in one")

    return announce


def _open(url: str) -> bool:
    """Open an address in the desktop's browser; return whether there is a desktop."""
    if sys.platform.startswith("linux") and not {"DISPLAY", "WAYLAND_DISPLAY"} & os.environ.keys():
        return False  # a browser of the terminal would take it over

    def open_it() -> None:
        with suppress(webbrowser.Error, OSError):
            webbrowser.open(url)

    Thread(target=open_it, daemon=True).start()
    return True
