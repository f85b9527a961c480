"""A vibration that one of two recordings states is absent from the other only where that would show it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.comparison.compare import compare
from stillcal.calib_core.diagnosis.comparison.lines_of_both import with_lines_heard
from stillcal.calib_core.diagnosis.comparison.records import Comparison
from stillcal.calib_core.diagnosis.diagnose import examine
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.records import Finding, Parameter
from stillcal.calib_core.diagnosis.noise.lines import line_put_in
from stillcal.calib_core.diagnosis.noise.lines.line import COMES_AND_GOES, WANDERS
from stillcal.calib_core.diagnosis.noise.lines.line_put_in import same_line, would_show
from stillcal.calib_core.diagnosis.noise.lines.spectral_line import AtRest, tones
from stillcal.calib_core.streams.samples import Samples, Sensor

NAMES = ("real.csv", "sim.csv")


def resting(
    seed: int, seconds: float, lines: dict[float, float], rate: float = 50.0, noise: float = 0.02
) -> Samples:
    """Return an accelerometer at rest with lines on x: amplitude (m/s^2) by frequency (Hz)."""
    t = np.arange(0.0, seconds, 1.0 / rate)
    force = np.array([0.3, -0.5, 9.78]) + np.random.default_rng(seed).normal(0.0, noise, (t.size, 3))
    force[:, 0] += sum(size * np.sin(2.0 * np.pi * f * t + seed) for f, size in lines.items())
    return Samples(Sensor.ACCELEROMETER, frozen(t), frozen(force))


def compared(one: Samples, other: Samples) -> Comparison:
    def examined(samples: Samples) -> Examination:
        return examine(samples, None, sought=())

    return compare(examined(one), examined(other), NAMES)


def may_have(samples: Samples, sensor: str, line: Finding) -> bool:
    return line_put_in.may_have(AtRest.of(samples, sensor).brief, line)


def differing(found: Comparison) -> list[tuple[str, str]]:
    return [(d.effect, d.relation) for d in found.discrepancies if d.sensor == "accel"]


@pytest.mark.parametrize("there", [True, False])
def test_a_short_rest_does_not_show_that_a_faint_line_is_absent(there: bool) -> None:
    """The line of half an hour was called superfluous beside a minute that has the same one."""
    long, short = resting(1, 1500.0, {11.0: 2.5e-3}), resting(2, 70.0, {11.0: 2.5e-3 * there})
    (line,) = tones(long, "accel")
    assert tones(short, "accel") == [] and would_show(short, "accel", [line]) == [False]
    assert would_show(resting(2, 1500.0, {}), "accel", [line]) == [True]


def test_one_vibration_at_four_hz_is_no_difference_whichever_side_of_it_it_is_told() -> None:
    """As a vibration of 4.002 Hz and a steady period of 3.999 Hz it was lacking, or superfluous."""
    above, below = resting(1, 400.0, {4.002: 0.03}), resting(2, 400.0, {3.999: 0.03})
    for pair in ((above, below), (below, above)):
        found = compared(*pair)
        assert differing(found) == []
        said = {one.effect: one.reason for one in found.not_compared if "the same one" in one.reason}
        assert sorted(said) == ["unknown", "vibration_tone"]
        assert "its vibration at 4.002 Hz may be the same one" in said["unknown"]
        assert "its steady period at 3.999 Hz may be the same one" in said["vibration_tone"]
    for other in ({}, {4.05: 0.03}):
        assert ("unknown", "lacking") in differing(compared(below, resting(2, 400.0, other)))


@pytest.mark.slow
def test_a_band_that_may_hide_a_line_of_the_other_recording_is_no_absence_of_it() -> None:
    """Its rests would show the line elsewhere, but have as much power at its own frequency."""
    plain, rng = resting(2, 400.0, {}), np.random.default_rng(4)
    phase = 2.0 * np.pi * 11.0 * plain.t + np.cumsum(rng.normal(0.0, 0.2, plain.t.size))
    band = replace(plain, xyz=frozen(plain.xyz + np.outer(0.03 * np.sin(phase), [1.0, 0.0, 0.0])))
    steady = resting(1, 400.0, {11.0: 0.006})
    (line,) = tones(steady, "accel")
    assert tones(band, "accel") == [] and would_show(band, "accel", [line]) == [True]
    for pair in ((steady, band), (band, steady)):
        found = compared(*pair)
        assert "vibration_tone" not in [effect for effect, _ in differing(found)]
        assert "not show one of this size" in next(
            one.reason for one in found.not_compared if one.effect == "vibration_tone"
        )


def test_a_line_that_is_absent_is_told_where_it_would_show_alone() -> None:
    faint = {11.0: 2.5e-3}
    assert differing(compared(resting(1, 1500.0, {}), resting(2, 1500.0, faint))) == [
        ("vibration_tone", "superfluous")
    ]
    found = compared(resting(1, 70.0, faint), resting(2, 1500.0, faint))
    assert differing(found) == []
    untold = [m.reason for m in found.not_compared if (m.effect, m.sensor) == ("vibration_tone", "accel")]
    assert untold == ["real.csv: its rests would not show one of this size"]


def lying(seed: int, ups: Sequence[Array], shaken: float) -> Samples:
    """Return rests of 200 s in some attitudes on what shakes upright by `shaken` m/s^2 at 11 Hz."""
    t = np.arange(0.0, 200.0 * len(ups), 0.02)
    up = np.repeat(ups, t.size // len(ups), axis=0)
    force = up * (9.81 + shaken * np.sin(2.0 * np.pi * 11.0 * t + seed))[:, None]
    force += np.random.default_rng(seed).normal(0.0, 0.02, force.shape)
    return Samples(Sensor.ACCELEROMETER, frozen(t), frozen(force))


@pytest.mark.parametrize("times", [1.0, 2.0])
def test_what_a_device_lies_on_shakes_other_axes_in_other_attitudes(times: float) -> None:
    """By its axes the same vibration was another one; its size is what two recordings can be asked for."""
    x, y, z = np.eye(3)
    found = compared(lying(1, [z, z, x], 0.03), lying(2, [y, z, y], 0.03 * times))
    said = [(d.effect, d.relation) for d in found.discrepancies if "vibration" in d.effect]
    assert said == ([] if times == 1.0 else [("vibration_tone", "too_large")])
    assert [d.effect for d in found.discrepancies if d.effect == "unknown"] == []


def test_a_line_and_its_alias_may_be_one() -> None:
    assert same_line(33.0, 17.0, 50.0) and not same_line(33.0, 17.0, 100.0)
    assert not same_line(33.0, 18.0, 50.0)
    found = compared(resting(1, 400.0, {33.0: 0.01}), resting(2, 400.0, {33.0: 0.01}, rate=100.0))
    assert "vibration_tone" not in [effect for effect, _ in differing(found)]
    untold = [m.reason for m in found.not_compared if m.effect == "vibration_tone"]
    assert "sim.csv: its vibration at 33 Hz may be the same one, folded back" in untold


@pytest.mark.parametrize("gated", [0, 1])
def test_a_line_that_comes_and_goes_in_one_of_two_is_told_once(gated: int) -> None:
    """It was lacking and superfluous, by two names."""
    pair = [resting(seed, 900.0, {12.0: 0.015}) for seed in (1, 2)]
    pair[gated] = _off_every_other(pair[gated], resting(1 + gated, 900.0, {}))
    (told,) = compared(*pair).discrepancies
    assert (told.effect, told.relation) == ("unknown", ("lacking", "superfluous")[gated])
    own = (told.recorded, told.simulated)[gated]
    assert own is not None and own.remark.endswith(
        f"In {NAMES[1 - gated]} the vibration at 12 Hz is steady instead."
    )


def test_a_line_that_comes_and_goes_in_both_may_seem_steady_in_the_fainter_one() -> None:
    """It was lacking: in rests of 100 s it seems to be there all along, as one put in there does."""

    def gated(seed: int, seconds: float) -> Samples:
        off = resting(seed, seconds, {})
        return _off_every_other(resting(seed, seconds, {9.03: 0.01}), off, 30.0)

    found = compared(gated(1, 900.0), gated(2, 100.0))
    assert differing(found) == []
    untold = [m.reason for m in found.not_compared if (m.effect, m.sensor) == ("vibration_tone", "accel")]
    assert untold == ["sim.csv: its rests would not show that a vibration comes and goes"]


def test_a_line_that_comes_and_goes_is_put_in_so() -> None:
    """A steady one of its power keeps its phase, and shows where none of its spells does."""
    on = resting(1, 900.0, {9.03: 0.01})
    (line,) = tones(_off_every_other(on, resting(1, 900.0, {}), 30.0), "accel")
    steady = replace(line, effect="vibration_tone", where=replace(line.where, driver="time"))
    louder = resting(2, 900.0, {}, noise=0.08)
    assert would_show(louder, "accel", [steady]) == [True]
    assert would_show(louder, "accel", [line]) == [False]
    assert would_show(resting(2, 900.0, {}), "accel", [line]) == [True]


def on_its_way(whole: Samples, hz: float) -> Samples:
    """Return a phone that is turned for 6 of 50 s, and lay on something that shakes for the fifth rest."""
    rng, k, turning = np.random.default_rng(4), (whole.t / 50.0).astype(int), whole.t % 50.0 > 44.0
    ways = rng.normal(0.0, 1.0, (k[-1] + 1, 3))
    ways *= 9.81 / np.linalg.norm(ways, axis=1, keepdims=True)
    xyz = (
        whole.xyz
        - whole.xyz.mean(axis=0)
        + ways[k]
        + np.outer(turning, [1.0, 1.0, 1.0]) * 4.0 * rng.normal(size=(whole.t.size, 3))
    )
    xyz[:, 0] += 0.05 * np.sin(2.0 * np.pi * hz * whole.t) * ((k == 4) & ~turning)
    return replace(whole, xyz=frozen(xyz))


@pytest.mark.slow
@pytest.mark.parametrize("of_recording", [True, False])
def test_beside_what_one_lay_on_a_vibration_of_the_other_is_told(of_recording: bool) -> None:
    """One of 11 Hz, all along the other recording, was not compared for that, and the verdict was a match."""
    lay = on_its_way(resting(1, 800.0, {}), 17.3)
    for hz, said in ((11.0, 1), (17.3, 0)):
        pair = (resting(2, 800.0, {hz: 0.05}), lay)
        found = compared(*(pair if of_recording else pair[::-1]))
        told = [relation for effect, relation in differing(found) if effect == "vibration_tone"]
        assert told.count("lacking" if of_recording else "superfluous") == said


def test_the_gyroscopes_part_is_compared_where_the_other_recording_only_lay_on_it() -> None:
    """The other one does not state the accelerometer's line either; the gyroscope's was not compared."""
    (felt,) = tones(resting(1, 400.0, {17.3: 0.03}), "accel")
    heard = replace(felt, sensor="gyro")

    def exam(passing: list[Finding]) -> Examination:
        lines = {"accel": [felt], "gyro": [heard]}
        streams = [SimpleNamespace(sensor=s, lines=f, passing=passing) for s, f in lines.items()]
        return cast("Examination", SimpleNamespace(streams=streams))

    states, lay = exam([]), exam([felt])
    assert with_lines_heard(([felt], []), (states, lay)) == ([felt, heard], [])
    assert with_lines_heard(([], [felt]), (lay, states)) == ([], [felt, heard])
    assert with_lines_heard(([felt], []), (states, states)) == ([felt], [])


def _off_every_other(on: Samples, off: Samples, seconds: float = 40.0) -> Samples:
    every: Array = (on.t // seconds) % 2.0
    return Samples(on.sensor, on.t, frozen(np.where(every[:, None] == 0.0, on.xyz, off.xyz)))


FIVE = {7.13: 0.03, 10.871: 0.03, 13.957: 0.03, 17.713: 0.03, 21.631: 0.03}


@pytest.mark.slow
def test_a_line_is_missed_beside_however_many_others() -> None:
    """Three lines are stated of any rests: beside those that they had, none that was put in was seen."""
    four = {8.317: 0.03, 12.27: 0.03, 15.83: 0.03, 19.87: 0.03}
    own, other = resting(1, 200.0, FIVE), resting(2, 200.0, four)
    found = [relation for effect, relation in differing(compared(own, other)) if effect == "vibration_tone"]
    assert sorted(found) == ["lacking"] * 3 + ["superfluous"] * 3


def test_lines_of_both_that_one_does_not_state_are_compared() -> None:
    """Of five lines, those were compared that were among the three surest of both, by chance."""
    found = compared(resting(1, 200.0, FIVE), resting(3, 200.0, FIVE))
    assert differing(found) == []
    assert [m for m in found.not_compared if (m.effect, m.sensor) == ("vibration_tone", "accel")] == []
    halved = compared(resting(1, 200.0, FIVE), resting(3, 200.0, dict.fromkeys(FIVE, 0.015)))
    assert len(differing(halved)) >= 3 and set(differing(halved)) == {("vibration_tone", "too_small")}


def test_a_line_is_put_in_where_no_other_is() -> None:
    """A line of 12 Hz was taken for one of 11 Hz that was put in at 12 Hz."""
    (line,) = tones(resting(1, 1500.0, {11.0: 2.5e-3}), "accel")
    short = resting(2, 70.0, {12.0: 0.05})
    assert would_show(short, "accel", [line], tones(short, "accel")) == [False]


@pytest.mark.parametrize(
    ("sizes", "told"),
    [((0.004, 0.0), "lacking"), ((0.0, 0.004), "superfluous"), ((0.004, 0.002), "too_small")],
)
def test_a_vibration_of_both_is_compared_in_the_gyroscope_too(sizes: tuple[float, float], told: str) -> None:
    """It was told with the accelerometer's line, and then compared in that alone."""

    def examined(seed: int, size: float) -> Examination:
        force = resting(seed, 200.0, {12.3: 0.04})
        rate = np.random.default_rng(seed + 5).normal(0.0, 0.002, force.xyz.shape)
        rate[:, 2] += size * np.sin(2.0 * np.pi * 12.3 * force.t)
        return examine(force, Samples(Sensor.GYROSCOPE, force.t, frozen(rate)), sought=())

    found = compare(examined(1, sizes[0]), examined(2, sizes[1]), NAMES)
    lines = [(d.sensor, d.relation) for d in found.discrepancies if d.effect == "vibration_tone"]
    assert lines == [("gyro", told)]


def wandering(seed: int, seconds: float, part: float, middle: float = 13.1) -> Samples:
    """Return an accelerometer at rest beside a fan whose speed (Hz) goes at random by so much of it."""
    samples = resting(seed, seconds, {})
    course = np.cumsum(np.random.default_rng(seed + 1).standard_normal(samples.t.size))
    course -= np.linspace(course[0], course[-1], course.size)
    turned = np.cumsum(middle * (1.0 + part * course / np.abs(course).max())) / 50.0
    xyz = np.array(samples.xyz)
    xyz[:, 0] += 0.1 * np.sin(2.0 * np.pi * turned)
    return Samples(samples.sensor, samples.t, frozen(xyz))


@pytest.mark.parametrize("part", [0.01, 0.03])
def test_a_fan_that_wanders_in_both_is_no_difference(part: float) -> None:
    """By 1 to 3 % in 900 and in 300 s its lines had different amplitudes, and different parts of the time."""
    assert differing(compared(wandering(1, 900.0, part), wandering(2, 300.0, part))) == []


def test_a_fan_that_wanders_is_told_beside_a_steady_one_and_beside_none() -> None:
    real, steady = wandering(3, 300.0, 0.05), wandering(4, 200.0, 0.0)
    (found,) = compared(real, steady).discrepancies
    assert (found.effect, found.relation) == ("unknown", "lacking")
    assert found.recorded is not None
    assert "In sim.csv the vibration at 13.1 Hz is steady instead." in found.recorded.remark
    (found,) = compared(steady, real).discrepancies
    assert (found.effect, found.relation) == ("unknown", "superfluous")
    assert differing(compared(real, resting(5, 200.0, {}))) == [("unknown", "lacking")]


def test_too_short_a_rest_does_not_show_that_a_fan_does_not_wander() -> None:
    found = compared(wandering(3, 300.0, 0.05), resting(5, 45.0, {}))
    assert differing(found) == []


def test_a_fan_that_wanders_a_little_may_be_as_steady_as_another_one() -> None:
    assert differing(compared(wandering(3, 300.0, 0.006), wandering(4, 100.0, 0.0))) == []


def test_fans_whose_speeds_overlap_may_be_one() -> None:
    """Their middles are 8 % apart."""
    found = compared(wandering(1, 300.0, 0.1), wandering(2, 300.0, 0.1, 13.6))
    assert differing(found) == []
    said = [m.reason for m in found.not_compared if "may be the same one" in m.reason]
    assert said, [m.reason for m in found.not_compared]


def test_a_line_whose_power_is_there_may_be_there_however_it_moves() -> None:
    """One of an engine was lacking and superfluous, as it was not among those that the other one states."""
    (line,) = tones(resting(1, 600.0, {11.0: 0.01}), "accel")
    none, half = resting(2, 600.0, {}), resting(3, 600.0, {11.0: 4e-3})
    assert [may_have(one, "accel", line) for one in (none, half)] == [False, False]
    t = none.t
    broad = np.cumsum(np.random.default_rng(4).normal(0.0, 0.03, t.size))
    moves = none.xyz + 0.012 * np.outer(np.sin(2.0 * np.pi * 11.1 * t + broad), [1.0, 0.0, 0.0])
    assert may_have(replace(none, xyz=frozen(moves)), "accel", line)
    for_a_while = none.xyz + (moves - none.xyz) * (np.abs(t - 200.0) < 100.0)[:, None]
    brief = replace(line, parameters=line.parameters | {"fraction": Parameter(0.3, [0.25, 0.35], "1")})
    assert may_have(replace(none, xyz=frozen(for_a_while)), "accel", brief)
    rests_of_12_s = [replace(none, xyz=frozen(xyz)).where(t % 15.0 < 12.0) for xyz in (moves, none.xyz)]
    assert [may_have(one, "accel", line) for one in rests_of_12_s] == [True, False]
    assert not may_have(none, "accel", brief)


def test_spells_have_their_share_of_the_power_and_what_wanders_is_at_no_frequency() -> None:
    """A line of 10 mm/s^2 for 20 s of every 80 may be in rests that have it so, and in none of a fan."""
    on, off = resting(1, 960.0, {11.0: 0.01}), resting(2, 960.0, {})
    spells = (off.t % 80.0 < 20.0)[:, None]
    (line,) = tones(on, "accel")
    share = {"fraction": Parameter(0.25, [0.2, 0.3], "1")}
    gated = replace(
        line, where=replace(line.where, driver=COMES_AND_GOES), parameters=line.parameters | share
    )
    assert may_have(replace(off, xyz=frozen(np.where(spells, on.xyz, off.xyz))), "accel", gated)
    assert not may_have(off, "accel", gated)
    wanders = replace(line, where=replace(line.where, driver=WANDERS))
    assert may_have(on, "accel", line) and not may_have(on, "accel", wanders)
