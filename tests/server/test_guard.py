"""What may reach the server: foreign pages, strange messages and unfit values change nothing."""

from __future__ import annotations

import contextlib
import http.client
import itertools
import logging
import math
import socket
import struct
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import msgspec
import pytest
import viser
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from raw_client import CAMERA, RawClient, wait_until
from websockets.asyncio.server import serve
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from hebbviz.server.web import admission, guard
from hebbviz.server.web.access import Access, Role
from hebbviz.server.web.guard import open_server
from hebbviz.server.web.listening import CannotListen, PortTaken


@dataclass
class Site:
    """A guarded server, what it refused, and what its callbacks were told."""

    server: guard.GuardedServer
    refusals: list[str]
    port: int
    fence: Any
    events: list[tuple[str, Any]] = field(default_factory=list)
    _count: Iterator[int] = field(default_factory=lambda: itertools.count(1))

    def slider(self, **changes: Any) -> Any:
        """A new slider from 0 to 1 that stands at 0.5 and notes what it is told."""
        options = {"min": 0.0, "max": 1.0, "step": 0.01, "initial_value": 0.5} | changes
        return self.noted(self.server.gui.add_slider(f"slider {next(self._count)}", **options))

    def noted(self, widget: Any) -> Any:
        widget.on_update(lambda _: self.events.append((widget.label, widget.value)))
        return widget

    def settle(self, client: RawClient) -> None:
        """Wait until the server has dealt with everything that `client` sent so far."""
        target = self.fence.value + 1
        client.send_value("fence", target)
        wait_until(lambda: self.fence.value == target)

    def told(self, widget: Any) -> list[Any]:
        return [value for label, value in self.events if label == widget.label]


@contextlib.contextmanager
def opened(access: Access = Access()) -> Iterator[Site]:  # noqa: B008
    refusals: list[str] = []
    server = open_server(port=0, access=access, on_refusal=refusals.append)
    fence = server.gui.add_number("fence", 0)
    try:
        yield Site(server, refusals, server.get_port(), fence)
    finally:
        server.stop()


@pytest.fixture(scope="module")
def site() -> Iterator[Site]:
    with opened() as site:
        yield site


@pytest.fixture
def client(site: Site) -> Iterator[RawClient]:
    with RawClient(site.port) as client:
        client.find("fence")
        yield client


@pytest.fixture(autouse=True)
def no_traceback(caplog: pytest.LogCaptureFixture) -> Iterator[None]:
    """Whatever clients do, the server logs no error."""
    yield
    told = caplog.get_records("setup") + caplog.get_records("call")
    assert [record for record in told if record.levelno >= logging.ERROR] == []


# Addresses and ports.


def test_a_port_that_was_asked_for_and_is_taken_raises(site: Site) -> None:
    with pytest.raises(PortTaken, match=rf"^can't listen on 127.0.0.1:{site.port}: .* taken; stop"):
        open_server(port=site.port, on_refusal=print)


def test_the_next_port_is_taken_when_the_usual_one_is(site: Site) -> None:
    server = open_server(default_port=site.port, on_refusal=print)
    try:
        assert site.port < server.get_port() < site.port + 100
        with RawClient(server.get_port()) as client:
            client.wait(lambda: client.frames > 0)
    finally:
        server.stop()


def test_ports_and_hosts_are_checked() -> None:
    with pytest.raises(ValueError, match="port must be between 1 and 65535, got 65536"):
        open_server(port=65536, on_refusal=print)
    with pytest.raises(ValueError, match="default_port must be between 1 and 65535, got 0"):
        open_server(default_port=0, on_refusal=print)
    with pytest.raises(CannotListen, match=r"listen on no\.such\.host\.invalid:0"):
        open_server("no.such.host.invalid", 0, on_refusal=print)


def test_viser_is_left_as_it_was_and_prints_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    import websockets
    from viser.infra import _infra

    server = open_server(port=0, on_refusal=print)
    assert vars(_infra)["websockets"] is websockets
    assert server.get_host() == "127.0.0.1"
    server.stop()
    assert capfd.readouterr() == ("", "")


def test_a_stopped_server_frees_its_port() -> None:
    server = open_server(port=0, on_refusal=print)
    port = server.get_port()
    server.stop()
    open_server(port=port, on_refusal=print).stop()


OPENING = (
    "GET / HTTP/1.1\r\nHost: 127.0.0.1:{}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
    "Sec-WebSocket-Key: MDEyMzQ1Njc4OTAxMjM0NQ==\r\nSec-WebSocket-Version: 13\r\n"
    "Sec-WebSocket-Protocol: viser-v{}\r\n\r\n"
)
"""How a tab opens its connection."""


def test_a_stopped_server_waits_for_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever is connected is cut off: a browser opens connections in advance, on which it says
    nothing, and a tab may stall.
    """
    patience = serve.__init__.__kwdefaults__
    for name in ("open_timeout", "close_timeout"):
        monkeypatch.setitem(patience, name, 600.0)
    with opened() as site:
        where = "127.0.0.1", site.port
        with socket.create_connection(where), socket.create_connection(where) as stalled:
            stalled.settimeout(10.0)
            stalled.sendall(OPENING.format(site.port, viser.__version__).encode())
            assert stalled.recv(4096).startswith(b"HTTP/1.1 101 ")
            wait_until(lambda: len(site.server.gate.crowd) == 2)
            site.server.stop()
            serving = site.server._websock_server._server_thread
            serving.join(60.0)
            assert not serving.is_alive()


# Requests: test_entrance.py has all the cases, here they are put to a server.


def fetch(
    port: int, path: str = "/", method: str = "GET", **headers: str
) -> tuple[int, str, http.client.HTTPMessage]:
    with contextlib.closing(http.client.HTTPConnection("127.0.0.1", port, timeout=5)) as connection:
        connection.putrequest(method, path, skip_host=True)
        for name, value in ({"Host": f"127.0.0.1:{port}"} | headers).items():
            connection.putheader(name, value)
        connection.endheaders()
        response = connection.getresponse()
        return response.status, response.read().decode(errors="replace"), response.headers


@pytest.mark.parametrize("name", ["localhost:PORT", "LocalHost.:9000", "[::1]:9000", "127.0.0.1"])
def test_own_names_get_the_page_and_connect(site: Site, name: str) -> None:
    own = name.replace("PORT", str(site.port))
    assert fetch(site.port, Host=own)[0] == 200
    assert fetch(site.port, "/?darkMode&initialCameraFov=1", Host=own)[0] == 200
    for origin in (f"http://{own}", f"https://{own}", None):
        with RawClient(site.port, name=own, origin=origin) as client:
            site.settle(client)


@pytest.mark.parametrize("host", ["evil.example:PORT", "10.0.0.1:PORT", "localhost.evil.example"])
def test_foreign_hosts_are_refused(site: Site, host: str) -> None:
    """A site that has its own name lead to us: DNS rebinding."""
    host = host.replace("PORT", str(site.port))
    status, body, _ = fetch(site.port, Host=host, Origin=f"http://{host}")
    assert status == 403
    assert body.startswith("refused a request: it is addressed to") and body.count("\n") == 1
    with pytest.raises(InvalidStatus, match="403"):
        RawClient(site.port, name=host, origin=f"http://{host}")
    assert any("addressed to" in line for line in site.refusals)


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:1"])
def test_foreign_origins_are_refused(site: Site, origin: str) -> None:
    assert fetch(site.port, Origin=origin)[0] == 403
    with pytest.raises(InvalidStatus, match="403"):
        RawClient(site.port, origin=origin)
    assert any("comes from" in line for line in site.refusals)


def test_links_that_show_another_server_are_refused(site: Site) -> None:
    status, body, _ = fetch(site.port, "/?websocket=ws://evil.example")
    assert (status, "another server" in body) == (403, True)


def test_two_hosts_are_refused(site: Site) -> None:
    own = f"Host: 127.0.0.1:{site.port}\r\n"
    for hosts, status in ((own, b"200"), (own + own, b"403"), ("", b"403")):
        with socket.create_connection(("127.0.0.1", site.port), timeout=5) as asked:
            asked.sendall(f"GET / HTTP/1.1\r\n{hosts}\r\n".encode())
            assert asked.recv(12) == b"HTTP/1.1 " + status


@pytest.mark.parametrize("method", ["HEAD", "POST", "PUT", "DELETE", "OPTIONS", "CONNECT", "TRACE"])
def test_the_page_can_only_be_got(site: Site, method: str) -> None:
    with pytest.raises(http.client.RemoteDisconnected):
        fetch(site.port, method=method)
    assert fetch(site.port)[0] == 200


SAFE = {
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
UPGRADE = {"Connection": "Upgrade", "Upgrade": "websocket"}


@pytest.mark.parametrize(
    ("status", "path", "more"),
    [
        (200, "/", {}),
        (404, "/nothing", {}),
        (404, "/../x", {}),
        (403, "/", {"Host": "evil.example"}),
        (403, "/", {"Origin": "null"}),
        (403, "/?websocket=x", {}),
        (400, "/", UPGRADE),
        (426, "/", {"Upgrade": "websocket"}),
    ],
)
def test_every_answer_has_the_headers(
    site: Site, status: int, path: str, more: dict[str, str]
) -> None:
    found, _, headers = fetch(site.port, path, **more)
    assert found == status
    assert {name: headers.get_all(name) for name in SAFE} == {n: [v] for n, v in SAFE.items()}
    rules = dict(rule.split(" ", 1) for rule in headers["Content-Security-Policy"].split("; "))
    assert rules == {
        "default-src": "'none'",
        "script-src": "'unsafe-inline' 'wasm-unsafe-eval'",
        "style-src": "'unsafe-inline'",
        "img-src": "'self' data: blob:",
        "worker-src": "blob:",
        "connect-src": "'self' data:",
        "base-uri": "'none'",
        "form-action": "'none'",
        "frame-ancestors": "'none'",
    }
    assert "Server" not in headers and "Access-Control-Allow-Origin" not in headers


def test_those_who_may_frame_are_named() -> None:
    with opened(Access(frame_from=("http://localhost:8888",))) as site:
        headers = fetch(site.port)[2]
        assert headers["Content-Security-Policy"].endswith("frame-ancestors http://localhost:8888")
        assert headers["X-Frame-Options"] is None


def test_a_proxy_s_name_passes_once_it_is_allowed() -> None:
    with opened(Access(("lab.example.org",), token=False)) as site:
        own = {"Host": "lab.example.org", "Origin": "https://lab.example.org"}
        assert fetch(site.port, **own)[0] == 200
        with RawClient(site.port, name=own["Host"], origin=own["Origin"]) as client:
            client.find("fence")
        assert fetch(site.port, **own | {"Host": "evil.example"})[0] == 403


def test_a_refused_request_is_told_once_of_each_kind_with_the_remedy() -> None:
    told: list[str] = []
    refusals: list[str] = []
    server = open_server(port=0, on_refusal=refusals.append, on_turned_away=told.append)
    try:
        for _ in range(3):
            fetch(server.get_port(), Host="box.lan:9000")
            fetch(server.get_port(), Origin="null")
    finally:
        server.stop()
    assert len(told) == 2 and refusals == []
    assert told[0].endswith("--allow-host box.lan:9000")


# Tokens.


def path_of(site: Site, role: Role) -> str:
    return site.server.entrance.link("", role)


def test_without_the_token_there_is_neither_page_nor_connection() -> None:
    with opened(Access(token=True)) as site:
        status, body, headers = fetch(site.port)
        assert status == 403 and "open the link that was printed" in body
        assert "<html" not in body and headers["Set-Cookie"] is None
        assert fetch(site.port, "/?token=wrong")[0] == 403
        for path in ("/", "/?token=wrong"):
            with pytest.raises(InvalidStatus, match="403"):
                RawClient(site.port, path=path)
        with RawClient(site.port, path=path_of(site, Role.OWNER)) as client:
            site.settle(client)


def test_the_link_answers_with_the_page_and_its_cookie_connects() -> None:
    with opened(Access(token=True)) as site:
        status, body, headers = fetch(site.port, path_of(site, Role.OWNER))
        assert status == 200 and "<html" in body  # a redirect would lose a strict cookie
        cookie = headers["Set-Cookie"].split(";")[0]
        assert fetch(site.port, Cookie=cookie)[0] == 200
        with RawClient(site.port, cookie=cookie) as client:
            site.settle(client)
        with pytest.raises(InvalidStatus, match="403"):  # a page on another port has it, too
            RawClient(site.port, cookie=cookie, origin="http://127.0.0.1:1")


def test_tokens_are_in_no_log(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.DEBUG)
    with opened(Access(token=True)) as site:
        link = path_of(site, Role.OWNER)
        cookie = fetch(site.port, link)[2]["Set-Cookie"].split(";")[0]
        fetch(site.port, link + "&websocket=x")
        fetch(site.port, link, Host="evil.example")
        with RawClient(site.port, path=link, cookie=cookie) as client:
            site.settle(client)
        token = link.partition("=")[2]
        ours = [r.getMessage() for r in caplog.records if r.name == "hebbviz.websockets"]
        assert ours
        assert not [line for line in (*site.refusals, *ours) if token in line]


# Values.


def assert_refused(site: Site, client: RawClient, widget: Any, send: Any) -> str:
    """`send` changes nothing about the widget, and is reported."""
    client.find(widget.label)
    before, value, reported = vars(widget._impl.props).copy(), widget.value, len(site.refusals)
    send(widget.label)
    site.settle(client)
    assert vars(widget._impl.props) == before
    assert widget.value == value and type(widget.value) is type(value)
    assert site.told(widget) == []
    assert len(site.refusals) == reported + 1
    return site.refusals[-1]


def assert_accepted(site: Site, client: RawClient, widget: Any, value: Any) -> None:
    client.send_value(widget.label, value)
    wait_until(lambda: widget.value == value and value in site.told(widget))


BAD = [math.nan, math.inf, -math.inf, 99, -5, 1.0001, "abc", "0.3", None, [], [0.3], {}, True, b"0"]


@pytest.mark.parametrize("value", BAD, ids=repr)
def test_a_slider_refuses(site: Site, client: RawClient, value: object) -> None:
    slider = site.slider()
    line = assert_refused(site, client, slider, lambda label: client.send_value(label, value))
    assert line == (f"{slider.label} must be between 0.0 and 1.0, got {repr(value)[:40]}")
    assert_accepted(site, client, slider, 0.123456789)  # off the grid of steps, but in range


def test_the_page_is_shown_the_true_value(site: Site, client: RawClient) -> None:
    slider = site.slider()
    page = client.find(slider.label)
    page.value = 99
    client.send_value(page, 99)
    client.wait(lambda: page.value == 0.5)


def test_a_flood_is_reported_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guard, "SETTLE_SECONDS", 30.0)  # however long the sending takes
    with opened() as site, RawClient(site.port) as client:
        slider = site.slider()
        page = client.find(slider.label)

        def flood(_: str) -> None:
            for n in range(50):
                client.send_value(page, 2.0 + n)

        assert_refused(site, client, slider, flood)


@pytest.mark.parametrize(
    "updates",
    [{name: 1} for name in ("min", "max", "step", "label", "visible", "disabled", "order")]
    + [{}, {"value": 0.4, "max": 9}, {"_impl": 1}, {"update_cb": []}, {"removed": True}],
    ids=repr,
)
def test_other_properties_are_refused(site: Site, client: RawClient, updates: Any) -> None:
    slider = site.slider()
    line = assert_refused(site, client, slider, lambda label: client.send_updates(label, updates))
    assert f"only the value of {slider.label} may be set" in line
    assert not slider._impl.removed


def widgets(gui: viser.GuiApi, name: str) -> dict[str, Any]:
    return {
        "number": lambda: gui.add_number(name, 3.0, min=0.0, max=9.0),
        "open number": lambda: gui.add_number(name, 3.0),
        "whole number": lambda: gui.add_number(name, 3, min=0),
        "checkbox": lambda: gui.add_checkbox(name, False),
        "text": lambda: gui.add_text(name, "hello"),
        "dropdown": lambda: gui.add_dropdown(name, ("a", "b")),
        "rgb": lambda: gui.add_rgb(name, (1, 2, 3)),
        "vector": lambda: gui.add_vector2(name, (0.0, 0.0)),
        "disabled": lambda: gui.add_number(name, 3.0, disabled=True),
    }


@pytest.mark.parametrize(
    ("kind", "good", "bad"),
    [
        ("number", 2.5, [-1, 10, math.nan, "3", True]),
        ("open number", -1e9, [math.nan, math.inf, None]),
        ("whole number", 7, [-1, 2.5, "7", True]),
        ("checkbox", True, [1, 0, "yes", None, [True]]),
        ("text", "x" * 10_000, ["x" * 10_001, 3, None, ["x"], b"x"]),
        ("dropdown", "b", ["c", "", None, 1, ["a"]]),
        ("rgb", (9, 0, 255), [[1, 2], [1, 2, 256], [1, 2, 3, 4], [1, 2, 0.5], [True, 0, 0], "abc"]),
        ("vector", None, [[1.0, 1.0]]),
        ("disabled", None, [4.0]),
    ],
)
def test_other_widgets(site: Site, client: RawClient, kind: str, good: Any, bad: list[Any]) -> None:
    for number, value in enumerate(bad):
        widget = site.noted(widgets(site.server.gui, f"{kind} {number}")[kind]())
        assert_refused(site, client, widget, lambda label, v=value: client.send_value(label, v))
    if good is not None:
        assert_accepted(site, client, widget, good)


def test_buttons(site: Site, client: RawClient) -> None:
    gui, pressed = site.server.gui, []
    button, group = gui.add_button("go"), gui.add_button_group("pace", ("slow", "fast"))
    button.on_click(lambda _: pressed.append("go"))
    group.on_click(lambda _: pressed.append(group.value))
    for value in (False, 1, None, "go"):
        client.send_value("go", value)
        client.send_value("pace", value)
    client.send_updates("go", {})
    site.settle(client)
    assert pressed == []
    client.press("go")
    client.send_value("pace", "fast")
    wait_until(lambda: sorted(pressed) == ["fast", "go"])
    button.disabled = True
    client.press("go")
    site.settle(client)
    assert len(pressed) == 2


messages = st.recursive(
    st.none() | st.booleans() | st.floats() | st.text() | st.binary()
    | st.integers(min_value=-(2**63), max_value=2**64 - 1),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=8,
)  # fmt: skip


@settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))
@given(value=messages)
def test_no_value_at_all_leaves_the_range(site: Site, client: RawClient, value: object) -> None:
    if not hasattr(site, "victim"):
        site.victim = site.slider()  # type: ignore[attr-defined]
    slider = site.victim  # type: ignore[attr-defined]
    client.send_value(slider.label, value)
    site.settle(client)
    assert type(slider.value) is float and 0.0 <= slider.value <= 1.0


# Messages.


def hostile_messages(uuid: str) -> list[dict[str, Any]]:
    upload = {"source_component_uuid": uuid, "transfer_uuid": "t", "filename": "../../x"}
    return [
        {"type": "GuiRemoveMessage", "uuid": uuid},
        {"type": "FileTransferStartUpload", "mime_type": "a", "part_count": 2, "size_bytes": 2**40}
        | upload,
        {"type": "FileTransferPart", "part_index": 0, "content": b"x" * 1000} | upload,
        {"type": "ShareUrlRequest"},
        {"type": "ShareUrlDisconnect"},
        {"type": "RunJavascriptMessage", "source": "alert(1)"},
        {"type": "SceneNodeUpdateMessage", "name": "/a", "updates": {"visible": False}},
        {"type": "RemoveSceneNodeMessage", "name": "/WorldAxes"},
        {"type": "GetRenderResponseMessage", "payload": b"x", "render_uuid": "r"},
        {"type": "ThemeConfigurationMessage"},
        {"type": "GuiUpdateMessage", "uuid": uuid, "updates": [1]},
        {"type": "GuiFormDirtyMessage", "uuid": uuid},
        {"type": "GuiFormDirtyMessage", "uuid": "root"},
        {"type": "GuiButtonHoldMessage", "uuid": uuid, "frequency": 1.0},
        CAMERA | {"position": [math.nan, 0, 0]},
        CAMERA | {"wxyz": [1, 0]},
        CAMERA | {"image_height": -1},
        {"type": "ViewerCameraMessage"},
        {"type": "SceneNodeClickMessage", "name": "/a", "instance_index": "x"},
        {"type": "NoSuchMessage"},
        {"type": 5},
        {},
    ]


def test_foreign_messages_change_nothing(
    site: Site, client: RawClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[object] = []
    for name in ("request_share_url", "disconnect_share_url"):
        monkeypatch.setattr(site.server, name, lambda: calls.append("share"))
    slider = site.slider()
    uuid = client.find(slider.label).uuid
    buffer = site.server._websock_server.get_message_buffer()
    wait_until(lambda: not site.server.gate._unsettled)  # true values are still to be shown
    kept, camera = len(buffer.message_from_id), site.server.get_clients()
    for message in hostile_messages(uuid):
        client.send(message)
    site.settle(client)
    assert calls == [] and site.told(slider) == [] and slider.value == 0.5
    assert not slider._impl.removed and site.server.gui._current_file_upload_states == {}
    assert len(buffer.message_from_id) <= kept + 1  # the fence's value
    assert all(math.isfinite(c.camera.position[0]) for c in camera.values())
    for kind in ("GuiRemoveMessage", "FileTransferStartUpload", "ShareUrlRequest", "garbled"):
        assert sum(kind in line for line in site.refusals) == 1  # however often it came
    assert_accepted(site, client, slider, 0.25)


@pytest.mark.parametrize(
    "frame",
    [b"", b"\xc1", b"\xff" * 99, b"\xdd\xff\xff\xff\xff", b"\x91" * 200_000, b"\x81", "text", "{}"]
    + [
        b"\x81\xa4type\xa3\xff\xfe\xfd",
        struct.pack(">BI", 0xDF, 2**32 - 1),
        b"\x81\x81\x01\x01\x01",
    ],
    ids=lambda frame: repr(frame)[:20],
)
def test_garbage_changes_nothing(site: Site, client: RawClient, frame: bytes | str) -> None:
    client.send_bytes(frame)
    site.settle(client)
    assert any("garbled" in line for line in site.refusals)


@settings(max_examples=100, deadline=None, suppress_health_check=list(HealthCheck))
@given(frame=st.binary(max_size=60) | messages.map(msgspec.msgpack.encode))
def test_random_frames_are_refused(frame: bytes) -> None:
    with pytest.raises(admission.Refused) as refused:
        admission.decode(frame)
    assert "\n" not in refused.value.line and len(refused.value.line) < 200


def test_a_doubled_key_is_not_read_in_two_ways(site: Site, client: RawClient) -> None:
    slider = site.slider()
    uuid = client.find(slider.label).uuid
    pack = msgspec.msgpack.encode
    for first, last in ((99, 0.7), (0.7, 99)):
        updates = b"\x82" + pack("value") + pack(first) + pack("value") + pack(last)
        kind = pack("type") + pack("GuiUpdateMessage")
        client.send_bytes(b"\x83" + kind + pack("uuid") + pack(uuid) + pack("updates") + updates)
        site.settle(client)
        assert slider.value in (0.5, 0.7)


def test_fields_that_are_not_known_are_dropped(site: Site, client: RawClient) -> None:
    client.send(CAMERA | {"position": [7, 7, 7], "extra": [1]})
    clients = site.server.get_clients
    wait_until(lambda: any(one.camera.position[0] == 7 for one in clients().values()))


def test_an_oversized_message_ends_the_connection_only(site: Site, client: RawClient) -> None:
    with RawClient(site.port) as big:
        page = big.find("fence")
        with contextlib.suppress(ConnectionClosed):  # which may come amid the sending
            big.send_updates(page, {"value": "x" * guard.MAX_MESSAGE_BYTES})
        big.wait(lambda: big.closed)
    wait_until(lambda: any("over 1048576 bytes" in line for line in site.refusals))
    site.settle(client)


def test_a_page_of_another_version_is_turned_away(
    site: Site, client: RawClient, capfd: pytest.CaptureFixture[str]
) -> None:
    protocol = Subprotocol("viser-v0.0.1")
    with connect(f"ws://127.0.0.1:{site.port}", subprotocols=[protocol], proxy=None) as old:
        with pytest.raises(ConnectionClosed, match="reload"):
            old.recv(timeout=5)
        assert old.close_code == 1002  # viser's page tells its user about this code
    site.settle(client)
    assert capfd.readouterr() == ("", "")


def test_commands_forms_holds_and_clicks_pass(site: Site, client: RawClient) -> None:
    server, told = site.server, []
    command = server.gui.add_command("reset", hotkey="R")
    command.on_trigger(lambda _: told.append("command"))
    with server.gui.add_form("form") as form:
        server.gui.add_number("inside", 1)
    form.on_submit(lambda _: told.append("form"))
    button = server.gui.add_button("hold")
    button.on_hold(lambda _: told.append("hold"), callback_hz=10.0)
    box = server.scene.add_icosphere("/ball")
    box.on_click(lambda _: told.append("click"))

    client.trigger("reset")
    client.send({"type": "GuiFormDirtyMessage", "uuid": client.find("form").uuid})
    client.send({"type": "GuiFormSubmitMessage", "uuid": client.find("form").uuid})
    held = client.find("hold").uuid
    client.send({"type": "GuiButtonHoldMessage", "uuid": held, "frequency": 10})
    click = {"ray_origin": [0, 0, 0], "ray_direction": [0, 0, 1.0], "screen_pos": [0.5, 0.5]}
    rest = {"name": "/ball", "instance_index": None, "modifier": None, "owner": ""}
    client.send({"type": "SceneNodeClickMessage"} | click | rest)
    wait_until(lambda: sorted(told) == ["click", "command", "form", "hold"])


def test_a_page_that_connects_while_the_server_starts_waits(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """viser listens before it is complete; no message may meet the half of it."""
    spare = open_server(port=0, on_refusal=print)
    port = spare.get_port()
    spare.stop()
    clients: list[RawClient] = []

    class SlowServer(guard.GuardedServer):
        def __init__(self, **options: Any) -> None:
            super().__init__(**options)
            time.sleep(0.3)  # it answers already

    def hurry() -> None:
        while not clients:
            with contextlib.suppress(OSError):
                clients.append(RawClient(port))
        clients[0].send({"type": "CommandTriggerMessage", "uuid": "none"})

    monkeypatch.setattr(guard, "GuardedServer", SlowServer)
    thread = threading.Thread(target=hurry, daemon=True)
    thread.start()
    server = open_server(port=port, on_refusal=print)
    try:
        box = server.gui.add_checkbox("box", False)
        thread.join(10)
        clients[0].send_value("box", True)
        wait_until(lambda: box.value)
        clients[0].close()
    finally:
        server.stop()
