"""Clusters of devices by affinity propagation (Frey and Dueck 2007)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array


def clusters(
    features: Array, seed: int, preference: float = 1.0
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return (labels (n,), rows of the exemplars) by affinity propagation (Frey and Dueck 2007).

    features (n, k) are brought to unit variance. preference: times the median similarity, which is the
    algorithm's usual choice; larger ones (similarities are negative) make fewer clusters.
    """
    from sklearn.cluster import AffinityPropagation  # noqa: PLC0415 - an extra

    unit = (features - features.mean(axis=0)) / features.std(axis=0)
    similarity = -np.square(unit[:, None, :] - unit[None, :, :]).sum(axis=2)
    middle = float(np.median(similarity[~np.eye(len(unit), dtype=bool)]))
    model = AffinityPropagation(
        affinity="precomputed", preference=preference * middle, damping=0.8, max_iter=2000, random_state=seed
    ).fit(similarity)
    return np.asarray(model.labels_, dtype=np.intp), np.asarray(model.cluster_centers_indices_, dtype=np.intp)
