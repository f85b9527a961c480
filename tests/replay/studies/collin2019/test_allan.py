"""A fit to the whole curve beats a reading of slopes where three noises share the floor."""

import numpy as np

from stillcal.replay.studies.collin2019.allan import NAMES, library_difference, record, recover, rms_error


def test_fit_is_nearer_to_the_truth_than_slopes_are() -> None:
    found = recover(5, 1, lambda share: None)
    for axis, name in enumerate(NAMES):
        assert rms_error(found.fitted[:, axis]) <= rms_error(found.read[:, axis]), name
    # N is known to a percent, so its mean over 15 axes to far less
    assert abs(found.fitted[:, 0].mean() - 1.0) < 0.01


def test_curve_of_simulated_noise_is_allantools() -> None:
    assert library_difference(record((0.025, 0.0025, 1e-4), 600.0, 10.0, 2)[:, 0]) < 1e-9


def test_simulated_white_noise_has_the_density_asked_for() -> None:
    values = record((0.5, 0.0, 0.0), 3600.0, 10.0, 3)
    assert np.allclose(values.std(), 0.5 * np.sqrt(10.0), rtol=3.0 / np.sqrt(2 * values.size))
