"""Learners, folds by people, scores and their intervals by people."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stillcal.calib_core.arrays import Array

Labels = NDArray[np.intp]
Learner = Callable[[int], Any]
"""A random seed -> a fresh classifier with fit and predict."""

BOOTSTRAPS = 2000


def _scaled(model: Any) -> Any:
    from sklearn.pipeline import make_pipeline  # noqa: PLC0415 - an extra
    from sklearn.preprocessing import StandardScaler  # noqa: PLC0415 - an extra

    return make_pipeline(StandardScaler(), model)


def nearest(seed: int) -> Any:
    """Return the five nearest neighbours, on standardised features."""
    from sklearn.neighbors import KNeighborsClassifier  # noqa: PLC0415 - an extra

    return _scaled(KNeighborsClassifier(5))


def tree(seed: int) -> Any:
    """Return a decision tree split by entropy, as C4.5 does; leaves of two or more."""
    from sklearn.tree import DecisionTreeClassifier  # noqa: PLC0415 - an extra

    return DecisionTreeClassifier(criterion="entropy", min_samples_leaf=2, random_state=seed)


def linear_svm(seed: int) -> Any:
    """Return a linear support vector machine, on standardised features."""
    from sklearn.svm import SVC  # noqa: PLC0415 - an extra

    return _scaled(SVC(kernel="linear"))


def forest(seed: int) -> Any:
    """Return a random forest of fifty trees."""
    from sklearn.ensemble import RandomForestClassifier  # noqa: PLC0415 - an extra

    return RandomForestClassifier(50, random_state=seed)


def radial_svm(seed: int) -> Any:
    """Return a support vector machine with Gaussian kernels, on standardised features."""
    from sklearn.svm import SVC  # noqa: PLC0415 - an extra

    return _scaled(SVC())


def plain_svm(seed: int) -> Any:
    """Return a support vector machine with Gaussian kernels on features as they are.

    Not standardised; the kernel's width is that which LIBSVM takes, 1 over the number of features.
    """
    from sklearn.svm import SVC  # noqa: PLC0415 - an extra

    return SVC(gamma="auto")


def network(hidden: int, iterations: int = 40) -> Learner:
    """Return a maker of networks with one hidden layer of so many units, trained for so many iterations."""

    def make(seed: int) -> Any:
        from sklearn.neural_network import MLPClassifier  # noqa: PLC0415 - an extra

        return _scaled(MLPClassifier((hidden,), max_iter=iterations, tol=1e-3, random_state=seed))

    return make


LEARNERS: dict[str, Learner] = {"kNN": nearest, "tree": tree, "SVM": linear_svm, "forest": forest}
"""Those of Stisen et al. 2015, 4.1."""


def principal(learner: Learner, share: float | None = 0.95, *, scaled: bool = True) -> Learner:
    """Return the learner on the components that keep `share` of the features' variance; None keeps all.

    scaled: whether features are standardised first.
    """

    def make(seed: int) -> Any:
        from sklearn.decomposition import PCA  # noqa: PLC0415 - an extra
        from sklearn.pipeline import make_pipeline  # noqa: PLC0415 - an extra

        reduced = make_pipeline(PCA(share, random_state=seed), learner(seed))
        return _scaled(reduced) if scaled else reduced

    return make


def fitted(learner: Learner, features: Array, labels: Labels, seed: int) -> Any:
    """Return a classifier fitted to features (n, k); one that stops before it has converged is kept."""
    import warnings  # noqa: PLC0415 - only here

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return learner(seed).fit(features, labels)


def folds(person: Labels, number: int, rng: np.random.Generator) -> Iterator[NDArray[np.bool_]]:
    """Yield masks (n,) of what is tested: people in `number` groups, none in both parts."""
    people = rng.permutation(np.unique(person))
    for group in np.array_split(people, number):
        yield np.isin(person, group)


def weighted_f1(truth: Labels, predicted: Labels) -> float:
    """Return the F1 scores' mean over classes, weighted by their size (Stisen et al. 2015, 4.1)."""
    score = 0.0
    for kind in np.unique(truth):
        right = float(np.sum((predicted == kind) & (truth == kind)))
        score += (
            np.mean(truth == kind) * 2.0 * right / float(np.sum(predicted == kind) + np.sum(truth == kind))
        )
    return float(score)


def mcnemar(one: NDArray[Any], other: NDArray[Any]) -> tuple[float, float]:
    """Return McNemar's chi-squared with Yates' correction and its p-value for paired judgements.

    one, other: (n,) whether each recogniser judged each sample rightly. Only samples that one alone judged
    rightly count (Stisen et al. 2015, 4.1); without any the statistic is 0 and p is 1.
    """
    from scipy.stats import chi2  # noqa: PLC0415 - slow to import

    a, b = one.astype(bool), other.astype(bool)
    first, second = int(np.sum(a & ~b)), int(np.sum(b & ~a))
    if first + second == 0:
        return 0.0, 1.0
    statistic = max(abs(first - second) - 1.0, 0.0) ** 2 / (first + second)
    return float(statistic), float(chi2.sf(statistic, 1))


LEAST_P = 1e-300
"""Keeps the sign of a p-value that is too small for a float."""


def signed_mcnemar(one: NDArray[Any], other: NDArray[Any]) -> Array:
    """Return McNemar's p-value by recogniser; negative where `one` judged fewer rightly.

    one, other: (families, learners, n), paired judgements. The test takes the n windows for independent, so
    judgements of one window by several recognisers are not put together.
    """
    return np.array(
        [
            [
                np.copysign(max(mcnemar(a, b)[1], LEAST_P), int(a.sum()) - int(b.sum()))
                for a, b in zip(mine, theirs, strict=True)
            ]
            for mine, theirs in zip(one, other, strict=True)
        ]
    )


def by_recogniser(p: Array, level: float = 0.01) -> str:
    """Say how many recognisers are better and worse for certain, from `signed_mcnemar`."""
    better, worse = int(np.sum((p >= 0.0) & (p < level))), int(np.sum((p < 0.0) & (p > -level)))
    return f"better in {better}, worse in {worse} of {p.size} recognisers at p < {level:g}"


INDEPENDENT = "McNemar's test takes windows for independent, which one person's are not"


def by_person(right: Array, person: Labels) -> Array:
    """Return the mean of `right` (n,) of each person, in order of their numbers."""
    return np.array([right[person == p].mean() for p in np.unique(person)])


def interval(values: Array) -> tuple[float, float]:
    """Return the 95 % interval of a mean over people (n,), by drawing people anew; always the same draws."""
    rng = np.random.default_rng(0)
    drawn = values[rng.integers(0, len(values), (BOOTSTRAPS, len(values)))].mean(axis=1)
    low, high = np.percentile(drawn, [2.5, 97.5])
    return float(low), float(high)


def with_interval(values: Array) -> str:
    """Say a mean over people (n,) with its interval, all with their signs."""
    low, high = interval(values)
    return f"{values.mean():+.1f} ({low:+.1f} to {high:+.1f})"
