"""Held-out runs that leave far more than any training run: told with run, channel and time."""

from dataclasses import replace

import numpy as np
import pytest
from test_episodes import added, bump, runs, track

from stiffopt.discovery.conclusions import describe_next_recording
from stiffopt.discovery.judging.beyond_training import describe_excess, find_excess
from stiffopt.discovery.judging.episodes import Episode


def test_a_usual_held_out_run_exceeds_nothing():
    assert find_excess(track("test_1", 9, "test"), runs(), ()) is None


def test_a_run_that_leaves_more_than_all_training_runs_is_told_with_its_time():
    own = track("test_1", 9, "test")
    own = added(own, bump(own, 3.0, 4.0, 60.0), channels=(1,))
    found = find_excess(own, runs(), ())
    assert found is not None
    assert found.channel == 1
    assert 2.8 < found.run.begin < found.run.end < 4.2
    assert found.run.ratio == pytest.approx(60.0, abs=4.0)
    left = describe_excess([found], 2)
    assert left is not None
    assert left.channels == ("torque_2",)
    assert 'Give test_1 the role "train"' in describe_next_recording(left)


def test_what_training_runs_leave_as_well_is_no_excess():
    every = runs()
    every[1] = added(every[1], bump(every[1], 3.0, 4.0, 60.0), channels=(1,))
    own = track("test_1", 9, "test")
    assert find_excess(added(own, bump(own, 5.0, 6.0, 60.0), channels=(1,)), every, ()) is None


def test_a_contact_interval_is_no_excess():
    own = track("test_1", 9, "test")
    own = added(own, bump(own, 3.0, 4.0, 60.0), channels=(1,))
    touched = Episode(run="test_1", role="test", begin=2.9, end=4.1, joints=(2,), sizes=(6.0,))
    assert find_excess(own, runs(), [touched]) is None


def test_the_run_that_differs_most_is_told():
    own = track("test_1", 9, "test")
    one = added(own, bump(own, 3.0, 4.0, 60.0), channels=(1,))
    other = replace(added(own, bump(own, 5.0, 6.0, 90.0), channels=(0,)), run="test_2")
    found = [find_excess(each, runs(), ()) for each in (one, other)]
    left = describe_excess([each for each in found if each], 2)
    assert left is not None
    assert left.held_out is not None
    assert left.held_out.run == "test_2"
    assert describe_excess([], 2) is None
    assert np.isfinite(left.ratio)
