"""Store documents that calibrations were published to."""

from __future__ import annotations

from stillcal.calib_core.calibration.record import CalibrationRecord
from stillcal.daemon.store.document import StoreDocument


def published(*records: CalibrationRecord, limit: int = 32) -> StoreDocument:
    """Return a document to which these were published in turn. limit: how many its history keeps."""
    document = StoreDocument()
    for record in records:
        document = document.after_publishing(record, limit)
    return document
