"""Access control: by the names of a server, the pages that send requests, and a token.

A server on this machine is reached by every website that the user visits, and beyond it by
everybody in the network. So a request must be addressed to a name of this server (a foreign site
can have its own name lead here, but not ours), must come from this server's own page, and where
others can reach the server it must bring a token: in the link that is printed, later as a cookie.
"""

from __future__ import annotations

import enum
import hmac
import secrets
import socket
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from urllib.parse import parse_qsl

from hebbviz.server.web import host_names
from hebbviz.server.web.host_names import Authority
from hebbviz.server.web.refusal import Refused, shown

TOKEN = "token"
TOKEN_BYTES = 32
COOKIE_SECONDS = 86_400
"""A browser sends all cookies of a name to all its ports; old ones must not pile up."""
EVERYWHERE = ("0.0.0.0", "::")

# Parameters in the page's address that make viser's page show another server or a recording.
# Either may run scripts in the page, so such a link would let a foreign site pass for our page.
FOREIGN_SOURCES = {"websocket", "playbackPath"}

GetAll = Callable[[str], list[str]]
"""All values of a header."""


class Role(enum.IntEnum):
    """Rights of a visitor; a greater role has more."""

    NOBODY = 0
    READER = 1
    """Looks, and changes nothing."""
    OWNER = 2


@dataclass(frozen=True)
class Access:
    """The user's access options.

    Args:
        allow_hosts: Names as NAME or NAME:PORT under which the server is reached besides its own,
            by a proxy say.
        token: Whether one is needed; None: where others than this machine can reach the server.
        frame_from: Origins such as http://localhost:8888 whose pages may show ours in a frame.

    Raises ValueError for what is no name or origin.
    """

    allow_hosts: tuple[str, ...] = ()
    token: bool | None = None
    frame_from: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in self.allow_hosts:
            allowed_name(name)
        for origin in self.frame_from:
            scheme, _, rest = origin.partition("://")
            if scheme not in host_names.PORTS or host_names.parse(rest) is None:
                raise ValueError(
                    f"frame_from takes origins such as http://localhost:8888, got {origin!r}"
                )


def allowed_name(text: str) -> Authority:
    """A name that the user allows; raises ValueError."""
    found = host_names.parse(text)
    if found is None:
        raise ValueError(
            f"an allowed host must be NAME or NAME:PORT, such as lab.example.org, got {text!r}"
        )
    return found


@dataclass(frozen=True)
class Passage:
    """One request that may pass: in which role, and the cookie to be set with the answer."""

    role: Role
    cookie: str | None = None


class Entrance:
    """Checks the requests to one server that listens at `host`."""

    def __init__(self, host: str, access: Access = Access()) -> None:
        self._bound = host_names.bound_to(host)
        self._allowed = [allowed_name(name) for name in access.allow_hosts]
        self.is_open = bool(access.allow_hosts) or not host_names.is_loopback(host)
        """Whether other machines are meant to reach it."""
        self.needs_token = self.is_open if access.token is None else access.token
        self._owner, self._reader = (secrets.token_urlsafe(TOKEN_BYTES) for _ in range(2))
        self._tickets: list[str] = []
        self._cookie = f"hebbviz-{secrets.token_hex(4)}"

    def link(self, address: str, role: Role = Role.OWNER) -> str:
        """The address, with the token of a role where one is needed."""
        return self._with(address, self._owner if role is Role.OWNER else self._reader)

    def warning(self, what: str) -> str | None:
        """A warning that others can do `what`, if nothing prevents them."""
        if not self.is_open or self.needs_token:
            return None
        return (
            "warning: other machines can reach this page, which needs no token: whoever "
            f"reaches it can {what}"
        )

    def link_for_once(self, address: str) -> str:
        """A link that opens the page a single time: other users of a machine can read how a
        browser was called, and an audience what its address bar says.
        """
        ticket = secrets.token_urlsafe(TOKEN_BYTES)
        if self.needs_token:
            self._tickets.append(ticket)
        return self._with(address, ticket)

    def _with(self, address: str, token: str) -> str:
        return f"{address.rstrip('/')}/?{TOKEN}={token}" if self.needs_token else address

    def check(self, path: str, get_all: GetAll) -> Passage:
        """Raise Refused for a request that is not meant for us, not sent by our page, or has no
        token; `path` is its path with the query.

        A browser names the Origin of a page that opens a websocket; without it, it is no browser's.
        """
        self._check_source(get_all("Host"), get_all("Origin"))
        query = parse_qsl(path.partition("?")[2], keep_blank_values=True)
        if FOREIGN_SOURCES & {key for key, _ in query}:
            line = "its link makes the page show another server or a recording"
            raise Refused("link", f"refused a request: {line}")
        if not self.needs_token:
            return Passage(Role.OWNER)
        return self._checked_token([value for key, value in query if key == TOKEN], get_all)

    def _check_source(self, hosts: list[str], origins: list[str]) -> None:
        host = host_names.parse(hosts[0]) if len(hosts) == 1 else None
        if host is None or not self.is_own(host):
            line = f"it is addressed to {shown(', '.join(hosts))}, which is not this server"
            remedy = "" if host is None else f"; if it is: --allow-host {host}"
            raise Refused("host", f"refused a request: {line}{remedy}")
        if origins and not (len(origins) == 1 and host.is_origin(origins[0])):
            line = f"it comes from {shown(', '.join(origins))}, not from this server's page"
            remedy = ""
            if any(name.is_origin(origins[0]) for name in self._allowed):
                remedy = f"; if that is a proxy, let it pass on the Host header, not send {host}"
            raise Refused("origin", f"refused a request: {line}{remedy}")

    def is_own(self, host: Authority) -> bool:
        """Whether a request to `host` means this server, whatever the port: it may be forwarded.

        A rebound DNS name resolves to us but is not our name, so a hostile site fails here. Bound
        to every interface, the server can't list its addresses; but a literal address can't be
        rebound.
        """
        address = host.address
        if host.name in ("localhost", self._bound) or (address and address.is_loopback):
            return True
        if any(name.names(host) for name in self._allowed):
            return True
        named = address is not None or host.name == socket.gethostname().lower()
        return named and self._bound in EVERYWHERE

    def _checked_token(self, given: list[str], get_all: GetAll) -> Passage:
        kept = max(map(self._role_of, self._kept(get_all("Cookie"))), default=Role.NOBODY)
        role, token = max(map(self._redeemed, given), default=(Role.NOBODY, ""))
        if max(role, kept) is Role.NOBODY:
            line = "it has no token, or another server's; open the link that was printed"
            raise Refused("token", f"refused a request: {line} as this one started")
        if role <= kept:  # also: a link to look never takes away what a browser may do
            return Passage(kept)
        secure = "; Secure" if get_all("X-Forwarded-Proto") == ["https"] else ""
        kind = f"Path=/; Max-Age={COOKIE_SECONDS}; HttpOnly; SameSite=Strict{secure}"
        return Passage(role, f"{self._cookie}={token}; {kind}")

    def _kept(self, cookies: Iterable[str]) -> list[str]:
        """Values of the cookie that this server set; browsers also send cookies of other ports."""
        pairs = (pair.strip().partition("=") for line in cookies for pair in line.split(";"))
        return [value for name, _, value in pairs if name == self._cookie]

    def _redeemed(self, given: str) -> tuple[Role, str]:
        """The role that a link gives, and the token to be kept."""
        for ticket in self._tickets:
            if _equal(given, ticket):
                self._tickets.remove(ticket)
                return Role.OWNER, self._owner
        return self._role_of(given), given

    def _role_of(self, token: str) -> Role:
        if _equal(token, self._owner):
            return Role.OWNER
        return Role.READER if _equal(token, self._reader) else Role.NOBODY


def _equal(one: str, other: str) -> bool:
    """In a time that does not tell how much is right."""
    return hmac.compare_digest(one.encode(errors="replace"), other.encode())


# Headers


def headers(policy: dict[str, str], frame_from: Iterable[str] = ()) -> dict[str, str]:
    """Headers of every answer: `policy` lists what a page may load, by kind; all else is forbidden.

    `frame_from` are the origins whose pages may show ours in a frame. X-Frame-Options knows none.
    """
    framing = " ".join(frame_from) or "'none'"
    rules = {"default-src": "'none'"} | policy
    rules |= {"base-uri": "'none'", "form-action": "'none'", "frame-ancestors": framing}
    return {
        "Content-Security-Policy": "; ".join(f"{kind} {what}" for kind, what in rules.items()),
        **({} if frame_from else {"X-Frame-Options": "DENY"}),
        "Cross-Origin-Opener-Policy": "same-origin",
        "Cross-Origin-Resource-Policy": "same-origin",
        "Referrer-Policy": "no-referrer",  # a link may hold a token
        "X-Content-Type-Options": "nosniff",
        "Cache-Control": "no-store",
    }
