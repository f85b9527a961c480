"""Real recordings through the diagnosis: the tables' parts on small cases, one whole path on real data."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stillcal.calib_core.diagnosis.segments.static_bins import Bins
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.formats.claims import Claims
from stillcal.replay.formats.trace import Recording
from stillcal.replay.real_data.optical_reference import compare_with_cameras
from stillcal.replay.real_data.sources import Source, part, sources, without_thermometer
from stillcal.replay.real_data.tables import Injected, agreement, names, row, tally
from stillcal.replay.real_data.withheld_thermometer import correlation, shared_curve, withheld


def bins(curve: np.ndarray, seed: int = 0) -> Bins:
    rng = np.random.default_rng(seed)
    n = curve.size
    noise = 1e-3 * rng.standard_normal((n, 6))
    channels = noise + np.outer(curve, [1e-2, 0, -5e-3, 0, 2e-2, 0])
    return Bins(
        t=10.0 * np.arange(n),
        duration=np.full(n, 10.0),
        rest=np.zeros(n, dtype=np.intp),
        force=channels[:, :3] + [0.0, 0.0, 9.8],
        force_variance=np.full((n, 3), 1e-6),
        vibration=np.ones(n),
        activity=np.zeros((1, 2)),
        span=(0.0, 10.0 * n),
        rate=channels[:, 3:],
        rate_variance=np.full((n, 3), 1e-6),
    )


def test_the_shared_curve_is_the_one_that_moves_the_channels() -> None:
    truth = np.sin(np.arange(60) / 9.0)
    curve, share = shared_curve(bins(truth))
    assert abs(correlation(curve, truth)) > 0.99 and share > 0.9


def test_white_channels_share_no_curve() -> None:
    _, share = shared_curve(bins(np.zeros(60)))
    assert share < 0.35  # a sixth, and what the largest of six eigenvalues exceeds it by with 60 bins


def test_channels_that_do_not_move_share_no_curve() -> None:
    """Coarse values may be one and the same in a whole rest."""
    still = bins(np.zeros(20))
    same = replace(still, force=np.full((20, 3), 5.0), rate=np.zeros((20, 3)))
    curve, share = shared_curve(same)
    assert share == 0.0 and not curve.any()


def test_members_of_a_set_count_as_named() -> None:
    finding = {
        "effect": "accel_warmup",
        "sensor": "accel",
        "alternatives": [
            {"effect": "accel_bias_drift", "indistinguishable": True},
            {"effect": "accel_bias_step", "indistinguishable": False},
        ],
    }
    assert names([finding]) == {("accel_warmup", "accel"), ("accel_bias_drift", "accel")}


def test_injections_are_counted_by_effect_and_strength() -> None:
    results = [Injected("a", 1.0, str(i), said, ()) for i, said in enumerate(("right", "right", "nothing"))]
    assert tally(results)[("a", 1.0)] == {"right": 2, "nothing": 1}


def test_the_thermometers_curve_is_in_the_sensors(data_dir: Path) -> None:
    """Ten minutes of an MPU-6050: no shift of the temperature fits the channels' curve as well."""
    held = list(sources(data_dir, "sunsided"))
    still = next(s for s in held if "still" in s.name)
    compared = withheld(still, [s for s in held if s is not still])
    assert compared is not None
    assert compared.chance < 0.05 and abs(compared.correlation) > 0.5
    assert without_thermometer(still.recording).accelerometer.temperature is None


@pytest.mark.slow
def test_a_row_says_what_the_halves_say(data_dir: Path) -> None:
    source = next(sources(data_dir, "broad"))
    told = row(source)
    assert source.optical is not None and len(source.optical) == len(source.recording.accelerometer)
    assert told.verdict in ("match", "identified", "partly_identified", "unidentified", "not_judged")
    for finding in told.findings:
        assert "first half" in agreement(told, finding, [told])
    first = part(source.recording, 0.0, 0.5)
    assert len(first.accelerometer) == pytest.approx(len(source.recording.accelerometer) / 2, abs=2)


def test_cameras_tell_bias_and_scale_from_squares_of_the_rate() -> None:
    """A gyroscope with all three beside cameras without noise: each model takes off what is its own."""
    rng = np.random.default_rng(4)
    t = np.arange(3000) / 100.0
    rate = np.cumsum(rng.normal(0.0, 0.05, (t.size, 3)), axis=0)
    rate -= np.linspace(0.0, 1.0, t.size)[:, None] * rate[-1]
    middle = [Rotation.from_rotvec(w / 100.0) for w in (rate[1:] + rate[:-1]) / 2.0]
    poses = [Rotation.identity()]
    for turn in middle:
        poses.append(poses[-1] * turn)
    truth = Rotation.concatenate(poses).as_quat()[:, [3, 0, 1, 2]]
    wrong = rate * 1.01 + 0.02 + np.array([0.01, 0.0, 0.0]) * rate**2
    still = Samples.checked(Sensor.ACCELEROMETER, t, np.zeros((t.size, 3)))
    recording = Recording(still, Samples.checked(Sensor.GYROSCOPE, t, wrong), [], Claims(), [])
    found = compare_with_cameras(Source("made", "made", recording, truth))
    assert found is not None and found.seconds == 29
    assert found.raw > 1.0 and found.affine < 0.6 * found.raw and found.squares < 0.1 * found.affine
