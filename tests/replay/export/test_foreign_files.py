"""Files as the tools themselves write them, with what else stands in them."""

from __future__ import annotations

import numpy as np
import pytest

from stillcal.calib_core.errors import UserError
from stillcal.replay.export.targets import target_named

OPENVINS = b"""%YAML:1.0 # need to specify the file type at the top!

imu0:
  T_i_b:
    - [1.0, 0.0, 0.0, 0.0]
    - [0.0, 1.0, 0.0, 0.0]
    - [0.0, 0.0, 1.0, 0.0]
    - [0.0, 0.0, 0.0, 1.0]
  accelerometer_noise_density: 2.0000e-3
  model: "kalibr"
  Tw:
    - [ 1.02, 0.0, 0.0 ]
    - [ 0.0, 1.0, 0.0 ]
    - [ 0.0, 0.0, 1.0 ]
  R_IMUtoGYRO:
    - [ 0.0, 1.0, 0.0 ]
    - [ -1.0, 0.0, 0.0 ]
    - [ 0.0, 0.0, 1.0 ]
  Ta:
    - [ 1.01, 0.0, 0.0 ]
    - [ 0.003, 1.0, 0.0 ]
    - [ 0.0, 0.0, 1.0 ]
  R_IMUtoACC:
    - [ 1.0, 0.0, 0.0 ]
    - [ 0.0, 1.0, 0.0 ]
    - [ 0.0, 0.0, 1.0 ]
  Tg:
    - [ 0.0, 0.0, 0.0 ]
    - [ 0.0, 0.0, 0.0 ]
    - [ 0.0, 0.0, 0.0 ]
"""

QGROUNDCONTROL = b"""# Onboard parameters for Vehicle 1
#
# Stack: PX4 Pro
# Vehicle: Multi-Rotor
# Version: 1.14.0
#
# Vehicle-Id Component-Id Name Value Type
1\t1\tASPD_BETA_GATE\t1\t6
1\t1\tCAL_ACC0_ID\t2490378\t6
1\t1\tCAL_ACC0_XOFF\t0.030000001192092896\t9
1\t1\tCAL_ACC0_XSCALE\t1.009999990463256836\t9
1\t1\tCAL_ACC0_YOFF\t0.000000000000000000\t9
1\t1\tCAL_ACC0_YSCALE\t1.000000000000000000\t9
1\t1\tCAL_ACC0_ZOFF\t-0.100000001490116119\t9
1\t1\tCAL_ACC0_ZSCALE\t0.990000009536743164\t9
1\t1\tTC_A_ENABLE\t0\t6
1\t1\tTC_A0_X1_0\t0.5\t9
"""

MISSION_PLANNER = b"""#NOTE: 11/22/2026 Frame: quad
INS_ACCOFFS_X,0.1
INS_ACCOFFS_Y,-0.013
INS_ACCOFFS_Z,0.045
INS_ACCSCAL_X,1.001
INS_ACCSCAL_Y,0.999
INS_ACCSCAL_Z,1.002
INS_ACC1_CALTEMP,-300
INS_TCAL1_ENABLE,0
INS_GYROFFS_X,0.002
INS_GYROFFS_Y,0.003
INS_GYROFFS_Z,0
SERIAL0_BAUD,115
"""

MATLAB = b"""% IMU of the robot
IMU = imuSensor('accel-gyro');
IMU.Gyroscope.ConstantBias = 0.01;           % all axes
IMU.Gyroscope.AxesMisalignment = [100, 1, 0; 0, 100, 0; 0, 0, 102];
"""


def test_openvins() -> None:
    imu = target_named("kalibr").read(OPENVINS)
    assert imu.accelerometer is not None and imu.accelerometer.scale is not None
    np.testing.assert_allclose(imu.accelerometer.scale @ [1.01, 0.003, 0.0], [1.0, 0.0, 0.0], atol=1e-12)
    assert imu.gyroscope is not None and imu.gyroscope.matrix is None
    # The gyroscope's x axis lies along the body's y, and reads 2 % too much.
    np.testing.assert_allclose(
        imu.gyroscope.scale, [[0.0, -1.0, 0.0], [1 / 1.02, 0.0, 0.0], [0, 0, 1.0]], atol=1e-12
    )


def test_qgroundcontrol_with_compensation_switched_off() -> None:
    imu = target_named("px4").read(QGROUNDCONTROL)
    assert imu.gyroscope is None and imu.accelerometer is not None
    np.testing.assert_allclose(imu.accelerometer.offset, [0.03, 0.0, -0.1], atol=1e-8)
    assert imu.accelerometer.scale is not None and imu.accelerometer.slope is None
    np.testing.assert_allclose(np.diag(imu.accelerometer.scale), [1.01, 1.0, 0.99], atol=1e-7)


def test_mission_planner_without_calibration_temperature() -> None:
    imu = target_named("ardupilot").read(MISSION_PLANNER)
    assert imu.accelerometer is not None and imu.gyroscope is not None
    assert imu.gyroscope.offset.tolist() == [0.002, 0.003, 0.0]
    assert imu.accelerometer.slope is None
    enabled = MISSION_PLANNER.replace(b"ENABLE,0", b"ENABLE,1") + b"".join(
        b"INS_TCAL1_ACC1_%c,100\n" % axis for axis in b"XYZ"
    )
    with pytest.raises(UserError, match="CALTEMP is not known"):
        target_named("ardupilot").read(enabled)


def test_a_matlab_script_with_one_number_for_all_axes() -> None:
    imu = target_named("imusensor").read(MATLAB)
    assert imu.accelerometer is None and imu.gyroscope is not None
    assert imu.gyroscope.offset.tolist() == [0.01] * 3
    np.testing.assert_allclose(imu.gyroscope.gain, [[1.0, 0.01, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.02]])


def test_a_bias_that_curves_with_temperature() -> None:
    px4 = b"TC_A_ENABLE 1\nTC_A0_TREF 25\nTC_A0_TMIN 10\nTC_A0_TMAX 50\n"
    for i, axis in enumerate(b"XYZ"):
        px4 += b"CAL_ACC0_%cOFF 0\nTC_A0_X0_%d 0.5\nTC_A0_X1_%d 0.1\nTC_A0_X2_%d 0.01\n" % (axis, i, i, i)
    part = target_named("px4").read(px4).accelerometer
    assert part is not None and part.limits == (10.0, 50.0)
    assert part.bias_at(35.0)[0] == pytest.approx(0.5 + 0.1 * 10.0 + 0.01 * 100.0)
    assert part.bias_at(90.0)[0] == pytest.approx(0.5 + 0.1 * 25.0 + 0.01 * 625.0)
    ardupilot = b"INS_TCAL1_ENABLE 1\nINS_ACC1_CALTEMP 25\n"
    for axis in b"XYZ":
        ardupilot += b"INS_ACCOFFS_%c 0\nINS_TCAL1_ACC1_%c 1000\nINS_TCAL1_ACC2_%c 100\n" % (axis, axis, axis)
    part = target_named("ardupilot").read(ardupilot).accelerometer
    assert part is not None
    # p(45) - p(25) with p about 35 degC: only the straight part remains.
    assert part.bias_at(45.0)[0] == pytest.approx(20.0 * 1e-3)
