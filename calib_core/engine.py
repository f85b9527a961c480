"""The daemon's mind, sans-I/O: samples and events in, actions out, on the sensor's own time.

Rule 1: no clock, no file, no socket; time is what the stamps say. Rule 2: what comes out depends on
what went in, never on how it was cut into blocks. For that, the streams are only looked at up to the
next deadline (an event, a check, a review), and every decision falls on a deadline, between samples.

The same engine runs in the daemon, in a replay and in the tests. `Engine.state` is all there is to
save; an engine built from it goes on as if nothing had happened.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from stillcal.calib_core import calibrate
from stillcal.calib_core import gravity as local_gravity
from stillcal.calib_core.accelerometer import AccelerometerFit
from stillcal.calib_core.energy import Allowance
from stillcal.calib_core.engine_state import EngineSettings, EngineState, Refusal
from stillcal.calib_core.events import (
    Action,
    Charging,
    End,
    Event,
    Level,
    Location,
    Log,
    Reject,
    Store,
    Tick,
)
from stillcal.calib_core.gravity import Gravity, LocationError
from stillcal.calib_core.pool import HeldRest, Pool
from stillcal.calib_core.quality import Verdict
from stillcal.calib_core.refusals import NotSupported
from stillcal.calib_core.rests import RestState
from stillcal.calib_core.samples import SampleError, Samples, Sensor
from stillcal.calib_core.schedule import (
    Need,
    Occasion,
    ScheduleSettings,
    Standing,
    Watch,
    calibration_due,
    next_on_grid,
    watch_for,
)
from stillcal.calib_core.stationary import StationaryDetector
from stillcal.calib_core.stillness_settings import Ledger, Mode, Sense, Sleep
from stillcal.calib_core.turns import Turn, make_turn

_MODES = {Watch.CONTINUOUS: Mode.SCAN, Watch.PROBING: Mode.PROBE, Watch.IDLE: Mode.SCAN}
_LEAST_REVIEW_S = 1.0  # two windows: what was spent is known no finer
_LONGEST_GAP_S = 86400.0


class Engine:
    """Feed it samples and events in any cut; do what the actions say."""

    def __init__(self, settings: EngineSettings | None = None, state: EngineState | None = None) -> None:
        self.settings = settings or EngineSettings()
        self._s = state or EngineState(gravity=_first_gravity(self.settings.schedule))
        self._detector = StationaryDetector(self.settings.detector, self._s.detector)
        self._actions: list[Action] = []

    @property
    def state(self) -> EngineState:
        """All there is to save; encode it before the next feed changes it."""
        self._s.detector = self._detector.state
        return self._s

    @property
    def present(self) -> EngineState:
        """What holds now, to look at and not to save: the detector's part, dear to copy, is stale."""
        return self._s

    @property
    def ledger(self) -> Ledger:
        """What was asked of the sensors, what was read, and what became of every window."""
        return self._detector.ledger

    def feed(self, *items: Samples | Event) -> list[Action]:
        """Take samples of either sensor and events; return what is to be done, in order.

        Blocks of one stream come in time order; the two streams come together, within the gyroscope's
        patience. Raises SampleError where a block begins before the last one of its stream ended.
        """
        for item in items:
            if isinstance(item, Samples):
                self._take(item)
            else:
                self._hear(item)
        self._advance()
        actions, self._actions = self._actions, []
        return actions

    def adopt(self, rests: Sequence[RestState]) -> None:
        """Take rests that somebody else has cut, such as the rows of a rest table."""
        for rest in rests:
            self._gather(rest)

    def wants(self) -> Sense | Sleep:
        """Say whether samples are wanted, until when to go by that, and to tick or ask again.

        What comes in while the engine wants none changes nothing; it may as well not be delivered.
        """
        s = self._s
        if s.began is None:
            return Sense(np.inf)
        until = min(t for t in (s.next_review, s.next_check, np.inf) if t is not None)
        if s.watch is Watch.IDLE:
            return Sleep(until)
        if s.watch is Watch.CONTINUOUS:
            return Sense(until)
        want = self._detector.wants(self._horizon())
        return replace(want, until=min(want.until, until))

    # What comes in

    def _take(self, samples: Samples) -> None:
        if not len(samples):
            return
        s, sensor = self._s, samples.sensor
        if samples.t[0] < s.latest.get(sensor, -np.inf):
            raise SampleError(0, f"{sensor} at {samples.t[0]:.6f} s comes after {s.latest[sensor]:.6f} s")
        s.waiting[sensor] = Samples.joined([s.waiting[sensor], samples]) if sensor in s.waiting else samples
        s.latest[sensor] = float(samples.t[-1])
        if s.began is None and sensor is Sensor.ACCELEROMETER:
            self._begin(float(samples.t[0]))

    def _hear(self, event: Event) -> None:
        if isinstance(event, Tick):
            self._s.heard = event.t if self._s.heard is None else max(event.t, self._s.heard)
        else:
            self._s.events = sorted([*self._s.events, event], key=lambda e: e.t)

    def _begin(self, t: float) -> None:
        s = self._s
        s.began = t
        s.allowance = Allowance(t, self.settings.energy.burst_s, 0.0)
        s.next_check = t + self.settings.schedule.check_interval_s
        self._plan(t)

    # Time

    def _horizon(self) -> float:
        """Return the time (s) up to which both streams are known."""
        s = self._s
        if any(isinstance(e, End) for e in s.events):
            return float("inf")
        accel = s.latest.get(Sensor.ACCELEROMETER, -np.inf)
        gyro = s.latest.get(Sensor.GYROSCOPE, -np.inf)
        known = max(min(accel, gyro), accel - self.settings.schedule.gyro_patience_s)
        return known if s.heard is None else max(known, s.heard)

    def _advance(self) -> None:
        """Look at the streams and act, deadline by deadline, as far as both streams are known."""
        horizon = self._horizon()
        while True:
            t, act = self._next_deadline()
            self._look(min(t, horizon))
            if t > horizon or act is None:
                return
            self._detector.wants(t)  # gives up probes that nothing came for, as it would have live
            act(t)
            horizon = min(horizon, self._horizon())

    def _next_deadline(self) -> tuple[float, Callable[[float], None] | None]:
        s = self._s
        deadlines: list[tuple[float, Callable[[float], None]]] = []
        if s.events:
            deadlines.append((self._due(s.events[0]), self._do_event))
        if s.next_check is not None:
            deadlines.append((s.next_check, self._do_check))
        if s.next_review is not None:
            deadlines.append((s.next_review, self._do_review))
        return min(deadlines, key=lambda d: d[0], default=(float("inf"), None))

    def _due(self, event: Event) -> float:
        """Return when an event takes place: its own time, but the end waits for every sample."""
        if not isinstance(event, End):
            return event.t
        return max([event.t, *(float(np.nextafter(t, np.inf)) for t in self._s.latest.values())])

    def _resumed(self, t: float) -> float:
        """Return from when (s) on deadlines count: `t`, or a day before what comes next after a longer gap.

        Through gaps of a day deadlines fall as they would live; years between two stamps cost no more.
        The gyroscope's next sample may still be on its way; the accelerometer's is known.
        """
        s = self._s
        waiting = s.waiting.get(Sensor.ACCELEROMETER)
        coming = [*([] if waiting is None else [float(waiting.t[0])]), *(e.t for e in s.events[:1])]
        return max(t, min(coming or [s.heard or t]) - _LONGEST_GAP_S)

    # Samples

    def _look(self, stop: float) -> None:
        """Pass the samples before `stop` to the detector and gather the rests it finds."""
        s = self._s
        due = [block for sensor in Sensor if len(block := self._taken(sensor, stop))]
        if not due or s.watch is Watch.IDLE:
            return
        for block in due:
            if block.sensor is Sensor.GYROSCOPE and s.watch is Watch.CONTINUOUS:
                s.gyro_tail = block if s.gyro_tail is None else Samples.joined([s.gyro_tail, block])
        for rest in self._detector.feed(*due):
            self._gather(rest)
        self._trim_tail()

    def _taken(self, sensor: Sensor, stop: float) -> Samples:
        """Take the samples before `stop` off those that wait."""
        waiting = self._s.waiting.get(sensor)
        if waiting is None or waiting.t[0] >= stop:
            return Samples.empty(sensor)
        cut = int(np.searchsorted(waiting.t, stop, side="left"))
        if cut == len(waiting):
            return self._s.waiting.pop(sensor)
        self._s.waiting[sensor] = waiting[cut:]
        return waiting[:cut]

    def _trim_tail(self) -> None:
        """Keep of the gyroscope what a turn may still need: its own length and the rest that ends it."""
        s, settings = self._s, self.settings
        if s.gyro_tail is not None and len(s.gyro_tail):
            reach = settings.turns.max_duration + settings.detector.max_rest_s + 60.0
            s.gyro_tail = s.gyro_tail.between(float(s.gyro_tail.t[-1]) - reach, np.inf)

    def _gather(self, rest: RestState) -> None:
        s = self._s
        before = s.left is not None and s.moved is not None and rest.t_end <= s.moved
        gravity = s.left if before and s.left is not None else s.gravity
        s.pool = s.pool.with_rest(HeldRest(rest, gravity), self.settings.pool)
        s.attitudes = len(s.pool.attitudes(self.settings.pool))
        s.fresh += 1
        s.counters.rests += 1
        if s.last_rest is not None and s.gyro_tail is not None:
            turn = make_turn(s.last_rest, rest, s.gyro_tail, self.settings.turns)
            if isinstance(turn, Turn):
                s.pool = s.pool.with_turn(turn, self.settings.pool)
                s.counters.turns += 1
        s.last_rest = rest
        self._log(rest.t_end, Level.DEBUG, "rest", f"lay still for {rest.duration:.1f} s", n=rest.n)

    # Deadlines

    def _do_event(self, t: float) -> None:
        event = self._s.events.pop(0)
        if isinstance(event, Charging):
            self._s.charging = event.on
            self._log(t, Level.INFO, "charging", "plugged in" if event.on else "unplugged")
            if event.on:
                self._calibrate(t, Occasion.CHARGING)
        elif isinstance(event, Location):
            self._move_to(event)
        elif isinstance(event, End):
            for rest in self._detector.finish():
                self._gather(rest)
            self._calibrate(t, Occasion.END)
            self._s.next_review = self._s.next_check = None
            return
        if self._s.began is not None and t >= self._s.began:
            self._plan(t)

    def _move_to(self, place: Location) -> None:
        if self.settings.schedule.gravity is not None:
            return
        try:
            found = local_gravity.at(place.latitude, place.altitude)
        except LocationError as error:
            self._log(place.t, Level.WARNING, "location", f"location not used: {error}")
            return
        change = found.value - self._s.gravity.value
        if self._s.gravity.source == "default":
            self._s.pool = self._s.pool.located(found)
        else:
            self._s.moved, self._s.left = place.t, self._s.gravity
        self._s.gravity = found
        self._log(place.t, Level.INFO, "gravity", f"g is {found.value:.5f} m/s^2 here", change=change)

    def _do_check(self, t: float) -> None:
        s, interval = self._s, self.settings.schedule.check_interval_s
        s.check_due = s.record is not None
        s.next_check = next_on_grid(s.began or t, interval, self._resumed(t))
        self._check(t)
        self._plan(t)

    def _do_review(self, t: float) -> None:
        if self._s.check_due:
            self._check(t)
        if self._s.charging:
            self._calibrate(t, Occasion.CHARGING)
        elif self._s.charging is None and self._supported_well():
            self._calibrate(t, Occasion.UNPLUGGED)
        self._plan(t)

    def _plan(self, t: float) -> None:
        """Decide how to look until the next review."""
        s, settings = self._s, self.settings
        if s.allowance is None:
            return
        s.allowance = s.allowance.at(t, self._detector.ledger.asked_s, settings.energy)
        lasts = s.allowance.lasts(settings.energy)
        need = Need(rests=not self._supported_well() or s.degraded, check=s.check_due)
        watch = watch_for(need, s.watch, lasts, settings.energy.burst_s, settings.schedule)
        if watch is not s.watch:
            self._turn_to(watch, t)
        step = settings.schedule.review_interval_s
        if watch is Watch.CONTINUOUS and settings.schedule.watch == "auto":
            step = min(step, max(lasts, _LEAST_REVIEW_S))
        s.next_review = self._resumed(t) + step

    def _turn_to(self, watch: Watch, t: float) -> None:
        for rest in [*(self._detector.finish() if watch is Watch.IDLE else ()), *self._switch(watch, t)]:
            self._gather(rest)
        self._s.last_rest = self._s.gyro_tail = None
        self._s.watch = watch
        level = Level.INFO if watch is Watch.CONTINUOUS else Level.DEBUG
        self._log(t, level, "watch", f"the sensors are watched: {watch}")

    def _switch(self, watch: Watch, t: float) -> list[RestState]:
        """Switch the detector over, its first probe drawn from now on, whoever asks for it and when."""
        closed = self._detector.set_mode(_MODES[watch])
        self._detector.next_probe(t)
        return closed

    def _supported_well(self) -> bool:
        """Say whether as many attitudes have been gathered as were wanted."""
        return self._s.attitudes >= self.settings.schedule.attitudes_wanted

    # The check of 4.7

    def _check(self, t: float) -> None:
        s = self._s
        if s.record is None or s.record.accelerometer is None:
            s.check_due = False
            return
        since = s.checked
        recent = s.pool.since(since).where(self._detector.still_valid)
        found = calibrate.checked(s.record, recent, self.settings.quality)
        if found.verdict is Verdict.WAIT:
            return
        s.check_due, s.checked = False, t
        s.counters.checks += 1
        self._log(t, Level.INFO, "check", f"{found.verdict}", **calibrate.figures(found))
        if found.verdict is Verdict.RECALIBRATE:
            self._degrade(t, since if found.off_since is None else found.off_since)
        else:
            self._zero_gyro(t, recent)

    def _degrade(self, t: float, since: float | None) -> None:
        """Gather again; `since` (s) is from when on the calibration may have been wrong."""
        s = self._s
        if not s.degraded:
            s.degraded, s.sound_until = True, since
            s.counters.degradations += 1
            self._log(t, Level.WARNING, "degraded", "the calibration no longer fits: gathering rests again")
        if s.charging:
            self._calibrate(t, Occasion.CHARGING)

    def _zero_gyro(self, t: float, recent: Pool) -> None:
        s = self._s
        assert s.record is not None
        zeroed = calibrate.zeroed(s.record, recent, t)
        if zeroed is None:
            return
        s.record = zeroed
        s.counters.zeroings += 1
        self._actions.append(Store(t, zeroed, zeroed.acceptance.reason))

    # Full calibration

    def _calibrate(self, t: float, occasion: Occasion) -> None:
        s = self._s
        since = np.inf if s.tried is None else t - s.tried
        standing = Standing(s.record is not None, s.degraded, s.fresh, since)
        if not calibration_due(standing, occasion, self.settings.schedule):
            return
        s.fresh, s.tried = 0, t
        try:
            candidate = self._candidate(t)
        except NotSupported as refusal:
            s.counters.refused += 1
            news = s.refusal is None or s.refusal.missing != refusal.missing
            s.refusal = Refusal(refusal.reason, refusal.missing)
            level = Level.INFO if news else Level.DEBUG
            self._log(t, level, "refused", str(refusal), occasion=str(occasion))
            return
        self._decide(t, candidate, occasion)

    def _candidate(self, t: float) -> calibrate.Candidate:
        """Fit what was gathered.

        After a failed check, what was gathered before it is only kept as long as one calibration
        explains both: otherwise the sensor has changed, and the older rests go.
        """
        s = self._s
        recent = s.pool.since(s.sound_until) if s.degraded else s.pool
        whole = self._fit(s.pool, t)
        if len(recent.held) == len(s.pool.held):
            return _taken(whole)
        if isinstance(whole, calibrate.Candidate):
            check = calibrate.checked(whole.record, recent, self.settings.quality)
            if check.verdict is not Verdict.RECALIBRATE:
                return whole
        found = _taken(self._fit(recent, t))
        s.pool, s.attitudes = recent, len(recent.attitudes(self.settings.pool))
        return found

    def _fit(self, pool: Pool, t: float) -> calibrate.Candidate | NotSupported:
        """Fit the rests that the noise floor, as known by now, confirms, or all: whichever leaves less open.

        A doubtful rest that is one adds an attitude; one that is none adds scatter.
        """
        sure = pool.where(self._detector.still_valid)
        everything = self._fitted_or_refused(pool, t)
        if len(sure.held) == len(pool.held) or isinstance(everything, NotSupported):
            return everything
        confirmed = self._fitted_or_refused(sure, t)
        if isinstance(confirmed, NotSupported):
            return everything
        return min(confirmed, everything, key=lambda c: _left_open(c.accelerometer))

    def _fitted_or_refused(self, pool: Pool, t: float) -> calibrate.Candidate | NotSupported:
        try:
            return calibrate.candidate(pool, self._s.gravity, t, self.settings.calibrate)
        except NotSupported as refusal:
            return refusal

    def _decide(self, t: float, candidate: calibrate.Candidate, occasion: Occasion) -> None:
        s = self._s
        decision = calibrate.decide(candidate, s.record, s.degraded, self.settings.quality)
        record = candidate.accepted(decision, occasion)
        if not decision.accepted:
            s.degraded = s.degraded and not decision.settled
            s.counters.rejected += 1
            self._actions.append(Reject(t, record, decision.reason))
            self._log(t, Level.INFO, "rejected", decision.reason, occasion=str(occasion))
            return
        s.record, s.checked, s.degraded, s.refusal = record, t, False, None
        s.counters.calibrations += 1
        self._actions.append(Store(t, record, decision.reason))
        self._log(t, Level.INFO, "calibrated", decision.reason, occasion=str(occasion))

    def _log(self, t: float, level: Level, what: str, why: str, **fields: object) -> None:
        self._actions.append(Log(t, level, what, why, fields))


def _taken(found: calibrate.Candidate | NotSupported) -> calibrate.Candidate:
    """Return the candidate, or raise the refusal."""
    if isinstance(found, NotSupported):
        raise found
    return found


def _left_open(fit: AccelerometerFit) -> tuple[int, float]:
    """Order fits: more parameters first, then the smaller uncertainty along the worst direction."""
    return -fit.parameters, fit.worst_norm_uncertainty


def _first_gravity(schedule: ScheduleSettings) -> Gravity:
    return Gravity() if schedule.gravity is None else local_gravity.given(schedule.gravity)
