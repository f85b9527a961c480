"""The examples in the docstrings of what users call, run."""

from __future__ import annotations

import doctest
import importlib

import pytest

MODULES = {
    "stillcal.calib_core.model": 1,
    "stillcal.calib_core.samples": 1,
    "stillcal.calib_core.gravity": 3,
    "stillcal.calib_core.noise": 2,
    "stillcal.calib_core.esgi": 1,
    "stillcal.calib_core.accelerometer": 1,
    "stillcal.calib_core.attitudes": 2,
    "stillcal.calib_core.gyro_bias": 1,
    "stillcal.calib_core.gyroscope": 1,
    "stillcal.daemon.iio_sysfs": 1,
    "stillcal.daemon.watch_words": 1,
}
"""Modules, and how many of their functions have examples at least."""


@pytest.mark.parametrize("name", MODULES)
def test_examples_do_what_they_say(name: str) -> None:
    module = importlib.import_module(name)
    found = [test for test in doctest.DocTestFinder().find(module) if test.examples]
    assert len(found) >= MODULES[name]
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS)
    for test in found:
        runner.run(test)
    assert runner.summarize(verbose=False).failed == 0
