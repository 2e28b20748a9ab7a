"""rerun's streams, and how they are let go of: left alone, it keeps the threads and memory of all.

rerun clears up what nobody refers to any more, but under a lock of its own, for which a thread that
makes a stream waits with Python's lock held. So the two are kept apart here, and nothing is cleared
up while another stream is held up by its disk or its viewer, which would be waited for as well.
"""

from __future__ import annotations

import contextlib
import threading
import uuid
import weakref
from collections.abc import Iterator

import rerun as rr
import rerun.blueprint as rrb
import rerun_bindings

APPLICATION = "hebbviz"
PATIENCE = 3.0
"""Seconds that making a stream may wait."""
LOOK = 0.2
"""Seconds within which a stream that is not held up is flushed."""

_lock = threading.Lock()
_open: weakref.WeakSet[Stream] = weakref.WeakSet()


class Stream(rr.RecordingStream):
    """A stream to be let go of. `identity` by default is a new one.

    Raises OSError if the disk or a viewer of another stream does not answer.
    """

    def __init__(self, identity: str | None = None) -> None:
        self.identity = identity or str(uuid.uuid4())
        with _alone(PATIENCE):
            super().__init__(APPLICATION, recording_id=self.identity)
            _open.add(self)

    def __del__(self) -> None:
        """rerun's own would clear up, in whatever thread and at whatever moment."""

    def send_page(self, blueprint: rrb.Blueprint) -> None:
        """`send_blueprint`, which makes a stream too and never lets go of it."""
        with _alone():
            native = rerun_bindings.new_blueprint(
                application_id=APPLICATION, make_default=False, make_thread_default=False
            )
            page = rr.RecordingStream._from_native(native)  # noqa: SLF001  # as rerun does
            page.set_time("blueprint", sequence=0)
            blueprint._log_to_stream(page)  # noqa: SLF001
            storage = page.memory_recording().storage
            rerun_bindings.send_blueprint(storage, True, True, recording=self.to_native())
            page.disconnect()
            del page

    def let_go(self) -> None:
        """Close it for good. Where a disk is full this may never return."""
        self.disconnect()
        with _alone():
            _open.discard(self)
            del self.inner
            if all(other.answers() for other in _open):
                with contextlib.suppress(RuntimeError):  # of another one, whose disk is full
                    rerun_bindings.flush_and_cleanup_orphaned_recordings()

    def answers(self) -> bool:
        """Whether it is not held up."""
        try:
            self.flush(timeout_sec=LOOK)
        except RuntimeError:
            return False
        return True


@contextlib.contextmanager
def _alone(seconds: float = -1) -> Iterator[None]:
    if not _lock.acquire(timeout=seconds):
        raise OSError("another recording is held up by its disk or its viewer")
    try:
        yield
    finally:
        _lock.release()
