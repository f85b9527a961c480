"""Six known faces laid one after another: what is asked for, what is refused, and what comes of it."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.accelerometer.known_attitudes import FACE_DIRECTIONS
from stillcal.calib_core.accelerometer.observability import describe, places
from stillcal.calib_core.accelerometer.six_faces import common_rotation
from stillcal.calib_core.arrays import Array, frozen
from stillcal.calib_core.codec import packed, unpacked
from stillcal.calib_core.engine.actions import Action, Log, Publish
from stillcal.calib_core.engine.engine import Engine
from stillcal.calib_core.engine.face_guide import GIVE_UP_S
from stillcal.calib_core.engine.laid_faces import LaidFaces, Stage
from stillcal.calib_core.engine.settings import EngineSettings, ScheduleSettings, Watch
from stillcal.calib_core.engine.state import EngineState
from stillcal.calib_core.maths import rotation
from stillcal.calib_core.streams.samples import Samples, Sensor

RATE_HZ = 50.0
SCALE = np.array([[1.01, 0.008, -0.004], [-0.002, 0.99, 0.006], [0.01, -0.012, 1.005]])
BIAS = np.array([0.3, -0.2, 0.15])
G = 9.80665
LEFT, RIGHT, *OTHERS = (FACE_DIRECTIONS[k] for k in (1, 0, 2, 3, 4, 5))


class Bench:
    """A phone on a person's bench, and the engine that guides that person."""

    def __init__(self, seed: int = 1) -> None:
        self.engine, self.actions, self.t = Engine(EngineSettings()), list[Action](), 0.0
        self.fed: list[tuple[Samples, Samples]] = []
        self._rng = np.random.default_rng(seed)

    @property
    def faces(self) -> LaidFaces:
        found = self.engine.present.faces
        assert found is not None
        return found

    def shaken(self, seconds: float = 3.0) -> Bench:
        """Carry the phone about."""
        n = round(seconds * RATE_HZ)
        return self._feed(G + self._rng.normal(0, 4, (n, 3)), self._rng.normal(0, 1, (n, 3)))

    def laid(self, up: Array, seconds: float = 12.0) -> Bench:
        """Carry it about and let it lie, `up` (3,) in the axes of the case."""
        self.shaken()
        n = round(seconds * RATE_HZ)
        raw = np.linalg.solve(SCALE, G * up / np.linalg.norm(up)) + BIAS
        return self._feed(raw + self._rng.normal(0, 0.02, (n, 3)), self._rng.normal(0, 0.002, (n, 3)))

    def _feed(self, force: Array, rate: Array) -> Bench:
        t = frozen(self.t + np.arange(len(force)) / RATE_HZ)
        self.t += len(force) / RATE_HZ
        blocks = Samples(Sensor.GYROSCOPE, t, frozen(rate)), Samples(Sensor.ACCELEROMETER, t, frozen(force))
        self.fed.append(blocks)
        self.actions += self.engine.feed(*blocks)
        return self

    def begun(self) -> Bench:
        self.actions += self.engine.lay_faces()
        return self

    def restarted(self) -> Bench:
        """Go on with another engine, from the saved state."""
        self.engine = Engine(EngineSettings(), unpacked(packed(self.engine.state), EngineState))
        return self

    def logged(self, what: str) -> list[str]:
        return [a.why for a in self.actions if isinstance(a, Log) and a.what == what]

    @property
    def published(self) -> list[Publish]:
        """Full calibrations."""
        return [a for a in self.actions if isinstance(a, Publish) and a.record.accelerometer is not None]


def tilted(up: Array, degrees: float) -> Array:
    """Return a face's direction (3,), tilted about an axis of the case."""
    axis = np.roll(np.abs(up), 1)
    return np.asarray(rotation.matrix(rotation.exponential(np.radians(degrees) * axis[None]))[0] @ up)


def test_each_face_is_told_as_it_lies_and_the_sixth_brings_the_calibration() -> None:
    bench = Bench().shaken(5.0).begun()
    assert bench.faces.missing[0] == describe(RIGHT)
    for number, up in enumerate(FACE_DIRECTIONS, 1):
        assert up is RIGHT or bench.faces.missing[0] == describe(up)
        bench.laid(up)
        assert bench.faces.words == f"{number} of 6 faces" and bench.faces.note != "6 of 6"
    assert bench.faces.stage is Stage.CALIBRATED and bench.faces.missing == ()
    (one,) = bench.published
    part = one.record.accelerometer
    assert part is not None and part.parameters == 12 and "six known faces" in one.reason
    assert part.scale == pytest.approx(SCALE, abs=1e-3) and part.bias == pytest.approx(BIAS, abs=2e-3)
    assert bench.logged("faces")[1:] == [f"{k} of 6 faces" for k in range(1, 7)]


def test_the_sensors_stay_on_meanwhile_and_no_longer() -> None:
    bench = Bench().shaken(5.0)
    bench.engine.change_settings(EngineSettings(schedule=ScheduleSettings(attitudes_wanted=6)))
    for up in FACE_DIRECTIONS:
        bench.laid(up)
    bench.shaken(120.0)
    assert bench.engine.present.watch is Watch.IDLE
    bench.begun()
    assert bench.engine.present.watch is Watch.CONTINUOUS
    bench.laid(LEFT)
    bench.actions += bench.engine.stop_faces()
    assert bench.engine.present.watch is Watch.IDLE and bench.faces.stage is Stage.STOPPED


def test_what_is_no_face_and_what_was_laid_before_is_said_and_does_not_count() -> None:
    bench = Bench().shaken(5.0).begun().laid(LEFT + RIGHT * 0.2 + OTHERS[0] * 0.5)
    assert bench.faces.done == () and "32 degrees from the nearest face" in bench.faces.note
    bench.laid(LEFT).laid(RIGHT)
    assert bench.faces.words == "2 of 6 faces" and bench.faces.note == ""
    bench.laid(LEFT)
    assert bench.faces.words == "2 of 6 faces" and "on that face before" in bench.faces.note
    bench.laid(OTHERS[0], 4.0)
    assert bench.faces.words == "2 of 6 faces"
    bench.laid(OTHERS[0], 8.0).shaken()
    assert bench.faces.words == "3 of 6 faces"


def test_a_tilted_face_and_the_one_opposite_are_asked_for_again_once_the_phone_is_lifted() -> None:
    bench = Bench().shaken(5.0).begun()
    for up in OTHERS:
        bench.laid(up)
    bench.laid(RIGHT).laid(tilted(LEFT, 12.0), 40.0)
    assert bench.published == [] and bench.faces.words == "4 of 6 faces"
    assert bench.faces.missing == (describe(RIGHT), describe(LEFT))
    assert "square and level" in bench.faces.note
    bench.laid(LEFT).laid(RIGHT)
    assert bench.faces.stage is Stage.CALIBRATED
    assert bench.published[-1].record.accelerometer.scale == pytest.approx(SCALE, abs=1e-3)


@pytest.mark.parametrize("number", [0, 5])
def test_a_face_that_disagrees_with_the_other_five_is_asked_for_again_once(number: int) -> None:
    """All six together would pass: five degrees of one are 1.4 degrees (rms) of six."""
    odd = FACE_DIRECTIONS[number]
    bench = Bench().shaken(5.0).begun()
    for up in FACE_DIRECTIONS:
        bench.laid(tilted(up, 5.0) if up is odd or np.array_equal(up, odd) else up)
    assert bench.published == [] and bench.faces.missing == (describe(odd),)
    assert bench.faces.note == "a face is 5 degrees off what the other five show: lay it again, flat"
    flat, bent = bench.restarted(), Bench().restarted()
    bent.engine, bent.t = Engine(EngineSettings(), unpacked(packed(bench.engine.state), EngineState)), bench.t
    flat.laid(odd)
    assert flat.faces.stage is Stage.CALIBRATED and "off what" not in flat.faces.note
    assert flat.published[-1].record.accelerometer.scale == pytest.approx(SCALE, abs=1e-3)
    bent.laid(tilted(odd, 5.0))  # the case itself is not flat
    assert bent.faces.stage is Stage.CALIBRATED
    assert f"a face is 5 degrees off what the other five show ({describe(odd)})" in bent.faces.note


def test_of_two_times_on_one_face_the_last_one_counts() -> None:
    bench = Bench().shaken(5.0).begun().laid(tilted(LEFT, 3.0), 60.0).laid(RIGHT).laid(LEFT)
    for up in OTHERS:
        bench.laid(up)
    part = bench.published[-1].record.accelerometer
    assert part is not None and part.scale == pytest.approx(SCALE, abs=1e-3)


def test_an_engine_that_is_restarted_in_the_middle_goes_on_with_the_faces_laid() -> None:
    bench = Bench().shaken(5.0).begun().laid(LEFT).laid(RIGHT).restarted()
    assert bench.faces.words == "2 of 6 faces"
    bench.begun()
    for up in OTHERS:
        bench.laid(up)
    assert bench.faces.stage is Stage.CALIBRATED and len(bench.published) == 1


def test_a_sound_calibration_is_turned_and_keeps_what_rests_showed_of_bias_and_scale() -> None:
    bench = Bench().shaken(5.0)
    for up in places()[6:]:
        bench.laid(up)
    bench.actions += bench.engine.calibrate()
    bench.begun()
    for up in FACE_DIRECTIONS:
        bench.laid(tilted(up, 0.1))
    before, after = (p.record.accelerometer for p in bench.published)
    assert before is not None and after is not None and (before.parameters, after.parameters) == (9, 12)
    assert after.bias.tolist() == before.bias.tolist()
    assert after.scale == pytest.approx(common_rotation(after.scale) @ before.scale, abs=1e-9)
    assert np.abs(before.scale - SCALE).max() > 4e-3
    assert after.scale == pytest.approx(SCALE, abs=1.5e-3)


def test_what_comes_of_it_does_not_depend_on_how_the_samples_were_cut() -> None:
    bench = Bench().begun()
    for up in FACE_DIRECTIONS:
        bench.laid(up)
    whole = Engine(EngineSettings())
    whole.lay_faces()
    by_sensor = zip(*bench.fed, strict=True)
    whole.feed(*(Samples.joined(blocks) for blocks in by_sensor))
    assert whole.present.faces == bench.faces
    assert whole.present.record.id == bench.engine.present.record.id


def test_half_an_hour_without_a_face_gives_up() -> None:
    bench = Bench().shaken(5.0).begun().laid(LEFT)
    bench.shaken(GIVE_UP_S - 30.0)
    assert bench.faces.stage is Stage.LAYING
    bench.shaken(60.0)
    assert bench.faces.stage is Stage.GIVEN_UP and "given up" in bench.logged("faces")[-1]
    bench.begun()
    assert bench.faces.stage is Stage.LAYING and bench.faces.done == ()
