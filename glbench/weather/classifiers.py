"""Classifier two-sample test for block boundaries: logistic regression and boosted trees.

Written out, to avoid a dependency on a machine-learning library. Labels are 0 and 1; both
return scores, the higher the more like 1.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from glbench.weather.record import FloatArray, IntArray

Labels = npt.NDArray[np.bool_]
RIDGE = 1.0
NEWTON_STEPS = 12
BINS = 32
TREES = 60
DEPTH = 3
RATE = 0.15
LEAF_RIDGE = 5.0


def area_under_curve(scores: FloatArray, labels: Labels) -> float:
    """Chance that a random 1 has a higher score than a random 0, ties counted half: 0.5 is guessing."""
    from scipy.stats import rankdata

    ones = int(labels.sum())
    zeros = labels.size - ones
    return float((rankdata(scores)[labels].sum() - ones * (ones + 1) / 2.0) / (ones * zeros))


def logistic(rows: FloatArray, labels: Labels, others: FloatArray) -> FloatArray:
    """Scores (m,) of ``others`` (m, features) by logistic regression with a ridge on ``rows`` (n, features), ``labels`` (n,)."""
    mean, scale = rows.mean(axis=0), np.maximum(rows.std(axis=0), 1e-9)
    x = np.column_stack([np.ones(len(rows)), (rows - mean) / scale])
    ridge = RIDGE * np.eye(x.shape[1])
    ridge[0, 0] = 0.0
    beta = np.zeros(x.shape[1])
    for _ in range(NEWTON_STEPS):
        chance = 1.0 / (1.0 + np.exp(-np.clip(x @ beta, -30.0, 30.0)))
        weight = np.maximum(chance * (1.0 - chance), 1e-9)
        beta += np.linalg.solve((x * weight[:, None]).T @ x + ridge, x.T @ (labels - chance) - ridge @ beta)
    return np.asarray(np.column_stack([np.ones(len(others)), (others - mean) / scale]) @ beta)


def boosted(rows: FloatArray, labels: Labels, others: FloatArray) -> FloatArray:
    """Scores (m,) of ``others`` (m, features) by gradient-boosted trees grown on ``rows`` (n, features), ``labels`` (n,)."""
    edges = [np.unique(np.quantile(column, np.linspace(0.0, 1.0, BINS + 1)[1:-1])) for column in rows.T]
    train, test = (_bins(x, edges) for x in (rows, others))
    fitted, scores = np.zeros(len(rows)), np.zeros(len(others))
    for _ in range(TREES):
        chance = 1.0 / (1.0 + np.exp(-fitted))
        on_train, on_test = _tree(train, labels - chance, chance * (1.0 - chance), test)
        fitted += RATE * on_train
        scores += RATE * on_test
    return scores


def _bins(rows: FloatArray, edges: list[FloatArray]) -> IntArray:
    return np.column_stack(
        [np.searchsorted(edge, column, side="left") for edge, column in zip(edges, rows.T, strict=True)]
    )


def _tree(
    train: IntArray, gradient: FloatArray, curvature: FloatArray, test: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Leaf values of one tree, grown level by level: for the rows it is grown on, and for others."""
    features = train.shape[1]
    node, node_of_test = np.zeros(len(train), dtype=np.int64), np.zeros(len(test), dtype=np.int64)
    place = train + BINS * np.arange(features)
    for level in range(DEPTH):
        cells = (place + (BINS * features) * node[:, None]).ravel()
        size = BINS * features * 2**level
        sums = [
            np.bincount(cells, np.repeat(weight, features), minlength=size)
            .reshape(2**level, features, BINS)
            .cumsum(axis=-1)
            for weight in (gradient, curvature)
        ]
        left_g, left_h = sums
        total_g, total_h = left_g[..., -1:], left_h[..., -1:]
        right_g, right_h = total_g - left_g, total_h - left_h
        gain = left_g**2 / (left_h + LEAF_RIDGE) + right_g**2 / (right_h + LEAF_RIDGE)
        best = gain.reshape(2**level, -1).argmax(axis=1)
        feature, cut = best // BINS, best % BINS
        node = 2 * node + (train[np.arange(len(train)), feature[node]] > cut[node])
        node_of_test = 2 * node_of_test + (test[np.arange(len(test)), feature[node_of_test]] > cut[node_of_test])
    leaves = 2**DEPTH
    leaf = np.bincount(node, gradient, minlength=leaves) / (np.bincount(node, curvature, minlength=leaves) + LEAF_RIDGE)
    return np.asarray(leaf[node]), np.asarray(leaf[node_of_test])
