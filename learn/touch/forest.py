"""A random forest as plain arrays: grown by scikit-learn, kept without pickle, walked by `kernels.touch.forest`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...sim.base.errors import InputError
from ...sim.base.extras import install_hint
from ...sim.base.types import Array, IntArray

#: Trees, leaves of each at most, and rows of a leaf at least. Splits are drawn at random (extremely randomised trees,
#: Geurts et al. 2006).
TREES, LEAVES, LEAST = 100, 256, 2


@dataclass(frozen=True)
class Forest:
    """The nodes of all trees.

    Attributes:
        root: First node of each tree, [trees].
        feature: Feature that a node asks, -1 at a leaf, [nodes].
        child: Left child of a node, the right one behind it; -1 at a leaf, [nodes].
        value: Threshold of a node, up to which the left child follows; share of contacts at a leaf, [nodes].
    """

    root: NDArray[np.int32]
    feature: NDArray[np.int32]
    child: NDArray[np.int32]
    value: NDArray[np.float32]

    def check(self, source: str, features: int) -> None:
        """Check that walks end: children behind their node, features that exist, shares between 0 and 1.

        Raises:
            InputError: They do not.
        """
        if not self._is_sound(features):
            raise InputError(source, "forest", "nodes that are no trees", "a model that bough touch train wrote")

    def _is_sound(self, features: int) -> bool:
        nodes, here = len(self.child), np.arange(len(self.child))
        if not (len(self.root) and self.child.shape == self.feature.shape == self.value.shape == (nodes,)):
            return False
        leaf = self.child < 0
        inner = (self.child > here) & (self.child < nodes - 1) & (self.feature >= 0) & (self.feature < features)
        share = self.value[leaf]
        found = [leaf | inner, np.diff(self.root) > 0, (self.root >= 0) & (self.root < nodes), np.isfinite(self.value)]
        return bool(all(f.all() for f in found) and ((share >= 0) & (share <= 1)).all())

    def device_rows(self, node: Any) -> tuple[Any, Any, Any]:
        """Return roots and depths of the trees, and all nodes as `kernels.touch.forest` walks them."""
        level = np.zeros(len(self.child), np.int32)
        inner = np.flatnonzero(self.child >= 0)
        for parent in inner:  # children lie behind their parents
            level[self.child[parent] : self.child[parent] + 2] = level[parent] + 1
        rows = np.zeros(len(self.child), node.numpy_dtype())
        leaf = self.child < 0
        rows["feature"], rows["share"] = np.maximum(self.feature, 0), np.where(leaf, self.value, 0.0)
        rows["child"] = np.where(leaf, np.arange(len(leaf)), self.child)
        rows["threshold"] = np.where(leaf, np.inf, self.value)
        tree = np.searchsorted(self.root, np.arange(len(leaf)), side="right") - 1
        depth = np.zeros(len(self.root), np.int32)
        np.maximum.at(depth, tree, level)
        return self.root, depth, rows

    def probability(self, x: Array) -> Array:
        """Return the mean share of contacts of the leaves that rows fall into, [N]; plain NumPy.

        Args:
            x: Features, [N, F], taken in single precision.
        """
        rows, single = np.arange(len(x)), x.astype(np.float32)
        total = np.zeros(len(x))
        for root in self.root:
            node = np.full(len(x), root)
            while (inner := self.child[node] >= 0).any():
                right = single[rows, np.maximum(self.feature[node], 0)] > self.value[node]
                node = np.where(inner, self.child[node] + right, node)
            total += self.value[node]
        return total / len(self.root)


def require_sklearn() -> Any:
    """Return scikit-learn's ensembles, or raise `InputError` that says how to install it."""
    try:
        from sklearn import ensemble
    except ImportError:
        raise InputError("touch", "", "no scikit-learn", install_hint("touch")) from None
    return ensemble


def grow_forest(x: Array, contact: IntArray, seed: int = 0) -> Forest:
    """Grow a forest on features [N, F] and labels 0 and 1 [N]."""
    ensemble = require_sklearn()
    grown = ensemble.ExtraTreesClassifier(TREES, min_samples_leaf=LEAST, max_leaf_nodes=LEAVES, random_state=seed).fit(
        x.astype(np.float32), contact
    )
    return packed([e.tree_ for e in grown.estimators_])


def packed(trees: list[Any]) -> Forest:
    """Return scikit-learn's trees with children side by side, level by level."""
    root: list[int] = []
    feature: list[int] = []
    child: list[int] = []
    value: list[float] = []
    for tree in trees:
        first = len(child)
        root.append(first)
        order = [0]
        share = tree.value[:, 0, 1] / tree.value[:, 0].sum(1)
        for node in order:  # grows meanwhile
            left, right = int(tree.children_left[node]), int(tree.children_right[node])
            feature.append(int(tree.feature[node]) if left >= 0 else -1)
            child.append(first + len(order) if left >= 0 else -1)
            value.append(_below(tree.threshold[node]) if left >= 0 else share[node])
            if left >= 0:
                order += [left, right]
    return Forest(np.array(root, np.int32), np.array(feature, np.int32), np.array(child, np.int32),
                  np.array(value, np.float32))  # fmt: skip


def _below(threshold: float) -> float:
    """Return the largest single-precision number up to a threshold, which splits single-precision numbers alike."""
    near = np.float32(threshold)
    return float(near if float(near) <= threshold else np.nextafter(near, np.float32(-np.inf)))
