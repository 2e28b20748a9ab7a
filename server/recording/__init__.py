"""Recordings in rerun's files: written while a run goes on, read back, inspected and exported."""

import os

# What goes wrong is said once and in our words; rerun, which reads this when it is imported, would
# print lines of its log as well.
os.environ.setdefault("RUST_LOG", "off")

# rerun's allocator keeps what is freed, more with each size of what passes through its threads; so
# it gives it back.
os.environ.setdefault("MIMALLOC_PURGE_DELAY", "0")
