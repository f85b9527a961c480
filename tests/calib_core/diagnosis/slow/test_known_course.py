"""A ramp is what a random walk looks like: most of its evidence is lost where the noise is not known."""

from __future__ import annotations

from tests.support.diagnosis.known_course import ramp_against_walk


def test_a_walk_follows_a_ramp() -> None:
    """With the noise known a ramp of d' gains d'^2 / 2."""
    gains = [ramp_against_walk(d, trials=4) for d in (0.0, 6.0, 12.0)]
    assert abs(gains[0]) < 1e-9
    assert 1.0 < gains[1] < gains[2] < 0.15 * 12.0**2 / 2.0
