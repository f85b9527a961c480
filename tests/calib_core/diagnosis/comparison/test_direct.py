"""Effects that samples show directly: the numbers of two findings, side by side."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.diagnosis.comparison.compare import compare
from stillcal.calib_core.diagnosis.comparison.coverage.looked_for import checks_of
from stillcal.calib_core.diagnosis.comparison.direct import (
    direct_statements,
    pair_of,
    partner,
    quantities_of,
    stamp_quantities,
    step_of_other,
)
from stillcal.calib_core.diagnosis.comparison.quantity import Difference, Quantity, posterior, subtract
from stillcal.calib_core.diagnosis.diagnose import examine
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.measurement import DirectEvidence, direct_finding, sized
from stillcal.calib_core.diagnosis.model.records import Evidence, Finding, Parameter, Where
from stillcal.calib_core.diagnosis.noise.lines.spectral_line import tones
from stillcal.calib_core.streams.samples import Samples, Sensor


def shaken(amplitude: float, seed: int, hertz: float = 13.7) -> Samples:
    """Return ten minutes on a table that vibrates along z, m/s^2."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 600.0, 0.02)
    xyz = np.array([0.0, 0.0, 9.81]) + rng.normal(0.0, 0.01, (t.size, 3))
    xyz[:, 2] += amplitude * np.sin(2.0 * np.pi * hertz * t)
    return Samples(Sensor.ACCELEROMETER, frozen(t), frozen(xyz))


def while_there(samples: Samples, seconds: float) -> Samples:
    """Return samples whose line ends after some seconds."""
    xyz = np.where((samples.t < seconds)[:, None], samples.xyz, shaken(0.0, 7).xyz)
    return Samples(samples.sensor, samples.t, frozen(xyz))


def tone(samples: Samples, sensor: str) -> Finding | None:
    """Return the surest line, None without any."""
    return next(iter(tones(samples, sensor)), None)


def evidence(amplitudes: tuple[float, float], seeds: tuple[int, int]) -> float:
    """Return the evidence, nats, that two lines differ."""
    one, other = (tone(shaken(a, s), "accel") for a, s in zip(amplitudes, seeds, strict=True))
    assert one is not None and other is not None
    pair = quantities_of(one, other)
    assert pair is not None
    return subtract(*pair).log_bayes_factor


def test_a_line_that_is_the_same_is_no_difference_where_an_axis_shows_nothing_of_it() -> None:
    quiet = tone(shaken(0.03, 1), "accel")
    heard = tone(shaken(0.03, 2), "accel")
    assert quiet is not None and heard is not None
    assert np.min(quiet.parameters["amplitude"].value) == 0.0 < np.min(heard.parameters["amplitude"].value)
    assert evidence((0.03, 0.03), (2, 1)) < 0.0
    assert evidence((0.03, 0.03), (1, 2)) < 0.0


def test_an_axis_that_may_have_nothing_has_no_logarithm() -> None:
    """An arm of 0.005 +- 3 mm along z was told as 1e-276 to 2e265 m, where all its numbers were positive."""
    where = Where(0.0, 1.0, (0.0, 0.05), "rate of turn")
    arms = []
    for at in ([0.02, 0.02, 5e-6], [0.08, 0.02, 2e-5]):
        size = Parameter(at, [[x - 3e-3, x + 3e-3] for x in at], "m")
        arms.append(
            Finding("lever_arm", "accel", ["x", "y"], where, {"position": size}, Evidence(50.0), [], "")
        )
    pair = quantities_of(*arms)
    assert pair is not None and not pair[0].logarithmic and not pair[1].logarithmic
    assert pair[0].value == pytest.approx([0.02, 0.02, 5e-6])
    assert subtract(*pair).log_bayes_factor > 10.0


def test_a_line_twice_as_strong_is_a_difference_whether_or_not_an_axis_shows_nothing_of_it() -> None:
    assert evidence((0.03, 0.06), (0, 1)) > 10.0
    assert evidence((0.06, 0.03), (1, 0)) > 10.0
    assert evidence((0.03, 0.06), (0, 0)) > 10.0


@pytest.mark.parametrize("seeds", [(0, 1), (2, 1)])  # with and without an axis that shows nothing of it
@pytest.mark.parametrize(("lasts", "relation"), [((100, 600), "too_large"), ((600, 100), "too_small")])
def test_a_line_of_the_same_size_that_lasts_longer_is_a_difference(
    lasts: tuple[float, float], relation: str, seeds: tuple[int, int]
) -> None:
    one, other = (
        tone(while_there(shaken(0.06, seed), seconds), "accel")
        for seed, seconds in zip(seeds, lasts, strict=True)
    )
    assert one is not None and other is not None
    assert one.parameters["fraction"].value == pytest.approx(lasts[0] / 600.0, abs=0.03)
    pair = quantities_of(one, other)
    assert pair is not None
    difference = subtract(*pair)
    assert difference.log_bayes_factor > 10.0 and difference.relation() == relation


@pytest.mark.parametrize(("hertz", "same"), [(13.9, True), (15.5, False)])
def test_two_lines_are_two_vibrations_and_no_line_of_the_wrong_frequency(hertz: float, same: bool) -> None:
    """Said was that the simulation's line is too large, by its frequency, and half as strong."""
    one, other = tone(shaken(0.06, 0), "accel"), tone(shaken(0.03, 1, hertz), "accel")
    assert one is not None and other is not None
    assert (pair_of(one, [other]) is other) is same


@pytest.mark.parametrize("hertz", [14.2, 21.0])
def test_a_second_line_has_no_partner_in_a_recording_with_one(hertz: float) -> None:
    """The nearer one is 4 % away: both would be taken for the other recording's one line."""
    one, alone = shaken(0.06, 0), tones(shaken(0.06, 1), "accel")
    both = one.xyz + np.outer(np.sin(2.0 * np.pi * hertz * one.t), [0.0, 0.0, 0.06])
    own = tones(Samples(one.sensor, one.t, frozen(both)), "accel")
    pairs = {round(float(np.mean(f.where.band_hz)), 1): partner(f, own, alone) for f in own}
    assert pairs == {13.7: alone[0], hertz: None}
    assert partner(alone[0], alone, own) is not None


@pytest.mark.parametrize(("samples", "same"), [(8.0, True), (50.0, False)])
def test_batches_of_other_sizes_are_two_effects(samples: float, same: bool) -> None:
    """Of a recording with one of 8 samples and a simulation with one of 50 it was said that they match."""
    where, seen = Where(0.0, 1.0, (0.0, 25.0), "count of the samples"), DirectEvidence(99.0)
    sizes = [sized({"period_samples": (n, "samples")}) for n in (8.0, samples)]
    one, other = (
        direct_finding("unknown", "accel", [0], where, size, statement="", seen=seen) for size in sizes
    )
    assert one is not None and other is not None
    assert (pair_of(one, [other]) is other) is same


EVEN = np.arange(6000.0) / 99.97


def jitter_apart(recorded: np.ndarray, simulated: np.ndarray) -> Difference:
    """Compare the jitter of two recordings' stamps, s."""
    xyz = np.array([0.0, 0.0, 9.81]) + np.random.default_rng(0).normal(0.0, 0.01, (recorded.size, 3))
    both = [examine(Samples(Sensor.ACCELEROMETER, t, xyz), None, sought=()) for t in (recorded, simulated)]
    return subtract(*(stamp_quantities(exam)["timestamp_jitter", "timing"] for exam in both))


@pytest.mark.parametrize(("rate_hz", "digits"), [(48.7, 3), (119.9, 4), (99.97, 5)])
def test_what_the_printed_step_makes_of_even_stamps_is_no_jitter_that_a_simulation_lacks(
    rate_hz: float, digits: int
) -> None:
    found = jitter_apart((np.arange(6000) / rate_hz).round(digits), np.arange(6000) / 100.0)
    assert posterior(found.log_bayes_factor, 30) < 0.1


def test_jitter_is_lacking_where_the_simulation_has_none_and_not_too_small() -> None:
    scattered = EVEN + np.random.default_rng(1).normal(0.0, 1e-4, EVEN.size)
    found = jitter_apart(scattered.round(6), np.arange(6000) / 100.0)
    assert found.simulated.none and not found.recorded.none
    assert found.relation() == "lacking" and posterior(found.log_bayes_factor, 30) > 0.95
    assert jitter_apart(np.arange(6000) / 100.0, scattered).relation() == "superfluous"


@pytest.mark.parametrize(("share", "relation"), [(0.5, "too_small"), (1.5, "too_large")])
def test_jitter_of_another_size_is_a_difference(share: float, relation: str) -> None:
    scatter = np.random.default_rng(1).normal(0.0, 5e-4, (2, EVEN.size))
    found = jitter_apart(EVEN + scatter[0], EVEN + share * scatter[1])
    assert found.relation() == relation and posterior(found.log_bayes_factor, 30) > 0.95
    assert posterior(jitter_apart(EVEN + scatter[0], EVEN + scatter[1]).log_bayes_factor, 30) < 0.05


def test_a_phone_that_is_never_at_rest_is_not_said_to_have_steps_that_hide_its_noise() -> None:
    t = np.arange(0.0, 60.0, 0.01)
    rng = np.random.default_rng(2)
    xyz = np.array([0.0, 0.0, 9.81]) + np.outer(np.sin(2.0 * np.pi * 0.7 * t), [3.0, 1.0, 2.0])
    xyz = np.round((xyz + rng.normal(0.0, 0.01, xyz.shape)) / 0.0012) * 0.0012
    exam = examine(Samples(Sensor.ACCELEROMETER, frozen(t), frozen(xyz)), None, sought=())
    reasons = {c.effect: c.reason for c in checks_of(exam, []) if c.sensor == "accel"}
    assert reasons["vibration_tone"] == reasons["noise_heavy_tailed"] == "0 static intervals, 3 are needed"


def test_a_step_is_not_lacking_where_louder_noise_hides_it() -> None:
    rng, t = np.random.default_rng(4), np.arange(0.0, 300.0, 0.02)

    def stepped(step: float, noise: float | Array) -> Examination:
        xyz = np.array([0.3, 0.2, 9.81]) + rng.normal(0.0, noise, (t.size, 3))
        xyz[:50] += np.linspace(0.0, 2.0, 50)[:, None]
        return examine(Samples(Sensor.ACCELEROMETER, t, step * np.rint(xyz / step)), None, sought=())

    found = [s.finding for s in stepped(0.04, 0.006).statements]
    assert [f.effect for f in found] == ["accel_quantisation"]
    louder, finer = stepped(0.04, 0.05), stepped(0.004, 0.015)
    assert not louder.statements and not finer.statements
    same = step_of_other(found[0], louder)
    assert same is not None and same.parameters["step"].value == pytest.approx(0.04, rel=1e-3)
    assert step_of_other(found[0], finer) is None
    other = step_of_other(found[0], stepped(0.02, 0.013))
    assert other is not None and other.parameters["step"].value == pytest.approx(0.02, rel=1e-3)
    assert step_of_other(found[0], stepped(0.011, 0.015)) is None, "finer than its noise, if not by much"
    of_x, quiet, loud = replace(found[0], axes=["x"]), 0.013, 0.05
    assert step_of_other(of_x, stepped(0.02, np.array([quiet, loud, loud]))) is not None
    assert step_of_other(of_x, stepped(0.02, np.array([loud, quiet, quiet]))) is None


def test_a_step_that_sound_phones_have_is_lacking_where_a_simulation_has_none() -> None:
    rng, t = np.random.default_rng(7), np.arange(0.0, 300.0, 0.02)

    def at_rest(step: float) -> Examination:
        xyz = np.array([0.3, 0.2, 9.81]) + rng.normal(0.0, 0.02, (t.size, 3))
        xyz[:50] += np.linspace(0.0, 2.0, 50)[:, None]
        return examine(
            Samples(Sensor.ACCELEROMETER, t, frozen(step * np.rint(xyz / step) if step else xyz)),
            None,
            sought=(),
        )

    coarse, fine = at_rest(0.03), at_rest(0.0)
    assert not coarse.statements and not direct_statements(fine), "1.5 times the noise, as sound phones have"
    assert [f.effect for f in direct_statements(coarse)] == ["accel_quantisation"]
    found = [
        compare(*pair, ("rec", "sim")) for pair in ((coarse, fine), (fine, coarse), (coarse, at_rest(0.03)))
    ]
    assert [[(d.effect, d.relation) for d in c.discrepancies] for c in found] == [
        [("accel_quantisation", "lacking")], [("accel_quantisation", "superfluous")], []
    ]  # fmt: skip


def delivered(rate_hz: float, every_s: float = 0.0) -> Samples:
    """Return five minutes that the host has after 2 ms and an exponential delay, or every so many seconds."""
    rng = np.random.default_rng(3)
    t = np.arange(300.0 * rate_hz) / rate_hz
    came = np.ceil(t / every_s) * every_s if every_s else t
    arrived = np.maximum.accumulate(came + 2e-3 + rng.exponential(1.5e-3, t.size))
    xyz = np.array([0.0, 0.0, 9.81]) + rng.normal(0.0, 0.01, (t.size, 3))
    return Samples(Sensor.ACCELEROMETER, frozen(t), frozen(xyz), t_arrival=frozen(arrived))


@pytest.mark.parametrize(("every_s", "differ"), [(0.0, False), (0.2, True)])
def test_the_same_delays_of_a_host_are_as_many_bursts_at_another_rate(every_s: float, differ: bool) -> None:
    both = [examine(delivered(*how), None, sought=()) for how in ((800.0, every_s), (50.0, 0.0))]
    pairs = [
        subtract(*(stamp_quantities(exam, period)["arrival_bursts", "timing"] for exam in both))
        for period in (0.02, 0.0)
    ]
    found = [posterior(p.log_bayes_factor, 30) for p in pairs]
    assert found[0] > 0.95 if differ else found[0] < 0.1
    assert found[1] > 0.95, "each among its own samples"


def test_stamps_that_come_in_bursts_are_a_difference() -> None:
    """A simulation of even stamps matched: no times of arrival said that they were in bursts."""
    rng = np.random.default_rng(4)
    even = np.arange(20000) / 50.0
    bursts = np.repeat(even[4::5], 5) - 0.001 * np.tile(np.arange(4, -1, -1), 4000)
    xyz = np.array([0.0, 0.0, 9.81]) + rng.normal(0.0, 0.02, (even.size, 3))
    exams = [examine(Samples(Sensor.ACCELEROMETER, frozen(t), frozen(xyz)), None, sought=()) for t in
             (bursts, even)]  # fmt: skip
    for pair, relation in ((exams, "lacking"), (exams[::-1], "superfluous"), (exams[:1] * 2, None)):
        found = compare(pair[0], pair[1], ("rec", "sim")).discrepancies
        assert [(d.effect, d.relation) for d in found] == ([("arrival_bursts", relation)] if relation else [])
    assert compare(exams[0], exams[1], ("rec", "phone"), played=True).discrepancies == []


def test_coarse_values_in_one_attitude_are_a_difference_and_no_noise() -> None:
    """Two to four codes of each axis had no step: what motion between them makes was 'unknown'."""
    rng = np.random.default_rng(5)
    slow = 0.01 * np.sin(np.arange(30000) / 5000.0)[:, None]
    fine = np.array([0.31, 0.2, 9.81]) + slow + rng.normal(0.0, 0.012, (30000, 3))
    coarse, same = (
        examine(Samples(Sensor.ACCELEROMETER, np.arange(30000) / 50.0, frozen(xyz)), None)
        for xyz in (0.04 * np.rint(fine / 0.04), fine + rng.normal(0.0, 1e-6, fine.shape))
    )
    assert coarse.bins.force_rounding is not None and (coarse.bins.force_rounding > 0.0).all()
    for pair, relation in (((coarse, same), "lacking"), ((same, coarse), "superfluous")):
        found = compare(*pair, ("rec", "sim")).discrepancies
        assert [(d.effect, d.relation) for d in found] == [("accel_quantisation", relation)]


@pytest.mark.parametrize("step", [0.0, 0.02])
def test_every_value_twice_is_no_matter_of_doubt_beside_none(step: float) -> None:
    """The logarithm of none at all was so unsure that it might have been half of the samples."""

    def examined(seed: int, *, twice: bool) -> Examination:
        noise = np.random.default_rng(seed).normal(0.0, 0.02, (6000, 3)) + np.array([0.1, 0.2, 9.8])
        values = np.repeat(noise[::2], 2, axis=0) if twice else noise
        values = np.rint(values / step) * step if step else values
        samples = Samples(Sensor.ACCELEROMETER, frozen(np.arange(6000) / 50.0), frozen(values))
        return examine(samples, None, sought=())

    recorded, simulated = (
        stamp_quantities(exam)["held_samples", "accel"]
        for exam in (examined(1, twice=True), examined(2, twice=False))
    )
    assert recorded.reference["longest"] == 1.0 and simulated.none
    difference = subtract(recorded, simulated)
    assert posterior(difference.log_bayes_factor, 40) > 0.99 and difference.relation() == "lacking"
    few = replace(recorded, value=simulated.value + 0.5)
    assert posterior(subtract(few, simulated).log_bayes_factor, 40) < 0.5, "so few steps may make"


@pytest.mark.parametrize(
    ("recorded", "simulated", "differ"),
    [((20, 12_000), (0, 1200), False), ((50, 12_000), (0, 1200), False), ((6, 6000), (0, 6000), False),
     ((3000, 6000), (4, 6000), True), ((60, 6000), (4, 6000), True), ((300, 6000), (0, 1200), True)],
)  # fmt: skip
def test_none_of_few_samples_is_no_difference_from_few_of_many(
    recorded: tuple[int, int], simulated: tuple[int, int], differ: bool
) -> None:
    """Where 20 of 12000 are held, 1200 have none one time in seven: told as a difference, and no doubt of it.

    Three or four of 6000 may be none by chance, and were too unsure to differ from half of them.
    """

    def held(count: int, n: int) -> Quantity:
        at = np.linspace(2, n - 2, count, dtype=np.int64) if count < n // 2 else np.arange(1, n, 2)
        xyz = np.random.default_rng(n).normal(0.0, 0.02, (n, 3))
        xyz[at] = xyz[at - 1]
        samples = Samples(Sensor.ACCELEROMETER, frozen(np.arange(n) / 50.0), frozen(xyz))
        return stamp_quantities(examine(samples, None, sought=()))["held_samples", "accel"]

    few, many = held(*simulated), held(*recorded)
    for pair in ((many, few), (few, many)):
        probability = posterior(subtract(*pair).log_bayes_factor, 40)
        assert probability > 0.9 if differ else probability < 0.5
