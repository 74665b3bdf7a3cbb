"""When input is followed, and with how much of the joints' speed after a hold."""

import numpy as np
import pytest

from geort_drake.systems.glove_checks import Easing


def test_input_is_followed_once_it_has_been_good_for_long_enough():
    """A fault begins the wait anew; times that are sums of periods count as the times they stand for."""
    easing = Easing.at_start(True)
    times = np.cumsum([0.1] * 6)
    assert not easing.follows()
    assert [easing.settled(t, 0.3) for t in times[:4]] == [False, False, False, True]
    easing.hold(times[4], good=False)
    assert not easing.settled(times[5], 0.3) and easing.good_since == times[5]


def test_the_share_of_the_speed_grows_over_as_long_as_the_hand_was_held():
    """But over no longer than is asked for; an easing that ends leaves the full speed."""
    easing = Easing.at_start(False)
    assert easing.follows() and easing.follow(1.0, 0.1, 0.5) == 1.0
    easing.hold(1.0, good=True)
    easing.hold(1.3, good=True)
    assert not easing.follows() and easing.held_since == 1.0
    shares = [easing.follow(t, 0.1, 0.5) for t in (1.4, 1.5, 1.6, 1.7, 1.8)]
    assert shares == pytest.approx([0.25, 0.5, 0.75, 1.0, 1.0])
    easing.hold(5.0, good=False)
    assert easing.follow(9.0, 0.1, 0.5) == pytest.approx(0.2)
    easing.end()
    assert easing.follow(9.1, 0.1, 0.5) == 1.0


def test_the_start_is_eased_like_the_longest_hold():
    """Unless the first input is to be followed at once."""
    eased, at_once = Easing.at_start(True), Easing.at_start(False)
    assert eased.follow(0.0, 0.1, 0.5) == pytest.approx(0.2)
    assert at_once.settled(0.0, 0.03) and at_once.follow(0.0, 0.1, 0.5) == 1.0
