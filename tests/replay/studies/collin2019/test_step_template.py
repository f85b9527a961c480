"""Steps by correlation, on a walk whose steps are known."""

from pathlib import Path

import numpy as np
import pytest

from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.replay.studies.claim import Verdict
from stillcal.replay.studies.collin2019.step_template import _better, real_cadences
from stillcal.replay.studies.har.data import read_windows
from stillcal.replay.studies.methods.step_template import WARP, correlation, count, form, places, warped


def a_walk(cadence: float, size: float = 3.0, seconds: float = 60.0) -> Samples:
    """Return a phone upright whose norm swings `cadence` times a second about g."""
    t = np.arange(0.0, seconds, 0.01)
    phase = 2.0 * np.pi * cadence * t
    up = 9.80665 + size * (np.sin(phase) + 0.3 * np.sin(2.0 * phase))
    return Samples(Sensor.ACCELEROMETER, t, np.column_stack((0.0 * t, 0.0 * t, up)))


def test_a_template_finds_the_steps_of_another_walk_of_another_size() -> None:
    template = form([a_walk(1.8)])
    assert template.shape.size == 14  # 25 Hz over 1.8 Hz
    assert count(a_walk(1.8, size=1.0), template) == pytest.approx(1.8 * 60.0, abs=2)
    assert count(a_walk(2.0), template) == pytest.approx(2.0 * 60.0, abs=2)
    # it does not see how large the signal is
    assert count(a_walk(1.8, size=1e-4), template) == count(a_walk(1.8), template)


def test_correlation_is_one_on_the_template_itself_and_none_on_a_constant() -> None:
    template = form([a_walk(1.8)])
    assert correlation(9.8 + 5.0 * template.shape, template) == pytest.approx([1.0])
    assert correlation(9.8 - 2.0 * template.shape, template) == pytest.approx([-1.0])
    assert correlation(np.full(40, 9.8), template) == pytest.approx(0.0)


def test_warping_is_the_correlation_where_nothing_is_bent_and_never_less() -> None:
    template = form([a_walk(1.8)])
    assert warped(9.8 + 5.0 * template.shape, template) == pytest.approx([1.0])
    noise = np.random.default_rng(0).normal(size=200)
    straight, bent = correlation(noise, template), warped(noise, template)
    assert (bent >= straight - 1e-12).all()
    assert bent.max() > straight.max()


def test_warping_follows_a_step_whose_parts_come_late_and_no_further_than_it_may() -> None:
    """A pulse put off by so many samples costs nothing within WARP, and more beyond it."""
    pulse = np.zeros(14)
    pulse[5] = 1.0
    template = form([a_walk(1.8)])
    shape = (pulse - pulse.mean()) / np.linalg.norm(pulse - pulse.mean())
    template = type(template)(shape)
    near, far = (9.8 + np.roll(shape, k) for k in (WARP, WARP + 1))
    assert warped(near, template) == pytest.approx([1.0])
    assert warped(far, template)[0] < 0.5
    assert correlation(near, template)[0] < 0.0


def test_places_of_steps_are_as_far_apart_as_the_steps() -> None:
    walk = a_walk(1.8)
    template = form([walk])
    norm = np.linalg.norm(walk.xyz[::4], axis=1)  # 25 Hz
    for alike in (correlation, warped):
        assert np.median(np.diff(places(norm, template, alike))) == pytest.approx(25.0 / 1.8, abs=0.6)


@pytest.mark.slow
def test_real_walkers_are_judged_by_the_template_of_others(data_dir: Path) -> None:
    walks = read_windows(data_dir).of("walk")
    steps, spectrum = real_cadences(data_dir, correlation)
    others = np.isin(walks.person, walks.people[1::2])
    assert steps.size == spectrum.size == others.sum()
    assert np.nanmedian(steps) == pytest.approx(np.median(spectrum), rel=0.1)


def test_warping_is_an_improvement_where_it_is_off_by_less() -> None:
    cells = [("pocket", "ideal"), ("hand", "ideal"), ("bag", "ideal")]
    less, more = np.array([0.01, -0.01, 0.02]), np.array([0.03, 0.02, -0.02])
    strict = np.ones((2, 3)) * [[-0.2], [-0.01]]
    assert _better(cells, more, less, strict, 14).verdict is Verdict.REPRODUCED
    assert _better(cells, less, more, strict, 14).verdict is Verdict.DIFFERS


@pytest.mark.parametrize(
    "found, strict, shown", [(0.01, 0.09, True), (0.01, 0.11, False), (-0.02, 0.09, False)]
)
def test_nothing_is_to_be_mended_where_no_step_is_lacking(found: float, strict: float, shown: bool) -> None:
    """By a stricter likeness correlation is off by a fifth; warping has to halve that."""
    cells = [("pocket", "ideal"), ("hand", "ideal"), ("bag", "ideal")]
    off = np.ones(3) * [[-0.2], [-strict]]
    claim = _better(cells, np.full(3, found), np.full(3, 0.03), off, 14)
    assert claim.verdict is Verdict.DIFFERS
    assert claim.explained is shown
