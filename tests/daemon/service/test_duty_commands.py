"""What the phone is told: nothing twice, no sensor on that is not wanted, time in steps up to decisions."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from stillcal.calib_core.static.settings import Sense, Sleep
from stillcal.daemon.service.duty_commands import LEAST_STEP_S, PROBE_STEP_S, STEP_S, DutyCommands, credit


def test_a_phone_that_was_told_nothing_is_told_to_sense_once():
    commands = DutyCommands()
    assert commands.due(Sense(math.inf), 60.0, 0.0) == [Sense(math.inf)]
    assert commands.due(Sense(math.inf), 120.0, 60.0) == []


def test_an_idle_phone_sleeps_on_through_decisions_that_concern_no_sample():
    commands = DutyCommands()
    assert commands.due(Sleep(60.0), 60.0, 0.0) == [Sleep(math.inf)]
    assert commands.due(Sleep(120.0), 120.0, 60.0) == []
    assert commands.asleep(1e9)


def test_a_probe_is_slept_up_to_and_needs_no_waking():
    commands = DutyCommands()
    assert commands.due(Sleep(40.0), 60.0, 0.0) == [Sleep(40.0)]
    assert commands.asleep(39.9) and not commands.asleep(40.0)
    assert commands.due(Sense(50.0), 60.0, 40.0) == []
    assert commands.due(Sleep(55.0), 60.0, 43.0) == [Sleep(55.0)]


def test_a_sleeping_phone_that_is_wanted_is_woken():
    commands = DutyCommands()
    commands.due(Sleep(60.0), 60.0, 0.0)
    assert commands.due(Sense(math.inf), 120.0, 60.0) == [Sense(math.inf)]
    assert not commands.asleep(60.0)


def test_after_a_restart_everything_is_said_again():
    commands = DutyCommands()
    commands.due(Sleep(40.0), 60.0, 0.0)
    commands.forget()
    assert not commands.asleep(1.0)
    assert commands.due(Sleep(40.0), 60.0, 1.0) == [Sleep(40.0)]


times = st.floats(0, 1e6) | st.just(math.inf)


@given(st.booleans(), times, times, st.floats(0, 1e6))
def test_a_grant_goes_forward_and_never_past_a_decision(
    sense: bool, until: float, decides: float, now: float
):
    want = Sense(until) if sense else Sleep(until)
    goal = credit(want, decides, now).until
    assert now < goal < math.inf
    ahead = [t for t in (until, decides) if t > now]
    if min(until, decides) > now:
        assert goal <= max(min([*ahead, now + STEP_S]), now + LEAST_STEP_S) or goal <= min(ahead)


def test_credit_to_the_next_instant_is_not_lost_on_a_phone_whose_clock_is_ahead():
    """Day 192 of a year: above 2^24 s a stamp is coarser, and the credit ended where the phone stood."""
    now, decides, ahead = 16682211.369999997, 16682211.37, 97789.0
    assert decides + ahead == now + ahead
    assert credit(Sleep(decides), decides, now).until + ahead > now + ahead


def test_a_probe_is_granted_in_small_steps_and_a_watch_up_to_its_decision():
    assert credit(Sense(50.0), 60.0, 40.0).until == 40.0 + PROBE_STEP_S
    assert credit(Sense(60.0), 60.0, 1.0).until == 60.0
    assert credit(Sleep(40.0), 60.0, 1.0).until == 40.0
