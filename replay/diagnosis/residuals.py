"""What a recording leaves of an ideal sensor, bin by bin, without and with the effects found."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.arrays import Array
from stillcal.calib_core.diagnosis.examination import Examination
from stillcal.calib_core.diagnosis.model.hypothesis import Hypothesis, SensorResiduals
from stillcal.calib_core.diagnosis.model.residuals import View

HEADER = "sensor,residual,component,t,duration,rest,sd,ideal,with_effects,unit"
UNITS = {"norm": "m/s^2", "tangent": "m/s^2", "turn": "rad"}
"""Units of the residuals; the rate's is rad/s."""


def residuals_csv(exam: Examination) -> str:
    """Return the residuals as CSV: a row for each static bin, or turn between rests, and component.

    residual: norm (of gravity), tangent (across it), rate_x, rate_y, rate_z at rest, or turn (what gravity
    carried through a turn misses). t, duration: s, of a turn its angle, rad; rest: which one; sd: white noise
    alone. ideal: the residual of an affine sensor; with_effects: what is left when the effects found are
    fitted too.
    """
    lines = [HEADER]
    for residuals in [*exam.sensors, *([] if exam.turns is None else [exam.turns])]:
        kind = bool(residuals.turns)
        found = [
            s.hypothesis
            for s in exam.statements
            if s.hypothesis is not None
            and s.residuals is not None
            and (s.residuals.sensor, bool(s.residuals.turns)) == (residuals.sensor, kind)
        ]
        lines += _of_one(residuals, found)
    return "\n".join(lines) + "\n"


def _of_one(residuals: SensorResiduals, found: list[Hypothesis]) -> list[str]:
    lines = []
    for i, view in enumerate(residuals.views):
        unit = UNITS.get(view.name, "rad/s")
        for block in range(len(view.y)):
            ideal = _left(view, block, [])
            after = _left(view, block, [h.columns[i][block] for h in found])
            for n in range(view.t.size):
                numbers = (view.t[n], view.duration[n], view.rest[n], np.sqrt(view.variance[n]))
                cells = ",".join(f"{x:.8g}" for x in (*numbers, ideal[n], after[n]))
                lines.append(f"{residuals.sensor},{view.name},{block},{cells},{unit}")
    return lines


def _left(view: View, block: int, effects: list[Array]) -> Array:
    """Return a block's residual (n,), the baseline and the effects fitted by least squares taken off.

    Of what is absorbed something is known: it is fitted as far as that lets it.
    """
    sd = np.sqrt(view.variance)
    columns = np.hstack([view.nuisance(block), *effects]) / sd[:, None]
    first, known = view.baseline.shape[2], 0 if view.absorbed is None else view.absorbed.shape[1]
    prior = np.eye(known, columns.shape[1], first)
    # Columns of very different size are scaled, lest small ones count as nothing.
    size = np.maximum(np.abs(np.vstack([columns, prior])).max(axis=0), 1e-300)
    design, target = np.vstack([columns, prior]) / size, np.append(view.y[block] / sd, np.zeros(known))
    fitted = columns / size @ np.linalg.lstsq(design, target, rcond=None)[0]
    return np.asarray(view.y[block] - fitted * sd)
