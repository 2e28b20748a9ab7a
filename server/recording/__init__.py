"""Recordings in rerun's files: written during a run, read back, inspected and exported."""

import os

# We report each error once, in our own text; without this, which rerun reads on import, it would
# also print lines of its log.
os.environ.setdefault("RUST_LOG", "off")

# Makes rerun's allocator return freed memory to the system; it would otherwise keep more and more.
os.environ.setdefault("MIMALLOC_PURGE_DELAY", "0")
