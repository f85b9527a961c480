"""The forward chain of one sensor: from what is felt to what is reported.

    raw = hold(Q(clip(h_LP * [bias + scale @ bound(true) + terms + wander + white])))

Noise is added ahead of the low-pass because it arises in the sensing element and its amplifier: the
filter shapes it as it shapes the signal. The quantiser comes last and so rounds the noise too, which is
what dithers it. White noise of one-sided density N at rate f has the standard deviation N sqrt(f / 2).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.streams.samples import Sensor
from stillcal.replay.phone.effects.base import Circumstances, Effect, Moment, Term
from stillcal.replay.phone.heat import Surroundings
from stillcal.replay.phone.noise import GaussMarkov, Wander, White, flicker_bank, seeded
from stillcal.replay.phone.settings import Noise, SensorSettings, per_axis


def slow_processes(noise: Noise) -> list[GaussMarkov]:
    """Return all Gauss-Markov processes of a sensor, the flicker's bank included."""
    own = [GaussMarkov(per_axis(g.sigma), g.tau_s) for g in noise.gauss_markov]
    return flicker_bank(per_axis(noise.flicker)) + own


class LowPass:
    """Butterworth low-pass at a steady rate, of the second order by default, settled on its first sample."""

    def __init__(self, cutoff_hz: float, rate_hz: float, order: int = 2) -> None:
        from scipy.signal import butter, lfilter_zi  # noqa: PLC0415 - a second of a command that simulates nothing

        self._rate_hz = rate_hz
        self._b, self._a = butter(order, cutoff_hz, fs=rate_hz)
        self._settled = lfilter_zi(self._b, self._a)
        self._state: Array | None = None

    @property
    def delay_s(self) -> float:
        """By how much it delays slow motion, s: its group delay at zero frequency."""
        b, a = (float(np.arange(c.size) @ c / c.sum()) for c in (self._b, self._a))
        return (b - a) / self._rate_hz

    def gain(self, frequency_hz: float) -> float:
        """Return what it leaves of the amplitude of a sine, below half the rate."""
        back = np.exp(-2j * math.pi * frequency_hz / self._rate_hz) ** np.arange(self._b.size)
        return float(abs(self._b @ back) / abs(self._a @ back))

    def __call__(self, values: Array) -> Array:
        """Filter the next (n, 3) values."""
        state = np.outer(self._settled, values[0]) if self._state is None else self._state
        from scipy.signal import lfilter  # noqa: PLC0415 - a second of a command that simulates nothing

        smooth, self._state = lfilter(self._b, self._a, values, axis=0, zi=state)
        return np.asarray(smooth)


class SensorChain:
    """One sensor with all its errors; blocks of regular samples are read in time order."""

    def __init__(
        self,
        sensor: Sensor,
        settings: SensorSettings,
        effects: Sequence[Effect],
        surroundings: Surroundings,
        seed: int,
    ) -> None:
        self._sensor, self._settings = sensor, settings
        noise, rate = settings.noise, settings.rate_hz
        sd = per_axis(noise.white) * math.sqrt(rate / 2.0)
        rng = seeded(seed, sensor, "white")
        self._white = White(sd, noise.tail_fraction, noise.tail_ratio, rng) if sd.any() else None
        self._wander = Wander(slow_processes(noise), per_axis(noise.random_walk), seed, sensor)
        self._filter = None if settings.cutoff_hz is None else LowPass(settings.cutoff_hz, rate)
        self._hold = seeded(seed, sensor, "hold")
        self._last: Array | None = None
        circumstances = [
            Circumstances(rate, surroundings, seeded(seed, sensor, e.name, i)) for i, e in enumerate(effects)
        ]
        pairs = list(zip(effects, circumstances, strict=True))
        self._inputs = {felt: self._input_terms(felt, pairs) for felt in Sensor}
        outputs = (e.output_term(sensor, a) for e, a in pairs if e.concerns(sensor))
        self._outputs = [term for term in outputs if term is not None]

    def read(self, moment: Moment) -> Array:
        """Return what the sensor reports at the moment's n times, (n, 3)."""
        if not moment.t.size:
            return np.empty((0, 3))
        moment = self._disturbed(moment)
        settings = self._settings
        felt, bound = moment.felt_by(self._sensor), settings.element_range
        felt = felt if bound is None else np.clip(felt, -bound, bound)
        raw: Array = felt @ np.asarray(settings.scale).T + np.asarray(settings.bias)
        for term in self._outputs:
            raw = raw + term(moment)
        if not self._wander.silent:
            raw = raw + self._wander.at(moment.t)
        if self._white is not None:
            raw = raw + self._white.draw(moment.t.size)
        return self._with_held_samples(self._digitised(raw if self._filter is None else self._filter(raw)))

    def _input_terms(self, felt: Sensor, pairs: Sequence[tuple[Effect, Circumstances]]) -> list[Term]:
        """Return the terms added to force or rate: effects on this sensor, and on the whole phone."""
        mine = felt is self._sensor
        terms = (e.input_term(a) for e, a in pairs if e.concerns(felt) and (mine or e.of_whole_phone))
        return [term for term in terms if term is not None]

    def _disturbed(self, moment: Moment) -> Moment:
        force, rate = (
            sum((term(moment) for term in self._inputs[felt]), start=moment.felt_by(felt)) for felt in Sensor
        )
        return dataclasses.replace(moment, force=force, rate=rate)

    def _digitised(self, raw: Array) -> Array:
        limit, lsb = self._settings.range, self._settings.lsb
        raw = raw if limit is None else np.clip(raw, -limit, limit)
        return raw if lsb == 0.0 else np.rint(raw / lsb) * lsb

    def _with_held_samples(self, raw: Array) -> Array:
        if self._settings.held_fraction == 0.0:
            return raw
        fresh = self._hold.random(len(raw)) >= self._settings.held_fraction
        source = np.maximum.accumulate(np.where(fresh, np.arange(len(raw)), -1))
        before = raw[0] if self._last is None else self._last
        with_held: Array = np.where((source >= 0)[:, None], raw[source], before)
        self._last = with_held[-1]
        return with_held
