"""Who may come in: names, pages, tokens and cookies, as pure checks of a request's headers."""

from __future__ import annotations

import re
import socket

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hebbviz.server.web import host_names
from hebbviz.server.web.access import Access, Entrance, Passage, Role, headers
from hebbviz.server.web.host_names import Authority
from hebbviz.server.web.refusal import Refused

LOOPBACK_NAMES = ["localhost", "LocalHost", "localhost.", "127.0.0.1", "127.3.2.1", "[::1]"]


def ask(entrance: Entrance, path: str = "/", **headers: str | list[str]) -> Passage:
    """What becomes of a request to localhost:8080; underscores in names stand for hyphens."""
    given = {"Host": "localhost:8080"} | {k.replace("_", "-"): v for k, v in headers.items()}
    values = {k: [v] if isinstance(v, str) else v for k, v in given.items()}
    return entrance.check(path, lambda name: values.get(name, []))


def refusal(entrance: Entrance, path: str = "/", **headers: str | list[str]) -> Refused:
    with pytest.raises(Refused) as refused:
        ask(entrance, path, **headers)
    assert "\n" not in refused.value.line and len(refused.value.line) < 300
    return refused.value


# Names.


@pytest.mark.parametrize("port", ["", ":80", ":9000", ":8080"])
@pytest.mark.parametrize("name", LOOPBACK_NAMES)
def test_names_of_this_machine_pass_with_any_port(name: str, port: str) -> None:
    """It may be forwarded: `ssh -L 9000:localhost:8080`, `docker -p 9000:8080`."""
    own = f"{name}{port}"
    for host in ("127.0.0.1", "::1", "0.0.0.0"):
        entrance = Entrance(host, Access(token=False))
        assert ask(entrance, Host=own).role is Role.OWNER
        assert ask(entrance, Host=own, Origin=f"http://{own}").role is Role.OWNER
        assert ask(entrance, Host=own, Origin=f"HTTPS://{own.upper()}").role is Role.OWNER


@pytest.mark.parametrize(
    "host",
    ["evil.example", "evil.example:8080", "localhost.evil.example:8080", "127.0.0.1.evil.example"]
    + ["10.0.0.1:8080", "[fe80::1]:8080", "0.0.0.0:8080", "localhost..", "mylocalhost", "notlocal"]
    + ["", ":8080", "localhost:", "localhost:0", "localhost:99999", "localhost:80:80", "::1"]
    + ["[::1", "[localhost]:8080", "[1.2.3.4]", "localhost@evil.example", "localhost/", "a b"]
    + ["localhost,evil.example", "l\u00f6calhost", "localhost:٨٠", "127.0.0.1\t", "\udcff"],
)  # fmt: skip
def test_other_names_do_not(host: str) -> None:
    assert refusal(Entrance("127.0.0.1"), Host=host).kind == "host"


@pytest.mark.parametrize("hosts", [[], ["localhost", "localhost"], ["localhost", "evil.example"]])
def test_a_request_has_one_host(hosts: list[str]) -> None:
    assert refusal(Entrance("127.0.0.1"), Host=hosts).kind == "host"


@given(st.text(max_size=30))
def test_no_text_at_all_is_read_in_two_ways(text: str) -> None:
    found = host_names.parse(text)
    assert found is None or host_names.parse(str(found)) == found


@pytest.mark.parametrize(
    ("written", "bound", "own"),
    [
        ("192.168.0.7:8080", "0.0.0.0", True),
        ("192.168.0.7:9000", "0.0.0.0", True),
        ("[fe80::1]:8080", "::", True),
        ("0.0.0.0:8080", "0.0.0.0", True),
        (f"{socket.gethostname()}:8080", "0.0.0.0", True),
        (f"{socket.gethostname()}.:8080", "::", True),
        (f"{socket.gethostname()}:8080", "127.0.0.1", False),
        ("evil.example:8080", "0.0.0.0", False),
        ("192.168.0.7:8080", "192.168.0.7", True),
        ("192.168.0.8:8080", "192.168.0.7", False),
        ("[2001:DB8:0::7]", "2001:db8::7", True),
        ("lab.example.org.", "Lab.example.org", True),
    ],
)
def test_which_names_are_own(written: str, bound: str, own: bool) -> None:
    found = host_names.parse(written)
    assert found is not None
    assert Entrance(bound).is_own(found) is own


@pytest.mark.parametrize(
    ("allowed", "host", "passes"),
    [
        ("lab.example.org", "lab.example.org", True),
        ("lab.example.org", "LAB.example.org.:8443", True),
        ("lab.example.org:8443", "lab.example.org:8443", True),
        ("lab.example.org:443", "lab.example.org", True),
        ("lab.example.org:8443", "lab.example.org", False),
        ("lab.example.org:8443", "lab.example.org:8080", False),
        ("lab.example.org", "example.org", False),
        ("lab.example.org", "evil.lab.example.org", False),
        ("192.168.0.7", "192.168.0.7:9000", True),
        ("[fe80::1]", "[fe80:0::1]:9000", True),
    ],
)
def test_allowed_names(allowed: str, host: str, passes: bool) -> None:
    entrance = Entrance("127.0.0.1", Access((allowed,), token=False))
    if passes:
        for scheme in ("http", "https"):
            assert ask(entrance, Host=host, Origin=f"{scheme}://{host}").role is Role.OWNER
    else:
        assert refusal(entrance, Host=host).kind == "host"
    assert ask(entrance, Host="localhost:1").role is Role.OWNER


@pytest.mark.parametrize("name", ["", "*", "*.example.org", "http://lab", "a b", "lab/", "lab:x"])
def test_what_is_no_name_cannot_be_allowed(name: str) -> None:
    with pytest.raises(ValueError, match=r"must be NAME or NAME:PORT, such as lab.example.org"):
        Access((name,))


def test_a_refusal_tells_the_remedy_where_there_is_one() -> None:
    entrance = Entrance("127.0.0.1", Access(("lab.example.org",), token=False))
    line = refusal(entrance, Host="BOX.lan:9000").line
    assert line.endswith("which is not this server; if it is: --allow-host box.lan:9000")
    assert "--allow-host" not in refusal(entrance, Host="$(reboot)").line
    line = refusal(entrance, Host="127.0.0.1:8080", Origin="https://lab.example.org").line
    assert "let it pass on the Host header" in line


# Pages.


@pytest.mark.parametrize(
    "origin",
    ["http://evil.example", "null", "", "http://localhost:1", "http://localhost", "file://"]
    + ["http://127.0.0.1:8080", "http://localhost:8080.evil", "ws://localhost:8080"]
    + ["http://localhost:8080/", "http://user@localhost:8080", "localhost:8080"],
)  # fmt: skip
def test_other_pages_are_refused(origin: str) -> None:
    assert refusal(Entrance("127.0.0.1"), Origin=origin).kind == "origin"


def test_two_origins_are_refused() -> None:
    own = "http://localhost:8080"
    assert ask(Entrance("127.0.0.1"), Origin=own).role is Role.OWNER
    assert refusal(Entrance("127.0.0.1"), Origin=[own, own]).kind == "origin"


def test_a_port_that_is_left_out_is_that_of_the_scheme() -> None:
    entrance = Entrance("127.0.0.1")
    assert ask(entrance, Host="localhost", Origin="http://localhost:80").role is Role.OWNER
    assert ask(entrance, Host="localhost:443", Origin="https://localhost").role is Role.OWNER
    assert refusal(entrance, Host="localhost:443", Origin="http://localhost").kind == "origin"


@pytest.mark.parametrize("key", ["websocket", "web%73ocket", "playbackPath", "a=1&websocket"])
def test_links_that_show_another_server_are_refused(key: str) -> None:
    assert refusal(Entrance("127.0.0.1"), f"/?{key}=ws://evil.example").kind == "link"


# Tokens.


def tokened(host: str = "127.0.0.1") -> Entrance:
    return Entrance(host, Access(token=True))


def token_of(entrance: Entrance, role: Role) -> str:
    found = re.fullmatch(r"http://x/\?token=([\w-]{43,})", entrance.link("http://x", role))
    assert found
    return found[1]


def cookie_of(passage: Passage) -> str:
    assert passage.cookie is not None
    return passage.cookie.partition(";")[0]


@pytest.mark.parametrize(
    ("host", "access", "needs"),
    [
        ("127.0.0.1", Access(), False),
        ("localhost", Access(), False),
        ("::1", Access(), False),
        ("127.0.0.1", Access(token=True), True),
        ("127.0.0.1", Access(("lab",)), True),
        ("127.0.0.1", Access(("lab",), token=False), False),
        ("0.0.0.0", Access(), True),
        ("::", Access(), True),
        ("192.168.0.7", Access(), True),
        ("0.0.0.0", Access(token=False), False),
    ],
)
def test_where_a_token_is_needed(host: str, access: Access, needs: bool) -> None:
    entrance = Entrance(host, access)
    assert entrance.needs_token is needs
    assert ("token=" in entrance.link("http://x")) is needs
    is_open = host not in ("127.0.0.1", "localhost", "::1") or bool(access.allow_hosts)
    warning = entrance.warning("do this")
    assert (warning is not None and "can do this" in warning) is (is_open and not needs)
    if needs:
        assert refusal(entrance).kind == "token"
    else:
        assert ask(entrance) == Passage(Role.OWNER)


@pytest.mark.parametrize("role", [Role.OWNER, Role.READER])
def test_a_link_lets_in_and_so_does_its_cookie(role: Role) -> None:
    entrance = tokened()
    by_link = ask(entrance, f"/?a=1&token={token_of(entrance, role)}&b")
    assert by_link.role is role
    cookie = cookie_of(by_link)
    assert ask(entrance, Cookie=cookie) == Passage(role)
    assert ask(entrance, Cookie=f"a=b; {cookie};c=d").role is role
    assert ask(entrance, Cookie=["a=b", cookie]).role is role
    kind = set(by_link.cookie.split("; ")[1:]) if by_link.cookie else set()
    assert kind == {"Path=/", "Max-Age=86400", "HttpOnly", "SameSite=Strict"}


@pytest.mark.parametrize("token", ["", "x", "%00", "%ff", "é", "a" * 43, "None"])
def test_other_tokens_do_not(token: str) -> None:
    entrance = tokened()
    assert refusal(entrance, f"/?token={token}").kind == "token"
    name = cookie_of(ask(entrance, f"/?token={token_of(entrance, Role.OWNER)}")).split("=")[0]
    for cookie in (f"{name}={token}", name, f"{name}x={token_of(entrance, Role.OWNER)}"):
        assert refusal(entrance, Cookie=cookie).kind == "token"


def test_a_part_of_a_token_is_none() -> None:
    entrance = tokened()
    token = token_of(entrance, Role.OWNER)
    for wrong in (token[:-1], token + "A", token.swapcase(), f" {token}"):
        assert refusal(entrance, f"/?token={wrong}").kind == "token"


def test_each_server_has_its_own_tokens_and_cookies() -> None:
    """Cookies ignore ports: a browser sends those of one server to the other."""
    one, other = tokened(), tokened()
    cookies = [cookie_of(ask(e, f"/?token={token_of(e, Role.OWNER)}")) for e in (one, other)]
    assert cookies[0].split("=")[0] != cookies[1].split("=")[0]
    assert refusal(one, Cookie=cookies[1]).kind == "token"
    assert ask(one, Cookie="; ".join(cookies)).role is Role.OWNER
    assert ask(other, Cookie="; ".join(cookies)).role is Role.OWNER
    assert len({token_of(e, r) for e in (one, other) for r in (Role.OWNER, Role.READER)}) == 4


def test_a_link_to_look_never_takes_away_what_a_browser_may_do() -> None:
    entrance = tokened()
    owner = cookie_of(ask(entrance, f"/?token={token_of(entrance, Role.OWNER)}"))
    assert ask(entrance, f"/?token={token_of(entrance, Role.READER)}", Cookie=owner) == Passage(
        Role.OWNER
    )
    reader = cookie_of(ask(entrance, f"/?token={token_of(entrance, Role.READER)}"))
    more = ask(entrance, f"/?token={token_of(entrance, Role.OWNER)}", Cookie=reader)
    assert more.role is Role.OWNER
    assert cookie_of(more) == owner
    assert ask(entrance, "/?token=gone", Cookie=owner) == Passage(Role.OWNER)


def test_a_link_for_once_opens_once() -> None:
    entrance = tokened()
    once = entrance.link_for_once("http://x").removeprefix("http://x")
    opened = ask(entrance, once)
    assert opened.role is Role.OWNER
    assert refusal(entrance, once).kind == "token"
    assert ask(entrance, once, Cookie=cookie_of(opened)).role is Role.OWNER  # reloaded
    assert token_of(entrance, Role.OWNER) not in once
    assert Entrance("127.0.0.1").link_for_once("http://x") == "http://x"


def test_beyond_https_the_cookie_stays_there() -> None:
    entrance = tokened()
    path = f"/?token={token_of(entrance, Role.OWNER)}"
    assert "; Secure" in str(ask(entrance, path, X_Forwarded_Proto="https").cookie)
    assert "; Secure" not in str(ask(entrance, path, X_Forwarded_Proto="http").cookie)


def test_a_token_does_not_help_a_foreign_page() -> None:
    entrance = tokened()
    path = f"/?token={token_of(entrance, Role.OWNER)}"
    assert refusal(entrance, path, Host="evil.example").kind == "host"
    assert refusal(entrance, path, Origin="http://evil.example").kind == "origin"
    for refused in (
        refusal(entrance, path, Host="evil.example"),
        refusal(entrance, path + "&websocket=x"),
    ):
        assert token_of(entrance, Role.OWNER) not in refused.line


# Frames.


def test_nobody_may_frame_unless_named() -> None:
    alone, framed = headers({}), headers({}, ["http://localhost:8888", "https://lab"])
    assert alone["X-Frame-Options"] == "DENY"
    assert "frame-ancestors 'none'" in alone["Content-Security-Policy"]
    assert "X-Frame-Options" not in framed
    policy = framed["Content-Security-Policy"]
    assert policy.endswith("frame-ancestors http://localhost:8888 https://lab")


@pytest.mark.parametrize(
    "origin",
    ["*", "'none'", "localhost:8888", "http://a; script-src *", "http://a http://b", "http://*"]
    + ["https://", "data:", "http://a/b", "http://localhost:8888\r\nX: y"],
)  # fmt: skip
def test_what_is_no_origin_cannot_frame(origin: str) -> None:
    with pytest.raises(ValueError, match="frame_from takes origins such as"):
        Access(frame_from=(origin,))


def test_addresses_are_told_from_names() -> None:
    assert Authority("::1").address is not None
    assert str(Authority("::1", 80)) == "[::1]:80"
    assert Authority("localhost").address is None
