"""The evidence, in nats, for a finding that one recording makes by itself."""

from __future__ import annotations

import numpy as np

from stillcal.calib_core.diagnosis.model.records import Finding


def evidence_of(finding: Finding) -> float:
    """Return the log Bayes factor of a finding against no effect.

    Where none was computed, it is the most that the p value can stand for: 1 / (-e p ln p) (Sellke, Bayarri
    and Berger, Am. Stat. 55, 2001).
    """
    if finding.evidence.log_bayes_factor is not None:
        return finding.evidence.log_bayes_factor
    if finding.evidence.p_value is None:
        return 0.0
    p = max(finding.evidence.p_value, 1e-300)
    return float(-1.0 - np.log(p) - np.log(-np.log(p))) if p < np.exp(-1.0) else 0.0


def heldout_contradicts(finding: Finding) -> bool:
    """Whether what was left out of the fit is predicted no better with the effect than without it."""
    gain = finding.evidence.heldout_log_score_gain
    return gain is not None and gain <= 0.0
