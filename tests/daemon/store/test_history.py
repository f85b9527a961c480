"""The store's history: what it keeps, what it lets go, and the way back through it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stillcal.daemon.store.document import StoreDocument, bounded


@pytest.fixture
def document(make_record):
    return StoreDocument().after_publishing(make_record(1), 32).after_publishing(make_record(2), 32)


def test_publishing_the_same_again_changes_no_history(document, make_record):
    assert document.after_publishing(make_record(2), 32).history == document.history


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
