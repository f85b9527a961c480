"""The words by which people name the columns of a log."""

from __future__ import annotations

from stillcal.calib_core.streams.samples import Sensor


def _of(*lines: str) -> frozenset[str]:
    """Return the words of lines."""
    return frozenset(word for line in lines for word in line.split())


ACCELERATION = _of(
    "a ac acc acce accel accelerometer accelerometers acceleration accelerations accl alpha force gforce gf",
    "beschleunigung aceleracion accelerazione aceleracao versnelling przyspieszenie",
    "beschleunigungssensor acelerometro accelerometro accelerometre versnellingsmeter akcelerometr",
)
ANGULAR = _of("angular rotation angolare angulaire katowa katowe")
"""Words that make an acceleration an angular one."""

RATE = ANGULAR | _of(
    "w g gy gyr gyro gyros gyroscope gyroscopes omega rotationrate rot angvel angrate turnrate bodyrate",
    "drehrate winkelgeschwindigkeit gyroskop giroscopio giroscopo zyroskop gyroscoop hoeksnelheid",
)
LETTERS = _of("a w g")
"""Letters that may stand for a sensor, or for anything beside a sensor's word (`imu_a_gyro_x`)."""

NEITHER = _of(
    "mag magnetometer magnetic gravity grav free user bias drift offset sigma std var variance covariance",
    "cov setpoint sp desired des target cmd commanded quat orientation position pos integral",
)
NO_AXES = NEITHER | _of("earth world global")
"""Words of axes that are no sensor's. The last three mean axes fixed to the ground; a time may have them."""

FILLERS = _of("velocity vel rate speed linear specific raw uncal uncalibrated per axis")
"""Words that say nothing by which sensors of one log differ."""

RAW = _of("raw uncal uncalibrated")
OTHER_VECTORS = _of(
    "quaternion quaternions attitude ahrs euler compass",
    "direction directions normals velocity velocities",
)
"""Words for what holds x, y, z of no sensor, which may be of gravity's size too: 1 or 9.8."""

OF_AXES = _of("axis value values val vals data attr reading readings sensor imu")
"""Words beside x, y, z that do not say of which sensor they are."""

OF_ROTATION = _of("w qw q0 heading")
"""Names beside x, y, z that are then a quaternion's or a pose's; so are the angles of an attitude."""

ATTITUDE = {"roll": 0, "pitch": 1, "yaw": 2}
TURNS = _of("rate rates speed velocity vel gyro gyr gyroscope angular omega")
"""Words that make roll, pitch and yaw rates about x, y and z; without one they are angles."""

BODY_RATES = {"p": 0, "q": 1, "r": 2}
"""Rates about x, y and z as flight mechanics calls them (ISO 1151-1). All three must be there.

The word by which both kinds go on is `bodyrate`."""

VAGUE = _of("linear alpha rot rotation rotationrate bodyrate")
"""Words that also stand for acceleration without gravity, angles, angular acceleration, filtered rates."""

SENSOR_WORDS = {Sensor.ACCELEROMETER: ACCELERATION - VAGUE, Sensor.GYROSCOPE: RATE - VAGUE}
"""Words that stand for a sensor and nothing else."""

WITHOUT_GRAVITY = _of("free user linear")
"""Words for acceleration from which gravity was taken."""

GRAVITY = _of("gravity grav")
"""Words for columns of gravity alone, which added to acceleration without it is what the sensor reads."""

OF_CORE_MOTION = _of("user")
"""Words by which Core Motion calls acceleration without gravity: it has minus the specific force."""

ROTATION = _of("rotation rot")
VECTOR = _of("vector vec")
"""Words that make a rotation an attitude: Android's rotation vector is a part of a quaternion."""

TIME = _of(
    "t time timestamp timestamps stamp ts elapsed epoch clock uptime datetime",
    "zeit tijd tid tempo tiempo temps czas zeitstempel tijdstempel czasu",
    "tow",  # GPS time of week
)
COUNTERS = _of("tick ticks count counter index seq number frame")
"""Words of numbers that go forward with the samples, in no unit of time unless one is stated."""

OF_MESSAGE = "header"
"""The word of a message's own stamp (ROS)."""

LATE = _of("offset")
"""Words of times that count from another one: they serve where there is no other."""

ARRIVAL = _of("arrival utc received host phone system pc log logging unix raw")
"""Words of times that another clock took, or that are ticks; the sensor's own go before them."""
THERMOMETER = _of("temp tmp temperature celsius degc degf temperatur temperatura temperatuur")
RATES_HZ = _of("fs hz samplingrate samplerate ratehz samplingfrequency samplefrequency freq")

OWN = {"t", "ax", "ay", "az"}
"""Columns by which a table is stillcal's own."""

OWN_RATES = {"gx", "gy", "gz"}
