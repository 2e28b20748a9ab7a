"""A flood takes a part of a run's speed, and only while it lasts. The bars have room for a machine
that does other things too; `benchmarks/floods.py` has them in full, and more kinds of floods.
"""

from __future__ import annotations

import pytest
from benchmarks.floods import opened


@pytest.mark.slow
def test_a_run_keeps_its_speed_in_floods_and_after() -> None:
    with opened() as bench:
        kept = [bench.flood(kind, turns=3) for kind in ("sliders", "sockets")]
        assert len(bench.site._run.log) < 2000  # of some 12 000 that were sent
    assert all(one.during > 0.25 and one.after > 0.5 for one in kept), "\n".join(map(str, kept))
