"""A session, stepped and told by hand: what is shown of a run, and when the run rests."""

from __future__ import annotations

import pytest

from hebbviz.learner.frames import Frame
from hebbviz.learner.learner import Learner
from hebbviz.server.live.commands import (
    BackToNow,
    EndFork,
    Seek,
    SetSpeed,
    ShowReward,
    StartFork,
    TakeOver,
)
from hebbviz.server.live.fork import NO_MEMORY
from hebbviz.server.live.session import Session
from hebbviz.server.live.view_mode import NOTHING_TO_PLAY
from hebbviz.server.run.run import Run
from hebbviz.sims.loading import make_task


@pytest.fixture
def session() -> Session:
    """Of the pendulum, at 1 000 steps per second, two seconds after its start."""
    it = Session(Run(Learner(make_task("pendulum")), make_task), on_notice=print)
    SetSpeed(1000.0).apply(it)
    for _ in range(40):
        go_on(it, 0.05)
    return it


def go_on(session: Session, seconds: float) -> None:
    """Let so much time pass: stretch by stretch, all that it owes."""
    session.go_on(seconds)
    while session.is_due():
        session.go_on(0.0)


def shown(session: Session) -> tuple[Frame, Frame]:
    """The run's frame, and the one that is shown."""
    live = session.run.frame()
    return live, session.showing.view(live, 0.1, session.tempo).frame


def test_it_is_stepped_by_the_time_that_passes(session: Session) -> None:
    assert session.run.learner.step in (1999, 2000)


def test_one_of_the_run_an_excerpt_and_its_past_is_shown(session: Session) -> None:
    live, frame = shown(session)
    assert frame.step < live.step
    assert session.showing.watch.excerpt() is not None
    Seek(450).apply(session)
    assert shown(session)[1].step == 450
    assert session.showing.watch.excerpt() is None
    BackToNow().apply(session)
    SetSpeed(2.0).apply(session)  # as slow as can be seen
    live, frame = shown(session)
    assert frame is live


def test_the_run_rests_while_its_past_is_shown(session: Session) -> None:
    step = session.run.learner.step
    Seek(450).apply(session)
    go_on(session, 0.05)
    assert session.run.learner.step == step
    TakeOver().apply(session)
    go_on(session, 0.05)
    assert session.run.learner.step == 500


def test_two_copies_go_on_together_and_have_no_past(session: Session) -> None:
    StartFork(NO_MEMORY).apply(session)
    go_on(session, 0.05)
    other = session.showing.view(session.run.frame(), 0.1, session.tempo).other
    assert other is not None
    assert other.frame.step == session.run.learner.step > other.start
    with pytest.raises(ValueError, match="end the fork first"):
        Seek(450).apply(session)
    with pytest.raises(ValueError, match=NOTHING_TO_PLAY):
        ShowReward().apply(session)
    EndFork().apply(session)
    Seek(450).apply(session)
    assert shown(session)[1].step == 450
