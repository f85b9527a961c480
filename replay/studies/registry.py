"""Which studies there are, and running one. A study's module is imported when it is run, not before."""

from __future__ import annotations

import importlib
from pathlib import Path

from stillcal.replay.studies.claim import Progress, Study, StudyFunction

STUDIES: dict[str, str] = {
    "smoothing": "stillcal.replay.studies.grammenos2018.smoothing:study",
    "homogeneity": "stillcal.replay.studies.grammenos2018.homogeneity:study",
    "classes": "stillcal.replay.studies.grammenos2018.classes:study",
    "new-phone": "stillcal.replay.studies.grammenos2018.newphone:study",
    "gravity": "stillcal.replay.studies.grammenos2018.gravity:study",
    "power": "stillcal.replay.studies.grammenos2018.power:study",
    "minimisation": "stillcal.replay.studies.grammenos2018.minimisation:study",
    "stationary-states": "stillcal.replay.studies.grammenos2018.stationary_states:study",
    "gyroscope-bias": "stillcal.replay.studies.grammenos2018.gyroscope_bias:study",
    "quality-check": "stillcal.replay.studies.grammenos2018.quality_check:study",
    "people": "stillcal.replay.studies.grammenos2018.people:study",
    "laboratory": "stillcal.replay.studies.esgi95.laboratory:study",
    "nonorthogonality": "stillcal.replay.studies.esgi95.nonorthogonality:study",
    "repeats": "stillcal.replay.studies.esgi95.repeats:study",
    "best-attitudes": "stillcal.replay.studies.esgi95.best_attitudes:study",
    "allan": "stillcal.replay.studies.collin2019.allan:study",
    "noise-processes": "stillcal.replay.studies.collin2019.noise_processes:study",
    "bias-prediction": "stillcal.replay.studies.collin2019.bias_prediction:study",
    "grades": "stillcal.replay.studies.collin2019.grades:study",
    "inertial-navigation": "stillcal.replay.studies.collin2019.inertial_navigation:study",
    "steps": "stillcal.replay.studies.collin2019.step_detection:study",
    "step-template": "stillcal.replay.studies.collin2019.step_template:study",
    "pedestrian-tables": "stillcal.replay.studies.collin2019.pedestrian_tables:study",
    "heading-tilt": "stillcal.replay.studies.collin2019.heading_tilt:study",
    "pedestrian-calibration": "stillcal.replay.studies.collin2019.pedestrian_calibration:study",
    "motion-modes": "stillcal.replay.studies.collin2019.motion_modes:study",
    "mode-sequences": "stillcal.replay.studies.collin2019.mode_sequences:study",
    "coning": "stillcal.replay.studies.collin2019.coning:study",
    "biases": "stillcal.replay.studies.stisen2015.biases:study",
    "intervals": "stillcal.replay.studies.stisen2015.timing:study",
    "washing-machine": "stillcal.replay.studies.stisen2015.washing_machine:study",
    "clusters": "stillcal.replay.studies.stisen2015.clusters:study",
    "still-devices": "stillcal.replay.studies.stisen2015.rests:study",
    "heterogeneity": "stillcal.replay.studies.stisen2015.heterogeneity:study",
    "modes": "stillcal.replay.studies.stisen2015.modes.study:study",
    "gyroscope": "stillcal.replay.studies.stisen2015.gyroscope:study",
    "remedies": "stillcal.replay.studies.stisen2015.remedies.study:study",
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
