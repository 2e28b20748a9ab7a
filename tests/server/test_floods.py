"""In a flood a run goes on and remembers little of it; `benchmarks/floods.py` has its speed."""

from __future__ import annotations

import signal
import time

import pytest
from raw_client import wait_until

from hebbviz.server.web.access import Access, Role
from tests.benchmarks.floods import attack, opened
from tests.benchmarks.lecture import seated

STEPS = 40_000
"""One or two seconds' worth when nothing else is done."""
DEADLINE = 60.0


@pytest.mark.slow
def test_a_run_goes_on_in_floods() -> None:
    with opened() as bench:
        began = time.monotonic()
        port, run = bench.site._server.get_port(), bench.site._run
        for kind in ("sliders", "cameras", "rewards", "sockets"):
            made = bench.steps.made
            with attack(port, kind, DEADLINE) as attacker:
                attacker.send_signal(signal.SIGCONT)
                wait_until(lambda made=made: bench.steps.made > made + STEPS, DEADLINE)
        assert len(run.log) < 200 * (time.monotonic() - began)  # of some 4 000 a second


@pytest.mark.slow
def test_a_lecture_hall_sees_a_run_that_goes_on() -> None:
    """`benchmarks/lecture.py` has its speed."""
    with opened(access=Access(token=True)) as bench:
        path = bench.site._entrance.link("", Role.READER)
        with seated(bench.site._server.get_port(), path, 40) as audience:
            (frames, _), made = audience.count(), bench.steps.made
            wait_until(lambda: audience.count()[0] > frames + 40 * 20, DEADLINE)
            wait_until(lambda: bench.steps.made > made + STEPS, DEADLINE)
            assert audience.count()[1] == 0
