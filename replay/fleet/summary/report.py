"""The summary of a fleet from its two tables: spread by model, outliers, clusters, priors."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stillcal.calib_core.accelerometer import prior as fleet_prior
from stillcal.calib_core.accelerometer.prior import FleetPrior
from stillcal.calib_core.arrays import Array
from stillcal.calib_core.errors import NotSupported
from stillcal.replay.fleet import results_folder
from stillcal.replay.fleet.prior_file import FEW, few_devices
from stillcal.replay.fleet.summary.changes import Change, changes, first_and_last
from stillcal.replay.fleet.summary.clusters import clusters
from stillcal.replay.fleet.summary.devices import Devices, devices
from stillcal.replay.fleet.summary.outliers import Distances, distances
from stillcal.replay.fleet.summary.spread import Effect, Spread, effects, spreads

LEAST, MOST_CLUSTERED = 5, 2000
"""Fewer devices have no outliers and no clusters; affinity propagation grows with their square."""

_PARAMETERS = 6  # by which outliers are judged: biases and scales, which every fit has
_NAMES = fleet_prior.FleetPrior(np.zeros(9), np.eye(9)).names


@dataclass(frozen=True, slots=True)
class Outlier:
    """An outlier: its distance and the limit, and its parameter that is farthest from the median."""

    device: str
    model: str
    distance: float
    limit: float
    parameter: str
    value: float
    median: float


@dataclass(frozen=True, slots=True)
class Cluster:
    """Devices with similar bias and sampling. exemplar: the most typical. models: how many of each model."""

    exemplar: str
    devices: int
    models: dict[str, int]
    bias: float
    rate_hz: float


@dataclass(frozen=True, slots=True, eq=False)
class Report:
    """The summary of a fleet.

    recordings: counts by status. compared: devices whose first and last recording could be compared, which
    `changes` are of. limits: what this fleet cannot show.
    """

    recordings: dict[str, int]
    spreads: list[Spread]
    effects: list[Effect]
    changes: list[Change]
    outliers: list[Outlier]
    clusters: list[Cluster]
    priors: list[FleetPrior]
    limits: list[str]
    compared: int = 0

    def document(self) -> dict[str, Any]:
        """Return the report as plain values."""
        plain = {
            k: [asdict(x) for x in getattr(self, k)]
            for k in ("spreads", "effects", "changes", "outliers", "clusters")
        }
        priors = [prior_document(prior) for prior in self.priors]
        counts = {"recordings": self.recordings, "compared": self.compared}
        return {"schema": 1, **counts, **plain, "priors": priors, "limits": self.limits}


def prior_document(prior: FleetPrior) -> dict[str, Any]:
    """Return a prior as plain values: names, mean and covariance in m/s^2 and 1."""
    return {
        "model": prior.model,
        "devices": prior.devices,
        "of_model": prior.of_model,
        "names": list(prior.names),
        "mean": prior.mean.tolist(),
        "sd": np.sqrt(np.diag(prior.covariance)).tolist(),
        "covariance": prior.covariance.tolist(),
        "scatter": prior.scatter,
    }


def report(folder: Path) -> Report:
    """Return the summary of the results in `folder`, finished or not."""
    rows, findings = results_folder.read(folder)
    counts: dict[str, int] = {}
    for row in rows:
        counts[row["status"]] = counts.get(row["status"], 0) + 1
    fleet = devices(rows)
    limits: list[str] = []
    enough = len(fleet) >= LEAST
    if not enough:
        limits.append(f"{len(fleet)} calibrated devices: outliers, clusters and priors need {LEAST}")
    return Report(
        dict(sorted(counts.items())),
        spreads(fleet) if len(fleet) else [],
        effects(rows, findings),
        changes(rows, limits),
        outliers(fleet, limits) if enough else [],
        cluster_devices(fleet, limits) if enough else [],
        priors(fleet, limits) if enough else [],
        limits,
        len(list(first_and_last(rows))),
    )


def outliers(fleet: Devices, limits: list[str]) -> list[Outlier]:
    """Return the devices whose biases and scales are outliers, farthest first."""
    values = fleet.values[:, :_PARAMETERS]
    judged_distances = distances(values, fleet.covariances[:, :_PARAMETERS, :_PARAMETERS])
    if not judged_distances.robust:
        limits.append(f"{len(fleet)} devices: outliers are judged by each parameter separately")
    return [_outlier(fleet, values, judged_distances, int(row)) for row in judged_distances.outliers]


def _outlier(fleet: Devices, values: Array, judged_distances: Distances, row: int) -> Outlier:
    median = np.median(values, axis=0)
    spread = np.median(np.abs(values - median), axis=0)
    worst = int(np.argmax(np.abs(values[row] - median) / np.maximum(spread, 1e-12)))
    return Outlier(
        fleet.names[row],
        fleet.models[fleet.model[row]],
        float(np.sqrt(judged_distances.squared[row])),
        float(np.sqrt(judged_distances.limit)),
        _NAMES[worst],
        float(values[row, worst]),
        float(median[worst]),
    )


def cluster_devices(fleet: Devices, limits: list[str]) -> list[Cluster]:
    """Cluster devices by what Stisen et al. 2015 did (5.1): bias, rate, and how steady that is."""
    bias = np.linalg.norm(fleet.values[:, :3], axis=1)
    features = np.column_stack((bias, fleet.rate_hz, fleet.rate_jitter))
    known = np.isfinite(features).all(axis=1)
    features = features[known][:, features[known].std(axis=0) > 0] if known.any() else features[:0]
    if not LEAST <= len(features) <= MOST_CLUSTERED or features.shape[1] == 0:
        limits.append(f"{len(features)} devices with a known rate: clusters need {LEAST} to {MOST_CLUSTERED}")
        return []
    labels, exemplars = clusters(features, 0)
    rows = np.flatnonzero(known)
    groups = [_cluster(fleet, bias, rows[labels == k], int(rows[e])) for k, e in enumerate(exemplars)]
    return sorted(groups, key=lambda c: -c.devices)


def _cluster(fleet: Devices, bias: Array, members: Array, exemplar: int) -> Cluster:
    counts = np.bincount(fleet.model[members], minlength=len(fleet.models))
    models = {name: int(n) for name, n in zip(fleet.models, counts, strict=True) if n}
    rate = float(np.median(fleet.rate_hz[members]))
    return Cluster(fleet.names[exemplar], len(members), models, float(np.median(bias[members])), rate)


def priors(fleet: Devices, limits: list[str]) -> list[FleetPrior]:
    """Return what the fleet says of a device of any model, then of each."""
    try:
        learnt = fleet_prior.learn(
            fleet.values, fleet.covariances, fleet.model, max(float(np.nanmedian(fleet.scatter)), 1e-3)
        )
    except NotSupported as refusal:
        limits.append(str(refusal))
        return []
    learnt_priors = [learnt.prior(), *(learnt.prior(k, name) for k, name in enumerate(fleet.models))]
    warnings = [warning for prior in learnt_priors if (warning := few_devices(prior))]
    limits.extend(warnings[:1] if learnt_priors[0].devices < FEW else warnings)
    return learnt_priors
