"""The store's history: which entries it keeps, which it drops, and rollback."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stillcal.calib_core.calibration.record import Acceptance
from stillcal.daemon.store.document import StoreDocument, bounded
from tests.support.store_documents import published


def test_publishing_the_same_again_changes_no_history(document, make_record):
    assert document.after_publishing(make_record(2), 32).history == document.history


def test_what_follows_the_rests_each_hour_does_not_crowd_out_calibrations(make_record):
    accepted, document = make_record(0), StoreDocument()
    document = document.after_publishing(accepted, 4)
    for hour in range(1, 30):
        how = "following" if hour % 2 else "zeroing"
        document = document.after_publishing(make_record(hour, how=how), 4)
    assert [e.calibration.id for e in document.history] == [accepted.id]


def test_zeroings_do_not_crowd_out_calibrations(make_record):
    document = StoreDocument().after_publishing(make_record(1), 4)
    for hour in range(2, 50):
        document = document.after_publishing(make_record(hour, how="zeroing"), 4)
    assert [entry.calibration.id for entry in document.history] == [make_record(1).id]
    assert document.current.id == make_record(49).id


@given(st.lists(st.sampled_from(["publish", "reject"]), max_size=40), st.integers(2, 8))
def test_history_is_bounded_and_rejections_never_crowd_out_calibrations(make_record, steps, limit):
    document = StoreDocument()
    for number, step in enumerate(steps):
        if step == "publish":
            document = document.after_publishing(make_record(number), limit)
        else:
            document = document.after_rejecting(make_record(number), "worse", limit)
    published = [n for n, step in enumerate(steps) if step == "publish"][:-1]
    kept = [e.calibration.fitted_at for e in document.history if e.what == "replaced"]
    assert len(document.history) <= limit
    assert sum(e.what == "rejected" for e in document.history) <= limit // 2
    assert kept == published[len(published) - len(kept) :]
    assert len(kept) >= min(len(published), limit - limit // 2)


def test_bounded_keeps_the_newest(make_record):
    document = StoreDocument()
    for number in range(10):
        document = document.after_publishing(make_record(number), 32)
    assert [e.calibration.fitted_at for e in bounded(document.history, 3)] == [6.0, 7.0, 8.0]


def test_rollback_walks_back_and_an_id_brings_forward_again(make_record):
    document = StoreDocument()
    for number in (1, 2, 3):
        document = document.after_publishing(make_record(number), 32)
    back = document.after_rollback(1, 32)
    assert back.current.id == make_record(2).id
    assert back.current.acceptance.how == "rollback"
    further = back.after_rollback(1, 32)
    assert further.current.id == make_record(1).id
    forward = further.after_rollback(make_record(3).id[:6], 32)
    assert forward.current.id == make_record(3).id
    assert np.array_equal(forward.current.accelerometer.scale, make_record(3).accelerometer.scale)


@pytest.mark.parametrize("target", [0, -1, 2, "zzz"])
def test_rollback_refuses_what_is_not_there(document, target):
    with pytest.raises(ValueError, match=r"earlier calibrations|cannot roll back"):
        document.after_rollback(target, 32)


def test_rollback_never_takes_a_rejected_candidate(document, make_record):
    refused = document.after_rejecting(make_record(7), "worse", 32)
    with pytest.raises(ValueError, match="no earlier calibrations"):
        refused.after_rollback(make_record(7).id, 32)


def test_history_says_when_and_why(make_record):
    document = StoreDocument().after_publishing(make_record(1), 32)
    document = document.after_publishing(make_record(2), 32, reason="charging", at=77.0)
    document = document.after_rejecting(make_record(3), "worse by 0.2", 32, at=88.0)
    replaced, rejected = document.history
    assert (replaced.at, rejected.at) == (77.0, 88.0)
    assert replaced.reason == f"replaced by {make_record(2).id}: charging"
    assert rejected.reason == "worse by 0.2"


# What it keeps, to the entry


def test_half_of_the_history_may_be_rejected_and_no_more(make_record):
    document = published(*map(make_record, range(4)))
    for number in range(10, 14):
        document = document.after_rejecting(make_record(number), "worse", 32)
    entries = document.history
    assert [e.what for e in entries] == ["replaced"] * 3 + ["rejected"] * 4
    assert [e.calibration.fitted_at for e in bounded(entries, 7)] == [0.0, 1.0, 2.0, 11.0, 12.0, 13.0]
    assert [e.calibration.fitted_at for e in bounded(entries, 5)] == [0.0, 1.0, 2.0, 12.0, 13.0]
    assert [e.calibration.fitted_at for e in bounded(entries, 4)] == [1.0, 2.0, 12.0, 13.0]
    assert bounded(entries, 8) == entries


def test_only_a_zeroing_after_a_zeroing_is_forgotten(make_record):
    calibration, zeroing = make_record(1), make_record(2, how="zeroing")
    assert [e.calibration.id for e in published(calibration, zeroing).history] == [calibration.id]
    again = published(zeroing, calibration)
    assert [e.calibration.id for e in again.history] == [zeroing.id]
    assert published(zeroing, make_record(3, how="zeroing")).history == ()


def test_what_nobody_dated_is_dated_by_its_successor(make_record):
    first, second = make_record(1), make_record(2)
    (entry,) = published(first, second).history
    assert (entry.at, entry.reason) == (2.0, f"replaced by {second.id}: number 2")
    (candidate,) = StoreDocument().after_rejecting(second, "worse", 32).history
    assert candidate.at == 2.0
    (retired,) = published(first).after_retiring("another phone", 32).history
    assert (retired.at, retired.what, retired.reason) == (1.0, "replaced", "another phone")
    (dated,) = published(first).after_retiring("another phone", 32, at=50.0).history
    assert dated.at == 50.0
    (at_zero,) = published(first).after_retiring("another phone", 32, at=0.0).history
    assert at_zero.at == 0.0


def test_a_calibration_that_gives_no_reason_is_named_alone(make_record):
    silent = replace(make_record(2), acceptance=Acceptance(how="calibration", reason="", evidence={}))
    (entry,) = published(make_record(1), silent).history
    assert entry.reason == f"replaced by {silent.id}"


def test_retiring_nothing_changes_nothing(make_record):
    document = StoreDocument().after_rejecting(make_record(1), "worse", 32)
    assert document.after_retiring("another phone", 32) is document
    assert published(make_record(1)).after_retiring("another phone", 32).current is None


def test_a_candidate_is_rejected_once_and_a_replaced_one_may_be(make_record):
    document = published(make_record(1), make_record(2)).after_rejecting(make_record(3), "worse", 32)
    assert document.after_rejecting(make_record(3), "again", 32) is document
    once_current = document.after_rejecting(make_record(1), "worse now", 32)
    assert [e.what for e in once_current.history] == ["replaced", "rejected", "rejected"]


def test_history_leaves_out_the_rests(make_record):
    (entry,) = published(make_record(1, states=5), make_record(2)).history
    assert entry.calibration.states == ()
    assert len(make_record(1, states=5).states) == 5


def test_rolling_back_counts_what_was_replaced_only(make_record):
    document = published(*map(make_record, (1, 2, 3))).after_rejecting(make_record(9), "worse", 32)
    assert document.after_rollback(2, 32).current.id == make_record(1).id
    back = document.after_rollback(1, 32)
    assert back.current.acceptance.reason == f"rolled back from {make_record(3).id}"
    assert back.history[-1].reason == f"rolled back to {back.current.id}"
    assert (back.history[-1].what, back.history[-1].at) == ("rolled_back", None)
    assert [e.calibration.fitted_at for e in back.history] == [1.0, 9.0, 3.0]
    with pytest.raises(ValueError, match=r"the history holds 1 earlier"):
        back.after_rollback(2, 32)


def test_rolling_back_without_a_current_calibration(make_record):
    document = published(make_record(1)).after_retiring("another phone", 32)
    back = document.after_rollback(1, 32)
    assert back.current.acceptance.reason == "rolled back"
    assert back.history == ()


def test_an_id_that_fits_two_calibrations_is_refused(make_record):
    document = published(*map(make_record, range(40)), limit=40)
    ids = [e.calibration.id for e in document.history]
    shared = next(i[0] for i in ids if sum(other[0] == i[0] for other in ids) > 1)
    with pytest.raises(ValueError, match=r"^\d+ earlier calibrations with an id beginning with"):
        document.after_rollback(shared, 40)
