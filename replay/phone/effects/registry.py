"""The registry of all effects that a phone file can switch on, by the names that a diagnosis uses."""

from __future__ import annotations

from typing import get_args

from stillcal.replay.phone.effects.base import Effect
from stillcal.replay.phone.effects.on_bias import (
    AccelBiasDrift,
    AccelBiasStep,
    AccelBiasTemperature,
    AccelChargingBias,
    AccelScaleTemperature,
    AccelThermalHysteresis,
    AccelWarmup,
    GyroBiasDrift,
    GyroBiasStep,
    GyroBiasTemperature,
    GyroChargingBias,
    GyroScaleTemperature,
    GyroThermalHysteresis,
    GyroWarmup,
    ThermalLatent,
)
from stillcal.replay.phone.effects.on_input import (
    AccelNonlinearity,
    AccelVibrationRectification,
    GyroGSensitivity,
    GyroNonlinearity,
    GyroVibrationRectification,
    LeverArm,
    Spikes,
    VibrationTone,
)
from stillcal.replay.phone.effects.on_settings import (
    AccelBiasRandomWalk,
    AccelGyroTimeOffset,
    AccelQuantisation,
    AccelSaturation,
    ArrivalBursts,
    Bandwidth,
    ClockSkew,
    DoubledSamples,
    DroppedSamples,
    GyroBiasRandomWalk,
    GyroQuantisation,
    GyroSaturation,
    HeldSamples,
    NoiseHeavyTailed,
    NoiseLevel,
    NoiseUnequalAxes,
    TiltCreep,
    TimestampJitter,
)
from stillcal.replay.phone.effects.other_physics import OtherPhysics

AnyEffect = (
    AccelBiasTemperature | GyroBiasTemperature | AccelScaleTemperature | GyroScaleTemperature
    | AccelWarmup | GyroWarmup | ThermalLatent | AccelBiasStep | GyroBiasStep | AccelBiasDrift
    | GyroBiasDrift | AccelBiasRandomWalk | GyroBiasRandomWalk | AccelChargingBias | GyroChargingBias
    | AccelNonlinearity | GyroNonlinearity | GyroGSensitivity | AccelVibrationRectification
    | GyroVibrationRectification | AccelThermalHysteresis | GyroThermalHysteresis | Spikes | LeverArm
    | VibrationTone | AccelSaturation | GyroSaturation | AccelQuantisation | GyroQuantisation | Bandwidth
    | HeldSamples | NoiseLevel | NoiseUnequalAxes | NoiseHeavyTailed | ClockSkew | TimestampJitter
    | DroppedSamples | DoubledSamples | ArrivalBursts | AccelGyroTimeOffset | TiltCreep | OtherPhysics
)  # fmt: skip

EFFECTS: dict[str, type[Effect]] = {str(kind.__struct_config__.tag): kind for kind in get_args(AnyEffect)}
"""Every effect's class by its name."""
