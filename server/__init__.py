"""The live page: its server, its panels and its scene. `serve(learner)` opens it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hebbviz.server.app import serve

__all__ = ["serve"]


def __getattr__(name: str) -> Any:
    """`serve`, when it is asked for: viser and numba take their time to import."""
    if name == "serve":
        from hebbviz.server.app import serve  # noqa: PLC0415

        return serve
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
