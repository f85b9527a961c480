"""What a replay says when it puts its calibration into a store."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from stillcal.calib_core.calibration.corrections.term import Term, TermParameter
from stillcal.calib_core.engine.actions import Publish
from stillcal.calib_core.streams.samples import Sensor
from stillcal.daemon.store.store import Store
from stillcal.replay.outcome import keep_in_store


def test_a_calibration_that_lacks_the_terms_of_the_one_it_replaces_says_so(
    tmp_path: Path, make_record: Any
) -> None:
    step = {"step": TermParameter(value=np.full(3, 0.01), unit="m/s^2")}
    term = Term(effect="accel_charging_bias", sensor=Sensor.ACCELEROMETER, parameters=step)
    before, after = replace(make_record(1), terms=(term,)), make_record(2)
    Store(tmp_path / "store.json").publish(before)
    (said,) = keep_in_store(tmp_path / "store.json", [Publish(0.0, after, "better")])
    assert said.startswith(f"calibration {before.id}, which is replaced, also corrected accel_charging_bias")
    assert not keep_in_store(tmp_path / "store.json", [Publish(1.0, make_record(3), "better")])
    assert not keep_in_store(tmp_path / "new.json", [Publish(0.0, before, "first")])
