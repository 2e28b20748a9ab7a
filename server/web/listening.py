"""The socket that the page is served on."""

from __future__ import annotations

import contextlib
import errno
import os
import socket

PORTS_TRIED = 100


class CannotListen(OSError):
    """The address can't be listened on."""


class PortTaken(CannotListen):
    """Another program listens on the port."""


def listener(host: str, port: int | None, default_port: int) -> socket.socket:
    """A listening socket on `port`, or else on `default_port` or the next free one above it."""
    for name, number, lowest in (("port", port, 0), ("default_port", default_port, 1)):
        if number is not None and not lowest <= number <= 65535:
            raise ValueError(f"{name} must be between 1 and 65535, got {number}")
    if not host:
        raise ValueError("host must be a name or an address such as 127.0.0.1, got nothing")
    if port is not None:
        return _listen(host, port)
    last = min(default_port + PORTS_TRIED, 65536) - 1
    for candidate in range(default_port, last + 1):
        with contextlib.suppress(PortTaken):
            return _listen(host, candidate)
    raise PortTaken(f"can't listen on {host}: ports {default_port} to {last} are taken; name one")


def _listen(host: str, port: int) -> socket.socket:
    """A listening socket on exactly this address; held from here on, so nobody can slip in."""
    where = f"can't listen on {host}:{port}"
    try:
        # A name such as localhost may have both kinds of address; browsers try both: take IPv4.
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
        family, _, _, _, address = min(found, key=lambda one: one[0] != socket.AF_INET)
        with contextlib.ExitStack() as on_error:
            listener = on_error.enter_context(socket.socket(family, socket.SOCK_STREAM))
            if os.name == "posix":  # there it only skips the wait after a restart
                listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            if family == socket.AF_INET6:
                listener.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
            listener.bind(address)
            listener.listen(128)
            on_error.pop_all()
            return listener
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            advice = "stop the program that uses it or choose another port"
            raise PortTaken(f"{where}: the port is taken; {advice}") from error
        reason = (error.strerror or str(error)).lower()
        raise CannotListen(f"{where}: {reason}; choose another host or port") from error
