"""The engine: samples and events go in, actions come out, on the sensor's own time and without any I/O.

Rule 1: there is no clock, file or socket; time is what the stamps say. Rule 2: the output depends on the
input, never on how that was cut into blocks. For this the streams are looked at only up to the next deadline
(an event, a check, a review), and every decision is taken at a deadline, between two samples.

This module decides when something happens and how the sensors are used. Rests are gathered in intake.py,
decisions on the calibration are taken in decisions.py. The same engine runs in the daemon, in a replay and in
the tests. `Engine.state` is all that has to be saved; an engine built from it goes on as if nothing had
happened.
"""

from __future__ import annotations

import math
from bisect import insort_right
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from stillcal.calib_core import gravity as local_gravity
from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.calib_core.engine.actions import Action, Forget, Level, Log
from stillcal.calib_core.engine.decisions import CalibrationPolicy
from stillcal.calib_core.engine.duty_cycle import DutyBudget
from stillcal.calib_core.engine.face_guide import FACE_S, LOOK_S, FaceGuide
from stillcal.calib_core.engine.intake import Intake
from stillcal.calib_core.engine.schedule import (
    Need,
    Occasion,
    early_check_due,
    first_of_use,
    first_without_charger,
    next_on_grid,
    resumed,
    review_soon,
    watch_for,
)
from stillcal.calib_core.engine.settings import EngineSettings, Watch
from stillcal.calib_core.engine.state import EngineState, first_state, without_phone
from stillcal.calib_core.static.detector import StationaryDetector
from stillcal.calib_core.static.rest import RestState
from stillcal.calib_core.static.settings import Ledger, Mode, Sense, Sleep
from stillcal.calib_core.streams.events import Charging, End, Event, Location, Temperature, Tick
from stillcal.calib_core.streams.samples import Samples, Sensor
from stillcal.calib_core.temperature.memory import Memory

MAX_EVENTS = 1024
"""Events ahead of the samples that are kept."""

_MODES = {Watch.CONTINUOUS: Mode.SCAN, Watch.PROBING: Mode.PROBE, Watch.IDLE: Mode.SCAN}
_LEVELS = {Watch.CONTINUOUS: Level.INFO, Watch.PROBING: Level.DEBUG, Watch.IDLE: Level.DEBUG}
_LEAST_REVIEW_S = 1.0
"""s: two of the detector's windows; the on-time spent is not known more finely than one window."""


class Engine:
    """The engine: feed it samples and events in blocks of any size, and carry out the actions it returns."""

    def __init__(self, settings: EngineSettings | None = None, state: EngineState | None = None) -> None:
        self.settings = settings or EngineSettings()
        self._actions: list[Action] = []
        self._restore(state or first_state(self.settings))

    def _restore(self, state: EngineState) -> None:
        """Build all parts on a state, in place."""
        self._state = state
        self._detector = StationaryDetector(self.settings.detector, state.detector)
        self._intake = Intake(self.settings, state, self._detector, self._actions)
        self._policy = CalibrationPolicy(self.settings, state, self._detector, self._actions)
        self._guide = FaceGuide(state, self._detector, self._policy, self._actions)

    @property
    def state(self) -> EngineState:
        """The state to be saved; encode it before the next feed changes it."""
        self._intake.trim_tail()
        self._state.detector = self._detector.state
        return self._state

    @property
    def present(self) -> EngineState:
        """The state now, to look at and not to save: its copy of the detector's part is out of date."""
        return self._state

    @property
    def ledger(self) -> Ledger:
        """The detector's ledger: what was asked of the sensors, what was read, and every window's label."""
        return self._detector.ledger

    def feed(self, *items: Samples | Event) -> list[Action]:
        """Take samples of either sensor and events; return the actions that follow, in order.

        Blocks of one stream come in time order, and the gyroscope's no later than its patience after the
        accelerometer's. Raises SampleError where a block begins before the last one of its stream ended.
        """
        for item in items:
            if isinstance(item, Samples):
                self._take_samples(item)
            else:
                self._take_event(item)
        if self._state.began is None and self._intake.accelerometer_never_came:
            self._begin(self._now())
            self._policy.inspect_sensors(self._now(), silent=True)
        self._advance()
        return self._take_actions()

    def wants(self) -> Sense | Sleep:
        """Say whether samples are wanted, and until when (s) that answer holds.

        Samples that come in while none are wanted change nothing and need not be delivered.
        """
        state = self._state
        if state.began is None:
            return Sense(math.inf)
        until = min(t for t in (state.next_review, state.next_check, math.inf) if t is not None)
        if state.watch is Watch.IDLE:
            return Sleep(until)
        if state.watch is Watch.CONTINUOUS:
            return Sense(until)
        want = self._detector.wants(self._horizon())
        return replace(want, until=min(want.until, until))

    # Requests

    def add_rests(self, rests: Sequence[RestState]) -> None:
        """Add rests that were found elsewhere, such as the rows of a rest table."""
        self._intake.gather(rests)

    def resume(self, t: float) -> None:
        """Plan deadlines again after the end of a stream at t (s), because the phone may come back."""
        state = self._state
        if state.began is not None:
            state.next_review = t
            state.next_check = next_on_grid(state.began, self.settings.schedule.check_interval_s, t)

    def change_settings(self, settings: EngineSettings) -> None:
        """Go on with other settings, keeping the state."""
        state = self.state
        self.settings = settings
        if settings.schedule.gravity is not None:
            state.gravity = local_gravity.given(settings.schedule.gravity)
        self._restore(state)
        review_soon(state, self._now(), settings.schedule)

    def use_calibration(self, record: CalibrationRecord | None) -> None:
        """Use `record` as the current calibration, as after a rollback, with no failed check against it.

        What is learnt of temperature from now on is learnt from later rests.
        """
        state = self._state
        state.memory, state.trials = Memory(), ()
        state.record, state.centre, state.degraded = record, None, False
        state.checked = state.sound_until = state.trouble = None
        state.suspected = {}
        review_soon(state, self._now(), self.settings.schedule)

    def calibrate(self) -> list[Action]:
        """Try a full calibration now, on request; return the actions that follow."""
        self._policy.calibrate(self._now(), Occasion.ASKED)
        return self._take_actions()

    def update_bias(self) -> list[Action]:
        """Measure the gyroscope's bias on the rests of the last check interval, on request."""
        t = self._now()
        self._policy.update_bias(t, t - self.settings.schedule.check_interval_s)
        return self._take_actions()

    def lay_faces(self) -> list[Action]:
        """Have the phone laid on its six faces, with the sensors on meanwhile.

        `EngineState.faces` tells how far that is, and which face comes next. Return the actions that follow.
        """
        self._guide.begin(self._now())
        self._plan(self._now())
        return self._take_actions()

    def stop_faces(self) -> list[Action]:
        """Stop what `lay_faces` began, if it still goes on; return the actions that follow."""
        self._guide.stop(self._now())
        self._plan(self._now())
        return self._take_actions()

    def consider(self, findings: Iterable[Mapping[str, Any]]) -> list[Action]:
        """Take a diagnosis of the rests kept: judge the terms on trial, and put new ones on trial.

        findings: as `diagnose --json` has them. Return the actions that follow.
        """
        self._policy.consider(self._now(), findings)
        return self._take_actions()

    def forget(self, reason: str) -> list[Action]:
        """Begin anew with another phone, dropping the rests and the calibration of the old one.

        The place, the charger and the time go on. reason: how the change of phone was noticed.
        """
        old, t = self._state, self._now()
        self._restore(without_phone(old))
        if old.record is not None:
            self._actions.append(Forget(t, old.record, reason))
        return self._take_actions()

    def _take_actions(self) -> list[Action]:
        """Return the actions gathered since the last call, in order; they are handed out once."""
        actions = self._actions.copy()
        self._actions.clear()
        return actions

    # Input

    def _take_samples(self, samples: Samples) -> None:
        if len(samples):
            self._intake.take(samples)
            if self._state.began is None and samples.sensor is Sensor.ACCELEROMETER:
                self._begin(float(samples.t[0]))

    def _take_event(self, event: Event) -> None:
        if isinstance(event, Tick):
            self._state.heard = event.t if self._state.heard is None else max(event.t, self._state.heard)
        elif isinstance(event, Temperature):
            self._intake.hear(np.array([event.t]), np.array([event.celsius]))
        else:
            insort_right(self._state.events, event, key=lambda e: e.t)
            if len(self._state.events) > MAX_EVENTS:
                self._drop_latest_event()

    def _drop_latest_event(self) -> None:
        """Forget the event that lies furthest ahead: no phone tells of so many before they happen."""
        events = self._state.events
        latest = next(i for i in reversed(range(len(events))) if not isinstance(events[i], End))
        dropped = events.pop(latest)
        why = f"more than {MAX_EVENTS} events lie ahead: one is forgotten"
        self._actions.append(Log(dropped.t, Level.WARNING, "events", why))

    def _begin(self, t: float) -> None:
        state = self._state
        state.began = t
        state.allowance = DutyBudget(t, self.settings.energy.burst_s, 0.0)
        state.next_check = t + self.settings.schedule.check_interval_s
        self._plan(t)

    # Time

    def _now(self) -> float:
        """Return the time (s) that the engine has reached; 0 before the first sample."""
        known = self._intake.known_until()
        return known if math.isfinite(known) else 0.0

    def _horizon(self) -> float:
        """Return the time (s) up to which both streams are known; inf once their end was reported."""
        ended = any(isinstance(e, End) for e in self._state.events)
        return math.inf if ended else self._intake.known_until()

    def _advance(self) -> None:
        """Look at the streams and act, deadline by deadline, as far as both streams are known.

        A probe for which no sample came is given up at each deadline, as it would be live.
        """
        horizon = self._horizon()
        while True:
            t, act = self._next_deadline()
            if t > horizon or act is None:
                self._intake.look(horizon)
                return
            if act == self._do_event or not self._nothing_asked_before(t):
                self._intake.look(t)
            self._detector.wants(t)
            act(t)
            horizon = min(horizon, self._horizon())

    def _nothing_asked_before(self, t: float) -> bool:
        """Tell whether no probe is asked for before `t` (s), so that samples may go on waiting."""
        return self._state.watch is Watch.PROBING and self._detector.next_probe(t) >= t

    def _next_deadline(self) -> tuple[float, Callable[[float], None] | None]:
        state = self._state
        deadlines: list[tuple[float, Callable[[float], None]]] = []
        if state.events:
            deadlines.append((self._due_at(state.events[0]), self._do_event))
        if state.next_check is not None:
            deadlines.append((state.next_check, self._do_check))
        if state.next_review is not None:
            deadlines.append((state.next_review, self._do_review))
        return min(deadlines, key=lambda d: d[0], default=(math.inf, None))

    def _due_at(self, event: Event) -> float:
        """Return when (s) an event is acted on: at its own time, but the end only after every sample."""
        if not isinstance(event, End):
            return event.t
        return max([event.t, *(float(np.nextafter(t, math.inf)) for t in self._state.latest.values())])

    # Deadlines

    def _do_event(self, t: float) -> None:
        event = self._state.events.pop(0)
        if isinstance(event, Charging):
            self._state.charging = event.on
            self._state.charger = self._state.charger.with_events([event]).of_late()
            self._actions.append(Log(t, Level.INFO, "charging", "plugged in" if event.on else "unplugged"))
            if event.on:
                self._policy.calibrate(t, Occasion.CHARGING)
        elif isinstance(event, Location):
            self._intake.move_to(event)
        elif isinstance(event, End):
            self._intake.gather(self._detector.finish())
            self._policy.notice_change(t)
            self._policy.calibrate(t, Occasion.END)
            self._policy.measure_gyroscope_alone(t)
            self._state.next_review = self._state.next_check = None
            return
        if self._state.began is not None and t >= self._state.began:
            self._plan(t)

    def _do_check(self, t: float) -> None:
        state, interval = self._state, self.settings.schedule.check_interval_s
        state.check_due = state.record is not None
        state.next_check = next_on_grid(state.began or t, interval, resumed(state, t))
        self._policy.check(t)
        self._policy.inspect_sensors(t, self._intake.accelerometer_silent)
        occasion = first_without_charger(state, t, self.settings.schedule)
        enough = state.attitudes >= self.settings.calibrate.accelerometer.prior_attitudes
        if occasion is not None and enough:
            self._policy.calibrate(t, occasion)
        self._plan(t)

    def _do_review(self, t: float) -> None:
        state = self._state
        if self._guide.laying:
            self._intake.gather(self._detector.cut_rest(FACE_S))
            self._guide.look(t)
            self._plan(t)
            return
        if state.early_check is not None and t >= state.early_check:
            state.check_due = state.check_due or early_check_due(state, t)
            state.early_check = None
        if state.check_due:
            self._policy.check(t)
        else:
            self._policy.notice_change(t)
        if self._state.charging:
            self._policy.calibrate(t, Occasion.CHARGING)
        elif self._state.charging is None and self._has_enough_attitudes():
            self._policy.calibrate(t, Occasion.UNPLUGGED)
        self._policy.measure_gyroscope_alone(t)
        self._plan(t)

    # How to sense

    def _plan(self, t: float) -> None:
        """Decide how to sense until the next review, and when that is."""
        state, settings = self._state, self.settings
        if state.allowance is None:
            return
        state.allowance = state.allowance.at(t, self._detector.asked_s, settings.energy)
        remaining_s = state.allowance.remaining_s(settings.energy)
        need = Need(rests=not self._has_enough_attitudes() or state.degraded, check=state.check_due)
        watch = watch_for(need, state.watch, remaining_s, settings.energy.burst_s, settings.schedule)
        if self._guide.laying:
            watch = Watch.CONTINUOUS
        onward = resumed(state, t)
        if state.watch is Watch.PROBING and (watch is not state.watch or onward > t):
            self._intake.look(t)
        self._set_watch(watch, t)
        step = settings.schedule.review_interval_s
        if watch is Watch.CONTINUOUS and settings.schedule.watch == "auto":
            step = min(step, max(remaining_s, _LEAST_REVIEW_S))
        if self._guide.laying:
            step = LOOK_S
        if onward > t and watch is Watch.PROBING:
            self._skip_to(onward)
        state.next_review = onward + step
        if watch is Watch.IDLE and not need.rests:
            state.next_review = first_of_use(state, state.next_review, step, settings.schedule)

    def _set_watch(self, watch: Watch, t: float) -> None:
        if watch is self._state.watch:
            return
        done = self._detector.finish() if watch is Watch.IDLE else []
        self._intake.gather([*done, *self._switch(watch, t)])
        self._intake.drop_tail()
        self._state.watch = watch
        self._actions.append(Log(t, _LEVELS[watch], "watch", f"sensing mode: {watch}"))

    def _skip_to(self, t: float) -> None:
        """Leave out the probes of a gap up to t (s), which could not have been answered."""
        self._intake.gather(self._detector.set_mode(Mode.SCAN))
        self._intake.gather(self._switch(Watch.PROBING, t))

    def _switch(self, watch: Watch, t: float) -> list[RestState]:
        """Switch the detector's mode at t (s), its first probe drawn from t on; return the rests closed."""
        closed = self._detector.set_mode(_MODES[watch])
        self._detector.next_probe(t)
        return closed

    def _has_enough_attitudes(self) -> bool:
        return self._state.attitudes >= self.settings.schedule.attitudes_wanted
