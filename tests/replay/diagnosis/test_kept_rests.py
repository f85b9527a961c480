"""What the rests show that a daemon has kept."""

from __future__ import annotations

from msgspec import structs

from stillcal.replay.diagnosis.rest_table import diagnose_kept, rest_bins
from tests.calib_core.calibration.test_following import lived
from tests.calib_core.calibration.test_trial import plugged


def test_a_bias_on_the_charger_is_named_where_the_rests_say_when_they_were_on_it() -> None:
    rests = plugged(lived(8.0, slopes=0.0, read=lambda t, celsius: None))
    assert [f["effect"] for f in diagnose_kept(rests, "state")["findings"]] == ["gyro_charging_bias"]
    untold = [structs.replace(rest, charged=None) for rest in rests]
    assert rest_bins([*rests[1:], untold[0]]).charging is None


def test_what_a_daemon_looked_at_briefly_is_in_no_hand_for_that() -> None:
    """It looks for some seconds at rests of hours: what wanders in them is told as before."""
    rests = lived(2.0, slopes=0.0, read=lambda t, celsius: None)
    assert not rest_bins([structs.replace(rest, t_end=rest.t_start + 2.0) for rest in rests]).held
