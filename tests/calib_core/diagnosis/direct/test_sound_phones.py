"""What most real phones do is no finding; what none of them does is one."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.diagnose import examine
from stillcal.calib_core.diagnosis.direct.halves import borne_out
from stillcal.calib_core.diagnosis.model.measurement import DirectEvidence, Measured, direct_finding
from stillcal.calib_core.diagnosis.model.records import Finding, Where
from stillcal.calib_core.diagnosis.model.sound_phones import sound_phones
from stillcal.calib_core.diagnosis.noise import noise_level
from stillcal.calib_core.diagnosis.noise.low_pass import Quiet, judged
from stillcal.replay.formats.hhar_still import recordings
from stillcal.replay.real_data.sound_phones import unlike_halves

WHERE = Where(0.0, 1.0, (0.0, 1.0), "noise at rest")


def unequal(sensor: str, ratio: Sequence[float], seed: int = 0, claim: float | None = None) -> list[Finding]:
    noise = np.random.default_rng(seed).normal(size=(20, 1000, 3)) * np.asarray(ratio)
    seen = judged(Quiet(tuple(noise), tuple(10.0 * np.arange(20)), 100.0))
    assert seen is not None
    return noise_level.noise_findings(sensor, noise_level.levels(seen), claim, sound_phones(), WHERE)


def test_z_of_an_accelerometer_is_louder_and_that_is_sound() -> None:
    for z in (1.0, 1.25, 1.5, 1.7):
        assert unequal("accel", (1.0, 1.0, z)) == [], z


def test_a_declared_density_is_of_no_axis_by_itself() -> None:
    """Of five real gyroscopes two have an x axis a quarter and a third louder than y; a fifth is no fault."""
    claim = 1.05 * np.sqrt(2.0 / 100.0)
    assert unequal("gyro", (1.17, 0.98, 1.03), claim=claim) == []
    found = unequal("gyro", (1.0, 1.4, 1.0), claim=claim)
    assert [f.axes for f in found if f.effect == "noise_unequal_axes"] == [["y"]]


@pytest.mark.parametrize(
    ("sensor", "ratio", "axis"),
    [("accel", (1.0, 1.0, 6.0), "z"), ("accel", (8.0, 1.0, 1.4), "x"), ("gyro", (1.0, 4.0, 1.0), "y")],
)
def test_an_axis_as_loud_as_in_no_phone_is_named(sensor: str, ratio: tuple[float, ...], axis: str) -> None:
    found = unequal(sensor, ratio)
    assert [(f.effect, f.axes) for f in found] == [("noise_unequal_axes", [axis])]
    own = float(np.asarray(found[0].parameters["ratio"].value)["xyz".index(axis)])
    others = [r for r, a in zip(ratio, "xyz", strict=True) if a != axis]
    assert own == pytest.approx(max(ratio) / np.sqrt(np.prod(others)), rel=0.05)
    assert "None of" in found[0].statement


def test_a_spectrum_that_falls_all_over_the_band_is_no_filtered_noise() -> None:
    """A bias that walks strongly: its noise has no level, and a declared one is not judged by it."""
    pieces = np.cumsum(np.random.default_rng(0).normal(size=(20, 500, 3)), axis=1)
    seen = judged(
        Quiet(tuple(pieces - pieces.mean(axis=1, keepdims=True)), tuple(20.0 * np.arange(20)), 25.0)
    )
    assert seen is not None and seen.low_pass is None
    levels = noise_level.levels(seen)
    assert not levels.white and np.isfinite(levels.values()).all()
    for claim in (1e-3, 3.0 * float(levels.values().max())):
        assert noise_level.noise_findings("gyro", levels, claim, sound_phones(), WHERE) == []


def test_a_half_that_speaks_against_the_noise_of_the_whole_takes_it_back() -> None:
    found = direct_finding("bandwidth", "accel", [0], WHERE, {}, statement="", seen=DirectEvidence(99.0))
    assert found is not None
    narrow, flat = {"bandwidth": Measured(-3.5, 0.02)}, {"bandwidth": Measured(-0.69, 0.02)}
    assert borne_out(found, [narrow, narrow], sound_phones(), None)
    assert not borne_out(found, [narrow, flat], sound_phones(), None)
    assert borne_out(found, [{}, narrow], sound_phones(), None), "a half that cannot tell"
    assert not borne_out(found, [{}, {}], sound_phones(), None), "a few rests, of which one may decide"


def test_two_real_phones_on_a_table_are_silent(data_dir: Path) -> None:
    """A Nexus 4 and a Galaxy S3 mini, each on several faces."""
    silent = [r for r in recordings(data_dir / "hhar_still") if r.device in ("it-137", "3Renault-AH")]
    assert len(silent) >= 10
    said = [s.finding.statement for r in silent for s in examine(r.samples, None).statements]
    assert said == []


UNLIKE = (
    ("HTC-Desire", "it-124", "Phoneonback"),
    ("Samsung-Galaxy-S+", "it-126", "Phoneonbottom"),
    ("Samsung-Galaxy-S+", "it-116", "Phoneonfront"),
    ("HTC-Desire", "it-135", "Phoneonfront"),
    ("LG-Nexus4", "it-140", "Phoneontop"),
    ("Xsens-reference", "xsens", "Phoneonback"),
)
"""Recordings whose halves differed by their steps, jitter or low-pass: one half was just judged otherwise."""


def test_halves_of_a_real_recording_do_not_differ(data_dir: Path) -> None:
    """All 190: `python -m stillcal.replay.real_data.sound_phones FOLDER --halves`."""
    chosen = [r for r in recordings(data_dir / "hhar_still") if (r.model, r.device, r.position) in UNLIKE]
    assert len(chosen) == len(UNLIKE)
    assert [(r.device, d.effect) for r in chosen for d in unlike_halves(r)] == []


@pytest.mark.slow
def test_few_real_recordings_differ_from_half_to_half(data_dir: Path) -> None:
    recorded = recordings(data_dir / "hhar_still")
    unlike = [r for r in recorded if unlike_halves(r)]
    assert len(recorded) == 190 and len(unlike) <= 0.04 * len(recorded)
