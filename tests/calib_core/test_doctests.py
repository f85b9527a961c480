"""The examples in the docstrings of what users call, run."""

from __future__ import annotations

import doctest
import importlib

import pytest

MODULES = {
    "stillcal.calib_core.model": 1,
    "stillcal.calib_core.streams.samples": 1,
    "stillcal.calib_core.gravity": 3,
    "stillcal.calib_core.noise.covariance": 2,
    "stillcal.replay.studies.methods.esgi": 1,
    "stillcal.calib_core.accelerometer.fit": 1,
    "stillcal.calib_core.accelerometer.observability": 2,
    "stillcal.calib_core.gyroscope.bias": 1,
    "stillcal.calib_core.gyroscope.fit": 1,
    "stillcal.daemon.sources.sysfs": 1,
    "stillcal.daemon.service.saved_state": 1,
    "stillcal.daemon.system.plain_words": 1,
    "stillcal.daemon.system.printable": 2,
    "stillcal.daemon.system.requirements": 1,
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
