"""The page's server against those who are slow, rude or no page at all: refused, bounded, and the others still look."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from aiohttp import ClientSession, ClientWebSocketResponse, WSMsgType, WSServerHandshakeError

from candaemon.errors import CandaemonError
from candaemon.view import connection_guard, page_server, viewer
from candaemon.view.page_server import FILES, PageAddress, PageServer, is_loopback
from tests.support.viewing import demo_pictures, serving, show_of

TOKEN = "correct-horse-battery"  # noqa: S105 - of the tests alone


def looked(
    act: Callable[[PageServer, ClientSession], Awaitable[None]],
    *,
    host: str = "127.0.0.1",
    token: str = "",
    live: bool = False,
) -> None:
    """Run a test against a served page; whatever it did, another browser can look afterwards."""

    async def run() -> None:
        async with serving(show_of(demo_pictures(), live=live), host, token) as server, ClientSession() as session:
            await act(server, session)
            async with session.ws_connect(where(server, "live", token)) as socket:
                assert (await said(socket))["type"] == "setup"

    asyncio.run(run())


def where(server: PageServer, path: str, token: str = "") -> str:
    return f"http://127.0.0.1:{server.port}/{path}" + (f"?token={token}" if token else "")


async def said(socket: ClientWebSocketResponse) -> dict[str, Any]:
    """Return the next message of a server."""
    found: dict[str, Any] = json.loads((await socket.receive(20.0)).data)
    return found


async def pictures(socket: ClientWebSocketResponse) -> dict[str, Any]:
    """Return the next pictures; confirm what comes."""
    while True:
        message = await said(socket)
        if "n" in message:
            await socket.send_json({"do": "shown", "n": message["n"]})
        if message["type"] == "pictures":
            return message


async def until(holds: Callable[[], bool]) -> None:
    """Wait until something holds."""
    async with asyncio.timeout(20):
        while not holds():
            await asyncio.sleep(0.01)


def test_every_file_comes_with_a_policy_that_lets_nothing_else_in() -> None:
    async def act(server: PageServer, session: ClientSession) -> None:
        for path, (_, kind) in FILES.items():
            async with session.get(where(server, path[1:])) as answer:
                assert (answer.status, answer.content_type) == (200, kind)
                assert "default-src 'none'" in answer.headers["Content-Security-Policy"]
                assert "unsafe" not in answer.headers["Content-Security-Policy"]
                assert answer.headers["X-Content-Type-Options"] == "nosniff"
                assert len(await answer.read()) > 100

    looked(act)


def test_pictures_come_and_follow_what_is_asked() -> None:
    async def act(server: PageServer, session: ClientSession) -> None:
        async with session.ws_connect(where(server, "live")) as socket:
            setup = await said(socket)
            assert setup["sensors"][0]["name"] == "front"
            first = await pictures(socket)
            assert first["afresh"]
            assert first["state"]["playing"]
            times = [picture.time for picture in demo_pictures()]
            await socket.send_json({"do": "pause"})
            await socket.send_json({"do": "seek", "t": times[-1]})
            while (message := await pictures(socket))["at"] < times[-1] - 1e-3:
                pass
            assert message["pictures"][-1]["t"] == pytest.approx(times[-1], abs=1e-4)
            assert len(message["pictures"]) == len(times)
            await socket.send_json({"do": "step", "by": -1})
            assert (await pictures(socket))["pictures"][-1]["t"] == pytest.approx(times[-2], abs=1e-4)
            await socket.send_json({"do": "speed", "value": 4})
            await socket.send_json({"do": "play"})
            while (message := await pictures(socket))["at"] < times[-1] - 1e-3:
                pass
            assert message["state"]["speed"] == 4

    looked(act)


@pytest.mark.parametrize(
    "path",
    [
        "../../etc/passwd",
        "%2e%2e/%2e%2e/etc/passwd",
        "static/../../page_server.py",
        "..%2f..%2fetc%2fpasswd",
        "uplot/",
        "index.html",
        "LICENSE",
        "uplot/..%00",
        "//etc/passwd",
    ],
)
def test_no_other_file_can_be_had(path: str) -> None:
    async def act(server: PageServer, session: ClientSession) -> None:
        reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
        writer.write(f"GET /{path} HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\n\r\n".encode())
        answer = await reader.read()
        assert answer.split()[1] in {b"404", b"400"}
        assert b"root:" not in answer
        writer.close()

    looked(act)


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "HEAD", "OPTIONS"])
def test_only_get_is_answered(method: str) -> None:
    async def act(server: PageServer, session: ClientSession) -> None:
        async with session.request(method, where(server, "")) as answer:
            assert answer.status == 405

    looked(act)


@pytest.mark.parametrize(
    "host", ["evil.example:{port}", "127.0.0.1:1", "evil.example", "", "[::1", "localhost.evil:{port}"]
)
def test_a_name_that_was_rebound_is_refused(host: str) -> None:
    async def act(server: PageServer, session: ClientSession) -> None:
        for path in ("", "live", "main.js"):
            headers = {"Host": host.format(port=server.port)}
            async with session.get(where(server, path), headers=headers) as answer:
                assert answer.status in {400, 421}

    looked(act)


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "https://127.0.0.1:{port}", "http://127.0.0.1:1", "http://[", "file://"]
)
def test_a_page_of_another_origin_may_not_look(origin: str) -> None:
    async def act(server: PageServer, session: ClientSession) -> None:
        with pytest.raises(WSServerHandshakeError) as refusal:
            await session.ws_connect(where(server, "live"), origin=origin.format(port=server.port))
        assert refusal.value.status == 403
        own = f"http://127.0.0.1:{server.port}"
        async with session.ws_connect(where(server, "live"), origin=own) as socket:
            assert (await said(socket))["type"] == "setup"

    looked(act)


@pytest.mark.parametrize("token", ["", "wrong", TOKEN[:-1], TOKEN + "x", "%ff%fe", "ü" * 20])
def test_without_the_token_nothing_is_shown(token: str) -> None:
    async def act(server: PageServer, session: ClientSession) -> None:
        async with session.get(where(server, "", token)) as answer:
            assert answer.status == 403
        with pytest.raises(WSServerHandshakeError) as refusal:
            await session.ws_connect(where(server, "live", token))
        assert refusal.value.status == 403
        assert server.counts.refused == 2
        async with session.get(where(server, "", TOKEN)) as answer:
            assert answer.status == 200

    looked(act, host="0.0.0.0", token=TOKEN)  # noqa: S104 - that is what is tested


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[" * 1000,
        "null",
        '{"do": "shown", "n": 99}',
        '{"do": "shown", "n": -1}',
        '{"do": "seek", "t": NaN}',
        '{"do": "seek", "t": 1e999}',
        '{"do": "seek", "t": "now"}',
        '{"do": "seek", "t": ' + "9" * 900 + "}",
        '{"do": "speed", "value": -Infinity}',
        '{"do": "step", "by": 1e3}',
        '{"do": "run"}',
    ],
)
def test_what_no_page_says_ends_the_conversation(text: str) -> None:
    async def act(server: PageServer, session: ClientSession) -> None:
        async with session.ws_connect(where(server, "live")) as socket:
            await socket.send_str(text)
            while (message := await socket.receive(20.0)).type is WSMsgType.TEXT:
                pass
            assert message.type is WSMsgType.CLOSE
            assert message.data == 1008
        await until(lambda: server.counts.misused == 1 and not server.viewers)

    looked(act)


@pytest.mark.parametrize("beyond", [0, 1])
def test_a_message_has_a_longest(beyond: int) -> None:
    async def act(server: PageServer, session: ClientSession) -> None:
        async with session.ws_connect(where(server, "live")) as socket:
            text = '{"do": "pause"}'
            await socket.send_str(text + " " * (viewer.LONGEST_COMMAND - len(text) + beyond))
            if beyond:
                while (message := await socket.receive(20.0)).type is WSMsgType.TEXT:
                    pass
                assert message.data == 1009
            else:
                while (await said(socket)).get("state", {}).get("playing", True):
                    pass

    looked(act)


@pytest.mark.parametrize("beyond", [0, 1])
def test_a_browser_sends_so_many_messages_a_second(beyond: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(viewer.Viewer, "_limit", frozen(viewer.Viewer._limit))

    async def act(server: PageServer, session: ClientSession) -> None:
        async with session.ws_connect(where(server, "live")) as socket:
            for _ in range(viewer.MOST_COMMANDS - 1 + beyond):
                await socket.send_json({"do": "pause"})
            await socket.send_json({"do": "speed", "value": 3})
            seen = []
            while (message := await socket.receive(20.0)).type is WSMsgType.TEXT:
                seen.append(json.loads(message.data))
                if seen[-1].get("state", {}).get("speed") == 3:
                    break
            assert (message.type is WSMsgType.CLOSE) == bool(beyond)

    looked(act)


def frozen(limit: Callable[[viewer.Viewer], None]) -> Callable[[viewer.Viewer], None]:
    """Return the count of messages with a clock that stands."""

    def count(self: viewer.Viewer) -> None:
        clock = self._clock
        self._clock = lambda: 1.5
        try:
            limit(self)
        finally:
            self._clock = clock

    return count


def test_binary_messages_end_the_conversation() -> None:
    async def act(server: PageServer, session: ClientSession) -> None:
        async with session.ws_connect(where(server, "live")) as socket:
            await socket.send_bytes(b"\x00\xff")
            while (message := await socket.receive(20.0)).type is WSMsgType.TEXT:
                pass
            assert message.data == 1008

    looked(act)


def test_a_browser_that_confirms_nothing_gets_no_more_and_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(viewer, "CONFIRM_S", 0.3)

    async def act(server: PageServer, session: ClientSession) -> None:
        async with session.ws_connect(where(server, "live")) as socket:
            got = 0
            while (message := await socket.receive(20.0)).type is WSMsgType.TEXT:
                got += "n" in json.loads(message.data)
            assert got == viewer.MOST_UNCONFIRMED
        assert server.counts.unread == 1
        assert server.viewers == 0

    looked(act)


def test_a_browser_that_confirms_late_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(viewer, "CONFIRM_S", 30.0)

    async def act(server: PageServer, session: ClientSession) -> None:
        async with session.ws_connect(where(server, "live")) as socket:
            assert (await said(socket))["type"] == "setup"
            numbers = [(await said(socket))["n"] for _ in range(viewer.MOST_UNCONFIRMED)]
            await socket.send_json({"do": "shown", "n": numbers[-1]})
            assert (await said(socket))["n"] == numbers[-1] + 1
        assert server.counts.unread == 0

    looked(act)


@pytest.mark.parametrize("beyond", [0, 1])
def test_so_many_browsers_look_and_no_more(beyond: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page_server, "MOST_VIEWERS", 3)

    async def act(server: PageServer, session: ClientSession) -> None:
        sockets = [await session.ws_connect(where(server, "live")) for _ in range(3)]
        if beyond:
            with pytest.raises(WSServerHandshakeError) as refusal:
                await session.ws_connect(where(server, "live"))
            assert refusal.value.status == 503
        assert server.counts.crowded == beyond
        assert server.viewers == 3
        for socket in sockets:
            assert (await said(socket))["type"] == "setup"
            await socket.close()
        await until(lambda: server.viewers == 0)

    looked(act)


@pytest.mark.parametrize("beyond", [0, 1])
def test_so_many_connections_are_held_and_no_more(beyond: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection_guard, "MOST_CONNECTIONS", 5)

    async def act(server: PageServer, session: ClientSession) -> None:
        opened = [await asyncio.open_connection("127.0.0.1", server.port) for _ in range(4 + beyond)]
        await until(lambda: len(server._guards) == 4 + beyond)
        reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
        writer.write(f"GET /main.js HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\n\r\n".encode())
        try:
            answer = await reader.read()
        except ConnectionResetError:
            answer = b""
        assert answer.startswith(b"HTTP/1.1 200") == (not beyond)
        assert server.counts.crowded == beyond
        for _, each in (*opened, (reader, writer)):
            each.close()
        await until(lambda: not server._guards)

    looked(act)


@pytest.mark.parametrize("asked", [b"", b"GET / HTTP/1.1\r\nHost: 127", b"\x16\x03\x01\x02\x00\x01\x00"])
def test_a_connection_that_asks_for_nothing_is_hung_up_on(asked: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection_guard, "ASK_S", 0.2)

    async def act(server: PageServer, session: ClientSession) -> None:
        reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
        writer.write(asked)
        try:
            answer = await asyncio.wait_for(reader.read(), 20)
        except ConnectionResetError:
            answer = b""
        assert b"200 OK" not in answer
        writer.close()
        await until(lambda: not server._guards)
        monkeypatch.undo()

    looked(act)


def test_an_answer_that_is_not_read_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection_guard, "ANSWER_S", 0.2)
    monkeypatch.setitem(FILES, "/icon.svg", ("uplot/uPlot.iife.min.js", "text/javascript"))

    async def act(server: PageServer, session: ClientSession) -> None:
        server._files["/icon.svg"] = (bytes(64 << 20), "image/svg+xml")
        _, writer = await asyncio.open_connection("127.0.0.1", server.port, limit=1 << 10)
        writer.write(f"GET /icon.svg HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\n\r\n".encode())
        await until(lambda: server.counts.stalled == 1)
        writer.close()
        monkeypatch.undo()

    looked(act)


@pytest.mark.parametrize("beyond", [0, 1])
def test_a_line_of_a_request_has_a_longest(beyond: int) -> None:
    async def act(server: PageServer, session: ClientSession) -> None:
        reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
        # the parser counts the target of the first line, and the value of a header
        value = "x" * (page_server.LONGEST_LINE - len("X-Long") + (2 * len("X-Long") if beyond else -len("X-Long")))
        head = f"GET /main.js HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\nX-Long: {value}\r\n\r\n"
        writer.write(head.encode())
        answer = await reader.read()
        assert answer.startswith(b"HTTP/1.1 200" if not beyond else b"HTTP/1.")
        assert (b" 400 " in answer.splitlines()[0]) == bool(beyond)
        writer.close()

    looked(act)


def test_an_address_that_cannot_be_had_is_said() -> None:
    async def run() -> None:
        async with serving(show_of(demo_pictures())) as server:
            with pytest.raises(CandaemonError, match="cannot serve the page at"):
                await PageServer(show_of(demo_pictures()), PageAddress("127.0.0.1", server.port)).__aenter__()

    asyncio.run(run())


@pytest.mark.parametrize(
    ("host", "alone"),
    [
        ("127.0.0.1", True),
        ("127.8.8.8", True),
        ("::1", True),
        ("localhost", True),
        ("0.0.0.0", False),  # noqa: S104 - compared
        ("10.0.0.1", False),
        ("car", False),
    ],
)
def test_loopback_is_this_machine_alone(host: str, alone: bool) -> None:
    assert is_loopback(host) == alone
