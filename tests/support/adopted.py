"""What a diagnosis found, taken up by a calibration, for tests that do not ask what was left out."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from stillcal.calib_core.calibration.adoption import adopt
from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.calib_core.streams.beginning import Beginning


def with_terms(
    record: CalibrationRecord, findings: Iterable[Mapping[str, Any]], diagnosed: Beginning | None = None
) -> CalibrationRecord:
    """Return the calibration with the terms of findings, as `adopt` does."""
    return adopt(record, findings, diagnosed)[0]
