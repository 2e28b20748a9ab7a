"""Names and ports of servers, as Host and Origin headers write them."""

from __future__ import annotations

import ipaddress
import re
import socket
from dataclasses import dataclass

PORTS = {"http": 80, "https": 443}
"""Which port a browser leaves out."""
_WRITTEN = re.compile(r"(?:\[([0-9a-f:.]+)\]|([a-z0-9_.-]+))(?::(\d{1,5}))?", re.ASCII)

Address = ipaddress.IPv4Address | ipaddress.IPv6Address


@dataclass(frozen=True)
class Authority:
    """`name:port`. The name is in lower case, without a dot at its end; an address is without
    brackets, in its shortest form. A port that was left out is None.
    """

    name: str
    port: int | None = None

    @property
    def address(self) -> Address | None:
        """The name as an address, if it is one: nobody can make that lead elsewhere."""
        return _address(self.name)

    def names(self, other: Authority) -> bool:
        """Whether `other` is this name, at this port or, where there is none, at any."""
        ports = PORTS.values() if other.port is None else (other.port,)
        return self.name == other.name and (self.port is None or self.port in ports)

    def is_origin(self, origin: str) -> bool:
        """Whether a page of this `origin` comes from here."""
        scheme, _, rest = origin.lower().partition("://")
        page, default = parse(rest), PORTS.get(scheme)
        if page is None or default is None:
            return False
        return page.name == self.name and (page.port or default) == (self.port or default)

    def __str__(self) -> str:
        name = f"[{self.name}]" if ":" in self.name else self.name
        return name if self.port is None else f"{name}:{self.port}"


def parse(text: str) -> Authority | None:
    """Parse a Host header; None if no browser would send it."""
    found = _WRITTEN.fullmatch(text.lower())
    if found is None:
        return None
    six, name, port = found.groups()
    name, port = six or name.removesuffix("."), None if port is None else int(port)
    address = _address(name)
    is_whole = bool(name) and (six is None or isinstance(address, ipaddress.IPv6Address))
    if not is_whole or not (port is None or 0 < port < 65536):
        return None
    return Authority(str(address or name), port)


def bound_to(host: str) -> str:
    """The name of a server that listens at `host`, which has no brackets, as in `Authority`."""
    return str(_address(host) or host.lower().removesuffix("."))


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach a server that listens at `host`."""
    try:
        found = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
    except OSError:
        return False
    return all(ipaddress.ip_address(str(a[4][0]).partition("%")[0]).is_loopback for a in found)


def _address(name: str) -> Address | None:
    try:
        return ipaddress.ip_address(name)
    except ValueError:
        return None
