"""Which studies there are, and running one. A study's module is imported when it is run, not before."""

from __future__ import annotations

import importlib
from pathlib import Path

from stillcal.replay.evaluation.claim import Progress, Study, StudyFunction

STUDIES: dict[str, str] = {
    "smoothing": "stillcal.replay.evaluation.unaided_smoothing:study",
    "homogeneity": "stillcal.replay.evaluation.unaided_homogeneity:study",
    "classes": "stillcal.replay.evaluation.unaided_classes:study",
    "new-phone": "stillcal.replay.evaluation.unaided_newphone:study",
    "gravity": "stillcal.replay.evaluation.unaided_gravity:study",
    "power": "stillcal.replay.evaluation.unaided_power:study",
    "people": "stillcal.replay.evaluation.unaided_people:study",
    "laboratory": "stillcal.replay.evaluation.laboratory:study",
    "nonorthogonality": "stillcal.replay.evaluation.nonorthogonality:study",
    "repeats": "stillcal.replay.evaluation.repeats:study",
    "best-attitudes": "stillcal.replay.evaluation.best_attitudes:study",
    "allan": "stillcal.replay.evaluation.allan:study",
    "noise-processes": "stillcal.replay.evaluation.noise_processes:study",
    "grades": "stillcal.replay.evaluation.grades:study",
    "inertial-navigation": "stillcal.replay.evaluation.inertial_navigation:study",
    "steps": "stillcal.replay.evaluation.step_detection:study",
    "pedestrian-tables": "stillcal.replay.evaluation.pedestrian_tables:study",
    "pedestrian-calibration": "stillcal.replay.evaluation.pedestrian_calibration:study",
    "motion-modes": "stillcal.replay.evaluation.motion_modes:study",
    "coning": "stillcal.replay.evaluation.coning:study",
    "biases": "stillcal.replay.evaluation.hetero_biases:study",
    "intervals": "stillcal.replay.evaluation.hetero_timing:study",
    "clusters": "stillcal.replay.evaluation.hetero_clusters:study",
    "still-devices": "stillcal.replay.evaluation.hetero_rests:study",
    "heterogeneity": "stillcal.replay.evaluation.hetero_families:study",
    "modes": "stillcal.replay.evaluation.hetero_modes:study",
    "remedies": "stillcal.replay.evaluation.hetero_remedies:study",
}
"""Name to "module:function", in the order of the page (paper by paper)."""

UNKNOWN = "no study is named {name}: choose among {known}"


def run(name: str, data: Path | None, figures: Path, seed: int, progress: Progress) -> Study:
    """Run a study; its figures go to `figures`, which exists. Raises KeyError for an unknown name."""
    module, function = STUDIES[name].split(":")
    study: StudyFunction = getattr(importlib.import_module(module), function)
    return study(data, figures, seed, progress)


def title(name: str) -> str:
    """Return the first sentence of what a study's module says of itself."""
    module = importlib.import_module(STUDIES[name].split(":")[0])
    return (module.__doc__ or "").strip().splitlines()[0]
