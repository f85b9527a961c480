"""Low-passes of a recording and a simulation, whether sound phones have such ones or not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.comparison.coverage.looked_for import direct_checks
from stillcal.calib_core.diagnosis.comparison.noise.white_noise import LOW_PASS, of_both, why_not_measured
from stillcal.calib_core.diagnosis.comparison.pair.samples_apart.compare_samples import compare_samples
from stillcal.calib_core.diagnosis.diagnose import examine
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.measurement import Measured
from stillcal.calib_core.diagnosis.noise.low_pass import LowPass, may_be_behind
from stillcal.calib_core.diagnosis.noise.noise_level import levels
from stillcal.calib_core.streams.samples import Samples, Sensor
from tests.support.diagnosis.turned_pairs import low_passed

RATE, KEY = 100.0, ("bandwidth", "accel")


def still(cutoff: float | None, seed: int, rate: float = RATE) -> Examination:
    """Return ten minutes at rest behind a low-pass. cutoff: Hz."""
    n = int(600.0 * rate)
    xyz = np.random.default_rng(seed).normal([0.0, 0.0, 9.80665], 0.02, (n, 3))
    made = Samples(Sensor.ACCELEROMETER, np.arange(n) / rate, xyz)
    return examine(made if cutoff is None else low_passed(made, cutoff / rate), None, sought=())


@pytest.mark.parametrize(
    ("recorded", "simulated", "relation"),
    [
        (20.0, None, "lacking"),
        (None, 20.0, "superfluous"),
        (8.0, 20.0, "too_large"),
        (20.0, 8.0, "too_small"),
        (20.0, 20.0, "agreed"),
    ],
)
def test_the_cutoffs_of_both_are_compared(
    recorded: float | None, simulated: float | None, relation: str
) -> None:
    said = compare_samples((still(recorded, 1), still(simulated, 2)), ("rec", "sim"))
    found = [(d.effect, d.relation) for d in said.discrepancies]
    if relation == "agreed":
        assert found == [] and "bandwidth" in {d.recorded.effect for d in said.agreed}
        return
    assert ("bandwidth", relation) in found
    (one,) = (d.difference for d in said.discrepancies if d.effect == "bandwidth")
    assert one is not None
    for quantity, cutoff in ((one.recorded, recorded), (one.simulated, simulated)):
        assert quantity.none == (cutoff is None)
        if cutoff is not None:
            assert np.exp(quantity.value) == pytest.approx([cutoff], rel=0.06)
            assert quantity.reference == {"order": 2}


def test_a_simulation_without_noise_lacks_the_low_pass_of_noise() -> None:
    """Only the noise was told: put in without the low-pass, it did not pass the comparison."""
    t = np.arange(60000) / RATE
    drift = np.array([0.0, 0.0, 9.8]) + np.outer(t, [1e-5, 2e-5, 1e-5])
    silent = examine(Samples(Sensor.ACCELEROMETER, t, drift), None, sought=())
    said = compare_samples((still(20.0, 1), silent), ("rec", "sim"))
    assert {(d.effect, d.relation) for d in said.discrepancies} == {
        ("noise_level", "lacking"), ("bandwidth", "lacking")
    }  # fmt: skip


def test_where_neither_has_one_nothing_is_told() -> None:
    exams = still(None, 1), still(None, 2)
    assert all(LOW_PASS not in {effect for effect, _ in side} for side in of_both(exams))
    said = compare_samples(exams, ("rec", "sim"))
    assert said.discrepancies == [] and KEY not in {(n.effect, n.sensor) for n in said.not_compared}


def held(share: float, seed: int, rate: float = RATE) -> Examination:
    """Return 6000 still samples of which a share repeats the one before."""
    rng = np.random.default_rng(seed)
    xyz = rng.normal([0.0, 0.0, 9.80665], 0.02, (6000, 3))
    last = np.maximum.accumulate(np.where(rng.random(6000) < share, 0, np.arange(6000)))
    return examine(Samples(Sensor.ACCELEROMETER, np.arange(6000) / rate, xyz[last]), None, sought=())


@pytest.mark.parametrize(("recorded", "simulated"), [(0.2, 0.0), (0.0, 0.2), (0.2, 0.2)])
def test_what_repeated_values_do_to_the_spectrum_is_no_noise_and_no_low_pass(
    recorded: float, simulated: float
) -> None:
    """A fifth repeated made 1.22 times the noise and a low-pass of 0.36 times the rate besides."""
    seeds = (1, 2) if recorded else (2, 1)
    said = compare_samples((held(recorded, seeds[0]), held(simulated, seeds[1])), ("rec", "sim"))
    alike = recorded == simulated
    assert [d.effect for d in said.discrepancies] == ([] if alike else ["held_samples"])
    whys = {n.effect: n.reason for n in said.not_compared}
    for effect in ("noise_level", "bandwidth"):
        assert (effect in whys) == (not alike)
        assert alike or "repeat the one before" in whys[effect]


def test_the_low_pass_of_repeated_values_is_compared_at_one_rate_only() -> None:
    """A simulation with as many, at twice the rate, had a cutoff that was "too large"."""
    said = compare_samples((held(0.2, 1), held(0.2, 2, 2.0 * RATE)), ("rec", "sim"))
    assert "bandwidth" not in {d.effect for d in said.discrepancies}
    assert "repeat the one before" in {n.effect: n.reason for n in said.not_compared}["bandwidth"]


def test_the_low_pass_of_repeated_values_is_not_compared_where_one_alone_shows_it() -> None:
    """Of a sixth repeated some recordings have a cutoff near half the rate."""
    exams = held(0.17, 1), held(0.17, 5)
    shown = [s.spectra is not None and s.spectra.low_pass is not None for e in exams for s in e.streams]
    assert shown == [True, False]
    said = compare_samples(exams, ("rec", "sim"))
    assert said.discrepancies == []
    assert "repeat the one before" in {n.effect: n.reason for n in said.not_compared}["bandwidth"]


def test_the_noise_of_repeated_values_is_not_said_to_be_looked_at() -> None:
    whys = {c.effect: c.reason for c in direct_checks(held(0.2, 1)) if c.sensor == "accel"}
    for effect in ("noise_heavy_tailed", "bandwidth", "noise_unequal_axes"):
        assert "repeat the one before" in (whys[effect] or "")


def test_a_rate_too_low_to_show_a_cutoff_says_nothing_of_it() -> None:
    slow = still(None, 2, rate=40.0)
    sides = of_both((still(20.0, 1), slow))
    assert [KEY in side for side in sides] == [True, False]
    assert why_not_measured("bandwidth", slow.streams[0]) == "its rate is too low to show it"


@pytest.mark.parametrize(("error", "differ"), [(0.01, True), (12.0, False)])
def test_what_an_unsure_low_pass_takes_off_is_no_difference_of_the_noise(error: float, differ: bool) -> None:
    """Noise of one size, a hand's tremor beside it: a filter that one of the two seemed to have made it less
    in the other, by a fifth."""
    exams = still(None, 1), still(None, 2)
    plain = exams[0].streams[0]
    assert plain.spectra is not None and plain.levels is not None
    shape = 1.0 / (1.0 + (plain.spectra.f / 32.0) ** 2)
    behind = LowPass(Measured(32.0, error), shape, 10.0, 1, 0.0, Measured(0.0, 0.0))
    filtered = replace(plain.spectra, low_pass=behind)
    stream = replace(plain, spectra=filtered, levels=levels(filtered))
    assert stream.levels is not None
    (own, _) = of_both((replace(exams[0], streams=[stream]), exams[1]))
    expected = (stream if differ else plain).levels
    assert expected is not None
    assert np.exp(own["noise_level", "accel"].value) == pytest.approx(expected.values())
    assert stream.levels.values() == pytest.approx(1.3 * plain.levels.values(), rel=0.15)


def test_low_passes_that_both_show_take_their_part_off_both() -> None:
    """They agree, though neither is sure: the noise before them is that of each alone."""
    exams = still(None, 1), still(None, 2)
    filtered = []
    for exam in exams:
        (plain,) = exam.streams
        assert plain.spectra is not None
        shape = 1.0 / (1.0 + (plain.spectra.f / 32.0) ** 2)
        behind = LowPass(Measured(32.0, 12.0), shape, 10.0, 1, 0.0, Measured(0.0, 0.0))
        spectra = replace(plain.spectra, low_pass=behind)
        filtered.append(replace(exam, streams=[replace(plain, spectra=spectra, levels=levels(spectra))]))
    for side, exam in zip(of_both(filtered), filtered, strict=True):
        own = exam.streams[0].levels
        assert own is not None
        assert np.exp(side["noise_level", "accel"].value) == pytest.approx(own.values())


def test_a_low_pass_that_the_other_may_have_as_well_is_no_difference() -> None:
    """Two recordings of one sensor may be just sure of its low-pass, and just not."""
    exams = [still(20.0, 1), still(20.0, 2)]
    unsure = [replace(s, spectra=replace(s.spectra, low_pass=None)) for s in exams[1].streams if s.spectra]
    sides = of_both([exams[0], replace(exams[1], streams=unsure)])
    assert [KEY in side for side in sides] == [True, False]
    assert why_not_measured("bandwidth", unsure[0], sides[0][KEY]) == "its noise may be behind it as well"
    said = compare_samples((exams[0], replace(exams[1], streams=unsure)), ("rec", "sim"))
    assert said.discrepancies == [] and "bandwidth" in {n.effect for n in said.not_compared}


@pytest.mark.parametrize(("cutoff", "may_be"), [(20.0, True), (18.5, True), (None, False)])
def test_noise_tells_whether_it_may_be_behind_a_low_pass(cutoff: float | None, may_be: bool) -> None:
    found, spectra = (still(c, seed).streams[0].spectra for c, seed in ((20.0, 1), (cutoff, 2)))
    assert found is not None and found.low_pass is not None and spectra is not None
    sure = replace(found.low_pass, cutoff=Measured(found.low_pass.cutoff.value, 1.0))
    assert may_be_behind(spectra, sure, sure.axes) == may_be
