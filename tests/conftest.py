"""What all tests share: the settings of the property tests, and a browser.

Property tests have the same examples each time, and no search for smaller ones.
"""

import os
import signal
import sys
from collections.abc import Iterator

import pytest
from browser import browser_or_skip
from hypothesis import Phase, settings
from playwright.sync_api import Browser

# Read when numpy is imported, which nothing above does. The matrices here are small, and threads
# that wait for each other at them take the cores from what else runs.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

if hasattr(signal, "SIGHUP"):  # ignored where the tests are started with nohup
    signal.signal(signal.SIGHUP, signal.SIG_DFL)

settings.register_profile(
    "hebbviz",
    deadline=None,
    derandomize=True,
    database=None,
    phases=(Phase.explicit, Phase.generate),
)
settings.load_profile("hebbviz")


@pytest.fixture(scope="session", autouse=True)
def nothing_has_a_second_name() -> Iterator[None]:
    """In a checkout `import server` works too, and would make every module a second time."""
    yield
    assert {"server", "sims"} & sys.modules.keys() == set()


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """One for all: the first page of a browser compiles its shaders, and later ones find them."""
    with browser_or_skip() as browser:
        yield browser
