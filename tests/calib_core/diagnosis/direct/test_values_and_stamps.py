"""What single samples and stamps show, on synthetic streams of known truth."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.diagnosis.direct import repeated_values as repeats
from stillcal.calib_core.diagnosis.direct.quantisation import quantisation, steps
from stillcal.calib_core.diagnosis.direct.saturation import saturation
from stillcal.calib_core.diagnosis.model.measurement import Measured, mean_of
from stillcal.calib_core.diagnosis.model.records import Claims, Finding, Where
from stillcal.calib_core.diagnosis.model.sound_phones import sound_phones
from stillcal.calib_core.diagnosis.noise.heavy_tails import contaminated, tails
from stillcal.calib_core.diagnosis.noise.lines.spectral_line import tones
from stillcal.calib_core.diagnosis.noise.low_pass import Quiet
from stillcal.calib_core.diagnosis.segments.value_grid import comb_step
from stillcal.calib_core.diagnosis.stamps.clock import clock_rate, timing_findings
from stillcal.calib_core.streams.samples import Samples, Sensor

N = 20000
SOUND = sound_phones()
FIFTY = Claims(nominal_rate_hz=50.0)


def stream(t: np.ndarray, xyz: np.ndarray | None = None, arrival: np.ndarray | None = None) -> Samples:
    rng = np.random.default_rng(0)
    noise = rng.normal(0, 0.01, (t.size, 3)) + np.array([0, 0, 9.81])
    return Samples.checked(Sensor.ACCELEROMETER, t, noise if xyz is None else xyz, None, arrival)


def tone(samples: Samples, sensor: str) -> Finding | None:
    """Return the surest line, None without any."""
    return next(iter(tones(samples, sensor)), None)


def even(rate: float = 50.0) -> np.ndarray:
    return np.arange(N) / rate


def latency(seed: int = 1) -> np.ndarray:
    return 0.002 + np.random.default_rng(seed).exponential(0.001, N)


def effects(samples: Samples, claims: Claims | None = None) -> dict[str, object]:
    return {
        f.effect: next(iter(f.parameters.values()))
        for f in timing_findings(samples, claims or Claims(), SOUND)
    }


def test_an_even_clock_is_silent() -> None:
    t = even()
    assert (
        effects(stream(t, arrival=np.maximum.accumulate(t + latency())), Claims(nominal_rate_hz=50.0)) == {}
    )


@pytest.mark.parametrize("skew", [0.004, -0.001])
def test_clock_rate_from_the_quickest_deliveries(skew: float) -> None:
    host = even()
    rate, _ = clock_rate(host * (1 + skew), host + latency())
    assert rate.value == pytest.approx(skew, abs=4 * rate.error + 1e-6)
    assert rate.error < 1e-5


def test_jitter_drops_and_bursts() -> None:
    rng = np.random.default_rng(3)
    jittered = np.sort(even() + rng.normal(0, 0.002, N))
    assert effects(stream(jittered), FIFTY)["timestamp_jitter"].value == pytest.approx(0.002, rel=0.05)  # type: ignore[attr-defined]
    kept = even()[rng.random(N) > 0.02]
    assert effects(stream(kept), FIFTY)["dropped_samples"].value == pytest.approx(0.02, rel=0.15)  # type: ignore[attr-defined]
    t = even()
    held = np.where((t % 5.0) < 0.5, np.ceil(t / 5.0) * 5.0 - 4.5, t) + 0.002
    assert effects(stream(t, arrival=held), FIFTY)["arrival_bursts"].value == pytest.approx(0.1, abs=0.02)  # type: ignore[attr-defined]


def test_steps_of_the_values() -> None:
    rng = np.random.default_rng(4)
    raw = rng.normal(0, 0.02, (N, 3)) + np.array([0, 0, 9.81])
    assert comb_step(raw[:, 0]) is None
    coarse = np.rint(raw / 0.04) * 0.04
    assert comb_step(coarse[:, 2]) is None or comb_step(coarse[:, 2]) == pytest.approx(0.04)
    walk = np.rint(np.cumsum(rng.normal(0, 0.05, N)) / 0.04) * 0.04
    assert comb_step(walk) == pytest.approx(0.04, rel=1e-6)
    fine = np.rint(raw / 0.001) * 0.001
    declared = stream(even(), fine)
    sd = np.full(3, 0.02)
    assert quantisation(declared, "accel", steps(declared, sd), 0.001, SOUND["step_over_noise"]) is None
    coarser = stream(even(), np.column_stack([walk] * 3))
    assert quantisation(coarser, "accel", steps(coarser, sd), 0.001, SOUND["step_over_noise"]) is not None


def test_a_flat_top_is_a_limit_and_a_sine_is_not() -> None:
    swing = 18.0 * np.sin(np.arange(N)[:, None] * 0.05 + np.array([0.0, 1.0, 2.0]))
    noise = np.random.default_rng(5).normal(0, 0.01, (N, 3))
    assert saturation(stream(even(), swing + noise), "accel", np.full(3, 0.01), None) is None
    clipped = saturation(stream(even(), np.clip(swing, -14, 14) + noise), "accel", np.full(3, 0.01), None)
    assert clipped is not None
    assert clipped.parameters["limit"].value == pytest.approx(14.0, abs=0.02)
    declared = saturation(stream(even(), np.clip(swing, -14, 14) + noise), "accel", np.full(3, 0.01), 14.0)
    assert declared is None


def test_a_line_is_found_and_broad_shaking_is_not() -> None:
    t = even()
    rng = np.random.default_rng(6)
    quiet = rng.normal(0, 0.01, (N, 3))
    assert tone(stream(t, quiet), "accel") is None
    humming = quiet + np.outer(np.sin(2 * np.pi * 17.0 * t), [0.0, 0.0, 0.01])
    line = tone(stream(t, humming), "accel")
    assert line is not None
    assert line.parameters["frequency"].value == pytest.approx(17.0, abs=0.02)
    assert line.parameters["amplitude"].value[2] == pytest.approx(0.01, rel=0.05)  # type: ignore[index]
    assert line.axes == ["z"]
    phase = np.cumsum(rng.normal(0, 0.25, N)) + 2 * np.pi * 9.0 * t
    assert tone(stream(t, quiet + 0.02 * np.sin(phase)[:, None]), "accel") is None
    shaken = np.fft.rfft(rng.normal(0, 0.2, (N, 3)), axis=0)
    shaken[np.fft.rfftfreq(N, t[1] - t[0]) < 12.0] = 0.0  # as loud right above an edge as far above it
    assert tone(stream(t, quiet + np.fft.irfft(shaken, N, axis=0)), "accel") is None


def test_contamination_is_measured() -> None:
    rng = np.random.default_rng(7)
    z = rng.normal(size=60000) * np.where(rng.random(60000) < 0.03, 5.0, 1.0)
    fit = contaminated(np.abs(z))
    assert fit.ratio.value == pytest.approx(5.0, abs=4 * fit.ratio.error)
    assert fit.fraction.value == pytest.approx(0.03, abs=4 * fit.fraction.error)
    assert fit.ratio.error < 0.2


def test_far_samples_too_few_for_one_axis_are_sure_on_three() -> None:
    rng = np.random.default_rng(1)
    wide = np.where(rng.random((14000, 3)) < 0.02, 2.3, 1.0)
    noise = rng.normal(size=wide.shape)

    def heavy(factor: np.ndarray) -> Finding | None:
        still = Quiet(tuple(np.split(noise * factor, 56)), tuple(10.0 * np.arange(56)), 25.0)
        return tails(
            still,
            "accel",
            SOUND["excess_kurtosis"],
            Where(0.0, 560.0, (0.0, 12.5), "noise at rest"),
            0.0,
        )

    found = heavy(wide)
    assert found is not None and found.effect == "noise_heavy_tailed" and found.axes == ["x", "y", "z"]
    assert heavy(np.where([True, False, False], wide, 1.0)) is None
    assert heavy(np.ones_like(wide)) is None


def test_a_number_is_beyond_only_outside_its_tolerance() -> None:
    assert Measured(1.1, 0.01).beyond(0.8, 1.2) == 0.0
    assert Measured(1.3, 0.01).beyond(0.8, 1.2) == pytest.approx(10.0)
    assert mean_of(np.array([1.0, 1.1, 0.9, 50.0])).value == pytest.approx(1.0)


def test_a_faint_line_is_found_in_long_stretches() -> None:
    """A tenth of the noise: no single stretch shows it, the mean of all does."""
    t, rng = even(), np.random.default_rng(8)
    quiet = rng.normal(0, 0.01, (N, 3))
    assert tone(stream(t, quiet), "accel") is None
    line = tone(stream(t, quiet + np.outer(np.sin(2 * np.pi * 11.3 * t), [0.001, 0.001, 0.001])), "accel")
    assert line is not None
    assert line.where.t_end - line.where.t_start > 0.8 * (t[-1] - t[0]), "it lasts as long as the recording"
    assert line.parameters["frequency"].value == pytest.approx(11.3, abs=0.02)


def test_a_line_keeps_its_phase_where_samples_are_lost() -> None:
    """Four in a hundred: closed up, each gap would turn the phase of a line at 13 Hz by a quarter."""
    t, rng = even(), np.random.default_rng(8)
    there = rng.random(N) > 0.04
    values = rng.normal(0, 0.01, (N, 3)) + np.outer(np.sin(2 * np.pi * 13.0 * t), [0.0, 0.01, 0.0])
    line = tone(stream(t[there], values[there]), "accel")
    assert line is not None and line.axes == ["y"]
    assert line.parameters["frequency"].value == pytest.approx(13.0, abs=0.01)
    assert line.parameters["amplitude"].value[1] == pytest.approx(0.01, rel=0.02)  # type: ignore[index]


@pytest.mark.parametrize(
    ("step", "declared", "coarse"), [(0.0305, None, False), (0.0333, None, False), (0.061, 0.0305, True)]
)
def test_steps_that_real_phones_have_are_no_finding_unless_finer_ones_are_declared(
    step: float, declared: float | None, coarse: bool
) -> None:
    """Steps of 1.2, 1.3 and 2.5 times the noise, deg/s; real phones have steps up to 1.3 times theirs."""
    step = float(np.deg2rad(step))
    sd = float(np.deg2rad(0.0245))
    turning = np.random.default_rng(12).normal(0, sd, (N, 3)) + 0.2 * np.sin(0.3 * even())[:, None]
    values = stream(even(), step * np.round(turning / step))
    seen = steps(values, np.full(3, sd))
    lsb = None if declared is None else float(np.deg2rad(declared))
    assert (quantisation(values, "gyro", seen, lsb, SOUND["step_over_noise"]) is not None) == coarse


@pytest.mark.slow
def test_a_line_near_the_limit_of_what_can_be_seen_has_its_frequency() -> None:
    """Quarter of an hour; the matched filter that knows all would see 16 standard deviations."""
    t = np.arange(22_500) / 25.0
    inside = 0
    for seed in range(10):
        rng = np.random.default_rng([11, seed])
        frequency = rng.uniform(6.5, 11.0)
        faint = 16.0 * 0.01 * np.sqrt(2.0 / t.size) * np.sin(2 * np.pi * frequency * t)
        line = tone(stream(t, rng.normal(0, 0.01, (t.size, 3)) + np.outer(faint, [0, 1, 0])), "accel")
        assert line is not None and line.axes == ["y"]
        low, high = line.parameters["frequency"].ci95
        inside += low <= frequency <= high
    assert inside >= 7, "95 % intervals: fewer than 7 of 10 have a chance of 1 in 1,000"


def test_stamps_that_run_fast_at_the_nominal_rate_are_skewed() -> None:
    """The host says 3 in 1000 fast, the nominal rate as much slow: the samples come as they should."""
    host = even()
    skewed = stream(host * 1.003, arrival=np.maximum.accumulate(host + latency()))
    assert effects(skewed, Claims(nominal_rate_hz=50.0))["clock_skew"].value == pytest.approx(3e-3, rel=0.01)  # type: ignore[attr-defined]
    true = stream(host * 1.003, arrival=np.maximum.accumulate(host + latency()))
    slower = effects(true, Claims(nominal_rate_hz=50.0 / 1.003))["clock_skew"].value  # type: ignore[attr-defined]
    assert slower == pytest.approx(3e-3, rel=0.01)


def test_a_line_is_found_in_rests_too_short_for_long_stretches() -> None:
    """Thirty rests of twelve seconds, each in another attitude, a hand between them."""
    t, rng = even(), np.random.default_rng(9)
    place = (t // 13.0).astype(int)
    up = rng.normal(size=(place.max() + 1, 3))
    moved = (t % 13.0 > 12.0)[:, None] * rng.normal(0, 3.0, (N, 3))
    still = 9.8 * (up / np.linalg.norm(up, axis=1)[:, None])[place] + moved + rng.normal(0, 0.01, (N, 3))
    assert tone(stream(t, still), "accel") is None
    line = tone(stream(t, still + np.outer(np.sin(2 * np.pi * 13.0 * t), [0.0, 0.0, 0.01])), "accel")
    assert line is not None and line.parameters["frequency"].value == pytest.approx(13.0, abs=0.02)


@pytest.mark.slow
def test_a_line_too_faint_for_any_rest_is_found_in_all_of_them_together() -> None:
    """Twenty rests of forty seconds; all of them have 13 standard deviations of it, each alone 3."""
    t = np.arange(21_500) / 25.0
    moving = t % 43.0 > 40.0
    frequency, size = 8.37, 13.0 * 0.01 * np.sqrt(2.0 / np.count_nonzero(~moving))
    faint = np.outer(size * np.sin(2 * np.pi * frequency * t), [1.0, 0.0, 0.0])
    seen = 0
    for seed in range(10):
        rng = np.random.default_rng([13, seed])
        moved = moving[:, None] * rng.normal(0, 3.0, (t.size, 3))
        line = tone(stream(t, rng.normal(0, 0.01, (t.size, 3)) + moved + faint), "accel")
        seen += line is not None and abs(line.parameters["frequency"].value - frequency) < 0.01  # type: ignore[operator]
    assert seen >= 8
    assert tone(stream(t, rng.normal(0, 0.01, (t.size, 3)) + moved), "accel") is None


def test_coarse_values_that_were_calibrated_are_not_held() -> None:
    """Mixed axes repeat together or not at all, as held samples do; but their values come back."""
    rng = np.random.default_rng(10)
    mixing = np.eye(3) + rng.normal(0, 0.02, (3, 3))
    coarse = np.round(rng.normal(0, 0.01, (N, 3)) / 0.02) * 0.02
    assert repeats.held(stream(even(), coarse @ mixing.T), "gyro", SOUND["held_samples_declared"])[0] is None
    fine = rng.normal(0, 0.01, (N, 3))
    late = np.flatnonzero(rng.random(N) < 0.1)[1:]
    fine[late] = fine[late - 1]
    assert (
        repeats.held(stream(even(), fine @ mixing.T), "gyro", SOUND["held_samples_declared"])[0] is not None
    )
